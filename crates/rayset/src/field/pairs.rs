//! Tests one ray against the points of a run, sixteen at a time: which of them reach its samples.

use fearless_simd::f32x16;
use fearless_simd::prelude::*;

use super::lane_ray::{BLOCKS, LaneRay};
use super::run::DecodedRun;
use crate::octree::layout::RUN_POINTS;

/// One ray and the points of a run, with distances in units of each point's radius.
#[derive(Clone, Debug)]
pub(super) struct Pairs {
    /// Distance along the ray from its foot to the position nearest to the point, divided by the radius.
    pub(super) nearest: [f32; RUN_POINTS],
    /// 1 − d⊥²/r², with d⊥ the distance of the point from the ray.
    pub(super) inside: [f32; RUN_POINTS],
    /// The vector from the ray to the point in the packet's space, if gradients are computed.
    pub(super) across: [[f32; RUN_POINTS]; 3],
    /// For each block of samples, the points that reach it; a bit for each.
    pub(super) hits: [[u64; 2]; BLOCKS],
}

impl Default for Pairs {
    fn default() -> Self {
        Self {
            nearest: [0.0; RUN_POINTS],
            inside: [0.0; RUN_POINTS],
            across: [[0.0; RUN_POINTS]; 3],
            hits: [[0; 2]; BLOCKS],
        }
    }
}

impl Pairs {
    /// Finds the points that reach samples of the slab; false if there are none.
    #[inline(always)]
    pub(super) fn test<S: Simd, const GRADIENT: bool>(
        &mut self,
        simd: S,
        ray: &LaneRay<S>,
        run: &DecodedRun,
        mut chunks: u64,
    ) -> bool {
        let mut hits = [[0_u64; 2]; BLOCKS];
        while chunks != 0 {
            let chunk = chunks.trailing_zeros() as usize & 7;
            chunks &= chunks - 1;
            let range = 16 * chunk..16 * chunk + 16;
            let position = [
                f32x16::from_slice(simd, &run.position[0][range.clone()]),
                f32x16::from_slice(simd, &run.position[1][range.clone()]),
                f32x16::from_slice(simd, &run.position[2][range.clone()]),
            ];
            let (nearest, [x, y, z]) = ray.project(simd, position);
            let inverse = f32x16::from_slice(simd, &run.inverse_radius[range.clone()]);
            let distance_squared = z.mul_add(z, y.mul_add(y, x * x));
            let nearest = nearest * inverse;
            let inside = (-distance_squared).mul_add(inverse * inverse, f32x16::splat(simd, 1.0));
            // Far larger than the rounding error of a pair that barely contributes.
            let reach = inside + 1e-5;
            for b in 0..BLOCKS {
                let before = inverse * ray.block_start[b] - nearest;
                let behind = nearest - inverse * ray.block_end[b];
                let gap = before.max(behind).max(0.0);
                hits[b][chunk / 4] |= (gap * gap).simd_lt(reach).to_bitmask() << (16 * (chunk % 4));
            }
            nearest.store_slice(&mut self.nearest[range.clone()]);
            inside.store_slice(&mut self.inside[range.clone()]);
            if GRADIENT {
                x.store_slice(&mut self.across[0][range.clone()]);
                y.store_slice(&mut self.across[1][range.clone()]);
                z.store_slice(&mut self.across[2][range.clone()]);
            }
        }
        let valid = [u64::MAX >> 64_usize.saturating_sub(run.len).min(63), high_mask(run.len)];
        let mut any = 0;
        for b in 0..BLOCKS {
            self.hits[b] = [hits[b][0] & valid[0], hits[b][1] & valid[1]];
            any |= self.hits[b][0] | self.hits[b][1];
        }
        any != 0
    }
}

/// The bits of points 64 to 127 of a run of `len` points.
#[inline(always)]
fn high_mask(len: usize) -> u64 {
    match len.saturating_sub(64) {
        0 => 0,
        more => u64::MAX >> (64 - more),
    }
}
