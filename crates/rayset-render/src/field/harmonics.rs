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

/// The values of the harmonics in a direction of length one: first 1, by which what is left of a
/// stored colour is multiplied, then those of degree 1, 2 and 3. The signs are those of INRIA's
/// trainer (Kerbl et al., 2023).
#[inline]
pub(super) fn harmonics([x, y, z]: [f64; 3]) -> [f64; MOST_COEFFICIENTS] {
    let (xx, yy, zz) = (x * x, y * y, z * z);
    [
        1.0,
        -0.488_602_511_902_919_9 * y,
        0.488_602_511_902_919_9 * z,
        -0.488_602_511_902_919_9 * x,
        1.092_548_430_592_079_2 * x * y,
        -1.092_548_430_592_079_2 * y * z,
        0.315_391_565_252_520_05 * (2.0 * zz - xx - yy),
        -1.092_548_430_592_079_2 * x * z,
        0.546_274_215_296_039_6 * (xx - yy),
        -0.590_043_589_926_643_5 * y * (3.0 * xx - yy),
        2.890_611_442_640_554 * x * y * z,
        -0.457_045_799_464_465_8 * y * (4.0 * zz - xx - yy),
        0.373_176_332_590_115_4 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
        -0.457_045_799_464_465_8 * x * (4.0 * zz - xx - yy),
        1.445_305_721_320_277 * z * (xx - yy),
        -0.590_043_589_926_643_5 * x * (xx - 3.0 * yy),
    ]
}

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

#[cfg(test)]
mod tests {
    use super::*;

    /// The associated Legendre function of degree l and order m ≥ 0, with the phase (−1)ᵐ.
    fn legendre(l: i32, m: i32, x: f64) -> f64 {
        let odd = (1..=m).map(|k| f64::from(1 - 2 * k)).product::<f64>();
        let (mut below, mut value) = (0.0, odd * (1.0 - x * x).sqrt().powi(m));
        for k in m + 1..=l {
            let next = (f64::from(2 * k - 1) * x * value - f64::from(k + m - 1) * below) / f64::from(k - m);
            (below, value) = (value, next);
        }
        value
    }

    #[test]
    fn harmonics_are_those_of_legendre_functions_with_their_phase_in_the_order_of_m() {
        let factorial = |n: i32| (1..=n).map(f64::from).product::<f64>();
        for direction in [DVec3::new(0.3, -0.5, 0.8), DVec3::new(-0.9, 0.2, -0.1), DVec3::new(0.1, 0.7, 0.4)]
        {
            let direction = direction.normalize();
            let found = harmonics(direction.to_array());
            let (turn, mut k) = (direction.y.atan2(direction.x), 1);
            for l in 1..=3_i32 {
                for m in -l..=l {
                    let order = m.abs();
                    let part = factorial(l - order) / factorial(l + order);
                    let size = (f64::from(2 * l + 1) / (4.0 * std::f64::consts::PI) * part).sqrt();
                    let around = match m {
                        0 => 1.0,
                        _ if m < 0 => std::f64::consts::SQRT_2 * (f64::from(order) * turn).sin(),
                        _ => std::f64::consts::SQRT_2 * (f64::from(order) * turn).cos(),
                    };
                    let expected = size * legendre(l, order, direction.z) * around;
                    assert!((found[k] - expected).abs() < 1e-12, "{l}, {m}: {} and {expected}", found[k]);
                    k += 1;
                }
            }
        }
    }

    #[test]
    fn harmonics_are_orthogonal_and_of_the_right_size() {
        // Points of a Fibonacci lattice stand for equal areas.
        const POINTS: usize = 20_000;
        let golden = std::f64::consts::PI * (5_f64.sqrt() - 1.0);
        let mut sums = [[0.0; MOST_COEFFICIENTS]; MOST_COEFFICIENTS];
        for i in 0..POINTS {
            let z = 1.0 - (2.0 * i as f64 + 1.0) / POINTS as f64;
            let (sin, cos) = (golden * i as f64).sin_cos();
            let across = (1.0 - z * z).sqrt();
            let values = harmonics([across * cos, across * sin, z]);
            for (row, a) in sums.iter_mut().zip(values) {
                row.iter_mut().zip(values).for_each(|(sum, b)| *sum += a * b);
            }
        }
        for (i, row) in sums.iter().enumerate() {
            for (j, sum) in row.iter().enumerate() {
                let integral = sum / POINTS as f64 * 4.0 * std::f64::consts::PI;
                // The constant one is 1, and not ½·√(1/π).
                let expected = match (i == j, i) {
                    (true, 0) => 4.0 * std::f64::consts::PI,
                    (true, _) => 1.0,
                    (false, _) => 0.0,
                };
                assert!((integral - expected).abs() < 2e-3, "{i}, {j}: {integral}");
            }
        }
    }
}
