//! Packets of rays and the samples on them.
//!
//! The samples of a ray lie on lattices t = (j + offset)·δ·2^level, j = 0, 1, …. The offset is the
//! ray's own; δ, the length of a *tick*, is the same for all rays of a packet. Which level they
//! have differs from place to place. The result at a sample depends only on its ray, its level and
//! its number.
//!
//! A packet is in world space, or in the local space of a transformed object. There the step has a
//! different length on every ray, but a sample number denotes the same position.

use rayset_base::geometry::{Aabb, Beam, DAffine3, DVec3, Ray};

/// Number of rays in a packet.
pub const LANES: usize = 64;
/// Lanes that look for their runs and points together: neighbours, where packets have their rays
/// in the order of a Z curve.
pub(super) const GROUP: usize = 16;
/// Number of samples of a ray that are processed together.
pub const SLAB_SAMPLES: usize = 32;
/// Number of samples of a ray to which points are added together: the most that a point covers at a
/// step of a quarter of its radius.
pub const BLOCK_SAMPLES: usize = 8;
/// Blocks of samples in a slab.
pub(super) const BLOCKS: usize = SLAB_SAMPLES / BLOCK_SAMPLES;

/// Upper bound of ticks: beyond it, the distances of samples would not be distinct numbers.
const MOST_TICKS: f64 = (1_u64 << 52) as f64;

/// Up to 64 rays, stored by columns.
#[derive(Clone, Debug)]
pub struct Packet {
    pub(super) origin: [[f64; LANES]; 3],
    /// Unit directions in the packet's space.
    pub(super) direction: [[f64; LANES]; 3],
    /// Length in the packet's space of a unit of world-space length along each ray.
    pub(super) scale: [f64; LANES],
    /// Distance between samples in the packet's space.
    pub(super) step: [f64; LANES],
    pub(super) step_f32: [f32; LANES],
    pub(super) per_step: [f64; LANES],
    /// Reciprocal of the length of a block of samples.
    pub(super) per_block: [f32; LANES],
    /// Sample offset in steps, in [0, 1).
    pub(super) sample_offset: [f64; LANES],
    pub(super) direction_f32: [[f32; LANES]; 3],
    /// 1 / direction; large and with the right sign if the component is zero.
    pub(super) inverse_direction: [[f32; LANES]; 3],
    rays: usize,
    step_world: f64,
    tick_world: f64,
    least_step: f64,
    /// The step is 2^level ticks long.
    level: u32,
}

