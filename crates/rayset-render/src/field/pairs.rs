//! Tests one ray against the points of a run, eight at a time: which of them reach its samples.

use fearless_simd::f32x8;
use fearless_simd::prelude::*;

use super::columns::{CHUNK_POINTS, CHUNKS, PointColumns};
use super::lane_ray::LaneRay;
use super::packet::{BLOCK_SAMPLES, BLOCKS, BlockRange};
use rayset_files::octree::layout::RUN_POINTS;

/// One ray and the points of a run, with distances in units of each point's radius.
#[derive(Clone, Debug)]
pub(super) struct Pairs {
    /// Distance along the ray from its foot to the position nearest to the point, divided by the
    /// radius.
    pub(super) nearest: [f32; RUN_POINTS],
    /// 1 − d⊥²/r², with d⊥ the distance of the point from the ray.
    pub(super) inside: [f32; RUN_POINTS],
    /// The vector from the ray to the point in the packet's space, if gradients are computed.
    pub(super) across: [[f32; RUN_POINTS]; 3],
    /// The first of the blocks of samples that were tested.
    first_block: usize,
    /// For each block from there on, the points that reach it; for each chunk of points, a bit for
    /// each.
    hits: [[u8; CHUNKS]; BLOCKS],
}

/// Where blocks of samples begin and end, in blocks: sample j of block b is at b + j/8. Whole
/// vectors, from which comparisons take them as they lie in memory.
#[derive(Clone, Copy, Debug)]
pub(super) struct BlockLimits {
    begin: [[f32; CHUNK_POINTS]; BLOCKS],
    end: [[f32; CHUNK_POINTS]; BLOCKS],
}

impl BlockLimits {
    pub(super) fn new() -> Self {
        let of = |offset: f32| std::array::from_fn(|b| [b as f32 + offset; CHUNK_POINTS]);
        Self { begin: of(0.0), end: of(1.0 - 1.0 / BLOCK_SAMPLES as f32) }
    }
}

impl Default for Pairs {
    fn default() -> Self {
        Self {
            nearest: [0.0; RUN_POINTS],
            inside: [0.0; RUN_POINTS],
            across: [[0.0; RUN_POINTS]; 3],
            first_block: 0,
            hits: [[0; CHUNKS]; BLOCKS],
        }
    }
}

impl Pairs {
    /// Finds the points of some chunks that reach samples of some blocks.
    #[inline(always)]
    pub(super) fn test<S: Simd, const GRADIENT: bool>(
        &mut self,
        simd: S,
        ray: &LaneRay,
        points: &PointColumns,
        mut chunks: u64,
        blocks: BlockRange,
        limits: &BlockLimits,
    ) {
        self.first_block = blocks.first;
        self.hits = [[0; CHUNKS]; BLOCKS];
        if chunks == 0 {
            return;
        }
        let start = ray.start_in_blocks + blocks.first as f32;
        let first = f32x8::splat(simd, -(start + ray.slack_in_blocks));
        let last = f32x8::splat(simd, ray.slack_in_blocks - start);
        let count = blocks.end - blocks.first;
        while chunks != 0 {
            let chunk = chunks.trailing_zeros() as usize & (CHUNKS - 1);
            chunks &= chunks - 1;
            let (from, to) = self.reach::<S, GRADIENT>(simd, ray, points, chunk);
            let (from, to) = (from.mul_add(ray.per_block, first), to.mul_add(ray.per_block, last));
            for b in 0..BLOCKS {
                let (begin, end) =
                    (f32x8::from_slice(simd, &limits.begin[b]), f32x8::from_slice(simd, &limits.end[b]));
                let reaches = from.simd_lt(end) & to.simd_gt(begin);
                self.hits[b][chunk] = reaches.to_bitmask() as u8;
                if b + 1 >= count {
                    break;
                }
            }
        }
    }

    /// The points that reach a block, a bit for each: those before point 64, and the others.
    #[inline(always)]
    pub(super) fn hits(&self, block: usize) -> [u64; 2] {
        let (low, high) = self.hits[(block - self.first_block) & (BLOCKS - 1)].split_at(8);
        let word = |bytes: &[u8]| u64::from_le_bytes(bytes.try_into().unwrap_or_default());
        [word(low), word(high)]
    }

    /// Projects the points of a chunk on the ray; returns where along it they begin and cease to
    /// contribute, neither of them a number if they do nowhere.
    #[inline(always)]
    fn reach<S: Simd, const GRADIENT: bool>(
        &mut self,
        simd: S,
        ray: &LaneRay,
        points: &PointColumns,
        chunk: usize,
    ) -> (f32x8<S>, f32x8<S>) {
        let range = CHUNK_POINTS * chunk..CHUNK_POINTS * (chunk + 1);
        let position = [
            f32x8::from_slice(simd, &points.position[0][range.clone()]),
            f32x8::from_slice(simd, &points.position[1][range.clone()]),
            f32x8::from_slice(simd, &points.position[2][range.clone()]),
        ];
        let (nearest, [x, y, z]) = ray.project(simd, position);
        let inverse = f32x8::from_slice(simd, &points.inverse_radius[range.clone()]);
        let inverse_squared = f32x8::from_slice(simd, &points.inverse_radius_squared[range.clone()]);
        let distance_squared = z.mul_add(z, y.mul_add(y, x * x));
        let inside = (-distance_squared).mul_add(inverse_squared, f32x8::splat(simd, 1.0));
        (nearest * inverse).store_slice(&mut self.nearest[range.clone()]);
        inside.store_slice(&mut self.inside[range.clone()]);
        if GRADIENT {
            x.store_slice(&mut self.across[0][range.clone()]);
            y.store_slice(&mut self.across[1][range.clone()]);
            z.store_slice(&mut self.across[2][range.clone()]);
        }
        // The slack is far larger than the rounding error of a pair that barely contributes.
        let half = (inside + 1e-5).sqrt();
        let radius = f32x8::from_slice(simd, &points.radius[range]);
        ((-half).mul_add(radius, nearest), half.mul_add(radius, nearest))
    }
}
