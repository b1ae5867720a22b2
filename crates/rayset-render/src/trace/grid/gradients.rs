//! Shading vectors and boundaries of grids.

use super::batch::{BATCH, Row};
use super::opacity::Values;
use rayset_base::geometry::DAffine3;

/// Gradients of stored numbers, in voxels, as shading vectors and boundaries in the world.
pub(super) struct Gradients {
    /// Scaled so that its largest component is 1.
    world_from_voxel: [[f32; 3]; 3],
    /// Boundary times the length of the scaled gradient: factor · number + offset.
    factor: f32,
    offset: f32,
}

impl Gradients {
    /// `outward` is −1 if the opacity rises with the value, else 1; `boundary_value` is the value
    /// at the boundary.
    pub(super) fn new(
        voxel_from_world: &DAffine3,
        values: &Values,
        outward: f64,
        boundary_value: f64,
    ) -> Self {
        let matrix = voxel_from_world.matrix3.transpose() * (values.scale * outward);
        let largest = matrix.to_cols_array().into_iter().fold(0.0, |most: f64, v| most.max(v.abs()));
        let unit = if largest > 0.0 { largest } else { 1.0 };
        let rows = (matrix.transpose() * (1.0 / unit)).to_cols_array_2d();
        Self {
            world_from_voxel: rows.map(|row| row.map(|v| v as f32)),
            factor: (values.scale * outward / unit) as f32,
            offset: ((values.offset - boundary_value) * outward / unit) as f32,
        }
    }

    /// Those of a quantity that is 1 where something shows and 0 where nothing does; the boundary
    /// lies at one half.
    pub(super) fn of_shown(voxel_from_world: &DAffine3) -> Self {
        Self::new(voxel_from_world, &Values { base: 0.0, scale: 1.0, offset: 0.0 }, -1.0, 0.5)
    }

    /// Shading vectors, of length one or zero, and boundaries.
    #[inline(always)]
    pub(super) fn of(&self, numbers: &Row, [x, y, z]: &[Row; 3]) -> ([Row; 3], Row) {
        let m = &self.world_from_voxel;
        let mut normal = [[0.0; BATCH]; 3];
        for (row, m) in normal.iter_mut().zip(m) {
            for i in 0..BATCH {
                row[i] = m[0] * x[i] + m[1] * y[i] + m[2] * z[i];
            }
        }
        let mut boundary = [0.0; BATCH];
        for i in 0..BATCH {
            let [a, b, c] = [normal[0][i], normal[1][i], normal[2][i]];
            // Relative to the largest component, so that squaring can neither overflow nor
            // underflow to zero.
            let largest = a.abs().max(b.abs()).max(c.abs());
            let fits = (f32::MIN_POSITIVE..f32::INFINITY).contains(&largest);
            let unit = if fits { 1.0 / largest } else { 0.0 };
            let [a, b, c] = [a * unit, b * unit, c * unit];
            let length = (a * a + b * b + c * c).sqrt();
            let inverse = if fits { 1.0 / length } else { 0.0 };
            (normal[0][i], normal[1][i], normal[2][i]) = (a * inverse, b * inverse, c * inverse);
            boundary[i] = (numbers[i] * self.factor + self.offset) / (length * largest);
        }
        (normal, boundary)
    }
}
