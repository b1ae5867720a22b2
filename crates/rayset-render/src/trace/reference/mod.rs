//! The reference renderer: the same rays, samples, operators and lighting as the ray tracer, one
//! sample at a time, over brute-force fields in `f64`. It is slow by design and shares no code with
//! the ray tracer except the scene description and the closed forms of procedural fields. The steps
//! are a parameter ([`ReferenceSteps`]). The fields of clouds may be supplied from outside; the
//! renderer is then the discrete ray tracer with which samples of another engine are compared.

pub mod far;
mod grid;
mod maps;
mod sample;
mod shared;
mod steps;
mod tree;

use std::sync::Arc;

use self::sample::{Sample, combine};
use self::shared::SharedShadows;
use crate::field::reference::{ReferenceField, ReferenceSample};
use crate::field::{AttributeColumns, Kernel, Sight, linear_from_srgb};
use crate::scene::{
    Camera, CameraError, Channel, CloudObject, ColorRule, Compositing, GridObject, LightKind, Lighting,
    MAX_OPACITY, MOST_ATTRIBUTES, MapInput, Material, Node, OpacityRule, Operator, Procedural,
    RenderSettings, SOLID_OPACITY, Scene, Shape, Transfer,
};
use rayset_base::geometry::{Aabb, DAffine3, DMat3, DVec3, Ray};
use rayset_store::container::ScanError;

pub use self::steps::ReferenceSteps;

/// A pixel: premultiplied colour in linear light, and opacity.
pub type ReferencePixel = [f64; 4];

/// The purpose for which a field is sampled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// What is visible along a ray.
    Opacity,
    /// How much of a light reaches a sample.
    Shadow,
}

/// The field of a cloud, supplied by another engine that is to produce the same picture.
pub trait PointField {
    /// Announces a ray, in the cloud's space; the samples on it follow in this order.
    fn ray(&self, _ray: &Ray, _purpose: Purpose) {}

    /// The field at a position in the cloud's space. Attributes are those of all columns of the
    /// cloud's file, colours first, numbered as by [`AttributeColumns`]; empty if no point reaches
    /// the position.
    fn sample(&self, q: DVec3, purpose: Purpose) -> ReferenceSample;
}

/// A sample on a ray.
#[derive(Clone, Copy)]
struct Position<'r> {
    q: DVec3,
    ray: &'r Ray,
    /// The part of the ray that the sample stands for, by distances.
    interval: (f64, f64),
}

/// The source of a cloud's field.
enum Loaded<'a> {
    Points(ReferenceField),
    Given(&'a dyn PointField),
}

/// The source of a cloud's field, for one ray.
enum Along<'a> {
    /// The points that reach the ray.
    Near(ReferenceField),
    Given(&'a dyn PointField, Purpose),
    Nothing,
}

/// A scene whose clouds are in memory, as lists of points, or supplied from outside.
pub struct ReferenceRenderer<'a> {
    scene: &'a Scene,
    clouds: Vec<(*const Node, Loaded<'a>)>,
    grids: Vec<(*const Node, Vec<f32>)>,
    /// Names of the attributes that transfer functions read.
    names: Vec<Arc<str>>,
}

/// Why the reference renderer could not load a scene.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReferenceError {
    /// A cloud or a grid cannot be read.
    #[error(transparent)]
    File(#[from] ScanError),
}

/// The part of a graph that one ray can meet: fields without the points that are out of its reach.
enum ReachableNode<'a> {
    Cloud { object: &'a CloudObject, field: Along<'a> },
    Grid { object: &'a GridObject, voxels: &'a [f32] },
    Procedural(&'a dyn Procedural),
    Operator(Operator, Vec<SeenNode<'a>>),
}

struct SeenNode<'a> {
    seen: ReachableNode<'a>,
    local_from_world: DAffine3,
    transfers: &'a [Transfer],
    material: Material,
}

impl<'a> ReferenceRenderer<'a> {
    /// Reads all clouds and grids of a scene.
    ///
    /// # Errors
    /// [`ReferenceError`] if a file cannot be read or is damaged.
    pub fn load(scene: &'a Scene) -> Result<Self, ReferenceError> {
        let names = scene.root.attributes_read();
        let mut reference_renderer = Self { scene, clouds: Vec::new(), grids: Vec::new(), names };
        reference_renderer.load_node(&scene.root, &mut |_| None)?;
        Ok(reference_renderer)
    }

    /// As [`load`](Self::load), but with fields supplied from outside for the clouds of the scene.
    ///
    /// # Errors
    /// [`ReferenceError`] if a grid cannot be read.
    pub fn with_fields(
        scene: &'a Scene,
        mut field: impl FnMut(&CloudObject) -> &'a dyn PointField,
    ) -> Result<Self, ReferenceError> {
        let names = scene.root.attributes_read();
        let mut reference_renderer = Self { scene, clouds: Vec::new(), grids: Vec::new(), names };
        reference_renderer.load_node(&scene.root, &mut |object| Some(field(object)))?;
        Ok(reference_renderer)
    }

