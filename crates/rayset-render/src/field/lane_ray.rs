//! Rays relative to a run of points: their positions nearest to the run's centre, and their samples
//! counted from there.
//!
//! The vector from a ray to a point is computed in coordinates relative to the centre of the run,
//! with the ray's origin moved (in `f64`) to its foot, the position nearest to that centre: |c|² −
//! t_c² with distances from the eye would lose all digits.

use fearless_simd::f32x8;
use fearless_simd::prelude::*;

use super::columns::CHUNKS;
use super::packet::{BLOCK_SAMPLES, BLOCKS, GROUP, LANES, Packet, Slab};
use super::run::DecodedRun;

/// A step, in blocks.
const STEP: f32 = 1.0 / BLOCK_SAMPLES as f32;
const COUNT: [f32; BLOCK_SAMPLES] = [0., 1., 2., 3., 4., 5., 6., 7.];

/// The rays of a packet relative to a run: the foot of each ray, nearest to the run's centre, and
/// its samples counted from there.
#[derive(Clone, Debug)]
pub(super) struct Frames {
    /// The foot, with reversed sign: what is added to a point to have it relative to the foot.
    pub(super) minus_foot: [[f32; LANES]; 3],
    /// Number of the slab's first sample, counted from sample zero, which lies within one step of
    /// the foot.
    first_sample: [f32; LANES],
    /// Signed distance along the ray from the foot to sample zero.
    sample_zero: [f32; LANES],
    /// The range of distances along the ray of the slab's samples, measured from the foot, or
    /// slightly more: of splats, the range of their intervals.
    pub(super) start: [f32; LANES],
    pub(super) end: [f32; LANES],
    /// Where the slab begins, in blocks from the foot, and a slack that exceeds the rounding error
    /// of such numbers, so that culling is never stricter than the evaluation.
    start_in_blocks: [f32; LANES],
    slack_in_blocks: [f32; LANES],
    /// For each block of samples, the lanes whose samples in it may lie within the run's bounds of
    /// influence.
    pub(super) meets: [u64; BLOCKS],
}

impl Default for Frames {
    fn default() -> Self {
        Self {
            minus_foot: [[0.0; LANES]; 3],
            first_sample: [0.0; LANES],
            sample_zero: [0.0; LANES],
            start: [0.0; LANES],
            end: [0.0; LANES],
            start_in_blocks: [0.0; LANES],
            slack_in_blocks: [0.0; LANES],
            meets: [0; BLOCKS],
        }
    }
}

impl Frames {
    /// Sets everything for a run and a slab, of the groups of rays of which some are in `lanes`.
    /// Others meet nothing, and keep what they had of the run before.
    #[inline(always)]
    pub(super) fn set<S: Simd>(
        &mut self,
        simd: S,
        run: &DecodedRun,
        packet: &Packet,
        slab: Slab,
        lanes: u64,
    ) {
        self.meets = [0; BLOCKS];
        for first in (0..LANES).step_by(GROUP) {
            if lanes >> first & ((1 << GROUP) - 1) != 0 {
                self.find_feet(run, packet, slab.first as f64, first);
                self.find_blocks(simd, run, packet, first);
            }
        }
        self.meets[slab.blocks()..].fill(0);
    }

    /// Finds where the rays of a group are nearest to the run's centre.
    #[inline(always)]
    fn find_feet(&mut self, run: &DecodedRun, packet: &Packet, first_sample: f64, first_lane: usize) {
        let (o, d) = (&packet.origin, &packet.direction);
        let center = run.center.to_array();
        // Separate multiplications and additions: `f64` has enough precision, and fused operations
        // are slow on processors that have no instruction for them.
        for lane in first_lane..first_lane + GROUP {
            let (x, y, z) = (o[0][lane] - center[0], o[1][lane] - center[1], o[2][lane] - center[2]);
            let t_foot = -(x * d[0][lane] + y * d[1][lane] + z * d[2][lane]);
            self.minus_foot[0][lane] = -(x + t_foot * d[0][lane]) as f32;
            self.minus_foot[1][lane] = -(y + t_foot * d[1][lane]) as f32;
            self.minus_foot[2][lane] = -(z + t_foot * d[2][lane]) as f32;
            let nearest = (t_foot * packet.per_step[lane]).floor();
            self.first_sample[lane] = (first_sample - nearest) as f32;
            self.sample_zero[lane] =
                ((nearest + packet.sample_offset[lane]) * packet.step[lane] - t_foot) as f32;
        }
    }

