//! Up to sixty-four rays, tested against boxes together.

use std::ops::Range;

use fearless_simd::f32x16;
use fearless_simd::prelude::*;

use super::packet::LANES;
use super::simd::{SimdLevel, dispatch};
use rayset_base::geometry::{Aabb, DVec3, Ray};

/// Rays stored by columns, prepared for tests against boxes.
#[derive(Clone, Debug)]
pub struct RayColumns {
    simd: SimdLevel,
    /// The position that origins are relative to, so that single precision suffices wherever the
    /// scene is.
    base: DVec3,
    origin: [[f32; LANES]; 3],
    inverse_direction: [[f32; LANES]; 3],
    /// Largest coordinate of an origin relative to the base.
    spread: f64,
}

/// Some of the rays in columns: where each begins, which is at infinity for others.
#[derive(Clone, Debug)]
pub struct ChosenRays {
    lanes: u64,
    begin: [f32; LANES],
}

impl ChosenRays {
    /// Those of some lanes.
    #[must_use]
    pub fn new(lanes: u64) -> Self {
        let begin = |lane| if lanes >> lane & 1 == 1 { 0.0 } else { f32::INFINITY };
        Self { lanes, begin: std::array::from_fn(begin) }
    }
}

/// Which of the chosen rays come within a small margin of a box, and where.
#[derive(Clone, Copy, Debug)]
pub struct Near {
    /// A bit for each such ray.
    pub lanes: u64,
    /// Distance at which each of them comes within the margin.
    pub enter: [f32; LANES],
    /// Distance at which each of them leaves it.
    pub exit: [f32; LANES],
    /// The least and the largest of these distances: infinity and 0 if there are none.
    pub span: (f32, f32),
}

/// Which rays meet a box, and where.
#[derive(Clone, Copy, Debug)]
pub struct Crossing {
    /// Rays that come within a margin of the box; a bit for each.
    pub near: u64,
    /// Rays that pass through the box itself; a bit for each.
    pub through: u64,
    /// Distance at which each ray of `near` comes within the margin.
    pub enter_near: [f32; LANES],
    /// Distance at which each ray of `through` leaves the box.
    pub exit: [f32; LANES],
    /// Length of each ray of `through` inside the box.
    pub length: [f32; LANES],
}

/// A box relative to the base of the rays, and the margin around it.
struct Narrowed {
    low: [f32; 3],
    high: [f32; 3],
    margin: f32,
}

impl RayColumns {
    /// Columns of at most 64 rays; unused columns repeat the last ray.
    ///
    /// Panics if there are no rays.
    #[must_use]
    pub fn new(simd: SimdLevel, rays: impl IntoIterator<Item = Ray>) -> Self {
        let mut rays = rays.into_iter().take(LANES);
        let mut ray = rays.next().expect("at least one ray");
        let mut columns = Self {
            simd,
            base: ray.origin,
            origin: [[0.0; LANES]; 3],
            inverse_direction: [[0.0; LANES]; 3],
            spread: 0.0,
        };
        for lane in 0..LANES {
            let offset = ray.origin - columns.base;
            columns.spread = columns.spread.max(offset.abs().max_element());
            for axis in 0..3 {
                columns.origin[axis][lane] = offset[axis] as f32;
                // Large and with the right sign if the component is zero.
                let direction = ray.direction[axis] as f32;
                columns.inverse_direction[axis][lane] = 1.0 / direction.abs().max(1e-30).copysign(direction);
            }
            ray = rays.next().unwrap_or(ray);
        }
        columns
    }

    /// Tests some of the rays against a box. Every one of them that meets it is near.
    #[must_use]
    pub fn near(&self, bounds: &Aabb, chosen: &ChosenRays) -> Near {
        let narrowed = self.narrow(bounds, 0.0);
        dispatch!(self.simd.level(), simd => self.near_with(simd, &narrowed, chosen))
    }

    /// Tests all rays against a box and against the box enlarged by `margin_world`. Every ray that
    /// meets the box is among those near it, even with a margin of 0.
    #[must_use]
    pub fn cross(&self, bounds: &Aabb, margin_world: f64) -> Crossing {
        let narrowed = self.narrow(bounds, margin_world);
        dispatch!(self.simd.level(), simd => self.cross_with(simd, &narrowed))
    }

    /// A box in single precision, with a margin far larger than the rounding error of coordinates
    /// and of the test.
    fn narrow(&self, bounds: &Aabb, margin_world: f64) -> Narrowed {
        let (low, high) = (bounds.min - self.base, bounds.max - self.base);
        let farthest = low.abs().max(high.abs()).max_element() + self.spread;
        let narrow = |v: DVec3| v.to_array().map(|v| v as f32);
        let margin = (margin_world + 1e-6 * farthest) as f32;
        Narrowed { low: narrow(low), high: narrow(high), margin }
    }

