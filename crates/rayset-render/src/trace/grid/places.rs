//! Where the samples of a slab are in the bricks of a grid.

use super::placement::Placement;
use super::rays::GridRay;
use super::shape::BLOCK_CELLS;
use crate::field::{BLOCK_SAMPLES, LANES, SLAB_SAMPLES};

/// One number for each sample of a slab, lane by lane, in groups of eight samples that follow each
/// other on a ray.
pub(super) type OfSamples<T> = [[T; BLOCK_SAMPLES]; GROUPS];
/// Groups of eight samples in a slab.
pub(super) const GROUPS: usize = LANES * GROUPS_OF_LANE;
pub(super) const GROUPS_OF_LANE: usize = SLAB_SAMPLES / BLOCK_SAMPLES;

/// Where the samples of a slab are in their bricks.
pub(super) struct Places {
    /// Index of the first voxel of the cell in the brick.
    pub(super) voxel: OfSamples<u16>,
    /// The block of the cell in the brick.
    pub(super) block: OfSamples<u16>,
    /// How far into the cell on each axis, 0 to 1 inside the grid.
    pub(super) within: [OfSamples<f32>; 3],
}

impl Places {
    pub(super) fn new() -> Self {
        Self {
            voxel: [[0; BLOCK_SAMPLES]; GROUPS],
            block: [[0; BLOCK_SAMPLES]; GROUPS],
            within: [[[0.0; BLOCK_SAMPLES]; GROUPS]; 3],
        }
    }

    /// Finds the places of all samples of a ray. Returns the numbers of their bricks.
    ///
    /// Positions beyond the first or the last cell of the grid are in that one: a place on the last
    /// voxel of an axis is at 1 in the last cell. The difference between a position and its cell is
    /// between numbers within a cell of each other, so it is not rounded until it becomes single
    /// precision.
    #[inline(always)]
    pub(super) fn locate(&mut self, grid: &Placement, ray: &GridRay, lane: usize) -> [u32; SLAB_SAMPLES] {
        let shape = grid.bricks.shape;
        let mut t = [0.0; SLAB_SAMPLES];
        for (j, t) in t.iter_mut().enumerate() {
            *t = ((ray.first + j as u64) as f64 + ray.offset) * ray.step;
        }
        let (mut bricks, mut voxels, mut blocks) =
            ([0_u32; SLAB_SAMPLES], [0_u32; SLAB_SAMPLES], [0_u32; SLAB_SAMPLES]);
        for axis in [2, 1, 0] {
            let cells_of_brick = shape.cells(axis) as f64;
            let (origin, direction) = (ray.origin[axis], ray.direction[axis]);
            let (last, count) = (grid.bounds_voxel.max[axis] - 1.0, grid.bricks.count[axis]);
            let within = row(&mut self.within[axis], lane);
            for j in 0..SLAB_SAMPLES {
                let place = origin + direction * t[j];
                let cell = place.floor().max(0.0).min(last);
                within[j] = (place - cell) as f32;
                // From the middle of the cell: rounding takes it nowhere near another brick.
                let brick = ((cell + 0.5) * (1.0 / cells_of_brick)).floor();
                let cell = whole(cell - brick * cells_of_brick);
                bricks[j] = bricks[j].wrapping_mul(count).wrapping_add(whole(brick));
                voxels[j] = voxels[j].wrapping_mul(shape.voxels(axis) as u32).wrapping_add(cell + 1);
                let along = shape.blocks(axis) as u32;
                blocks[j] = blocks[j].wrapping_mul(along).wrapping_add(cell / BLOCK_CELLS as u32);
            }
        }
        let (voxel, block) = (row(&mut self.voxel, lane), row(&mut self.block, lane));
        for j in 0..SLAB_SAMPLES {
            (voxel[j], block[j]) = (voxels[j] as u16, blocks[j] as u16);
        }
        bricks
    }
}

/// The numbers of one lane.
#[inline(always)]
fn row<T>(of_samples: &mut OfSamples<T>, lane: usize) -> &mut [T; SLAB_SAMPLES] {
    &mut of_samples.as_flattened_mut().as_chunks_mut().0[lane % LANES]
}

/// A whole number below 2³², as an integer: plus 2⁵² it is the lowest bits of a number in double
/// precision. Vectors of these can be converted like this at every level of instructions.
#[inline(always)]
fn whole(number: f64) -> u32 {
    (number + 4_503_599_627_370_496.0).to_bits() as u32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trace::grid::placement::Bricks;
    use crate::trace::grid::volume::tests::header;
    use rayset_base::geometry::{Aabb, DAffine3, DVec3};
    use rayset_files::grid::format::VoxelKind;

    #[test]
    fn a_place_is_in_its_own_cell_and_in_one_that_its_brick_has() {
        for &kind in VoxelKind::ALL {
            let (cells, side) = (kind.brick_cells() as i32, kind.brick_voxels() as i32);
            let mut found = Places::new();
            for n in 2..=130_i32 {
                let header = header([n as u64, n as u64, 2], kind);
                let grid = Placement {
                    voxel_from_world: DAffine3::IDENTITY,
                    bounds_voxel: Aabb::new(DVec3::ZERO, header.last_voxel()),
                    bricks: Bricks::new(&header),
                };
                let last = f64::from(n - 1);
                // Every voxel, the floating-point numbers next to it, and places in between.
                let places = (0..n).flat_map(|i| {
                    let i = f64::from(i);
                    [i, i.next_down(), i.next_up(), i + 1e-17, i + 1e-3, i + 0.5, (i + 1.0).next_down()]
                });
                for x in places.filter(|x| (0.0..=last).contains(x)) {
                    let (origin, direction) = (DVec3::new(x, 0.0, 0.0), DVec3::ZERO);
                    let ray = GridRay { origin, direction, offset: 0.0, first: 0, step: 1.0 };
                    let bricks = found.locate(&grid, &ray, 3);
                    let at = 3 * SLAB_SAMPLES + 31;
                    let (brick, voxel) = (bricks[31] as i32, i32::from(found.voxel.as_flattened()[at]));
                    let (within, first) = (found.within[0].as_flattened()[at], voxel % side);
                    assert_eq!((voxel / side % side, voxel / side / side), (1, 1), "y and z");
                    assert!((1..=cells).contains(&first), "{n} voxels, at {x:e}: cell {first}");
                    let cell = brick * cells + first - 1;
                    assert_eq!(cell, (x as i32).min(n - 2), "{n} voxels, at {x:e}");
                    assert!((0.0..=1.0).contains(&within), "{n} voxels, at {x:e}: {within}");
                    assert!((f64::from(within) + f64::from(cell) - x).abs() < 1e-7, "{n} voxels, at {x:e}");
                    assert_eq!(i32::from(found.block.as_flattened()[at]), (first - 1) / BLOCK_CELLS as i32);
                }
            }
        }
    }
}
