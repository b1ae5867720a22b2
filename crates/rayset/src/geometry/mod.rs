//! Boxes, rays and space-filling curves: what every later module measures with.
//!
//! Positions are `f64` in world space (the space of the input file). Nothing here knows about points,
//! pages or pictures.

mod beam;
mod bounds;
pub mod curve;

pub use beam::Beam;
pub use bounds::Aabb;
pub use glam::{DAffine3, DMat3, DQuat, DVec3};

/// A half-line in world space. `direction` has length one, so the parameter `t` is a world-space length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Where the ray starts, world space.
    pub origin: DVec3,
    /// Unit direction, world space.
    pub direction: DVec3,
}

impl Ray {
    /// The position at distance `t` from the origin.
    #[must_use]
    pub fn at(&self, t: f64) -> DVec3 {
        self.origin + self.direction * t
    }
}
