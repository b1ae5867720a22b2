//! Rays.

use super::DVec3;

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
