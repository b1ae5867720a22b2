//! The inner loop in isolation: 64 samples against points in cache. It measures the peak throughput
//! of a processor, for comparison with that of a render.

use fearless_simd::prelude::*;
use fearless_simd::{dispatch, f32x16};
use rayset::SimdLevel;

/// Number of samples evaluated together.
pub const BARE_SAMPLES: usize = 64;

/// Adds the contribution of every point (x, y, z, 1/r², weight) to 64 samples and returns their
/// densities; one kernel evaluation per pair of point and sample.
#[must_use]
pub fn bare_loop(
    simd: SimdLevel,
    points: &[[f32; 5]],
    samples: &[[f32; BARE_SAMPLES]; 3],
) -> [f32; BARE_SAMPLES] {
    dispatch!(simd.level(), simd => evaluate(simd, points, samples))
}

#[inline(always)]
fn evaluate<S: Simd>(
    simd: S,
    points: &[[f32; 5]],
    samples: &[[f32; BARE_SAMPLES]; 3],
) -> [f32; BARE_SAMPLES] {
    const VECTORS: usize = BARE_SAMPLES / 16;
    let mut position = [[f32x16::splat(simd, 0.0); VECTORS]; 3];
    for axis in 0..3 {
        for v in 0..VECTORS {
            position[axis][v] = f32x16::from_slice(simd, &samples[axis][16 * v..16 * v + 16]);
        }
    }
    let mut sums = [f32x16::splat(simd, 0.0); VECTORS];
    for &[x, y, z, inverse, weight] in points {
        for v in 0..VECTORS {
            let (dx, dy, dz) = (position[0][v] - x, position[1][v] - y, position[2][v] - z);
            let distance_squared = dz.mul_add(dz, dy.mul_add(dy, dx * dx));
            let q = (-distance_squared).mul_add(f32x16::splat(simd, inverse), f32x16::splat(simd, 1.0));
            let q = q.max(0.0);
            sums[v] = (q * q * q).mul_add(weight, sums[v]);
        }
    }
    let mut out = [0.0; BARE_SAMPLES];
    for v in 0..VECTORS {
        sums[v].store_slice(&mut out[16 * v..16 * v + 16]);
    }
    out
}
