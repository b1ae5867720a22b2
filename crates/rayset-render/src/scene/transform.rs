//! Transforms: which are allowed, and how far they stretch.

use super::{FARTHEST, SHORTEST, SceneError};
use rayset_base::geometry::{DAffine3, DVec3};

/// Checks that a transform is invertible and that it and its inverse keep lengths and positions
/// within the allowed range.
pub(crate) fn check_transform(transform: &DAffine3) -> Result<(), SceneError> {
    if *transform == DAffine3::IDENTITY {
        return Ok(());
    }
    let m = transform.matrix3;
    let determinant = m.determinant();
    let size = m.x_axis.length() * m.y_axis.length() * m.z_axis.length();
    let invertible = determinant.abs() > 1e-12 * size && transform.is_finite() && size > 0.0;
    if !invertible {
        return Err(SceneError::Singular { determinant });
    }
    let largest = |m: &DAffine3| m.to_cols_array().into_iter().map(f64::abs).fold(0.0, f64::max);
    let inverse = m.inverse();
    let (most, most_back) =
        (largest(transform), largest(&DAffine3 { matrix3: inverse, ..DAffine3::IDENTITY }));
    if !(most <= FARTHEST) {
        return Err(SceneError::Stretch { length: most });
    }
    if most_back <= 1.0 / SHORTEST { Ok(()) } else { Err(SceneError::Stretch { length: 1.0 / most_back }) }
}

/// The greatest length to which a linear map takes a vector of length one.
#[must_use]
pub fn largest_stretch(map: &DAffine3) -> f64 {
    // Power iteration on MᵀM, from a start vector that is not orthogonal to any axis.
    let m = map.matrix3;
    let square = m.transpose() * m;
    let mut v = DVec3::new(0.577, 0.578, 0.576);
    for _ in 0..64 {
        v = (square * v).normalize_or(v);
    }
    (m * v).length()
}
