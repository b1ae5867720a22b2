//! Bricks of a grid: the cell of a position, and values and gradients within it.

use crate::geometry::DVec3;
use crate::grid::format::{GridHeader, VoxelKind};

/// The cell of a place, as the index of its first voxel within a brick, and how far into the cell the place lies, 0 to
/// 1 on each axis. A place on the last voxel of an axis is at 1 in the last cell.
///
/// All differences are between numbers within a cell of each other or between integers, so none is rounded. The
/// difference between a place and a brick's corner would be rounded, and could fall into another cell.
pub(super) fn cell_in_brick(header: &GridHeader, place: DVec3, first: [i64; 3]) -> ([usize; 3], DVec3) {
    // A place on a face of the grid may have been rounded to just outside it.
    let cell = place.floor().max(DVec3::ZERO).min(header.last_voxel() - 1.0);
    let in_brick = std::array::from_fn(|axis| (cell[axis] as i64 - first[axis]) as usize);
    (in_brick, place - cell)
}

/// The voxels of a brick.
pub(super) struct Brick<'a> {
    pub(super) bytes: &'a [u8],
    pub(super) kind: VoxelKind,
}

impl Brick<'_> {
    fn voxel(&self, [x, y, z]: [usize; 3]) -> f64 {
        let n = self.kind.brick_voxels();
        let at = ((z * n + y) * n + x) * self.kind.bytes();
        f64::from(self.kind.value(&self.bytes[at..]))
    }

    /// Interpolates between the eight voxels of a cell.
    pub(super) fn trilinear(&self, [x, y, z]: [usize; 3], f: DVec3) -> f64 {
        let along_x = |y: usize, z: usize| {
            let (a, b) = (self.voxel([x, y, z]), self.voxel([x + 1, y, z]));
            a + (b - a) * f.x
        };
        let along_y = |z: usize| {
            let (a, b) = (along_x(y, z), along_x(y + 1, z));
            a + (b - a) * f.y
        };
        let (a, b) = (along_y(z), along_y(z + 1));
        a + (b - a) * f.z
    }

    /// The voxels that the gradient within a cell needs. Every brick holds a voxel on either side of each of its cells.
    pub(super) fn neighborhood(&self, cell: [usize; 3]) -> Neighborhood {
        match self.kind {
            VoxelKind::U8 => self.rows_of_four(cell, |[a]| f32::from(a)),
            VoxelKind::I16 => self.rows_of_four(cell, |bytes| f32::from(i16::from_le_bytes(bytes))),
            VoxelKind::U16 => self.rows_of_four(cell, |bytes| f32::from(u16::from_le_bytes(bytes))),
            VoxelKind::F32 => self.rows_of_four(cell, f32::from_le_bytes),
        }
    }

    fn rows_of_four<const BYTES: usize>(
        &self,
        [x, y, z]: [usize; 3],
        value: impl Fn([u8; BYTES]) -> f32,
    ) -> Neighborhood {
        let n = self.kind.brick_voxels();
        let mut voxels = [[[0.0; 4]; 4]; 4];
        for (k, plane) in voxels.iter_mut().enumerate() {
            for (j, row) in plane.iter_mut().enumerate() {
                let at = (((z + k - 1) * n + y + j - 1) * n + x - 1) * BYTES;
                let (bytes, _) = self.bytes[at..at + 4 * BYTES].as_chunks::<BYTES>();
                for (voxel, &bytes) in row.iter_mut().zip(bytes) {
                    *voxel = f64::from(value(bytes));
                }
            }
        }
        Neighborhood(voxels)
    }
}

/// The 4 × 4 × 4 voxels around a cell: from one before its first on each axis to one behind its last; z, y, x.
pub(super) struct Neighborhood([[[f64; 4]; 4]; 4]);

impl Neighborhood {
    /// Interpolates as [`Brick::trilinear`] does, in the cell whose first voxel is `[x, y, z]`.
    fn trilinear(&self, [x, y, z]: [usize; 3], f: DVec3) -> f64 {
        let along_x = |y: usize, z: usize| {
            let row = &self.0[z][y];
            row[x] + (row[x + 1] - row[x]) * f.x
        };
        let along_y = |z: usize| {
            let (a, b) = (along_x(y, z), along_x(y + 1, z));
            a + (b - a) * f.y
        };
        let (a, b) = (along_y(z), along_y(z + 1));
        a + (b - a) * f.z
    }

    /// Central differences over one voxel to either side.
    pub(super) fn gradient(&self, f: DVec3) -> DVec3 {
        let difference = |before: [usize; 3], behind: [usize; 3]| {
            0.5 * (self.trilinear(behind, f) - self.trilinear(before, f))
        };
        DVec3::new(
            difference([0, 1, 1], [2, 1, 1]),
            difference([1, 0, 1], [1, 2, 1]),
            difference([1, 1, 0], [1, 1, 2]),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::DAffine3;

    fn header(size: [u64; 3], kind: VoxelKind) -> GridHeader {
        GridHeader {
            identity: crate::container::Identity::default(),
            size,
            kind,
            range: (0.0, 1.0),
            scale: 1.0,
            offset: 0.0,
            space_from_voxel: DAffine3::IDENTITY,
            file_bytes: 0,
            sources: Vec::new(),
            up: None,
            facing: None,
        }
    }

    #[test]
    fn a_place_is_in_its_own_cell_and_in_one_that_its_brick_has() {
        for &kind in VoxelKind::ALL {
            let cells = kind.brick_cells();
            for n in 2..=130_u64 {
                let header = header([n, n, 2], kind);
                let last = (n - 1) as f64;
                // Every voxel, the floating-point numbers next to it, and places in between.
                let places = (0..n).flat_map(|i| {
                    let i = i as f64;
                    [i, i.next_down(), i.next_up(), i + 1e-17, i + 1e-3, i + 0.5, (i + 1.0).next_down()]
                });
                for x in places.filter(|x| (0.0..=last).contains(x)) {
                    let cell = (x as u64).min(n - 2);
                    let corner = ((cell / cells) * cells) as i64 - 1;
                    let ([found, ..], within) =
                        cell_in_brick(&header, DVec3::new(x, 0.0, 0.0), [corner, -1, -1]);
                    assert_eq!(found as i64 + corner, cell as i64, "{n} voxels, at {x:e}");
                    assert!((1..=cells as usize).contains(&found), "{n} voxels, at {x:e}: cell {found}");
                    assert_eq!(within.x + cell as f64, x, "{n} voxels, at {x:e}");
                    assert!((0.0..=1.0).contains(&within.x), "{n} voxels, at {x:e}: {}", within.x);
                }
            }
        }
    }
}
