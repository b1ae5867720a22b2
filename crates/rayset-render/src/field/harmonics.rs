//! Colours that change with the direction from which points are seen: real spherical harmonics of
//! the direction from the eye to each point, in the space of their file
//! (`docs/rendering.md`, Colours of splats).

use super::sight::Eye;
use crate::math::linear_from_display;
use rayset_base::geometry::DVec3;
use rayset_files::octree::format::Header;
use rayset_files::octree::harmonics::{CHANNELS, MOST_COEFFICIENTS, coefficients, decode, stored_bytes};
use rayset_files::octree::layout::RUN_POINTS;
use rayset_files::octree::page::Run;
use rayset_files::points::harmonics::harmonics;

/// The harmonics in the direction from an eye to a place, of which those of degrees that a point
/// does not have are multiplied by nothing. Without an eye, the directions add nothing.
#[inline]
pub(super) fn basis(eye: Option<Eye>, place: DVec3) -> [f32; MOST_COEFFICIENTS] {
    match eye {
        Some(eye) => harmonics(eye.toward(place).to_array()).map(|v| v as f32),
        None => std::array::from_fn(|k| if k == 0 { 1.0 } else { 0.0 }),
    }
}

/// The display values of a colour in a direction: those that are stored, and what the coefficients
/// of a point add to them, none below 0. Without an eye, the directions add nothing.
#[inline]
pub(super) fn color_toward(
    stored: [f64; CHANNELS],
    bytes: &[u8],
    toward: Option<DVec3>,
    degree: u8,
) -> [f64; CHANNELS] {
    let count = if toward.is_some() { coefficients(degree) } else { 1 };
    let basis = harmonics(toward.unwrap_or(DVec3::Z).to_array());
    let mut color = stored;
    for (value, channels) in basis[..count].iter().zip(bytes.chunks_exact(CHANNELS)) {
        for (sum, byte) in color.iter_mut().zip(channels) {
            *sum += value * f64::from(decode(*byte));
        }
    }
    color.map(|v| v.max(0.0))
}

/// Coefficients that are added together: as many as there are channels, times lanes of a vector.
const TOGETHER: usize = 8 * CHANNELS;
const MOST_BYTES: usize = CHANNELS * MOST_COEFFICIENTS;
const _: () = assert!(MOST_BYTES.is_multiple_of(TOGETHER), "whole groups of coefficients");

/// As [`color_toward`], in single precision, of a point with this [basis] in its direction.
#[inline]
pub(super) fn color(
    stored: [f32; CHANNELS],
    bytes: &[u8],
    basis: &[f32; MOST_COEFFICIENTS],
) -> [f32; CHANNELS] {
    let mut whole = [0; MOST_BYTES];
    whole[..bytes.len()].copy_from_slice(bytes);
    let mut sums = [0.0; TOGETHER];
    for first in (0..MOST_BYTES).step_by(TOGETHER) {
        for i in 0..TOGETHER {
            sums[i] += basis[(first + i) / CHANNELS] * decode(whole[first + i]);
        }
    }
    std::array::from_fn(|channel| {
        let sum: f32 = sums[channel..].iter().step_by(CHANNELS).sum();
        (stored[channel] + sum).max(0.0)
    })
}

/// Fills the columns of the colours of a run's points with those that an eye in the cloud's space
/// sees. Their places are relative to a centre.
pub(super) fn fill_colors(
    (run, header): (&Run<'_>, &Header),
    eye: Option<Eye>,
    (center, position): (DVec3, &[[f32; RUN_POINTS]; 3]),
    as_displayed: bool,
    columns: &mut [[f32; RUN_POINTS]],
) {
    let (Some(colors), Some(bytes)) = (run.colors(header), run.harmonics(header)) else { return };
    for (i, (stored, bytes)) in colors.zip(of_points(bytes, header.harmonics)).enumerate() {
        let offset = DVec3::from_array([0, 1, 2].map(|axis| f64::from(position[axis][i])));
        let basis = basis(eye, center + offset);
        let seen = color(stored.map(|byte| f32::from(byte) * (1.0 / 255.0)), bytes, &basis);
        for (column, v) in columns.iter_mut().zip(seen) {
            column[i] = if as_displayed { v } else { linear_from_display(v) };
        }
    }
}

/// The bytes of the coefficients of each point of a run.
pub(super) fn of_points(bytes: &[u8], degree: u8) -> impl Iterator<Item = &[u8]> {
    bytes.chunks_exact(stored_bytes(degree))
}
