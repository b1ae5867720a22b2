//! A packet of rays and the samples on them.
//!
//! Samples of a ray sit on its own lattice t = (j + offset)·δ, j = 0, 1, …; all rays of a packet share δ. What is computed
//! for a sample depends on its ray and its number alone.
//!
//! A packet is in world space, or in the local space of an object that is transformed: there a step has another length
//! on every ray, and sample numbers mean the same places.

use crate::geometry::{Aabb, Beam, DAffine3, DVec3, Ray};

/// Rays in a packet.
pub const LANES: usize = 64;
/// Samples of a ray that are worked on at a time.
pub const SLAB_SAMPLES: usize = 32;

/// No ray has more samples: beyond, their distances could not be told apart.
const MOST_SAMPLES: f64 = (1_u64 << 52) as f64;

/// Up to 64 rays in columns.
#[derive(Clone, Debug)]
pub struct Packet {
    pub(super) origin: [[f64; LANES]; 3],
    /// Unit directions.
    pub(super) direction: [[f64; LANES]; 3],
    /// What a unit of world-space length along a ray is in the packet's space.
    pub(super) scale: [f64; LANES],
    /// Distance between samples in the packet's space.
    pub(super) step: [f64; LANES],
    pub(super) step_f32: [f32; LANES],
    pub(super) per_step: [f64; LANES],
    /// Offset of the lattice, in steps, in [0, 1).
    pub(super) sample_offset: [f64; LANES],
    pub(super) direction_f32: [[f32; LANES]; 3],
    /// 1 / direction, large and of the right sign where the direction has no extent along an axis.
    pub(super) inverse_direction: [[f32; LANES]; 3],
    rays: usize,
    step_world: f64,
    least_step: f64,
}

impl Packet {
    /// A packet of at most 64 rays, each with the offset of its samples in steps, that share the step `step_world`.
    ///
    /// Panics where there are no rays or more than 64.
    #[must_use]
    pub fn new(rays: &[(Ray, f64)], step_world: f64) -> Self {
        assert!(!rays.is_empty() && rays.len() <= LANES, "a packet of {} rays", rays.len());
        let mut packet = Self {
            origin: [[0.0; LANES]; 3],
            direction: [[0.0; LANES]; 3],
            scale: [1.0; LANES],
            step: [step_world; LANES],
            step_f32: [step_world as f32; LANES],
            per_step: [1.0 / step_world; LANES],
            sample_offset: [0.0; LANES],
            direction_f32: [[0.0; LANES]; 3],
            inverse_direction: [[0.0; LANES]; 3],
            rays: rays.len(),
            step_world,
            least_step: step_world,
        };
        for lane in 0..LANES {
            // Lanes that are left over repeat the last ray; their results are never looked at.
            let (ray, sample_offset) = rays[lane.min(rays.len() - 1)];
            packet.set_ray(lane, &ray);
            packet.sample_offset[lane] = sample_offset;
        }
        packet
    }

    fn set_ray(&mut self, lane: usize, ray: &Ray) {
        for axis in 0..3 {
            self.origin[axis][lane] = ray.origin[axis];
            self.direction[axis][lane] = ray.direction[axis];
            let direction = ray.direction[axis] as f32;
            self.direction_f32[axis][lane] = direction;
            self.inverse_direction[axis][lane] = 1.0 / direction.abs().max(1e-30).copysign(direction);
        }
    }

    /// The same rays and samples in the local space of an object. The map must not be singular; `least_stretch` is the
    /// least length that it makes of a vector of length one.
    #[must_use]
    pub fn in_local_space(&self, local_from_world: &DAffine3, least_stretch: f64) -> Self {
        let mut local = self.clone();
        local.least_step = self.least_step * least_stretch;
        for lane in 0..LANES {
            let ray = self.ray(lane);
            let direction = local_from_world.transform_vector3(ray.direction);
            let scale = direction.length();
            let origin = local_from_world.transform_point3(ray.origin);
            local.set_ray(lane, &Ray { origin, direction: direction / scale });
            local.scale[lane] = self.scale[lane] * scale;
            local.step[lane] = self.step[lane] * scale;
            local.step_f32[lane] = local.step[lane] as f32;
            local.per_step[lane] = 1.0 / local.step[lane];
        }
        local
    }

    /// A ray, in the packet's space.
    #[must_use]
    pub fn ray(&self, lane: usize) -> Ray {
        let column = |c: &[[f64; LANES]; 3]| DVec3::new(c[0][lane], c[1][lane], c[2][lane]);
        Ray { origin: column(&self.origin), direction: column(&self.direction) }
    }

    /// Distance of sample `sample` of a ray from its origin, in the packet's space.
    #[must_use]
    pub fn sample_t(&self, lane: usize, sample: u64) -> f64 {
        (sample as f64 + self.sample_offset[lane]) * self.step[lane]
    }

    /// Distance of sample `sample` of a ray from its origin, world space.
    #[must_use]
    pub fn sample_t_world(&self, lane: usize, sample: u64) -> f64 {
        (sample as f64 + self.sample_offset[lane]) * self.step_world
    }

    /// Direction of a ray in single precision.
    #[must_use]
    pub fn direction_f32(&self, lane: usize) -> [f32; 3] {
        std::array::from_fn(|axis| self.direction_f32[axis][lane])
    }

    /// The sample offset of a ray, in steps.
    #[must_use]
    pub fn sample_offset(&self, lane: usize) -> f64 {
        self.sample_offset[lane]
    }

    /// A lower bound of the distance between samples in the packet's space, that does not depend on its rays.
    #[must_use]
    pub fn least_step(&self) -> f64 {
        self.least_step
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
    pub fn step_world(&self) -> f64 {
        self.step_world
    }

    /// The rays in `lanes`.
    pub fn rays(&self, lanes: u64) -> impl Iterator<Item = Ray> {
        (0..LANES).filter(move |lane| lanes >> lane & 1 == 1).map(|lane| self.ray(lane))
    }

    /// The bound of the rays in `lanes`, by distance in world space.
    #[must_use]
    pub fn beam(&self, lanes: u64) -> Beam {
        let mut beam = Beam::EMPTY;
        for lane in (0..LANES).filter(|lane| lanes >> lane & 1 == 1) {
            let ray = self.ray(lane);
            beam.include(&Ray { direction: ray.direction * self.scale[lane], ..ray });
        }
        beam
    }

    /// The least and the greatest distance between samples of some rays, in the packet's space.
    #[must_use]
    pub fn step_range(&self, lanes: u64) -> (f64, f64) {
        let steps = (0..LANES).filter(|lane| lanes >> lane & 1 == 1).map(|lane| self.step[lane]);
        steps.fold((f64::INFINITY, 0.0), |(least, most), step| (least.min(step), most.max(step)))
    }

    /// The numbers of the samples that may lie in a box on any ray of a beam of this packet's: an inclusive range, never
    /// too small, or `None` if no ray meets the box.
    #[must_use]
    pub fn samples_in(&self, beam: &Beam, bounds: &Aabb) -> Option<(u64, u64)> {
        let (enter, exit) = beam.span(bounds)?;
        // Rounding in the quotients is far below the two samples of slack.
        let first = (enter / self.step_world - 2.0).max(0.0);
        let last = (exit / self.step_world + 2.0).min(MOST_SAMPLES);
        (first < MOST_SAMPLES).then_some((first as u64, last as u64))
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
