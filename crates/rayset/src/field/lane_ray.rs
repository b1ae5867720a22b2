//! Rays relative to a run of points: their positions nearest to the run's centre, and their samples counted from there.
//!
//! The vector from a ray to a point is computed in coordinates relative to the centre of the run, with the ray's origin
//! moved (in `f64`) to its foot, the position nearest to that centre: |c|² − t_c² with distances from the eye would
//! lose all digits.

use fearless_simd::f32x16;
use fearless_simd::prelude::*;

use super::packet::{LANES, Packet, SLAB_SAMPLES, Slab};
use super::run::DecodedRun;

/// Vectors of sixteen samples in a slab.
pub(super) const BLOCKS: usize = SLAB_SAMPLES / 16;

const COUNT: [f32; 16] = [0., 1., 2., 3., 4., 5., 6., 7., 8., 9., 10., 11., 12., 13., 14., 15.];

/// The rays of a packet relative to a run: the foot of each ray, nearest to the run's centre, and its samples counted
/// from there.
pub(super) struct Frames {
    foot: [[f32; LANES]; 3],
    /// Number of the slab's first sample, counted from sample zero, which lies within one step of the foot.
    first_sample: [f32; LANES],
    /// Signed distance along the ray from the foot to sample zero.
    sample_zero: [f32; LANES],
}

impl Frames {
    #[inline(always)]
    pub(super) fn new(run: &DecodedRun, packet: &Packet, slab: Slab) -> Self {
        let mut frames =
            Self { foot: [[0.0; LANES]; 3], first_sample: [0.0; LANES], sample_zero: [0.0; LANES] };
        let (o, d) = (&packet.origin, &packet.direction);
        let center = run.center.to_array();
        let first = slab.first as f64;
        // Separate multiplications and additions: `f64` has enough precision, and fused operations are slow on
        // processors that have no instruction for them.
        for lane in 0..LANES {
            let (x, y, z) = (o[0][lane] - center[0], o[1][lane] - center[1], o[2][lane] - center[2]);
            let t_foot = -(x * d[0][lane] + y * d[1][lane] + z * d[2][lane]);
            frames.foot[0][lane] = (x + t_foot * d[0][lane]) as f32;
            frames.foot[1][lane] = (y + t_foot * d[1][lane]) as f32;
            frames.foot[2][lane] = (z + t_foot * d[2][lane]) as f32;
            let nearest = (t_foot * packet.per_step[lane]).floor();
            frames.first_sample[lane] = (first - nearest) as f32;
            frames.sample_zero[lane] =
                ((nearest + packet.sample_offset[lane]) * packet.step[lane] - t_foot) as f32;
        }
        frames
    }

    /// Lanes whose samples in the slab may lie within the run's bounds of influence.
    #[inline(always)]
    pub(super) fn lanes_that_meet<S: Simd>(
        &self,
        simd: S,
        run: &DecodedRun,
        packet: &Packet,
        samples: usize,
    ) -> u64 {
        let mut mask = 0;
        let last = (samples - 1) as f32;
        for chunk in 0..LANES / 16 {
            let step = lanes_of(simd, &packet.step_f32, chunk);
            let start =
                lanes_of(simd, &self.first_sample, chunk) * step + lanes_of(simd, &self.sample_zero, chunk);
            // Half a step of slack on either side covers the rounding error of this test.
            let (mut enter, mut exit) = (start - step * 0.5, start + step * (last + 0.5));
            for axis in 0..3 {
                let foot = lanes_of(simd, &self.foot[axis], chunk);
                let inverse = lanes_of(simd, &packet.inverse_direction[axis], chunk);
                let reach = run.reach[axis];
                // A ray parallel to this axis never crosses its planes: the products are huge, of opposite signs inside
                // and of the same sign outside.
                let (a, b) = ((-reach - foot) * inverse, (reach - foot) * inverse);
                enter = enter.max(a.min(b));
                exit = exit.min(a.max(b));
            }
            let slack = (enter.abs() + exit.abs()) * 1e-5;
            mask |= (enter - slack).simd_le(exit + slack).to_bitmask() << (16 * chunk);
        }
        mask
    }
}

