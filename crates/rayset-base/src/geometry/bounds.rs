//! Axis-aligned bounding boxes.

use super::{DAffine3, DVec3, Ray};

/// An axis-aligned bounding box, in world space or in the local space of an object. Empty if `min`
/// exceeds `max` on any axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aabb {
    /// The corner with the smallest coordinates.
    pub min: DVec3,
    /// The corner with the largest coordinates.
    pub max: DVec3,
}

impl Aabb {
    /// The empty box; including any point enlarges it.
    pub const EMPTY: Self = Self { min: DVec3::INFINITY, max: DVec3::NEG_INFINITY };

    /// A box with the given corners.
    #[must_use]
    #[inline]
    pub fn new(min: DVec3, max: DVec3) -> Self {
        Self { min, max }
    }

    /// Whether the box is empty.
    #[must_use]
    #[inline]
    pub fn is_empty(&self) -> bool {
        self.min.cmpgt(self.max).any()
    }

    /// Enlarges the box to contain `p`.
    #[inline]
    pub fn include(&mut self, p: DVec3) {
        self.min = self.min.min(p);
        self.max = self.max.max(p);
    }

    /// The smallest box that contains both boxes.
    #[must_use]
    #[inline]
    pub fn union(self, other: Self) -> Self {
        Self { min: self.min.min(other.min), max: self.max.max(other.max) }
    }

    /// The intersection of both boxes; empty if they are disjoint.
    #[must_use]
    #[inline]
    pub fn intersection(self, other: Self) -> Self {
        Self { min: self.min.max(other.min), max: self.max.min(other.max) }
    }

    /// A box that contains the image of this one under an affine map. If this one is infinite on
    /// any axis, the result is infinite on all, unless the map is the identity.
    #[must_use]
    pub fn transformed(self, map: &DAffine3) -> Self {
        if *map == DAffine3::IDENTITY || self.is_empty() {
            return self;
        }
        if !self.size().is_finite() {
            return Self::new(DVec3::NEG_INFINITY, DVec3::INFINITY);
        }
        let center = map.transform_point3(self.center());
        let half = self.size() * 0.5;
        let m = map.matrix3;
        let reach = m.x_axis.abs() * half.x + m.y_axis.abs() * half.y + m.z_axis.abs() * half.z;
        // Much larger than the rounding error of the products.
        let slack = 1e-12 * (center.abs() + reach);
        Self { min: center - reach - slack, max: center + reach + slack }
    }

    /// The box enlarged by `margin` on every side.
    #[must_use]
    #[inline]
    pub fn inflated(self, margin: f64) -> Self {
        Self { min: self.min - margin, max: self.max + margin }
    }

    /// Centre of the box, which must not be empty.
    #[must_use]
    #[inline]
    pub fn center(&self) -> DVec3 {
        (self.min + self.max) * 0.5
    }

    /// Edge lengths.
    #[must_use]
    #[inline]
    pub fn size(&self) -> DVec3 {
        self.max - self.min
    }

    /// Whether `p` lies in the box or on its faces.
    #[must_use]
    #[inline]
    pub fn contains(&self, p: DVec3) -> bool {
        p.cmpge(self.min).all() && p.cmple(self.max).all()
    }

    /// Whether `other` is empty or lies in this box; faces may touch.
    #[must_use]
    #[inline]
    pub fn encloses(&self, other: &Self) -> bool {
        other.is_empty() || (self.contains(other.min) && self.contains(other.max))
    }

    /// The interval of `t` (clipped to `t ≥ 0`) in which the ray is inside the box, or `None` if it
    /// misses the box.
    #[doc(hidden)]
    #[must_use]
    #[inline]
    pub fn clip(&self, ray: &Ray) -> Option<(f64, f64)> {
        let (mut t_enter, mut t_exit) = (0.0_f64, f64::INFINITY);
        for axis in 0..3 {
            let (o, d) = (ray.origin[axis], ray.direction[axis]);
            if d == 0.0 {
                if o < self.min[axis] || o > self.max[axis] {
                    return None;
                }
                continue;
            }
            let (a, b) = ((self.min[axis] - o) / d, (self.max[axis] - o) / d);
            t_enter = t_enter.max(a.min(b));
            t_exit = t_exit.min(a.max(b));
        }
        (t_enter <= t_exit).then_some((t_enter, t_exit))
    }
}
