//! Bounds of many rays at once.

use super::{Aabb, DVec3, Ray};

/// A bound of a set of rays: at distance t from their origins, every one of them is within the box from
/// `origin_min + t·direction_min` to `origin_max + t·direction_max`. Right for any rays, where a cone is not.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Beam {
    origin_min: DVec3,
    origin_max: DVec3,
    direction_min: DVec3,
    direction_max: DVec3,
}

impl Beam {
    /// The bound of no rays, which any ray enlarges.
    pub const EMPTY: Self = Self {
        origin_min: DVec3::INFINITY,
        origin_max: DVec3::NEG_INFINITY,
        direction_min: DVec3::INFINITY,
        direction_max: DVec3::NEG_INFINITY,
    };

    /// Grows the bound to contain a ray, whose direction may have any length.
    pub fn include(&mut self, ray: &Ray) {
        self.origin_min = self.origin_min.min(ray.origin);
        self.origin_max = self.origin_max.max(ray.origin);
        self.direction_min = self.direction_min.min(ray.direction);
        self.direction_max = self.direction_max.max(ray.direction);
    }

    /// How much the directions of its rays differ along an axis, at most.
    #[must_use]
    pub fn spread(&self) -> f64 {
        (self.direction_max - self.direction_min).max_element()
    }

    /// The distances t ≥ 0 between which some ray may be in a box, or `None` if none meets it. Never too short.
    #[must_use]
    pub fn span(&self, bounds: &Aabb) -> Option<(f64, f64)> {
        // Each face of the bound that must not pass the opposite face of the box is one inequality a + b·t ≥ 0.
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
        // Far above the rounding of the quotients.
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