/// Sixteen lanes of a column. A function, because closures are not always inlined where vector code requires it.
#[inline(always)]
fn lanes_of<S: Simd>(simd: S, column: &[f32; LANES], chunk: usize) -> f32x16<S> {
    f32x16::from_slice(simd, &column[16 * chunk..16 * chunk + 16])
}

/// One ray relative to a run.
pub(super) struct LaneRay<S: Simd> {
    foot: [f32; 3],
    pub(super) direction: [f32; 3],
    /// Distances of the slab's samples along the ray, measured from its foot.
    pub(super) t: [f32x16<S>; BLOCKS],
    /// The same for the first and the last sample of each block, slightly widened, so that culling is never stricter
    /// than the evaluation.
    pub(super) block_start: [f32; BLOCKS],
    pub(super) block_end: [f32; BLOCKS],
}

impl<S: Simd> LaneRay<S> {
    #[inline(always)]
    pub(super) fn new(simd: S, packet: &Packet, frames: &Frames, lane: usize) -> Self {
        let step = packet.step_f32[lane];
        let (first, zero) = (frames.first_sample[lane], frames.sample_zero[lane]);
        let count = f32x16::from_slice(simd, &COUNT);
        let mut ray = Self {
            foot: [frames.foot[0][lane], frames.foot[1][lane], frames.foot[2][lane]],
            direction: packet.direction_f32(lane),
            t: [f32x16::splat(simd, zero); BLOCKS],
            block_start: [0.0; BLOCKS],
            block_end: [0.0; BLOCKS],
        };
        for b in 0..BLOCKS {
            let block_first = first + (16 * b) as f32;
            ray.t[b] = (count + block_first).mul_add(step, ray.t[b]);
            ray.block_start[b] = (block_first - 0.01) * step + zero;
            ray.block_end[b] = (block_first + 15.01) * step + zero;
        }
        ray
    }

    /// Distances along the ray at which it is nearest to the points, and the vectors from the ray to the points there.
    #[inline(always)]
    pub(super) fn project(&self, simd: S, position: [f32x16<S>; 3]) -> (f32x16<S>, [f32x16<S>; 3]) {
        let (x, y, z) = (position[0] - self.foot[0], position[1] - self.foot[1], position[2] - self.foot[2]);
        let dx = f32x16::splat(simd, self.direction[0]);
        let dy = f32x16::splat(simd, self.direction[1]);
        let dz = f32x16::splat(simd, self.direction[2]);
        let nearest = z.mul_add(dz, y.mul_add(dy, x * dx));
        let back = -nearest;
        (nearest, [back.mul_add(dx, x), back.mul_add(dy, y), back.mul_add(dz, z)])
    }

    /// Chunks of sixteen points whose sphere of influence the ray meets within the slab; a bit for each.
    #[inline(always)]
    pub(super) fn chunks_in_reach(&self, simd: S, run: &DecodedRun) -> u64 {
        let center = [
            f32x16::from_slice(simd, &run.chunk_center[0]),
            f32x16::from_slice(simd, &run.chunk_center[1]),
            f32x16::from_slice(simd, &run.chunk_center[2]),
        ];
        let (nearest, [x, y, z]) = self.project(simd, center);
        let distance_squared = z.mul_add(z, y.mul_add(y, x * x));
        let gap = (self.block_start[0] - nearest).max(nearest - self.block_end[BLOCKS - 1]).max(0.0);
        let within =
            gap.mul_add(gap, distance_squared).simd_le(f32x16::from_slice(simd, &run.chunk_reach_squared));
        within.to_bitmask() & ((1 << run.len.div_ceil(16)) - 1)
    }
}
