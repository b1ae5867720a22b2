//! The rays of a packet in a grid, in voxels.

use super::placement::Placement;
use crate::field::{LANES, Packet, Slab};
use rayset_base::geometry::{Aabb, DVec3, Ray};

/// The rays of a packet in voxels, and where they are inside the grid.
#[derive(Clone, Debug)]
pub(super) struct GridRays {
    origin: [[f64; LANES]; 3],
    direction: [[f64; LANES]; 3],
    offset: [f64; LANES],
    /// The first sample inside the grid, and the one after the last.
    within: [(u64, u64); LANES],
    step: f64,
}

impl GridRays {
    pub(super) fn new(grid: &Placement, packet: &Packet) -> Self {
        let mut rays = Self {
            origin: [[0.0; LANES]; 3],
            direction: [[0.0; LANES]; 3],
            offset: [0.0; LANES],
            within: [(0, 0); LANES],
            step: packet.step_world(),
        };
        for lane in 0..packet.len() {
            let world = packet.ray(lane);
            let origin = grid.voxel_from_world.transform_point3(world.origin);
            let direction = grid.voxel_from_world.transform_vector3(world.direction);
            for axis in 0..3 {
                (rays.origin[axis][lane], rays.direction[axis][lane]) = (origin[axis], direction[axis]);
            }
            rays.offset[lane] = packet.sample_offset(lane);
            rays.within[lane] = rays.find_within(lane, &Ray { origin, direction }, &grid.bounds_voxel);
        }
        rays
    }

    /// The samples of a ray that are inside a box.
    fn find_within(&self, lane: usize, ray: &Ray, bounds: &Aabb) -> (u64, u64) {
        let Some((enter, exit)) = bounds.clip(ray) else { return (0, 0) };
        let number = |t: f64| (t / self.step - self.offset[lane]).clamp(0.0, MOST_SAMPLES);
        // Whether a sample is inside is tested at its own position; this range has at most one or
        // two too many at either end.
        let (mut first, mut end) =
            ((number(enter).floor() - 1.0).max(0.0) as u64, (number(exit).ceil() + 2.0) as u64);
        let slab = |sample: u64| self.ray(lane, Slab { first: sample, samples: 1, level: 0 });
        while first < end && !bounds.contains(slab(first).place(0)) {
            first += 1;
        }
        while first < end && !bounds.contains(slab(end - 1).place(0)) {
            end -= 1;
        }
        (first, end)
    }

    #[inline(always)]
    pub(super) fn ray(&self, lane: usize, slab: Slab) -> GridRay {
        GridRay {
            origin: DVec3::new(self.origin[0][lane], self.origin[1][lane], self.origin[2][lane]),
            direction: DVec3::new(self.direction[0][lane], self.direction[1][lane], self.direction[2][lane]),
            offset: self.offset[lane],
            first: slab.first,
            step: self.step,
        }
    }

    /// The samples of a ray inside the grid, counted from the first of the slab: the first, and the
    /// one after the last.
    #[inline(always)]
    pub(super) fn within(&self, lane: usize, slab: Slab) -> (usize, usize) {
        let (first, end) = self.within[lane];
        let (first, end) = (first.max(slab.first), end.min(slab.end()));
        if first < end { ((first - slab.first) as usize, (end - slab.first) as usize) } else { (0, 0) }
    }
}

/// Upper bound of sample numbers.
const MOST_SAMPLES: f64 = (1_u64 << 52) as f64;

/// One ray in a slab; positions in voxels, distances in the world.
#[derive(Clone, Copy, Debug)]
pub(super) struct GridRay {
    pub(super) origin: DVec3,
    pub(super) direction: DVec3,
    pub(super) offset: f64,
    /// Of the slab.
    pub(super) first: u64,
    pub(super) step: f64,
}

impl GridRay {
    /// The position of a sample, counted from the first of the slab.
    #[inline(always)]
    pub(super) fn place(&self, j: usize) -> DVec3 {
        self.origin + self.direction * (((self.first + j as u64) as f64 + self.offset) * self.step)
    }
}
