//! Cameras: where rays start and in which direction they go.

use crate::field::{Eye, Sight};
use rayset_base::geometry::{Aabb, DVec3, Ray};

/// How points of the image plane are mapped to rays.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum Projection {
    /// All rays start at the eye.
    Perspective {
        /// Vertical field of view in radians, between 0 and π.
        fovy: f64,
    },
    /// All rays are parallel.
    Orthographic {
        /// Height of the picture in world units.
        height: f64,
    },
}

/// A camera; names follow ANARI.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// The eye, or the centre of the image plane of an orthographic camera; world space.
    pub position: DVec3,
    /// Viewing direction, world space; of any length except zero.
    pub direction: DVec3,
    /// A direction that points up in the picture, world space; not parallel to `direction`.
    pub up: DVec3,
    /// Perspective or orthographic.
    pub projection: Projection,
}

/// Largest coordinate of a camera's position. A camera that frames a scene may be farther away than
/// anything in the scene, so this is larger than the limit for the scene.
const FARTHEST_EYE: f64 = 1e30;

/// The unit vector in the direction of `v`, whatever the length of `v`; `None` if `v` is zero or
/// not finite.
fn unit(v: DVec3) -> Option<DVec3> {
    // Divided by its largest component, the vector has a length that can be squared without
    // overflow or underflow.
    let largest = v.abs().max_element();
    v.try_normalize().or_else(|| (v / largest).try_normalize().filter(|_| v.is_finite()))
}

/// Why a camera is invalid.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum CameraError {
    /// The viewing direction is zero or not finite, or the position is out of range.
    #[error("the camera's direction is zero or not finite, or its position beyond 1e30")]
    Direction,
    /// The up direction does not determine the roll of the camera.
    #[error("the camera's up direction is parallel to its viewing direction, zero or not finite")]
    Up,
    /// The field of view or height is out of range.
    #[error("the camera's field of view must lie between 0 and 180 degrees, its height above 0")]
    Projection,
}

/// How wide a pixel is along a ray, world space.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Footprint {
    /// Where the ray starts.
    pub(crate) width: f32,
    /// By how much it grows per unit of distance.
    pub(crate) spread: f32,
}

impl Footprint {
    /// Its width at a distance along the ray.
    #[inline(always)]
    pub(crate) fn at(self, t: f64) -> f64 {
        f64::from(self.width) + f64::from(self.spread) * t
    }

    /// That of a ray that starts at a distance along this one.
    pub(crate) fn from(self, t: f64) -> Self {
        Self { width: self.at(t) as f32, ..self }
    }
}

/// A camera prepared for a picture of a given size; generates the rays of its pixels.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RayMaker {
    camera: Camera,
    forward: DVec3,
    right: DVec3,
    up: DVec3,
    size: [f64; 2],
    /// Half the height of the image plane: at distance 1 for a perspective camera, in world units
    /// for an orthographic one.
    half_height: f64,
}

impl Camera {
    /// A perspective camera at `position` that looks at `target`, with the vertical field of view
    /// `fovy` in radians.
    #[must_use]
    pub fn look_at(position: DVec3, target: DVec3, up: DVec3, fovy: f64) -> Self {
        Self { position, direction: target - position, up, projection: Projection::Perspective { fovy } }
    }

