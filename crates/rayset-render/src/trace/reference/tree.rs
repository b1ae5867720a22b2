//! The tree of rays of a pixel: reflection and refraction, ray by ray and sample by sample.

use super::shared::SharedShadows;
use super::steps::Place;
use super::{Position, Purpose, ReferencePixel, ReferenceRenderer, ReferenceSteps};
use crate::field::{Sight, linear_from_srgb};
use crate::image::srgb_from_linear;
use crate::scene::{Camera, CameraError, Lighting, Material, Node, RenderSettings, Shape, largest_stretch};
use rayset_base::geometry::{Aabb, DAffine3, DVec3, Ray};

/// If the reflected light contributes less than this to the pixel, the sample shows its own colour.
const LEAST_REFLECTED: f64 = 1.0 / 256.0;
/// Rays that contribute less than this to the pixel are not followed.
const LEAST_PASSED: f64 = 1.0 / 4096.0;

/// A ray of the tree, with its state.
pub(super) struct Course {
    ray: Ray,
    /// Fraction of the ray's light that reaches the pixel.
    weight: f64,
    /// Refractive index at the ray's origin.
    index: f64,
    /// Normal of the boundary at the ray's origin.
    normal: DVec3,
    depth: u32,
    /// How the picture is seen.
    sight: Sight,
}

impl Course {
    pub(super) fn from_eye(ray: Ray, sight: Sight) -> Self {
        Self { ray, weight: 1.0, index: 1.0, normal: DVec3::ZERO, depth: 0, sight }
    }
}

/// Consecutive samples that reflect.
#[derive(Default)]
struct Mirror {
    weight: f64,
    /// The step of the last of them.
    step: f64,
    place: DVec3,
    normal: DVec3,
    color: DVec3,
}

