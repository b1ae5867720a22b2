//! Bounds of sets of rays.

use super::{Aabb, DVec3, Ray};

/// Bound of a set of rays: at distance t from its origin, each ray lies within the box from
/// `origin_min + t·direction_min` to `origin_max + t·direction_max`. Unlike a bounding cone, it is
/// valid for any set of rays.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Beam {
    origin_min: DVec3,
    origin_max: DVec3,
    direction_min: DVec3,
    direction_max: DVec3,
}

impl Beam {
    /// The bound of no rays; including any ray enlarges it.
    pub const EMPTY: Self = Self {
        origin_min: DVec3::INFINITY,
        origin_max: DVec3::NEG_INFINITY,
        direction_min: DVec3::INFINITY,
        direction_max: DVec3::NEG_INFINITY,
    };

    /// Enlarges the bound to contain a ray. The ray's direction may have any length.
    #[inline]
    pub fn include(&mut self, ray: &Ray) {
        self.origin_min = self.origin_min.min(ray.origin);
        self.origin_max = self.origin_max.max(ray.origin);
        self.direction_min = self.direction_min.min(ray.direction);
        self.direction_max = self.direction_max.max(ray.direction);
    }

    /// The largest difference between the directions of the rays along any axis.
    #[must_use]
    #[inline]
    pub fn spread(&self) -> f64 {
        (self.direction_max - self.direction_min).max_element()
    }

    /// The longest edge of the bound of the rays at a distance.
    #[must_use]
    #[inline]
    pub fn width_at(&self, t: f64) -> f64 {
        let (origins, directions) =
            (self.origin_max - self.origin_min, self.direction_max - self.direction_min);
        (origins + directions * t).max_element()
    }

    /// The interval of distances t ≥ 0 in which some ray may be inside a box, or `None` if no ray
    /// meets it. Conservative.
    #[must_use]
    #[inline]
    pub fn span(&self, bounds: &Aabb) -> Option<(f64, f64)> {
        // On each axis, neither face of the bound may have passed the opposite face of the box: one
        // inequality a + b·t ≥ 0 for each face.
        let (mut enter, mut exit) = (0.0_f64, f64::INFINITY);
        let mut require = |a: f64, b: f64| {
            if b > 0.0 {
                enter = enter.max(-a / b);
            } else if b < 0.0 {
                exit = exit.min(-a / b);
            } else if a < 0.0 {
                exit = f64::NEG_INFINITY;
            }
        };
        for axis in 0..3 {
            require(bounds.max[axis] - self.origin_min[axis], -self.direction_min[axis]);
            require(self.origin_max[axis] - bounds.min[axis], self.direction_max[axis]);
        }
        // Much larger than the rounding error of the quotients.
        let slack = 1e-9 * enter;
        (enter - slack <= exit + slack).then_some((enter - slack, exit + slack))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn vector(size: f64) -> impl Strategy<Value = DVec3> {
        prop::array::uniform3(-size..size).prop_map(DVec3::from_array)
    }

    proptest! {
        #[test]
        fn a_beam_spans_whatever_its_rays_meet(
            rays in prop::collection::vec((vector(2.0), vector(1.0)), 1..8),
            corner in vector(3.0),
            size in prop::array::uniform3(0.0_f64..1.0),
        ) {
            let bounds = Aabb::new(corner, corner + DVec3::from_array(size));
            let rays: Vec<Ray> = rays
                .into_iter()
                .filter_map(|(origin, d)| d.try_normalize().map(|direction| Ray { origin, direction }))
                .collect();
            let mut beam = Beam::EMPTY;
            rays.iter().for_each(|ray| beam.include(ray));
            for (enter, exit) in rays.iter().filter_map(|ray| bounds.clip(ray)) {
                let span = beam.span(&bounds);
                prop_assert!(span.is_some_and(|(from, to)| from <= enter && to >= exit), "{span:?}");
            }
        }
    }
}