    fn load_node(
        &mut self,
        node: &Arc<Node>,
        given: &mut dyn FnMut(&CloudObject) -> Option<&'a dyn PointField>,
    ) -> Result<(), ReferenceError> {
        let known = |(at, _): &(*const Node, Loaded<'a>)| *at == Arc::as_ptr(node);
        match &node.shape {
            Shape::Cloud(object) if !self.clouds.iter().any(known) => {
                if let Some(field) = given(object) {
                    self.clouds.push((Arc::as_ptr(node), Loaded::Given(field)));
                    return Ok(());
                }
                let (kernel, normalised) = (object.kernel, object.normalised);
                let header = object.cloud.header();
                let everything = AttributeColumns {
                    color: header.has_color,
                    color_as_displayed: self.scene.compositing == Compositing::Display,
                    scalars: (0..header.attributes.len() + 3).collect(),
                    labels: Vec::new(),
                };
                let field = ReferenceField::load(&object.cloud, kernel, normalised, &everything)?;
                self.clouds.push((Arc::as_ptr(node), Loaded::Points(field)));
                Ok(())
            }
            Shape::Grid(object) => {
                self.grids.push((Arc::as_ptr(node), object.grid.load()?));
                Ok(())
            }
            Shape::Cloud(_) | Shape::Procedural(_) => Ok(()),
            Shape::Operator(_, children) => {
                children.iter().try_for_each(|child| self.load_node(child, given))
            }
        }
    }

    /// Sum of the shading vectors of a ray's samples, weighted by their contribution to the ray;
    /// not normalised.
    ///
    /// # Errors
    /// [`CameraError`] if the camera is invalid.
    pub fn normal(
        &self,
        camera: &Camera,
        settings: &RenderSettings,
        steps: &ReferenceSteps,
        x: u32,
        y: u32,
    ) -> Result<DVec3, CameraError> {
        let ray = camera.ray_maker(settings.width, settings.height)?.pixel_ray(x, y);
        let mut sum = DVec3::ZERO;
        let sample_offset = settings.sample_offset_of(x, y);
        self.march(
            settings,
            &ray,
            sample_offset,
            steps,
            (f64::INFINITY, Purpose::Opacity),
            |_, sample, share| {
                sum += sample.normal * share;
            },
        );
        Ok(sum)
    }

    /// Visits every sample of a ray before `end` that is not transparent, front to back; returns
    /// the remaining transmittance.
    fn march(
        &self,
        settings: &RenderSettings,
        ray: &Ray,
        sample_offset: f64,
        steps: &ReferenceSteps,
        (end, purpose): (f64, Purpose),
        mut visit: impl FnMut(DVec3, &Sample, f64),
    ) -> f64 {
        // Colours are of no importance.
        let along = (ray, purpose, None);
        let root = self.seen(&self.scene.root, &DAffine3::IDENTITY, Material::default(), along);
        let mut transmittance = 1.0;
        let samples = steps.samples(ray, sample_offset, &self.scene.root.bounds());
        for place in samples.into_iter().take_while(|sample| sample.t < end) {
            let q = ray.at(place.t);
            let sample = self.sample(&root, Position { q, ray, interval: place.interval() });
            let passed = self.passed(&sample, place.step);
            if passed >= 1.0 {
                continue;
            }
            visit(q, &sample, transmittance * (1.0 - passed));
            transmittance *= passed;
            if transmittance < f64::from(settings.stop_transmittance) {
                break;
            }
        }
        transmittance
    }

    /// Transmittance of one sample.
    fn passed(&self, sample: &Sample, step: f64) -> f64 {
        // All but splats have no more than the largest opacity.
        let extinction = -(1.0 - sample.opacity.min(1.0 - f64::EPSILON)).ln() / self.scene.unit_distance;
        (-extinction * step).exp()
    }

    fn seen<'s>(
        &'s self,
        node: &'s Arc<Node>,
        world_from_parent: &DAffine3,
        material: Material,
        (ray, purpose, sight): (&Ray, Purpose, Option<Sight>),
    ) -> SeenNode<'s> {
        let material = node.material.unwrap_or(material);
        let world_from_local = *world_from_parent * node.parent_from_local;
        let local_from_world = world_from_local.inverse();
        let seen = match &node.shape {
            Shape::Cloud(object) => {
                let local = Ray {
                    origin: local_from_world.transform_point3(ray.origin),
                    direction: local_from_world.transform_vector3(ray.direction).normalize(),
                };
                let known = self.clouds.iter().find(|(at, _)| *at == Arc::as_ptr(node));
                let field = match known {
                    Some((_, Loaded::Points(field))) => {
                        let sight = sight.map(|sight| sight.transformed(&local_from_world));
                        let (filter, sight) = (object.splat_filter, sight.as_ref());
                        let farther = |p| sight.map_or(0.0, |sight| filter.reach_in(&Aabb::new(p, p), sight));
                        Along::Near(field.near(&local, farther).seen(filter, sight))
                    }
                    Some((_, Loaded::Given(field))) => {
                        field.ray(&local, purpose);
                        Along::Given(*field, purpose)
                    }
                    None => Along::Nothing,
                };
                ReachableNode::Cloud { object, field }
            }
            Shape::Grid(object) => {
                let known = self.grids.iter().find(|(at, _)| *at == Arc::as_ptr(node));
                ReachableNode::Grid { object, voxels: known.map_or(&[], |(_, voxels)| voxels) }
            }
            Shape::Procedural(field) => ReachableNode::Procedural(&**field),
            Shape::Operator(operator, children) => {
                let seen = children
                    .iter()
                    .map(|child| self.seen(child, &world_from_local, material, (ray, purpose, sight)));
                ReachableNode::Operator(*operator, seen.collect())
            }
        };
        SeenNode { seen, local_from_world, transfers: &node.transfers, material }
    }

    fn sample(&self, node: &SeenNode<'_>, position: Position<'_>) -> Sample {
        let q = position.q;
        let mut sample = match &node.seen {
            ReachableNode::Cloud { object, field } => self.sample_cloud(node, object, field, position),
            ReachableNode::Grid { object, voxels } => self.sample_grid(node, object, voxels, q),
            ReachableNode::Procedural(field) => {
                let s = field.sample(node.local_from_world.transform_point3(q));
                let (normal, boundary) = surface(node, s.implicit, s.gradient);
                let opacity = s.opacity.clamp(0.0, MAX_OPACITY);
                let place = node.local_from_world.transform_point3(q);
                let attributes = self.attributes(|name| {
                    let index = field.attributes().iter().position(|own| *own == name)?;
                    Some(f64::from(field.attribute(index, place)))
                });
                let material = node.material.to_array();
                Sample { opacity, color: s.color, normal, boundary, material, attributes }
            }
            ReachableNode::Operator(operator, children) => {
                let samples: Vec<Sample> =
                    children.iter().map(|child| self.sample(child, position)).collect();
                combine(*operator, &samples, self.scene.unit_distance)
            }
        };
        for transfer in node.transfers {
            if !(sample.opacity > 0.0) {
                break;
            }
            let value = |channel: &Channel| match channel {
                Channel::Opacity => sample.opacity,
                Channel::Red => sample.color[0],
                Channel::Green => sample.color[1],
                Channel::Blue => sample.color[2],
                Channel::Attribute(name) => {
                    self.names.iter().position(|known| known == name).map_or(0.0, |at| sample.attributes[at])
                }
            };
            match transfer {
                Transfer::Opacity { input, curve } => {
                    sample.opacity = maps::line(curve, value(input), |&o| [o])[0].min(MAX_OPACITY);
                }
                Transfer::Color { input, map } => sample.color = maps::color(map, value(input)),
            }
        }
        sample
    }

    fn sample_cloud(
        &self,
        node: &SeenNode<'_>,
        object: &CloudObject,
        field: &Along<'_>,
        position: Position<'_>,
    ) -> Sample {
        let q = node.local_from_world.transform_point3(position.q);
        let are_splats = object.kernel == Kernel::Splat;
        let s = match field {
            Along::Near(field) if are_splats => {
                let origin = node.local_from_world.transform_point3(position.ray.origin);
                let direction = node.local_from_world.transform_vector3(position.ray.direction);
                field.interval(&Ray { origin, direction }, position.interval)
            }
            Along::Near(field) => field.sample(q),
            Along::Given(field, purpose) => field.sample(q, *purpose),
            Along::Nothing => ReferenceSample::default(),
        };
        let least = 1e-12 * object.largest_point_density();
        let sum = |channel: usize| s.attributes.get(channel).copied().unwrap_or(0.0);
        let mean = |channel: usize| if s.density > least { sum(channel) / s.density } else { 0.0 };
        let header = object.cloud.header();
        let scalar = |index: usize| mean(index + if header.has_color { 3 } else { 0 });
        let color = match &object.transfer.color {
            ColorRule::Uniform(c) => c.map(f64::from),
            ColorRule::Points => {
                let mean = [mean(0), mean(1), mean(2)];
                if self.displays() { mean.map(linear_from_srgb) } else { mean }
            }
            ColorRule::Map { map, input: MapInput::Attribute(index) } => maps::color(map, scalar(*index)),
            ColorRule::Map { map, input: MapInput::Density } => maps::color(map, s.density),
        };
        let attributes = self.attributes(|name| header.attribute_number(name).map(scalar));
        let unit = self.scene.unit_distance;
        let level = object.transfer.opacity.boundary_density(unit);
        let (normal, boundary) = surface(node, level - s.density, -s.gradient);
        let opacity = match &object.transfer.opacity {
            OpacityRule::Extinction(kappa) if are_splats => -(-kappa * s.density * unit).exp_m1(),
            rule => rule.opacity(s.density, unit),
        };
        Sample { opacity, color, normal, boundary, material: node.material.to_array(), attributes }
    }

    /// Whether display values are composited.
    fn displays(&self) -> bool {
        self.scene.compositing == Compositing::Display
    }

    /// The values of all attributes that are read anywhere, for one object; 0 for those it lacks.
    fn attributes(&self, mut of: impl FnMut(&str) -> Option<f64>) -> [f64; MOST_ATTRIBUTES] {
        let mut attributes = [0.0; MOST_ATTRIBUTES];
        for (value, name) in attributes.iter_mut().zip(&self.names) {
            *value = of(name).unwrap_or(0.0);
        }
        attributes
    }

    /// The light that a sample scatters toward the origin of the ray.
    fn lit(
        &self,
        settings: &RenderSettings,
        (ray, q): (&Ray, DVec3),
        sample: &Sample,
        sample_offset: f64,
        (steps, step): (&ReferenceSteps, f64),
        shadows: &mut SharedShadows,
    ) -> [f64; 3] {
        let Lighting::Lit(lights) = &self.scene.lighting else { return sample.color };
        let [ambient, diffuse, specular, shininess, ..] = sample.material;
        let view = -ray.direction;
        let mut sum = [0.0; 3];
        shadows.reaching.resize(lights.len(), 1.0);
        for (number, light) in lights.iter().enumerate() {
            let (toward, distance, strength) = match light.kind {
                LightKind::Ambient => {
                    for channel in 0..3 {
                        sum[channel] += sample.color[channel] * ambient * f64::from(light.color[channel]);
                    }
                    continue;
                }
                LightKind::Headlight => (view, f64::INFINITY, 1.0),
                LightKind::Directional { direction } => (-direction.normalize(), f64::INFINITY, 1.0),
                LightKind::Point { position, decays } => {
                    let toward = position - q;
                    let strength = if decays { (1.0 / toward.length_squared()).min(1e12) } else { 1.0 };
                    (toward.normalize_or(DVec3::Y), toward.length(), strength)
                }
            };
            let reaching = if light.throws_shadows() && shadows.are_taken {
                shadows.reaching[number]
            } else if light.throws_shadows() && distance > 0.0 {
                // A sample just behind a boundary is lit as if it lay on the boundary.
                let depth = -sample.boundary;
                let reach = steps.boundary_reach(step);
                // Solids do not shadow themselves, however fine their steps are.
                let is_solid = sample.opacity >= SOLID_OPACITY;
                let reach = if is_solid { reach.max(self.scene.unit_distance) } else { reach };
                let on_boundary = depth > 0.0 && depth <= reach;
                let place = if on_boundary { q + sample.normal * depth } else { q };
                let (toward, distance) = match light.kind {
                    LightKind::Point { position, .. } => {
                        ((position - place).normalize_or(DVec3::Y), position.distance(place))
                    }
                    _ => (toward, distance),
                };
                let from = Ray { origin: place + toward * (0.5 * step), direction: toward };
                let end = (distance - 0.5 * step, Purpose::Shadow);
                self.march(settings, &from, sample_offset, steps, end, |_, _, _| {})
            } else {
                1.0
            };
            shadows.reaching[number] = reaching;
            let n = sample.normal;
            if n == DVec3::ZERO {
                continue;
            }
            let half = toward + view;
            let cosine = if half.length() > 1e-6 { n.dot(half.normalize()).abs().min(1.0) } else { 0.0 };
            let highlight = if shininess == 0.0 { 1.0 } else { cosine.powf(shininess) };
            for channel in 0..3 {
                let given = sample.color[channel] * diffuse * n.dot(toward).abs() + specular * highlight;
                sum[channel] += given * strength * reaching * f64::from(light.color[channel]);
            }
        }
        sum
    }
}

/// Normal and signed distance of a boundary in world space, from the implicit function and its
/// gradient in local space.
fn surface(node: &SeenNode<'_>, implicit: f64, gradient: DVec3) -> (DVec3, f64) {
    let to_world: DMat3 = node.local_from_world.matrix3.transpose();
    let gradient = to_world * gradient;
    let length = gradient.length();
    // A gradient too small for single precision has no direction.
    let normal = if length >= f64::from(f32::MIN_POSITIVE) { gradient / length } else { DVec3::ZERO };
    (normal, implicit / length)
}
