//! Spherical harmonics of what is turned: a band of them, seen from elsewhere, is another sum of
//! the same band.

use rayset_base::geometry::{DMat3, DVec3};
use rayset_files::points::harmonics::{CHANNELS, MOST_COEFFICIENTS, coefficients, harmonics};

/// Most coefficients of a band.
const MOST_OF_BAND: usize = 7;
type Matrix = [[f64; MOST_OF_BAND]; MOST_OF_BAND];

/// What a rotation makes of the coefficients of each band, from the first.
pub(super) struct Turn(Vec<Matrix>);

impl Turn {
    /// By a rotation, for harmonics up to a degree.
    ///
    /// With the functions of a band at directions **d**ⱼ as rows of A, and at the turned ones as
    /// rows of B, coefficients c become those c′ with B·c′ = A·c.
    pub(super) fn new(rotation: &DMat3, degree: u8) -> Self {
        Self((1..=degree).map(|band| matrix(rotation, band)).collect())
    }

    /// Turns coefficients that are in the order of INRIA's trainer, of so many degrees.
    pub(super) fn apply(&self, rest: &mut [f32], degree: u8) {
        let per_channel = coefficients(degree) - 1;
        for channel in 0..CHANNELS {
            for (matrix, band) in self.0.iter().zip(1..=degree) {
                let (first, size) = (coefficients(band - 1) - 1, 2 * usize::from(band) + 1);
                let of_band = &mut rest[channel * per_channel + first..][..size];
                let before: Vec<f64> = of_band.iter().map(|&v| v.into()).collect();
                for (to, row) in of_band.iter_mut().zip(matrix) {
                    *to = row.iter().zip(&before).map(|(a, b)| a * b).sum::<f64>() as f32;
                }
            }
        }
    }
}

/// Directions that are spread over half of the sphere, as the other half says the same: a spiral,
/// in equal steps of height.
fn direction(j: usize, count: usize) -> DVec3 {
    let z = (j as f64 + 0.5) / count as f64;
    let (sin, cos) = (2.4 * j as f64).sin_cos();
    let across = (1.0 - z * z).sqrt();
    DVec3::new(across * cos, across * sin, z)
}

fn matrix(rotation: &DMat3, band: u8) -> Matrix {
    let (first, size) = (coefficients(band - 1), 2 * usize::from(band) + 1);
    let at = |direction: DVec3| -> [f64; MOST_COEFFICIENTS] { harmonics(direction.to_array()) };
    let mut left = [[0.0; MOST_OF_BAND]; MOST_OF_BAND];
    let mut right = left;
    for j in 0..size {
        let before = direction(j, size);
        for m in 0..size {
            left[j][m] = at(*rotation * before)[first + m];
            right[j][m] = at(before)[first + m];
        }
    }
    solved(left, right, size)
}

/// The solution of `left`·X = `right`, by elimination with the largest pivot.
fn solved(mut left: Matrix, mut right: Matrix, size: usize) -> Matrix {
    for column in 0..size {
        let largest = (column..size).max_by(|&a, &b| left[a][column].abs().total_cmp(&left[b][column].abs()));
        let pivot = largest.unwrap_or(column);
        left.swap(column, pivot);
        right.swap(column, pivot);
        let inverse = 1.0 / left[column][column];
        left[column].iter_mut().chain(&mut right[column]).for_each(|v| *v *= inverse);
        for row in (0..size).filter(|&row| row != column) {
            let factor = left[row][column];
            for k in 0..size {
                left[row][k] -= factor * left[column][k];
                right[row][k] -= factor * right[column][k];
            }
        }
    }
    right
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use rayset_base::geometry::DQuat;

    proptest! {
        #[test]
        fn what_is_turned_shows_in_a_turned_direction_what_it_showed_before(
            quaternion in prop::array::uniform4(-1.0..1.0_f64),
            toward in prop::array::uniform3(-1.0..1.0_f64),
            rest in prop::collection::vec(-2.0..2.0_f32, 45),
        ) {
            let rotation = DMat3::from_quat(DQuat::from_array(quaternion).normalize());
            let toward = DVec3::from_array(toward).normalize_or(DVec3::X);
            for degree in 1..=3 {
                let mut turned = rest.clone();
                Turn::new(&rotation, degree).apply(&mut turned, degree);
                let per_channel = coefficients(degree) - 1;
                for channel in 0..CHANNELS {
                    let sum = |rest: &[f32], toward: DVec3| -> f64 {
                        let values = harmonics(toward.to_array());
                        let own = &rest[channel * per_channel..][..per_channel];
                        own.iter().zip(&values[1..]).map(|(c, v)| f64::from(*c) * v).sum()
                    };
                    let (before, after) = (sum(&rest, toward), sum(&turned, rotation * toward));
                    prop_assert!((before - after).abs() < 1e-5, "degree {degree}: {before} and {after}");
                }
            }
        }
    }
}
