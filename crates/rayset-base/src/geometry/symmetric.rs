//! Eigenvectors of symmetric matrices.

use super::{DMat3, DVec3};

/// Rounds of rotations; with each the rest becomes the square of what it was.
const ROUNDS: usize = 12;
/// Elements beside the diagonal are left if they are at most this part of the diagonal. They would
/// only turn axes whose eigenvalues differ by no more than that.
const NEGLIGIBLE: f64 = 1e-20;

/// The eigenvalues of a symmetric matrix, largest first, and its eigenvectors in their order, as
/// columns of a rotation. By Jacobi's rotations (Golub and Van Loan, *Matrix Computations*, 8.5),
/// from additions, multiplications, divisions and square roots alone: the same bits everywhere.
///
/// A matrix with elements that are not finite has eigenvalues that are not, and some rotation.
#[must_use]
pub fn eigenvectors(matrix: &DMat3) -> (DVec3, DMat3) {
    let (mut m, mut v) = (matrix.to_cols_array_2d(), DMat3::IDENTITY.to_cols_array_2d());
    for _ in 0..ROUNDS {
        let rest = m[0][1].abs() + m[0][2].abs() + m[1][2].abs();
        let diagonal = m[0][0].abs() + m[1][1].abs() + m[2][2].abs();
        if !(rest > NEGLIGIBLE * diagonal && rest.is_finite()) {
            break;
        }
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            rotate(&mut m, &mut v, p, q);
        }
    }
    let values = [m[0][0], m[1][1], m[2][2]];
    let mut order = [0, 1, 2];
    order.sort_by(|&a, &b| values[b].total_cmp(&values[a]));
    let [x, y] = [order[0], order[1]].map(|i| DVec3::from_array(v[i]));
    (DVec3::from_array(order.map(|i| values[i])), DMat3::from_cols(x, y, x.cross(y)))
}

/// Makes the elements (p, q) and (q, p) zero by a rotation of these axes, under which the columns
/// of `v` turn, too.
fn rotate(m: &mut [[f64; 3]; 3], v: &mut [[f64; 3]; 3], p: usize, q: usize) {
    if m[p][q] == 0.0 {
        return;
    }
    let ratio = (m[q][q] - m[p][p]) / (2.0 * m[p][q]);
    let tangent = 1_f64.copysign(ratio) / (ratio.abs() + (ratio * ratio + 1.0).sqrt());
    let cosine = 1.0 / (tangent * tangent + 1.0).sqrt();
    let sine = tangent * cosine;
    let between = m[p][q];
    m[p][p] -= tangent * between;
    m[q][q] += tangent * between;
    (m[p][q], m[q][p]) = (0.0, 0.0);
    let other = 3 - p - q;
    let (a, b) = (m[p][other], m[q][other]);
    (m[p][other], m[q][other]) = (cosine * a - sine * b, sine * a + cosine * b);
    (m[other][p], m[other][q]) = (m[p][other], m[q][other]);
    for axis in 0..3 {
        let (a, b) = (v[p][axis], v[q][axis]);
        (v[p][axis], v[q][axis]) = (cosine * a - sine * b, sine * a + cosine * b);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::DQuat;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_symmetric_matrix_is_that_of_its_eigenvectors(
            values in prop::array::uniform3((-9.0..3.0_f64).prop_map(|e| 10_f64.powf(e))),
            q in prop::array::uniform4(-1.0..1.0_f64),
        ) {
            prop_assume!(q.iter().any(|v| v.abs() > 0.1));
            let axes = DMat3::from_quat(DQuat::from_array(q).normalize());
            let matrix = axes * DMat3::from_diagonal(DVec3::from_array(values)) * axes.transpose();
            let (found, vectors) = eigenvectors(&matrix);
            let largest = values.into_iter().fold(0.0, f64::max);
            prop_assert!(found.x >= found.y && found.y >= found.z);
            prop_assert!((vectors.determinant() - 1.0).abs() < 1e-12);
            let again = vectors * DMat3::from_diagonal(found) * vectors.transpose();
            prop_assert!((again - matrix).to_cols_array().iter().all(|v| v.abs() < 1e-13 * largest));
        }
    }

    #[test]
    fn matrices_that_are_diagonal_or_no_numbers_have_some_rotation() {
        let (values, vectors) = eigenvectors(&DMat3::from_diagonal(DVec3::new(1.0, 3.0, 2.0)));
        assert_eq!(values, DVec3::new(3.0, 2.0, 1.0));
        assert_eq!((vectors.x_axis, vectors.y_axis), (DVec3::Y, DVec3::Z));
        assert_eq!(eigenvectors(&DMat3::ZERO), (DVec3::ZERO, DMat3::IDENTITY));
        // Beside the largest value the others are nothing, and so is what stands between them.
        let small = DMat3::from_cols_array_2d(&[[1.0, 0.0, 0.0], [0.0, 1e-20, 3e-21], [0.0, 3e-21, 1e-21]]);
        let (values, vectors) = eigenvectors(&small);
        assert!(values.x == 1.0 && values.y < 2e-20 && vectors.x_axis == DVec3::X);
        for v in [f64::NAN, f64::INFINITY] {
            assert!(eigenvectors(&DMat3::from_cols_array(&[v; 9])).1.is_finite());
        }
    }
}
