//! A packet of rays and the samples on them.
//!
//! Samples of a ray sit on its own lattice t = (j + ξ)·δ, j = 0, 1, …; all rays of a packet share δ. What is computed
//! for a sample depends on its ray and its number alone.

use crate::geometry::{Aabb, Beam, DVec3, Ray};

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

    /// The rays in `lanes`.
    pub fn rays(&self, lanes: u64) -> impl Iterator<Item = Ray> {
        let column = |c: &[[f64; LANES]; 3], lane: usize| DVec3::new(c[0][lane], c[1][lane], c[2][lane]);
        (0..LANES).filter(move |lane| lanes >> lane & 1 == 1).map(move |lane| Ray {
            origin: column(&self.origin, lane),
            direction: column(&self.direction, lane),
        })
    }

    /// The bound of the rays in `lanes`.
    #[must_use]
    pub fn beam(&self, lanes: u64) -> Beam {
        let mut beam = Beam::EMPTY;
        self.rays(lanes).for_each(|ray| beam.include(&ray));
        beam
    }

    /// The numbers of the samples that may lie in a box on any ray of a beam of this packet's: an inclusive range, never
    /// too small, or nothing where no ray meets the box.
    #[must_use]
    pub fn samples_in(&self, beam: &Beam, bounds: &Aabb) -> Option<(u64, u64)> {
        let (enter, exit) = beam.span(bounds)?;
        // Rounding in the quotients is far below the two samples of slack.
        let first = (enter / self.step - 2.0).max(0.0);
        let last = exit / self.step + 2.0;
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