    /// Finds the blocks of a group of rays that may lie within the run's bounds of influence.
    #[inline(always)]
    fn find_blocks<S: Simd>(&mut self, simd: S, run: &DecodedRun, packet: &Packet, first_lane: usize) {
        for chunk in first_lane / 8..(first_lane + GROUP) / 8 {
            let per_block = lanes_of(simd, &packet.per_block, chunk);
            let mut enter = f32x8::splat(simd, f32::NEG_INFINITY);
            let mut exit = f32x8::splat(simd, f32::INFINITY);
            for axis in 0..3 {
                let minus_foot = lanes_of(simd, &self.minus_foot[axis], chunk);
                let inverse = lanes_of(simd, &packet.inverse_direction[axis], chunk);
                let reach = run.reach[axis];
                // A ray parallel to this axis never crosses its planes: the products are huge, of
                // opposite signs inside and of the same sign outside.
                let (a, b) = ((minus_foot - reach) * inverse, (minus_foot + reach) * inverse);
                enter = enter.max(a.min(b));
                exit = exit.min(a.max(b));
            }
            if run.has_plates {
                let foot = [0, 1, 2].map(|axis| lanes_of(simd, &self.minus_foot[axis], chunk));
                let direction = [0, 1, 2].map(|axis| lanes_of(simd, &packet.direction_f32[axis], chunk));
                let (from, to) = run.plates.of_run.ranges(simd, foot, direction);
                (enter, exit) = (enter.max(from), exit.min(to));
            }
            // In blocks from the slab's beginning. Half a sample of slack on either side covers the
            // rounding error.
            let zero = lanes_of(simd, &self.sample_zero, chunk);
            let first = lanes_of(simd, &self.first_sample, chunk);
            let start = zero.mul_add(per_block, first * (1.0 / BLOCK_SAMPLES as f32));
            let before = if run.are_splats { STEP } else { 0.0 };
            let most = start.abs() + per_block * run.reach_length;
            self.set_range(simd, packet, chunk, (start, most), before);
            let slack = (enter.abs() + exit.abs()).mul_add(per_block, start.abs()) * 1e-5;
            let from = enter.mul_add(per_block, -(start + slack));
            let to = exit.mul_add(per_block, slack - start);
            let before = if run.are_splats { 0.0625 + STEP } else { 0.0625 };
            for b in 0..BLOCKS {
                let meets = from.simd_lt(b as f32 + 1.0) & to.simd_gt(b as f32 - before);
                self.meets[b] |= meets.to_bitmask() << (8 * chunk);
            }
        }
    }

    /// Sets where the slab begins and ends on eight rays, from its beginning in blocks and a bound
    /// of such numbers; `before` is how far intervals begin before it.
    #[inline(always)]
    fn set_range<S: Simd>(
        &mut self,
        simd: S,
        packet: &Packet,
        chunk: usize,
        (start, most): (f32x8<S>, f32x8<S>),
        before: f32,
    ) {
        let range = 8 * chunk..8 * chunk + 8;
        let step = lanes_of(simd, &packet.step_f32, chunk);
        let slack = most.mul_add(2e-6, f32x8::splat(simd, 2e-3));
        start.store_slice(&mut self.start_in_blocks[range.clone()]);
        slack.store_slice(&mut self.slack_in_blocks[range.clone()]);
        let (begin, end) = (start - slack - before, start + slack + BLOCKS as f32);
        (begin * BLOCK_SAMPLES as f32 * step).store_slice(&mut self.start[range.clone()]);
        (end * BLOCK_SAMPLES as f32 * step).store_slice(&mut self.end[range]);
    }
}

/// Eight lanes of a column. A function, because closures are not always inlined where vector code
/// requires it.
#[inline(always)]
fn lanes_of<S: Simd>(simd: S, column: &[f32; LANES], chunk: usize) -> f32x8<S> {
    f32x8::from_slice(simd, &column[8 * chunk..8 * chunk + 8])
}