    /// A camera that looks along `toward` and sees all of `bounds`.
    #[must_use]
    pub fn framing(
        bounds: &Aabb,
        toward: DVec3,
        up: DVec3,
        fovy: f64,
        aspect: f64,
        orthographic: bool,
    ) -> Self {
        let direction = toward.normalize_or(DVec3::NEG_Z);
        let right = direction.cross(up).normalize_or(direction.any_orthonormal_vector());
        let upward = right.cross(direction);
        let (center, half) = (bounds.center(), bounds.size() * 0.5);
        let half_extent = |axis: DVec3| axis.abs().dot(half).max(1e-300);
        let (width, height) = (half_extent(right), half_extent(upward));
        /// Factor by which the image is larger than the object, to leave a margin around it.
        const MARGIN: f64 = 1.04;
        let half_height = MARGIN * height.max(width / aspect);
        let tangent = (fovy * 0.5).tan();
        // Nearer corners look larger: the camera moves back until every corner fits.
        let mut distance = 0.0_f64;
        for corner in 0..8 {
            let sign = |bit: i32| if corner >> bit & 1 == 0 { -1.0 } else { 1.0 };
            let offset = half * DVec3::new(sign(0), sign(1), sign(2));
            let spread = (offset.dot(upward).abs()).max(offset.dot(right).abs() / aspect) * MARGIN;
            distance = distance.max(spread / tangent - offset.dot(direction));
        }
        let projection = if orthographic {
            Projection::Orthographic { height: 2.0 * half_height }
        } else {
            Projection::Perspective { fovy }
        };
        let depth = half_extent(direction);
        let distance = if orthographic { 2.0 * depth + half_height } else { distance.max(depth * 1e-3) };
        Self { position: center - direction * distance, direction, up: upward, projection }
    }

    /// Checks that the camera can generate rays.
    ///
    /// # Errors
    /// [`CameraError`] if a direction, the position or the projection is invalid.
    pub fn check(&self) -> Result<(), CameraError> {
        self.ray_maker(1, 1).map(drop)
    }

    /// Checks the camera and prepares it for a picture.
    pub(crate) fn ray_maker(&self, width: u32, height: u32) -> Result<RayMaker, CameraError> {
        let in_range = self.position.abs().max_element() <= FARTHEST_EYE;
        let forward = unit(self.direction).filter(|_| in_range).ok_or(CameraError::Direction)?;
        // If the two are parallel within rounding error, the roll is undetermined.
        let sine = unit(self.up).map_or(0.0, |up| forward.cross(up).length());
        let right = unit(forward.cross(self.up)).filter(|_| sine > 1e-12).ok_or(CameraError::Up)?;
        let fits = match self.projection {
            Projection::Perspective { fovy } => fovy > 0.0 && fovy < std::f64::consts::PI,
            Projection::Orthographic { height } => (1.0 / FARTHEST_EYE..=FARTHEST_EYE).contains(&height),
        };
        if !fits {
            return Err(CameraError::Projection);
        }
        let up = right.cross(forward);
        let size = [f64::from(width), f64::from(height)];
        let half_height = match self.projection {
            Projection::Perspective { fovy } => (fovy * 0.5).tan(),
            Projection::Orthographic { height } => height * 0.5,
        };
        Ok(RayMaker { camera: *self, forward, right, up, size, half_height })
    }
}

impl RayMaker {
    /// The ray through a point of the picture, given in pixels from its upper left corner.
    pub(crate) fn ray(&self, x: f64, y: f64) -> Ray {
        let [width, height] = self.size;
        // Picture coordinates in units of half the picture's height, up and right positive.
        let (u, v) = ((2.0 * x - width) / height, 1.0 - 2.0 * y / height);
        let across = (self.right * u + self.up * v) * self.half_height;
        match self.camera.projection {
            Projection::Perspective { .. } => {
                Ray { origin: self.camera.position, direction: (self.forward + across).normalize() }
            }
            Projection::Orthographic { .. } => {
                Ray { origin: self.camera.position + across, direction: self.forward }
            }
        }
    }

    /// How the picture is seen.
    pub(crate) fn sight(&self) -> Sight {
        let eye = match self.camera.projection {
            Projection::Perspective { .. } => Eye::At(self.camera.position),
            Projection::Orthographic { .. } => Eye::Along(self.forward),
        };
        let corner = self.ray(0.0, 0.0).direction;
        let (forward, pixel) = (self.forward, self.pixel());
        Sight { eye, forward, pixel, corner_cosine: corner.dot(forward), is_shown: true }
    }

    /// Edge of a pixel: of a perspective at the distance 1 in front of the eye.
    fn pixel(&self) -> f64 {
        2.0 * self.half_height / self.size[1]
    }