impl Packet {
    /// A packet of up to 64 rays, each with its sample offset in steps, with ticks of the length
    /// `step_world`, at level 0.
    ///
    /// Panics if there are no rays or more than 64.
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
            per_block: [per_block(step_world); LANES],
            sample_offset: [0.0; LANES],
            direction_f32: [[0.0; LANES]; 3],
            inverse_direction: [[0.0; LANES]; 3],
            rays: rays.len(),
            step_world,
            tick_world: step_world,
            least_step: step_world,
            level: 0,
        };
        for lane in 0..LANES {
            // Unused lanes repeat the last ray; their results are ignored.
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

    /// The same rays and samples in the local space of an object. The map must be invertible;
    /// `least_stretch` is the smallest length to which it takes a vector of length one.
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
            local.per_block[lane] = per_block(local.step[lane]);
        }
        local
    }

    /// Goes to another level, at which a step is 2^`level` ticks long. Powers of two are exact: the
    /// packet is then what a packet of that step would be, bit for bit.
    pub fn set_level(&mut self, level: u32) {
        if level == self.level {
            return;
        }
        let factor = 2_f64.powi(level as i32 - self.level as i32);
        self.level = level;
        self.step_world *= factor;
        self.least_step *= factor;
        for lane in 0..LANES {
            self.step[lane] *= factor;
            self.step_f32[lane] = self.step[lane] as f32;
            self.per_step[lane] = 1.0 / self.step[lane];
            self.per_block[lane] = per_block(self.step[lane]);
        }
    }

    /// A ray in the packet's space.
    #[must_use]
    pub fn ray(&self, lane: usize) -> Ray {
        let column = |c: &[[f64; LANES]; 3]| DVec3::new(c[0][lane], c[1][lane], c[2][lane]);
        Ray { origin: column(&self.origin), direction: column(&self.direction) }
    }

    /// Distance of a sample from the origin of its ray, in the packet's space.
    #[must_use]
    pub fn sample_t(&self, lane: usize, sample: u64) -> f64 {
        (sample as f64 + self.sample_offset[lane]) * self.step[lane]
    }

    /// Distance of a sample from the origin of its ray, world space.
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

    /// How far the interval of ticks of a sample extends before and behind it, in the packet's
    /// space.
    #[inline(always)]
    pub(super) fn interval_f32(&self, lane: usize) -> (f32, f32) {
        let before = self.sample_offset[lane] * self.step[lane];
        (before as f32, (self.step[lane] - before) as f32)
    }

    /// The reciprocal of the distance between samples, world space.
    #[inline(always)]
    pub(super) fn per_step_world_f32(&self) -> f32 {
        (1.0 / self.step_world) as f32
    }

    /// A lower bound of the distance between samples in the packet's space, independent of the
    /// rays.
    #[must_use]
    pub fn least_step(&self) -> f64 {
        self.least_step
    }

    /// Number of rays.
    #[must_use]
    pub fn len(&self) -> usize {
        self.rays
    }

    /// Always false: a packet has at least one ray.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        false
    }

    /// A mask with one bit set for every ray.
    #[must_use]
    pub fn all(&self) -> u64 {
        if self.rays == LANES { u64::MAX } else { (1 << self.rays) - 1 }
    }

    /// Distance between samples, world space.
    #[must_use]
    pub fn step_world(&self) -> f64 {
        self.step_world
    }

    /// The rays of a mask, in the packet's space.
    pub fn rays(&self, lanes: u64) -> impl Iterator<Item = Ray> {
        (0..LANES).filter(move |lane| lanes >> lane & 1 == 1).map(|lane| self.ray(lane))
    }

    /// Bound of the rays of a mask, parametrised by distance in world space.
    #[must_use]
    pub fn beam(&self, lanes: u64) -> Beam {
        let mut beam = Beam::EMPTY;
        for lane in (0..LANES).filter(|lane| lanes >> lane & 1 == 1) {
            let ray = self.ray(lane);
            beam.include(&Ray { direction: ray.direction * self.scale[lane], ..ray });
        }
        beam
    }

    /// Length of a tick, world space.
    #[must_use]
    pub fn tick_world(&self) -> f64 {
        self.tick_world
    }

    /// The smallest and the largest length of a tick on the rays of a mask, in the packet's space.
    #[must_use]
    pub fn tick_range(&self, lanes: u64) -> (f64, f64) {
        let per_step = 2_f64.powi(-(self.level as i32));
        let ticks = (0..LANES).filter(|lane| lanes >> lane & 1 == 1).map(|lane| self.step[lane] * per_step);
        ticks.fold((f64::INFINITY, 0.0), |(least, most), tick| (least.min(tick), most.max(tick)))
    }

    /// The ticks at which samples may lie in a box on any ray of a beam of this packet: an
    /// inclusive, conservative range, or `None` if no ray meets the box.
    #[must_use]
    pub fn ticks_in(&self, beam: &Beam, bounds: &Aabb) -> Option<(u64, u64)> {
        let (enter, exit) = beam.span(bounds)?;
        let tick = self.tick_world;
        // Two ticks of slack are far more than the rounding error of the quotients.
        let first = (enter / tick - 2.0).max(0.0);
        let last = (exit / tick + 2.0).min(MOST_TICKS);
        (first < MOST_TICKS).then_some((first as u64, last as u64))
    }

    /// The same, of the beam of all rays. Far away they are much farther apart than a box is wide,
    /// and what holds for the beam says little: then each ray is asked by itself.
    #[must_use]
    pub fn ticks_of_rays_in(&self, beam: &Beam, bounds: &Aabb) -> Option<(u64, u64)> {
        let (first, last) = self.ticks_in(beam, bounds)?;
        if beam.width_at(first as f64 * self.tick_world) <= bounds.size().max_element() {
            return Some((first, last));
        }
        let of_each = (0..self.rays).filter_map(|lane| self.ticks_in(&self.beam(1 << lane), bounds));
        of_each.reduce(|all, one| (all.0.min(one.0), all.1.max(one.1)))
    }
}