/// One ray relative to a run.
pub(super) struct LaneRay {
    pub(super) minus_foot: [f32; 3],
    pub(super) direction: [f32; 3],
    step: f32,
    /// The reciprocal of the length of a block.
    pub(super) per_block: f32,
    first_sample: f32,
    sample_zero: f32,
    start: f32,
    end: f32,
    pub(super) start_in_blocks: f32,
    pub(super) slack_in_blocks: f32,
    /// How far the interval of a sample extends before and behind it.
    pub(super) interval: (f32, f32),
    /// The reciprocal of a step in world space.
    pub(super) per_step_world: f32,
}

impl LaneRay {
    #[inline(always)]
    pub(super) fn new(packet: &Packet, frames: &Frames, lane: usize) -> Self {
        Self {
            minus_foot: [frames.minus_foot[0][lane], frames.minus_foot[1][lane], frames.minus_foot[2][lane]],
            direction: [
                packet.direction_f32[0][lane],
                packet.direction_f32[1][lane],
                packet.direction_f32[2][lane],
            ],
            step: packet.step_f32[lane],
            per_block: packet.per_block[lane],
            first_sample: frames.first_sample[lane],
            sample_zero: frames.sample_zero[lane],
            start: frames.start[lane],
            end: frames.end[lane],
            start_in_blocks: frames.start_in_blocks[lane],
            slack_in_blocks: frames.slack_in_blocks[lane],
            interval: packet.interval_f32(lane),
            per_step_world: packet.per_step_world_f32(),
        }
    }

    /// Distances of a block's samples along the ray, measured from its foot.
    #[inline(always)]
    pub(super) fn samples_of_block<S: Simd>(&self, simd: S, block: usize) -> f32x8<S> {
        let number = f32x8::from_slice(simd, &COUNT) + (self.first_sample + (block * BLOCK_SAMPLES) as f32);
        number.mul_add(f32x8::splat(simd, self.step), f32x8::splat(simd, self.sample_zero))
    }

    /// Distances along the ray at which it is nearest to the points, and the vectors from the ray
    /// to the points there.
    #[inline(always)]
    pub(super) fn project<S: Simd>(&self, simd: S, position: [f32x8<S>; 3]) -> (f32x8<S>, [f32x8<S>; 3]) {
        let (x, y, z) = (
            position[0] + self.minus_foot[0],
            position[1] + self.minus_foot[1],
            position[2] + self.minus_foot[2],
        );
        let dx = f32x8::splat(simd, self.direction[0]);
        let dy = f32x8::splat(simd, self.direction[1]);
        let dz = f32x8::splat(simd, self.direction[2]);
        let nearest = z.mul_add(dz, y.mul_add(dy, x * dx));
        let back = -nearest;
        (nearest, [back.mul_add(dx, x), back.mul_add(dy, y), back.mul_add(dz, z)])
    }

    /// Chunks of points whose sphere of influence the ray meets in the slab, of ellipsoids within
    /// their plate; a bit for each.
    #[inline(always)]
    pub(super) fn chunks_in_reach<S: Simd, const SHAPES: bool>(&self, simd: S, run: &DecodedRun) -> u64 {
        let mut reached = 0;
        for group in 0..CHUNKS / 8 {
            let range = 8 * group..8 * group + 8;
            let center = [
                f32x8::from_slice(simd, &run.chunk_center[0][range.clone()]),
                f32x8::from_slice(simd, &run.chunk_center[1][range.clone()]),
                f32x8::from_slice(simd, &run.chunk_center[2][range.clone()]),
            ];
            let (nearest, [x, y, z]) = self.project(simd, center);
            let distance_squared = z.mul_add(z, y.mul_add(y, x * x));
            let (mut start, mut end) = (f32x8::splat(simd, self.start), f32x8::splat(simd, self.end));
            if SHAPES {
                let (from, to) = run.plates.ranges(simd, 8 * group, self.minus_foot, self.direction);
                (start, end) = (start.max(from), end.min(to));
            }
            let gap = (start - nearest).max(nearest - end).max(0.0);
            let mut within = gap
                .mul_add(gap, distance_squared)
                .simd_le(f32x8::from_slice(simd, &run.chunk_reach_squared[range]));
            if SHAPES {
                within &= start.simd_le(end);
            }
            reached |= within.to_bitmask() << (8 * group);
        }
        reached
    }
}