    /// Projects a position to the picture, in pixels from its upper left corner; `None` if it is
    /// not in front of the eye.
    pub(crate) fn project(&self, p: DVec3) -> Option<(f64, f64)> {
        let [width, height] = self.size;
        let offset = p - self.camera.position;
        let (u, v) = (offset.dot(self.right), offset.dot(self.up));
        let half = match self.camera.projection {
            Projection::Perspective { .. } => {
                let depth = offset.dot(self.forward);
                if depth <= 0.0 {
                    return None;
                }
                depth * self.half_height
            }
            Projection::Orthographic { .. } => self.half_height,
        };
        Some(((u / half * height + width) * 0.5, (1.0 - v / half) * height * 0.5))
    }

    /// How wide a pixel is along one of its rays.
    pub(crate) fn footprint(&self, ray: &Ray) -> Footprint {
        let pixel = self.pixel() as f32;
        match self.camera.projection {
            // On a plane in front of the eye all pixels are alike; the plane is nearer than the
            // distance says.
            Projection::Perspective { .. } => {
                Footprint { width: 0.0, spread: pixel * ray.direction.dot(self.forward) as f32 }
            }
            Projection::Orthographic { .. } => Footprint { width: pixel, spread: 0.0 },
        }
    }

    /// The ray through the centre of a pixel.
    pub(crate) fn pixel_ray(&self, x: u32, y: u32) -> Ray {
        self.ray(f64::from(x) + 0.5, f64::from(y) + 0.5)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use rayset_base::geometry::DAffine3;

    fn camera(projection: Projection) -> Camera {
        let (position, direction) = (DVec3::new(1.0, -2.0, 0.5), DVec3::new(0.2, 1.0, -0.1));
        Camera { position, direction, up: DVec3::Z, projection }
    }

    proptest! {
        #[test]
        fn a_pixel_has_the_area_that_its_corners_enclose(
            x in 0.0..600.0_f64,
            y in 0.0..400.0_f64,
            distance in 0.1..100.0_f64,
            is_orthographic: bool,
        ) {
            let projection = if is_orthographic {
                Projection::Orthographic { height: 3.0 }
            } else {
                Projection::Perspective { fovy: 1.2 }
            };
            let rays = camera(projection).ray_maker(600, 400).expect("a camera");
            let ray = rays.ray(x, y);
            let place = ray.at(distance);
            // Where rays through the neighbours cross the plane across the ray.
            let crossed = |dx: f64, dy: f64| {
                let other = rays.ray(x + dx, y + dy);
                let t = (place - other.origin).dot(ray.direction) / other.direction.dot(ray.direction);
                other.at(t)
            };
            let across = crossed(0.5, 0.0) - crossed(-0.5, 0.0);
            let down = crossed(0.0, 0.5) - crossed(0.0, -0.5);
            let area = across.cross(down).length();
            let edge = rays.sight().pixel_at(place);
            prop_assert!((edge * edge / area - 1.0).abs() < 1e-4, "{} and {area}", edge * edge);
            let bounds = Aabb::new(place - 0.1, place + 0.1);
            prop_assert!(rays.sight().largest_pixel_in(&bounds) >= edge);
        }

        #[test]
        fn a_scaled_and_turned_space_has_pixels_that_are_scaled(
            scale in 0.01..100.0_f64,
            angle in -3.0..3.0_f64,
            place in prop::array::uniform3(-5.0..5.0_f64),
            is_orthographic: bool,
        ) {
            let projection = if is_orthographic {
                Projection::Orthographic { height: 3.0 }
            } else {
                Projection::Perspective { fovy: 1.2 }
            };
            let sight = camera(projection).ray_maker(60, 40).expect("a camera").sight();
            let map = DAffine3::from_scale(DVec3::splat(scale))
                * DAffine3::from_rotation_y(angle)
                * DAffine3::from_translation(DVec3::new(3.0, 1.0, -2.0));
            let place = DVec3::from_array(place);
            let there = sight.transformed(&map).pixel_at(map.transform_point3(place));
            prop_assert!((there / (scale * sight.pixel_at(place)) - 1.0).abs() < 1e-9);
        }
    }
}
