//! How the voxels of a brick lie: in cubes, whose numbers the compiler knows, or in boxes, for thin grids.

use super::voxels::Voxel;
use crate::grid::format::GridHeader;

/// Cells along an edge of a block, the part of a brick of which it is known whether it shows anything.
pub(super) const BLOCK_CELLS: usize = 4;

/// The voxels along the edges of a brick.
pub(super) trait BrickShape: Copy {
    fn voxels<V: Voxel>(self, axis: usize) -> usize;

    /// Cells along an edge.
    #[inline(always)]
    fn cells<V: Voxel>(self, axis: usize) -> usize {
        self.voxels::<V>(axis) - 3
    }

    /// Blocks of cells along an edge.
    #[inline(always)]
    fn blocks<V: Voxel>(self, axis: usize) -> usize {
        self.cells::<V>(axis).div_ceil(BLOCK_CELLS)
    }

    /// Voxels from one to the next along y, and along z.
    #[inline(always)]
    fn strides<V: Voxel>(self) -> (usize, usize) {
        let row = self.voxels::<V>(0);
        (row, row * self.voxels::<V>(1))
    }
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Cube;

impl BrickShape for Cube {
    #[inline(always)]
    fn voxels<V: Voxel>(self, _: usize) -> usize {
        V::SIDE
    }
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Cuboid([u16; 3]);

impl Cuboid {
    /// `None` if the bricks of a grid are cubes.
    pub(super) fn of(header: &GridHeader) -> Option<Self> {
        (!header.has_cubes()).then(|| Self(header.brick_voxels.map(|n| n as u16)))
    }
}

impl BrickShape for Cuboid {
    #[inline(always)]
    fn voxels<V: Voxel>(self, axis: usize) -> usize {
        usize::from(self.0[axis])
    }
}

/// Calls a generic function with the type of a [`VoxelKind`](crate::grid::format::VoxelKind) and the shape of bricks.
macro_rules! with_bricks {
    ($kind:expr, $cuboid:expr, $V:ident, $shape:ident => $call:expr) => {
        match $cuboid {
            None => {
                let $shape = $crate::trace::grid::shape::Cube;
                with_voxel!($kind, $V => $call)
            }
            Some($shape) => with_voxel!($kind, $V => $call),
        }
    };
}
pub(super) use with_bricks;
