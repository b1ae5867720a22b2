//! Neighbouring rays of a packet, which look for their points together: a bound of the rays within
//! reach of a run, and the points near it.
//!
//! The bound is a line, in the coordinates of `lane_ray`, and the distance from it that no ray
//! exceeds as far as the run reaches. A point that reaches a ray is within its radius and that
//! distance of the line.

use fearless_simd::f32x8;
use fearless_simd::prelude::*;

use super::columns::{CHUNK_POINTS, CHUNKS};
use super::lane_ray::Frames;
use super::packet::{GROUP, LANES, Packet};
use super::run::DecodedRun;

/// Rays are bounded together where that enlarges the smallest radius of a run by this part of it at
/// most.
const MOST_GROWTH: f32 = 1.0;

/// A line, and how far from it rays are at most within reach of a run.
pub(super) struct GroupLine {
    minus_foot: [f32; 3],
    direction: [f32; 3],
    distance: f32,
    /// The range of distances along the line of all samples of the slab.
    start: f32,
    end: f32,
}

impl GroupLine {
    /// The bound of the lanes from `first` on. `None` if the rays are too far apart for one to be
    /// of use.
    #[inline(always)]
    pub(super) fn new<S: Simd>(
        simd: S,
        run: &DecodedRun,
        packet: &Packet,
        frames: &Frames,
        first: usize,
    ) -> Option<Self> {
        let (mut foot, mut direction) = ([0.0; 3], [0.0; 3]);
        let zero = f32x8::splat(simd, 0.0);
        let (mut apart, mut spread) = ([zero; 2], [zero; 2]);
        for axis in 0..3 {
            let feet = lanes_of(simd, &frames.minus_foot[axis], first);
            foot[axis] = (feet[0] + feet[1]).reduce_sum() * (1.0 / GROUP as f32);
            let directions = lanes_of(simd, &packet.direction_f32[axis], first);
            direction[axis] = (directions[0] + directions[1]).reduce_sum() * (1.0 / GROUP as f32);
            for half in 0..2 {
                let (f, d) = (feet[half] - foot[axis], directions[half] - direction[axis]);
                apart[half] = f.mul_add(f, apart[half]);
                spread[half] = d.mul_add(d, spread[half]);
            }
        }
        let apart = apart[0].max(apart[1]).reduce_max();
        let spread = spread[0].max(spread[1]).reduce_max();
        // The last term is far more than what is rounded.
        let distance = (apart.sqrt() + run.reach_length * spread.sqrt()) * 1.01 + run.reach_length * 1e-5;
        let start = lanes_of(simd, &frames.start, first);
        let end = lanes_of(simd, &frames.end, first);
        let (start, end) = (start[0].min(start[1]).reduce_min(), end[0].max(end[1]).reduce_max());
        (distance <= MOST_GROWTH * run.radius_min).then_some(Self {
            minus_foot: foot,
            direction,
            distance,
            start,
            end,
        })
    }

    /// The points of a run that may reach a ray of the group in the slab; a bit for each.
    #[inline(always)]
    pub(super) fn points_near<S: Simd>(&self, simd: S, run: &DecodedRun) -> [u64; 2] {
        let mut near = [0; 2];
        let mut chunks = self.chunks_near(simd, run);
        while chunks != 0 {
            let chunk = chunks.trailing_zeros() as usize & (CHUNKS - 1);
            chunks &= chunks - 1;
            let range = CHUNK_POINTS * chunk..CHUNK_POINTS * (chunk + 1);
            let points = &run.points;
            let position = [
                f32x8::from_slice(simd, &points.position[0][range.clone()]),
                f32x8::from_slice(simd, &points.position[1][range.clone()]),
                f32x8::from_slice(simd, &points.position[2][range.clone()]),
            ];
            let (along, across_squared) = self.project(simd, position);
            let reach = f32x8::from_slice(simd, &points.radius[range]) + self.distance;
            let within = across_squared.simd_le(reach * reach)
                & (along - reach).simd_le(self.end)
                & (along + reach).simd_ge(self.start);
            near[chunk / 8] |= within.to_bitmask() << (CHUNK_POINTS * (chunk % 8));
        }
        let (low, high) = (run.len.min(64) as u32, run.len.saturating_sub(64) as u32);
        [near[0] & mask(low), near[1] & mask(high)]
    }

    #[inline(always)]
    fn chunks_near<S: Simd>(&self, simd: S, run: &DecodedRun) -> u64 {
        let mut near = 0;
        for some in 0..CHUNKS / 8 {
            let range = 8 * some..8 * some + 8;
            let center = [
                f32x8::from_slice(simd, &run.chunk_center[0][range.clone()]),
                f32x8::from_slice(simd, &run.chunk_center[1][range.clone()]),
                f32x8::from_slice(simd, &run.chunk_center[2][range.clone()]),
            ];
            let (along, across_squared) = self.project(simd, center);
            let gap = (along - self.end).max(self.start - along).max(0.0);
            // Not a number for chunks that the run does not have.
            let reach = f32x8::from_slice(simd, &run.chunk_reach_squared[range]).sqrt() + self.distance;
            near |= gap.mul_add(gap, across_squared).simd_le(reach * reach).to_bitmask() << (8 * some);
        }
        near
    }

    /// Distances along the line, and squared distances from it.
    #[inline(always)]
    fn project<S: Simd>(&self, simd: S, position: [f32x8<S>; 3]) -> (f32x8<S>, f32x8<S>) {
        let (x, y, z) = (
            position[0] + self.minus_foot[0],
            position[1] + self.minus_foot[1],
            position[2] + self.minus_foot[2],
        );
        let dx = f32x8::splat(simd, self.direction[0]);
        let dy = f32x8::splat(simd, self.direction[1]);
        let dz = f32x8::splat(simd, self.direction[2]);
        let along = z.mul_add(dz, y.mul_add(dy, x * dx));
        let back = -along;
        let (x, y, z) = (back.mul_add(dx, x), back.mul_add(dy, y), back.mul_add(dz, z));
        (along, z.mul_add(z, y.mul_add(y, x * x)))
    }
}

/// The lanes of a group in a column.
#[inline(always)]
fn lanes_of<S: Simd>(simd: S, column: &[f32; LANES], first: usize) -> [f32x8<S>; 2] {
    let lanes = &column[first..first + GROUP];
    [f32x8::from_slice(simd, &lanes[..8]), f32x8::from_slice(simd, &lanes[8..])]
}

/// The lowest bits, up to 64.
#[inline(always)]
fn mask(bits: u32) -> u64 {
    if bits >= 64 { u64::MAX } else { (1 << bits) - 1 }
}
