//! Where a grid and its bricks are.

use super::shape::BrickShape;
use rayset_base::geometry::{Aabb, DAffine3};
use rayset_files::grid::format::GridHeader;

/// Where a grid is.
#[derive(Clone, Copy, Debug)]
pub(super) struct Placement {
    pub(super) voxel_from_world: DAffine3,
    pub(super) bounds_voxel: Aabb,
    pub(super) bricks: Bricks,
}

/// The bricks of a grid. Each is a page, so that their numbers fit in 32 bits.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bricks {
    /// Along each axis.
    pub(super) count: [u32; 3],
    pub(super) shape: BrickShape,
}

impl Bricks {
    pub(super) fn new(header: &GridHeader) -> Self {
        Self { count: header.bricks().map(|count| count as u32), shape: BrickShape::of(header) }
    }

    /// The number of the brick at a place among the bricks, x fastest.
    #[inline(always)]
    pub(super) fn number(&self, [x, y, z]: [u32; 3]) -> u32 {
        (z.wrapping_mul(self.count[1]).wrapping_add(y)).wrapping_mul(self.count[0]).wrapping_add(x)
    }

    /// The place of a brick among the bricks.
    pub(super) fn place(&self, number: u32) -> [u32; 3] {
        let [x, y, _] = self.count;
        [number % x, number / x % y, number / x / y]
    }
}