/// The reciprocal of the length of a block.
fn per_block(step: f64) -> f32 {
    (1.0 / (step * BLOCK_SAMPLES as f64)) as f32
}

/// A range of sample numbers at one level, the same on every ray of a packet. Sample j stands for
/// the ticks from j·2^level on, up to those of the next sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Slab {
    /// Number of the first sample.
    pub first: u64,
    /// Number of samples, at most [`SLAB_SAMPLES`].
    pub samples: usize,
    /// Their level: they are 2^level ticks apart.
    pub level: u32,
}

impl Slab {
    /// One past the last sample.
    #[must_use]
    pub fn end(&self) -> u64 {
        self.first + self.samples as u64
    }

    /// The first tick.
    #[must_use]
    pub fn first_tick(&self) -> u64 {
        self.first << self.level
    }

    /// One past the last tick.
    #[must_use]
    pub fn end_tick(&self) -> u64 {
        self.end() << self.level
    }

    /// Its ticks at the level below, as two slabs of as many samples.
    ///
    /// Panics at level 0.
    #[must_use]
    pub fn halves(&self) -> [Self; 2] {
        assert!(self.level > 0, "there is nothing below level 0");
        let first = 2 * self.first;
        [first, first + self.samples as u64].map(|first| Self { first, level: self.level - 1, ..*self })
    }

    /// The samples in a range of ticks, both included, that has ticks in the slab or behind its
    /// beginning: counted from the first of the slab.
    #[must_use]
    pub fn samples_at(&self, first_tick: u64, last_tick: u64) -> (u64, u64) {
        let number = |tick: u64| tick.saturating_sub(self.first_tick()) >> self.level;
        (number(first_tick), number(last_tick))
    }

    /// Number of blocks of samples that it takes, the last of them perhaps in part.
    pub(super) fn blocks(&self) -> usize {
        self.samples.div_ceil(BLOCK_SAMPLES).min(BLOCKS)
    }
}

/// Some of a slab's blocks of samples.
#[derive(Clone, Copy)]
pub(super) struct BlockRange {
    pub(super) first: usize,
    /// One past the last.
    pub(super) end: usize,
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The beam of all rays holds everything between them, at distances that differ by much more
    /// than the box is long.
    #[test]
    fn from_very_far_a_box_takes_few_ticks_or_none() {
        let ray = |x: f64, y: f64| {
            let direction = DVec3::new(x, y, -1.0).normalize();
            (Ray { origin: DVec3::new(0.0, 0.0, 5e12), direction }, 0.5)
        };
        let packet = Packet::new(&[ray(-0.3, 0.2), ray(0.3, 0.2), ray(0.1, -0.3), ray(-0.1, -0.3)], 0.01);
        let beam = packet.beam(packet.all());
        let bounds = Aabb::new(DVec3::splat(-1.0), DVec3::splat(1.0));
        let (first, last) = packet.ticks_in(&beam, &bounds).unwrap();
        assert!(last - first > 1 << 40);
        assert_eq!(packet.ticks_of_rays_in(&beam, &bounds), None);
        let there = packet.ray(2).at(5.1e12);
        let bounds = Aabb::new(there - 1.0, there + 1.0);
        let (first, last) = packet.ticks_of_rays_in(&beam, &bounds).unwrap();
        assert!(first as f64 <= 5.1e14 && 5.1e14 <= last as f64 && last - first < 1 << 21, "{first} {last}");
    }
}
