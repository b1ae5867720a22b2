//! The principal axes of symmetric matrices of three rows, in single precision.
//!
//! Of the three eigenvalues, the one that is farthest from their mean is known well, and its axis
//! from the matrix less it. Across that axis the matrix has two rows, of which the axes follow by a
//! square root (Eberly, *A Robust Eigensolver for 3 × 3 Symmetric Matrices*).

use super::footprints::dot;

/// Differences of variances below this part of them may come from rounding.
const ROUNDED: f32 = 1e-6;

/// The axes, of length one and at right angles, and the variances along them, of a covariance
/// (xx, yy, zz, xy, xz, yz): the shortest is the last.
// Without branches: the compiler makes vectors of a loop over it.
#[inline(always)]
pub(super) fn principal_axes(covariance: [f32; 6]) -> ([[f32; 3]; 3], [f32; 3]) {
    let [xx, yy, zz, xy, xz, yz] = covariance;
    let mean = (xx + yy + zz) * (1.0 / 3.0);
    let (dx, dy, dz) = (xx - mean, yy - mean, zz - mean);
    let off = xy * xy + xz * xz + yz * yz;
    let spread = ((dx * dx + dy * dy + dz * dz + 2.0 * off) * (1.0 / 6.0)).sqrt();
    // What is rounded has no axes.
    let per_spread = if spread > ROUNDED * mean { 1.0 / spread } else { 0.0 };
    // Of what is left of the matrix, as long as one.
    let [bx, by, bz, cxy, cxz, cyz] = [dx, dy, dz, xy, xz, yz].map(|v| v * per_spread);
    let determinant =
        bx * (by * bz - cyz * cyz) - cxy * (cxy * bz - cyz * cxz) + cxz * (cxy * cyz - by * cxz);
    let is_long = determinant >= 0.0;
    // cos(acos(h)/3) solves 4 c³ − 3 c = h.
    let h = (0.5 * determinant.abs()).min(1.0);
    let mut c = 0.5 + ((1.0 + h) * (1.0 / 6.0)).sqrt();
    for _ in 0..3 {
        c -= (c * (4.0 * c * c - 3.0) - h) / (12.0 * c * c - 3.0);
    }
    let value = if is_long { 2.0 * c } else { -2.0 * c };
    let rows = [[bx - value, cxy, cxz], [cxy, by - value, cyz], [cxz, cyz, bz - value]];
    let first = longest([cross(rows[0], rows[1]), cross(rows[1], rows[2]), cross(rows[2], rows[0])]);
    let [u, w] = across(first);
    let times = |v: [f32; 3]| {
        [
            xx * v[0] + xy * v[1] + xz * v[2],
            xy * v[0] + yy * v[1] + yz * v[2],
            xz * v[0] + yz * v[1] + zz * v[2],
        ]
    };
    let (of_first, of_u, of_w) = (dot(first, times(first)), dot(u, times(u)), dot(w, times(w)));
    let (of_both, half) = (dot(u, times(w)), 0.5 * (of_u - of_w));
    let length = (half * half + of_both * of_both).sqrt();
    let (a, b) = if half >= 0.0 { (half + length, of_both) } else { (of_both, length - half) };
    let per_length = 1.0 / (a * a + b * b).sqrt();
    let middle = 0.5 * (of_u + of_w);
    let (a, b) = if length > ROUNDED * middle { (a * per_length, b * per_length) } else { (1.0, 0.0) };
    let long = [0, 1, 2].map(|axis| a * u[axis] + b * w[axis]);
    let short = [0, 1, 2].map(|axis| a * w[axis] - b * u[axis]);
    let select = |of_long: [f32; 3], other: [f32; 3]| {
        [0, 1, 2].map(|axis| if is_long { of_long[axis] } else { other[axis] })
    };
    let axes = [select(first, long), select(long, short), select(short, first)];
    let variances =
        [(of_first, middle + length), (middle + length, middle - length), (middle - length, of_first)];
    (axes, variances.map(|(of_long, other)| if is_long { of_long } else { other }.max(0.0)))
}

/// The longest of three vectors, of length one; the z axis if there is none.
#[inline(always)]
fn longest(vectors: [[f32; 3]; 3]) -> [f32; 3] {
    let [a, b, c] = vectors;
    let [la, lb, lc] = vectors.map(|v| dot(v, v));
    let (v, length) = if la >= lb { (a, la) } else { (b, lb) };
    let (v, length) = if length >= lc { (v, length) } else { (c, lc) };
    let scale = 1.0 / length.max(f32::MIN_POSITIVE).sqrt();
    if length > 1e-20 { v.map(|v| v * scale) } else { [0.0, 0.0, 1.0] }
}

/// Two directions across one of length one, at a right angle (Duff et al., *Building an
/// Orthonormal Basis, Revisited*).
#[inline(always)]
fn across([x, y, z]: [f32; 3]) -> [[f32; 3]; 2] {
    let sign = 1_f32.copysign(z);
    let a = -1.0 / (sign + z);
    let b = x * y * a;
    [[1.0 + sign * x * x * a, sign * b, -sign * x], [b, sign + y * y * a, -y]]
}

#[inline(always)]
fn cross(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use rayset_base::geometry::{DMat3, DQuat, DVec3};

    proptest! {
        #[test]
        fn axes_and_variances_make_the_matrix_again(
            q in prop::array::uniform4(-1.0..1.0_f64),
            (kind, exponents) in (0..5_usize, prop::array::uniform3(-10.0..0.0_f64)),
            scale in -20.0..20.0_f64,
        ) {
            prop_assume!(q.iter().any(|v| v.abs() > 0.1));
            let [a, b, c] = exponents.map(|v| (v + scale).exp2());
            // Balls, rods and plates, too.
            let variances = [[a, b, c], [a, a, a], [a, a, c.min(a)], [a.max(b), b, b], [a, b, 0.0]][kind];
            let turn = DMat3::from_quat(DQuat::from_array(q).normalize());
            let m = turn * DMat3::from_diagonal(DVec3::from_array(variances)) * turn.transpose();
            let [x, y, z] = [0, 1, 2].map(|column| m.col(column));
            let (axes, found) = principal_axes([x.x, y.y, z.z, x.y, x.z, y.z].map(|v| v as f32));
            let largest = variances.into_iter().fold(0.0, f64::max);
            let axes = axes.map(|axis| DVec3::from_array(axis.map(f64::from)));
            let found = found.map(f64::from);
            // Those of a ball are equal but for what is rounded.
            prop_assert!(found[2] <= found[0].min(found[1]) + 1e-5 * largest);
            let again = (0..3).fold(DMat3::ZERO, |sum, k| {
                let axis = axes[k];
                sum + DMat3::from_cols(axis * axis.x, axis * axis.y, axis * axis.z) * found[k]
            });
            for (is, was) in again.to_cols_array().into_iter().zip(m.to_cols_array()) {
                prop_assert!((is - was).abs() < 3e-6 * largest, "{is} of {was}, {largest}");
            }
            for (i, j) in [(0, 1), (0, 2), (1, 2)] {
                prop_assert!(axes[i].dot(axes[j]).abs() < 1e-5);
            }
            prop_assert!(axes.iter().all(|axis| (axis.length() - 1.0).abs() < 1e-5));
        }
    }

    #[test]
    fn nothing_has_axes_too() {
        let (axes, variances) = principal_axes([0.0; 6]);
        assert!(axes.as_flattened().iter().all(|v| v.is_finite()) && variances == [0.0; 3]);
    }
}