    #[inline(always)]
    fn near_with<S: Simd>(&self, simd: S, narrowed: &Narrowed, chosen: &ChosenRays) -> Near {
        let mut near = Near { lanes: 0, enter: [0.0; LANES], exit: [0.0; LANES], span: (0.0, 0.0) };
        let (zero, infinity) = (f32x16::splat(simd, 0.0), f32x16::splat(simd, f32::INFINITY));
        let (mut first, mut last) = (infinity, zero);
        for chunk in 0..LANES / 16 {
            if chosen.lanes >> (16 * chunk) & 0xffff == 0 {
                continue;
            }
            let range = 16 * chunk..16 * chunk + 16;
            // A ray that begins at infinity leaves every box before.
            let mut enter = f32x16::from_slice(simd, &chosen.begin[range.clone()]);
            let mut exit = infinity;
            for axis in 0..3 {
                let (a, b, more) = self.between(simd, narrowed, axis, range.clone());
                (enter, exit) = (enter.max(a - more), exit.min(b + more));
            }
            let is_near = enter.simd_le(exit);
            near.lanes |= is_near.to_bitmask() << (16 * chunk) & chosen.lanes;
            first = first.min(is_near.select(enter, infinity));
            last = last.max(is_near.select(exit, zero));
            enter.store_slice(&mut near.enter[range.clone()]);
            exit.store_slice(&mut near.exit[range]);
        }
        near.span = (first.reduce_min(), last.reduce_max());
        near
    }

    #[inline(always)]
    fn cross_with<S: Simd>(&self, simd: S, narrowed: &Narrowed) -> Crossing {
        let mut crossing = Crossing {
            near: 0,
            through: 0,
            enter_near: [0.0; LANES],
            exit: [0.0; LANES],
            length: [0.0; LANES],
        };
        let (zero, infinity) = (f32x16::splat(simd, 0.0), f32x16::splat(simd, f32::INFINITY));
        for chunk in 0..LANES / 16 {
            let range = 16 * chunk..16 * chunk + 16;
            let (mut enter, mut exit) = (zero, infinity);
            let (mut enter_near, mut exit_near) = (zero, infinity);
            for axis in 0..3 {
                let (a, b, more) = self.between(simd, narrowed, axis, range.clone());
                (enter, exit) = (enter.max(a), exit.min(b));
                (enter_near, exit_near) = (enter_near.max(a - more), exit_near.min(b + more));
            }
            crossing.near |= enter_near.simd_le(exit_near).to_bitmask() << (16 * chunk);
            crossing.through |= enter.simd_le(exit).to_bitmask() << (16 * chunk);
            enter_near.store_slice(&mut crossing.enter_near[range.clone()]);
            exit.store_slice(&mut crossing.exit[range.clone()]);
            (exit - enter).store_slice(&mut crossing.length[range]);
        }
        crossing
    }

    /// Where sixteen rays are between the faces of a box across an axis, from where to where, and
    /// how much farther between those of the enlarged one.
    #[inline(always)]
    fn between<S: Simd>(
        &self,
        simd: S,
        Narrowed { low, high, margin }: &Narrowed,
        axis: usize,
        range: Range<usize>,
    ) -> (f32x16<S>, f32x16<S>, f32x16<S>) {
        let origin = f32x16::from_slice(simd, &self.origin[axis][range.clone()]);
        let inverse = f32x16::from_slice(simd, &self.inverse_direction[axis][range]);
        let (a, b) = ((low[axis] - origin) * inverse, (high[axis] - origin) * inverse);
        (a.min(b), a.max(b), inverse.abs() * *margin)
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
        fn every_chosen_ray_that_meets_a_box_is_near_it_and_no_other_is(
            far_off in prop::sample::select(vec![0.0, 1e7]),
            rays in prop::collection::vec((vector(2.0), vector(1.0)), 1..LANES),
            corner in vector(3.0),
            size in prop::array::uniform3(0.0_f64..1.0),
            lanes in prop::sample::select(vec![u64::MAX, 0x5555_5555_5555_5555, 0x0f, 0]),
        ) {
            let place = DVec3::splat(far_off);
            let bounds = Aabb::new(corner + place, corner + place + DVec3::from_array(size));
            let rays: Vec<Ray> = rays
                .into_iter()
                .map(|(o, d)| Ray { origin: o + place, direction: d.try_normalize().unwrap_or(DVec3::X) })
                .collect();
            for simd in SimdLevel::available() {
                let columns = RayColumns::new(simd, rays.iter().copied());
                let near = columns.near(&bounds, &ChosenRays::new(lanes));
                prop_assert_eq!(near.lanes & !lanes, 0);
                prop_assert_eq!(near.lanes, columns.cross(&bounds, 0.0).near & lanes);
                for (lane, ray) in rays.iter().enumerate().filter(|(lane, _)| lanes >> lane & 1 == 1) {
                    prop_assert!(bounds.clip(ray).is_none() || near.lanes >> lane & 1 == 1, "{ray:?}");
                }
                let of_lanes = (0..LANES).filter(|lane| near.lanes >> lane & 1 == 1);
                let span = of_lanes.fold((f32::INFINITY, 0.0_f32), |(enter, exit), lane| {
                    (enter.min(near.enter[lane]), exit.max(near.exit[lane]))
                });
                prop_assert_eq!(near.span, span);
            }
        }
    }
}
