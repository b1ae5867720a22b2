//! How the voxels of a brick lie: in cubes, or in boxes for thin grids.

use rayset_files::grid::format::GridHeader;

/// Cells along an edge of a block, the part of a brick of which it is known whether it shows
/// anything.
pub(super) const BLOCK_CELLS: usize = 4;

/// The voxels along the edges of a brick.
#[derive(Clone, Copy, Debug)]
pub(super) struct BrickShape([u16; 3]);

impl BrickShape {
    pub(super) fn of(header: &GridHeader) -> Self {
        Self(header.brick_voxels.map(|n| n as u16))
    }

    #[inline(always)]
    pub(super) fn voxels(self, axis: usize) -> usize {
        usize::from(self.0[axis])
    }

    /// Cells along an edge.
    #[inline(always)]
    pub(super) fn cells(self, axis: usize) -> usize {
        self.voxels(axis) - 3
    }

    /// Blocks of cells along an edge.
    #[inline(always)]
    pub(super) fn blocks(self, axis: usize) -> usize {
        self.cells(axis).div_ceil(BLOCK_CELLS)
    }

    /// Voxels from one to the next along y, and along z.
    #[inline(always)]
    pub(super) fn strides(self) -> (usize, usize) {
        let row = self.voxels(0);
        (row, row * self.voxels(1))
    }
}
