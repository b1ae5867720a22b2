//! Voxels whose values are labels: a sample has the label of the most trilinear weight, and no value in between.

use fearless_simd::prelude::*;

use super::batch::{BATCH, Cells, Quantity, Row, corners};
use super::opacity::Opacities;
use super::shape::BrickShape;
use super::voxels::Voxel;
use crate::trace::node_samples::Measure;

/// The labels of a batch, in stored numbers less `base`: of those around each sample the one with the most trilinear weight,
/// the larger of two with as much.
#[inline(always)]
pub(super) fn labels<V: Voxel, B: BrickShape>(shape: B, brick: &[u8], cells: &Cells, base: f32) -> Row {
    let numbers = corners::<V, B>(shape, brick, cells, base);
    let mut most = numbers[0][0];
    if is_uniform(&numbers) {
        return most;
    }
    let weights = weights(&cells.within);
    let mut of_most = [0.0; BATCH];
    for candidate in numbers.as_flattened() {
        let mut weight = [0.0; BATCH];
        for (number, of_corner) in numbers.as_flattened().iter().zip(&weights) {
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
fn is_uniform(numbers: &[[Row; 2]; 4]) -> bool {
    let mut different = 0_u32;
    for corner in numbers.as_flattened() {
        for i in 0..BATCH {
            different |= u32::from(corner[i] != numbers[0][0][i]);
        }
    }
    different == 0
}

/// The trilinear weights of the corners, in the order of [`corners`].
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

/// 1 for voxels that are at least as opaque as the sample that they surround, or that show at all if it does not; 0 for others.
/// Its mean is one half where what shows ends.
pub(super) struct Shown<'a, S> {
    simd: S,
    opacities: &'a Opacities,
    base: f32,
    least: Row,
}

impl<'a, S: Simd> Shown<'a, S> {
    /// Around samples of the given labels, which are numbers less `base`.
    #[inline(always)]
    pub(super) fn around(simd: S, labels: &Row, opacities: &'a Opacities, base: f32) -> Self {
        let mut least = opacities.of(simd, labels, Measure::Opacity);
        for opacity in &mut least {
            *opacity = opacity.max(f32::MIN_POSITIVE);
        }
        Self { simd, opacities, base, least }
    }
}

impl<S: Simd> Quantity for Shown<'_, S> {
    #[inline(always)]
    fn of(&self, mut numbers: [Row; 2]) -> [Row; 2] {
        for row in &mut numbers {
            for number in &mut *row {
                *number -= self.base;
            }
            let opacities = self.opacities.of(self.simd, row, Measure::Opacity);
            for i in 0..BATCH {
                row[i] = if opacities[i] >= self.least[i] { 1.0 } else { 0.0 };
            }
        }
        numbers
    }
}
