//! A packet of rays and the samples on them.
//!
//! Samples of a ray sit on its own lattice t = (j + ξ)·δ, j = 0, 1, …; all rays of a packet share δ. What is computed
//! for a sample depends on its ray and its number alone.

use crate::geometry::{Aabb, DVec3, Ray};

/// Rays in a packet.
pub const LANES: usize = 64;
/// Samples of a ray that are worked on at a time.
pub const SLAB_SAMPLES: usize = 32;

/// Up to 64 rays in columns, in world space.
#[derive(Clone, Debug)]
pub struct Packet {
    pub(super) origin: [[f64; LANES]; 3],
    pub(super) direction: [[f64; LANES]; 3],
    /// Offset of the lattice, ξ in [0, 1).
    pub(super) phase: [f64; LANES],
    pub(super) direction_f32: [[f32; LANES]; 3],
    /// 1 / direction, large and of the right sign where the direction has no extent along an axis.
    pub(super) inverse_direction: [[f32; LANES]; 3],
    rays: usize,
    step: f64,
    /// At distance t, every ray is within `origin_min + t·direction_min` and `origin_max + t·direction_max`.
    origin_min: DVec3,
    origin_max: DVec3,
    direction_min: DVec3,
    direction_max: DVec3,
}

impl Packet {
    /// A packet of at most 64 rays, each with the phase ξ of its lattice, that share the step `step_world`.
    ///
    /// Panics where there are no rays or more than 64.
    #[must_use]
    pub fn new(rays: &[(Ray, f64)], step_world: f64) -> Self {
        assert!(!rays.is_empty() && rays.len() <= LANES, "a packet of {} rays", rays.len());
        let mut packet = Self {
            origin: [[0.0; LANES]; 3],
            direction: [[0.0; LANES]; 3],
            phase: [0.0; LANES],
            direction_f32: [[0.0; LANES]; 3],
            inverse_direction: [[0.0; LANES]; 3],
            rays: rays.len(),
            step: step_world,
            origin_min: DVec3::INFINITY,
            origin_max: DVec3::NEG_INFINITY,
            direction_min: DVec3::INFINITY,
            direction_max: DVec3::NEG_INFINITY,
        };
        for lane in 0..LANES {
            // Lanes that are left over repeat the last ray; their results are never looked at.
            let (ray, phase) = rays[lane.min(rays.len() - 1)];
            for axis in 0..3 {
                packet.origin[axis][lane] = ray.origin[axis];
                packet.direction[axis][lane] = ray.direction[axis];
                let direction = ray.direction[axis] as f32;
                packet.direction_f32[axis][lane] = direction;
                packet.inverse_direction[axis][lane] = 1.0 / direction.abs().max(1e-30).copysign(direction);
            }
            packet.phase[lane] = phase;
            packet.origin_min = packet.origin_min.min(ray.origin);
            packet.origin_max = packet.origin_max.max(ray.origin);
            packet.direction_min = packet.direction_min.min(ray.direction);
            packet.direction_max = packet.direction_max.max(ray.direction);
        }
        packet
    }

    /// Direction of a ray in single precision.
    #[must_use]
    pub fn direction_f32(&self, lane: usize) -> [f32; 3] {
        std::array::from_fn(|axis| self.direction_f32[axis][lane])
    }

    /// Number of rays.
    #[must_use]
    pub fn len(&self) -> usize {
        self.rays
    }

    /// Never: a packet holds at least one ray.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        false
    }

    /// A mask with the bit of every ray set.
    #[must_use]
    pub fn all(&self) -> u64 {
        if self.rays == LANES { u64::MAX } else { (1 << self.rays) - 1 }
    }

    /// Distance between samples, world space.
    #[must_use]
    pub fn step(&self) -> f64 {
        self.step
    }

    /// Distance of sample `sample` of a ray from its origin.
    #[must_use]
    pub fn sample_t(&self, lane: usize, sample: u64) -> f64 {
        (sample as f64 + self.phase[lane]) * self.step
    }

    /// The numbers of the samples that may lie in a box on any ray: an inclusive range, never too small, or nothing
    /// where no ray meets the box.
    #[must_use]
    pub fn samples_in(&self, bounds: &Aabb) -> Option<(u64, u64)> {
        // The packet at distance t is inside a box whose faces move linearly with t; each face that must not pass
        // the opposite face of `bounds` is one inequality a + b·t ≥ 0.
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
        // Rounding in the quotients is far below the two samples of slack.
        let slack = 1e-9 * enter;
        if enter - slack > exit + slack {
            return None;
        }
        let first = ((enter - slack) / self.step - 2.0).max(0.0);
        let last = (exit + slack) / self.step + 2.0;
        Some((first as u64, last as u64))
    }
}

/// The stretch of 32 samples of every ray that begins at `first`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Slab {
    /// Number of the first sample, a multiple of [`SLAB_SAMPLES`] or of a part of it.
    pub first: u64,
    /// Samples worked on, at most [`SLAB_SAMPLES`].
    pub samples: usize,
}

impl Slab {
    /// One past the last sample.
    #[must_use]
    pub fn end(&self) -> u64 {
        self.first + self.samples as u64
    }
}
