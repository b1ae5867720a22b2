//! From where a picture is seen, and how large its pixels are.

use rayset_base::geometry::{Aabb, DAffine3, DVec3};

/// From where points are seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Eye {
    /// From a place.
    At(DVec3),
    /// All along one direction.
    Along(DVec3),
    /// Along rays that all go to a place, with pixels that are as wide everywhere.
    Toward(DVec3),
}

impl Eye {
    /// The direction from the eye to a place, of length one.
    #[must_use]
    pub fn toward(self, place: DVec3) -> DVec3 {
        let toward = match self {
            Self::At(eye) | Self::Toward(eye) => place - eye,
            Self::Along(direction) => direction,
        };
        toward.normalize_or(DVec3::Z)
    }
}

/// A picture's eye and its pixels, in one space; or those of the rays of a light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sight {
    /// From where it is seen.
    pub eye: Eye,
    /// The direction of the middle of the picture, of length one.
    pub forward: DVec3,
    /// Edge of a pixel: at the distance 1 in front of an eye at a place, otherwise everywhere.
    pub pixel: f64,
    /// The cosine of the angle between the middle and the corners of the picture.
    pub corner_cosine: f64,
    /// Whether what is seen is shown. It is not to lights: splats, which look different from
    /// everywhere, have the same shadow for everyone.
    pub is_shown: bool,
}

impl Sight {
    /// The same in another space. Where the map does not keep angles, pixels are what an eye in the
    /// other space has.
    #[must_use]
    pub fn transformed(self, map: &DAffine3) -> Self {
        let scale = map.matrix3.determinant().abs().cbrt();
        let (eye, scale) = match self.eye {
            Eye::At(place) => (Eye::At(map.transform_point3(place)), 1.0),
            Eye::Along(direction) => (Eye::Along(map.transform_vector3(direction)), scale),
            Eye::Toward(place) => (Eye::Toward(map.transform_point3(place)), scale),
        };
        let forward = map.transform_vector3(self.forward).normalize_or(DVec3::Z);
        Self { eye, forward, pixel: self.pixel * scale, ..self }
    }

    /// Edge of the square that a pixel covers at a place, across the way to it: the square root of
    /// its area. Outside the picture, pixels are those of its corners.
    ///
    /// At the distance d, in a direction with the cosine c to the middle, a pixel is p·d·c wide
    /// across the direction of the middle, and less by c toward it: its area is (p·d)²·c³.
    #[must_use]
    pub fn pixel_at(&self, place: DVec3) -> f64 {
        match self.eye {
            Eye::Along(_) | Eye::Toward(_) => self.pixel,
            Eye::At(eye) => {
                let (offset, distance) = (place - eye, place.distance(eye));
                // Not a number at the eye itself, which `max` leaves out.
                let cosine = (offset.dot(self.forward) / distance).max(self.corner_cosine);
                self.pixel * distance * cosine * cosine.sqrt()
            }
        }
    }

    /// No more than the edge of a pixel at any place in a box.
    #[must_use]
    pub fn least_pixel_in(&self, bounds: &Aabb) -> f64 {
        match self.eye {
            Eye::Along(_) | Eye::Toward(_) => self.pixel,
            Eye::At(eye) => {
                let nearest = eye.clamp(bounds.min, bounds.max);
                let cosine = self.corner_cosine;
                self.pixel * nearest.distance(eye) * cosine * cosine.sqrt()
            }
        }
    }

    /// No less than the edge of a pixel at any place in a box.
    #[must_use]
    pub fn largest_pixel_in(&self, bounds: &Aabb) -> f64 {
        match self.eye {
            Eye::Along(_) | Eye::Toward(_) => self.pixel,
            Eye::At(eye) => {
                let farthest = (bounds.center() - eye).abs() + bounds.size() * 0.5;
                self.pixel * farthest.length()
            }
        }
    }
}
