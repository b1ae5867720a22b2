//! Voxels whose values are labels: a sample has the label of the most trilinear weight, and no
//! value in between.

use fearless_simd::prelude::*;

use super::batch::{BATCH, Pairs, Row};
use super::opacity::Opacities;
use crate::trace::node_samples::Measure;

/// The labels of a batch: of those at the corners around each sample the one with the most
/// trilinear weight, the larger of two with as much.
#[inline(always)]
pub(super) fn labels(corners: &Pairs<4>, within: &[Row; 3]) -> Row {
    let mut most = corners[0][0];
    if is_uniform(corners) {
        return most;
    }
    let weights = weights(within);
    let mut of_most = [0.0; BATCH];
    for candidate in corners.as_flattened() {
        let mut weight = [0.0; BATCH];
        for (number, of_corner) in corners.as_flattened().iter().zip(&weights) {
            for i in 0..BATCH {
                weight[i] += if number[i] == candidate[i] { of_corner[i] } else { 0.0 };
            }
        }
        for i in 0..BATCH {
            let is_larger = weight[i] == of_most[i] && candidate[i] > most[i];
            let wins = weight[i] > of_most[i] || is_larger;
            most[i] = if wins { candidate[i] } else { most[i] };
            of_most[i] = if wins { weight[i] } else { of_most[i] };
        }
    }
    most
}

/// Whether every sample is among voxels of one label.
#[inline(always)]
fn is_uniform(corners: &Pairs<4>) -> bool {
    let mut different = 0_u32;
    for corner in corners.as_flattened() {
        for i in 0..BATCH {
            different |= u32::from(corner[i] != corners[0][0][i]);
        }
    }
    different == 0
}

/// The trilinear weights of the corners, in the order of
/// [`Around::corners`](super::batch::Around::corners).
#[inline(always)]
fn weights([fx, fy, fz]: &[Row; 3]) -> [Row; 8] {
    let mut weights = [[0.0; BATCH]; 8];
    for (corner, row) in weights.iter_mut().enumerate() {
        for i in 0..BATCH {
            let x = if corner & 1 == 1 { fx[i] } else { 1.0 - fx[i] };
            let y = if corner & 2 == 2 { fy[i] } else { 1.0 - fy[i] };
            let z = if corner & 4 == 4 { fz[i] } else { 1.0 - fz[i] };
            row[i] = x * y * z;
        }
    }
    weights
}

/// Replaces the labels of voxels: 1 for those that are at least as opaque as the sample that they
/// surround, or that show at all if it does not; 0 for others. The mean is one half where what
/// shows ends. All labels are stored numbers less the base.
#[inline(always)]
pub(super) fn show<S: Simd, const ROWS: usize>(
    simd: S,
    opacities: &Opacities,
    labels: &Row,
    voxels: &mut Pairs<ROWS>,
) {
    let mut least = opacities.of(simd, labels, Measure::Opacity);
    for opacity in &mut least {
        *opacity = opacity.max(f32::MIN_POSITIVE);
    }
    for row in voxels.as_flattened_mut() {
        let opacities = opacities.of(simd, row, Measure::Opacity);
        for i in 0..BATCH {
            row[i] = if opacities[i] >= least[i] { 1.0 } else { 0.0 };
        }
    }
}
