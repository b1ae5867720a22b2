//! Tests one ray against the points of a run, eight at a time: which of them reach its samples.

use fearless_simd::f32x8;
use fearless_simd::prelude::*;

use super::columns::{CHUNK_POINTS, CHUNKS, MAP_COLUMNS, PointColumns};
use super::lane_ray::LaneRay;
use super::packet::{BLOCK_SAMPLES, BLOCKS, BlockRange};
use rayset_files::octree::layout::RUN_POINTS;

/// One ray and the points of a run, with distances in units of each point's radius.
#[derive(Clone, Debug)]
pub(super) struct Pairs {
    /// Distance along the ray from its foot to the position nearest to the point, divided by the
    /// radius.
    pub(super) nearest: [f32; RUN_POINTS],
    /// 1 − d⊥²/r², with d⊥ the distance of the point from the ray; both in the space in which it is
    /// a ball.
    pub(super) inside: [f32; RUN_POINTS],
    /// The vector from the ray to the point in the packet's space, if gradients are computed.
    pub(super) across: [[f32; RUN_POINTS]; 3],
    /// Of ellipsoids, the length that a unit of the ray has in the space in which the point is the
    /// unit ball: of balls it is the inverse radius.
    pub(super) scale: [f32; RUN_POINTS],
    /// Of ellipsoids, if gradients are computed: what the gradient of the squared distance in that
    /// space grows by along the ray, halved. `across` is the same, of the vector from ray to point.
    pub(super) toward: [[f32; RUN_POINTS]; 3],
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
    /// Those of samples, or of their intervals, which begin up to a step before them.
    pub(super) fn new(of_intervals: bool) -> Self {
        let of = |offset: f32| std::array::from_fn(|b| [b as f32 + offset; CHUNK_POINTS]);
        let step = 1.0 / BLOCK_SAMPLES as f32;
        if of_intervals {
            Self { begin: of(-step), end: of(1.0) }
        } else {
            Self { begin: of(0.0), end: of(1.0 - step) }
        }
    }
}

impl Default for Pairs {
    fn default() -> Self {
        Self {
            nearest: [0.0; RUN_POINTS],
            inside: [0.0; RUN_POINTS],
            across: [[0.0; RUN_POINTS]; 3],
            scale: [0.0; RUN_POINTS],
            toward: [[0.0; RUN_POINTS]; 3],
            first_block: 0,
            hits: [[0; CHUNKS]; BLOCKS],
        }
    }
}

impl Pairs {
    /// Finds the points of some chunks that reach samples of some blocks.
    #[inline(always)]
    pub(super) fn test<S: Simd, const GRADIENT: bool, const SHAPES: bool>(
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
            let (from, to) = if SHAPES {
                self.reach_ellipsoids::<S, GRADIENT>(simd, ray, points, chunk)
            } else {
                self.reach::<S, GRADIENT>(simd, ray, points, chunk)
            };
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

    /// The same for ellipsoids. In the space to which its map A takes a point, that is the unit
    /// ball and a ray is a ray: with c the point relative to the foot and the direction d, it is
    /// nearest at t = (A c · A d)/|A d|², and A c − t A d is the vector to the point there.
    #[inline(always)]
    fn reach_ellipsoids<S: Simd, const GRADIENT: bool>(
        &mut self,
        simd: S,
        ray: &LaneRay,
        points: &PointColumns,
        chunk: usize,
    ) -> (f32x8<S>, f32x8<S>) {
        let range = CHUNK_POINTS * chunk..CHUNK_POINTS * (chunk + 1);
        let Some(columns) = points.map.first_chunk::<MAP_COLUMNS>() else {
            // Not a number: nothing is reached.
            return (f32x8::splat(simd, f32::NAN), f32x8::splat(simd, f32::NAN));
        };
        let mut to = [f32x8::splat(simd, 0.0); 3];
        for axis in 0..3 {
            to[axis] = f32x8::from_slice(simd, &points.position[axis][range.clone()]) + ray.minus_foot[axis];
        }
        let (mut map, mut center, mut direction) = ([[to[0]; 3]; 3], to, to);
        for row in 0..3 {
            for axis in 0..3 {
                map[row][axis] = f32x8::from_slice(simd, &columns[3 * row + axis][range.clone()]);
            }
            let [x, y, z] = map[row];
            center[row] = z.mul_add(to[2], y.mul_add(to[1], x * to[0]));
            let [dx, dy, dz] = ray.direction;
            direction[row] = z.mul_add(
                f32x8::splat(simd, dz),
                y.mul_add(f32x8::splat(simd, dy), x * f32x8::splat(simd, dx)),
            );
        }
        let scale_squared = dot(direction, direction);
        let scale = scale_squared.sqrt();
        let per_scale = 1.0 / scale;
        let nearest = dot(center, direction) * (per_scale * per_scale);
        let mut across = center;
        for row in 0..3 {
            across[row] = (-nearest).mul_add(direction[row], center[row]);
        }
        let inside = (-dot(across, across)) + 1.0;
        scale.store_slice(&mut self.scale[range.clone()]);
        (nearest * scale).store_slice(&mut self.nearest[range.clone()]);
        inside.store_slice(&mut self.inside[range.clone()]);
        if GRADIENT {
            for axis in 0..3 {
                let column = [map[0][axis], map[1][axis], map[2][axis]];
                dot(column, across).store_slice(&mut self.across[axis][range.clone()]);
                (dot(column, direction) * per_scale).store_slice(&mut self.toward[axis][range.clone()]);
            }
        }
        // The slack is far larger than the rounding error of a pair that barely contributes.
        let half = (inside + 1e-3).sqrt() * per_scale;
        (nearest - half, nearest + half)
    }
}

#[inline(always)]
fn dot<S: Simd>(a: [f32x8<S>; 3], b: [f32x8<S>; 3]) -> f32x8<S> {
    a[2].mul_add(b[2], a[1].mul_add(b[1], a[0] * b[0]))
}