impl ReferenceRenderer<'_> {
    /// The bounds of the scene, as far as splats reach for those who see them.
    fn bounds_seen(&self, sight: &Sight) -> Aabb {
        fn reach(node: &Node, world_from_parent: &DAffine3, sight: &Sight) -> f64 {
            let world_from_local = *world_from_parent * node.parent_from_local;
            match &node.shape {
                Shape::Cloud(object) => {
                    let sight = sight.transformed(&world_from_local.inverse());
                    object.splat_filter.reach_in(&object.bounds(), &sight)
                        * largest_stretch(&world_from_local)
                }
                Shape::Operator(_, children) => {
                    children.iter().map(|child| reach(child, &world_from_local, sight)).fold(0.0, f64::max)
                }
                Shape::Grid(_) | Shape::Procedural(_) => 0.0,
            }
        }
        let root = &self.scene.root;
        root.bounds().inflated(reach(root, &DAffine3::IDENTITY, sight))
    }

    /// Renders one pixel.
    ///
    /// # Errors
    /// [`CameraError`] if the camera is invalid.
    pub fn pixel(
        &self,
        camera: &Camera,
        settings: &RenderSettings,
        steps: &ReferenceSteps,
        x: u32,
        y: u32,
    ) -> Result<ReferencePixel, CameraError> {
        let maker = camera.ray_maker(settings.width, settings.height)?;
        let ray = maker.pixel_ray(x, y);
        let sample_offset = settings.sample_offset_of(x, y);
        let eye = Course::from_eye(ray, maker.sight());
        let (color, transmittance) = self.follow(settings, &eye, sample_offset, steps);
        let composited = |light: f64| if self.displays() { srgb_from_linear(light) } else { light };
        let pixel = match self.scene.background {
            Some(b) => {
                let behind = |c: usize| color[c] + transmittance * composited(f64::from(b[c]));
                [behind(0), behind(1), behind(2), 1.0]
            }
            None => [color[0], color[1], color[2], 1.0 - transmittance],
        };
        let [red, green, blue, opacity] = pixel;
        if !self.displays() || opacity <= 0.0 {
            return Ok(pixel);
        }
        let [red, green, blue] = [red, green, blue].map(|v| linear_from_srgb(v / opacity) * opacity);
        Ok([red, green, blue, opacity])
    }

    /// The light of a ray and of all rays that follow from it, and the fraction of the background
    /// that is visible.
    pub(super) fn follow(
        &self,
        settings: &RenderSettings,
        course: &Course,
        sample_offset: f64,
        steps: &ReferenceSteps,
    ) -> ([f64; 3], f64) {
        let ray = &course.ray;
        let along = (ray, Purpose::Opacity, Some(course.sight));
        let root = self.seen(&self.scene.root, &DAffine3::IDENTITY, Material::default(), along);
        let turns = course.depth < settings.max_depth && self.scene.lighting != Lighting::Unlit;
        let mut light = DVec3::ZERO;
        let mut transmittance = 1.0;
        let mut mirror: Option<Mirror> = None;
        let mut shadows = SharedShadows::default();
        let mut index = course.index;
        // For the last sample inside: distance along the ray, normal, distance to the boundary,
        // reflectance.
        let mut inside = (0.0, course.normal, 0.0, 0.0);
        // One sample more after the last, in empty space.
        let samples = steps.samples(ray, sample_offset, &self.bounds_seen(&course.sight));
        let none = Place { t: -f64::INFINITY, step: steps.coarsest_world(), number: 0 };
        let last = samples.last().copied().unwrap_or(none);
        let beyond = Place { t: (last.t + last.step).max(0.0), ..last };
        for place in samples.into_iter().chain([beyond]) {
            let Place { t, step, number } = place;
            let q = ray.at(t);
            let sample = self.sample(&root, Position { q, ray, interval: place.interval() });
            if turns {
                let is_inside = sample.opacity > 0.0 && sample.boundary < 0.0;
                let here = if is_inside { sample.material[5] } else { 1.0 };
                let at =
                    if is_inside { (t, sample.normal, -sample.boundary, sample.material[4]) } else { inside };
                if is_inside {
                    inside = at;
                }
                let (before, cosine) = (index, at.1.dot(ray.direction).abs());
                index = here;
                if here != before && cosine != 0.0 {
                    let way = (at.2 / cosine).min(step);
                    let t = if is_inside { (at.0 - way).max(0.0) } else { at.0 + way };
                    light += self.reflected(settings, course, mirror.take(), sample_offset, steps);
                    let go_on = |direction, index, weight| {
                        let ray = Ray { origin: ray.at(t), direction };
                        let next = Course {
                            ray,
                            weight,
                            index,
                            normal: at.1,
                            depth: course.depth + 1,
                            sight: course.sight,
                        };
                        self.follow(settings, &next, sample_offset, steps)
                    };
                    let mut weight = transmittance;
                    let back = ray.direction.reflect(at.1);
                    let bent = bent(ray.direction, at.1, before / here);
                    if bent.is_some() && at.3 > 0.0 && course.weight * weight * at.3 >= LEAST_REFLECTED {
                        let (color, open) = go_on(back, before, course.weight * weight * at.3);
                        light += weight * at.3 * (DVec3::from_array(color) + open * self.behind());
                        weight *= 1.0 - at.3;
                    }
                    if course.weight * weight < LEAST_PASSED {
                        return (light.to_array(), 0.0);
                    }
                    let (direction, index) = bent.map_or((back, before), |bent| (bent, here));
                    let (color, open) = go_on(direction, index, course.weight * weight);
                    return ((light + weight * DVec3::from_array(color)).to_array(), weight * open);
                }
            }
            let passed = self.passed(&sample, step);
            if passed >= 1.0 {
                light += self.reflected(settings, course, mirror.take(), sample_offset, steps);
                continue;
            }
            let share = transmittance * (1.0 - passed);
            shadows.comes_to((number, step), course.weight * share);
            let lit = self.lit(settings, (ray, q), &sample, sample_offset, (steps, step), &mut shadows);
            let lit = if self.displays() { lit.map(srgb_from_linear) } else { lit };
            let own = share * DVec3::from_array(lit);
            let reflectance = if turns && sample.material[5] == 1.0 { sample.material[4] } else { 0.0 };
            light += (1.0 - reflectance) * own;
            if reflectance > 0.0 {
                if mirror.as_ref().is_some_and(|m| m.normal.dot(sample.normal) <= 0.0) {
                    light += self.reflected(settings, course, mirror.take(), sample_offset, steps);
                }
                let mirror = mirror.get_or_insert_default();
                let weight = share * reflectance;
                let depth = -sample.boundary;
                let reach = self.scene.unit_distance.max(steps.boundary_reach(step));
                let lift = if depth > 0.0 && depth <= reach { depth } else { 0.0 };
                mirror.weight += weight;
                mirror.step = step;
                mirror.place += weight * (q + lift * sample.normal);
                mirror.normal += weight * sample.normal;
                mirror.color += reflectance * own;
            } else {
                light += self.reflected(settings, course, mirror.take(), sample_offset, steps);
            }
            transmittance *= passed;
            if transmittance < f64::from(settings.stop_transmittance) {
                break;
            }
        }
        light += self.reflected(settings, course, mirror.take(), sample_offset, steps);
        (light.to_array(), transmittance)
    }

    /// The light reflected by consecutive samples, multiplied by their weight.
    fn reflected(
        &self,
        settings: &RenderSettings,
        course: &Course,
        mirror: Option<Mirror>,
        sample_offset: f64,
        steps: &ReferenceSteps,
    ) -> DVec3 {
        let Some(mirror) = mirror else { return DVec3::ZERO };
        let weight = course.weight * mirror.weight;
        let Some(normal) = mirror.normal.try_normalize().filter(|_| weight >= LEAST_REFLECTED) else {
            return mirror.color;
        };
        let direction = course.ray.direction.reflect(normal);
        let ray = Ray { origin: mirror.place / mirror.weight + 0.5 * mirror.step * direction, direction };
        let next = Course { ray, weight, index: 1.0, normal, depth: course.depth + 1, sight: course.sight };
        let (color, open) = self.follow(settings, &next, sample_offset, steps);
        mirror.weight * (DVec3::from_array(color) + open * self.behind())
    }

    fn behind(&self) -> DVec3 {
        DVec3::from_array(self.scene.background.unwrap_or_default().map(f64::from))
    }
}

/// The refracted direction; `None` for total internal reflection.
fn bent(direction: DVec3, normal: DVec3, ratio: f64) -> Option<DVec3> {
    let normal = if direction.dot(normal) > 0.0 { -normal } else { normal };
    Some(direction.refract(normal, ratio)).filter(|bent| *bent != DVec3::ZERO)
}
