//! Rays.

use super::DVec3;

/// A half-line. Unless stated otherwise it is in world space and `direction` has length one, so
/// that `t` is a length in world space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Origin of the ray.
    pub origin: DVec3,
    /// Direction of the ray.
    pub direction: DVec3,
}

impl Ray {
    /// The position at parameter `t`.
    #[must_use]
    #[inline]
    pub fn at(&self, t: f64) -> DVec3 {
        self.origin + self.direction * t
    }
}
