//! Logarithm and exponentials that vectorise and, unlike the system's own, give the same results on
//! every machine.

use fearless_simd::prelude::*;
use fearless_simd::{f32x8, i32x8};

pub use rayset_base::srgb::linear_from_srgb;

/// ln x for positive x; exactly 0 at 1. From 2⁻¹² to 1 its error, as a relative error of 1 − x, is
/// below 1e-6.
#[inline(always)]
pub(crate) fn ln(x: f32) -> f32 {
    let bits = x.to_bits();
    let mantissa = f32::from_bits(bits & 0x007f_ffff | 0x3f80_0000);
    let high = mantissa > std::f32::consts::SQRT_2;
    let mantissa = if high { mantissa * 0.5 } else { mantissa };
    let exponent = (bits >> 23) as i32 - 127 + i32::from(high);
    // 2 artanh((m − 1)/(m + 1)), whose series converges fast for m from √½ to √2.
    let s = (mantissa - 1.0) / (mantissa + 1.0);
    let z = s * s;
    let series = 1.0 + z * (1.0 / 3.0 + z * (1.0 / 5.0 + z * (1.0 / 7.0 + z * (1.0 / 9.0))));
    exponent as f32 * std::f32::consts::LN_2 + 2.0 * s * series
}

/// exp(−x) for x ≥ 0, absolute error below 2e-7; exactly 1 at 0.
#[inline(always)]
pub(crate) fn exp_minus(x: f32) -> f32 {
    let z = (x * std::f32::consts::LOG2_E).min(126.0);
    let whole = z as i32;
    // 2^−f for f in [0, 1): Taylor about ½ in f − ½, times 2^−½.
    let y = (0.5 - (z - whole as f32)) * std::f32::consts::LN_2;
    let mut p = y * (1.0 / 5040.0) + 1.0 / 720.0;
    p = p * y + 1.0 / 120.0;
    p = p * y + 1.0 / 24.0;
    p = p * y + 1.0 / 6.0;
    p = p * y + 0.5;
    p = p * y + 1.0;
    p = p * y + 1.0;
    let result = p * std::f32::consts::FRAC_1_SQRT_2 * f32::from_bits(((127 - whole) as u32) << 23);
    if x > 0.0 { result.min(1.0) } else { 1.0 }
}

/// 1 − exp(−x) for x ≥ 0, relative error below 3e-7 however small x is; exactly 0 at 0.
#[inline(always)]
pub(crate) fn absorbed(x: f32) -> f32 {
    let series = x
        * (1.0
            - x * (1.0 / 2.0 - x * (1.0 / 6.0 - x * (1.0 / 24.0 - x * (1.0 / 120.0 - x * (1.0 / 720.0))))));
    if x < 0.25 { series } else { 1.0 - exp_minus(x) }
}

/// [`absorbed`] of eight numbers at a time, with the same bits. In vectors by hand: the compiler
/// makes none of a loop over eight numbers.
#[inline(always)]
pub(crate) fn absorbed_of_eight<S: Simd>(simd: S, x: f32x8<S>) -> f32x8<S> {
    let number = |v: f32| f32x8::splat(simd, v);
    let mut series = number(1.0 / 120.0) - x * (1.0 / 720.0);
    for factor in [1.0 / 24.0, 1.0 / 6.0, 1.0 / 2.0, 1.0] {
        series = number(factor) - x * series;
    }
    let is_small = x.simd_lt(0.25);
    if is_small.all_true() {
        return x * series;
    }
    is_small.select(x * series, number(1.0) - exp_minus_of_eight(simd, x))
}

/// [`exp_minus`] of eight numbers at a time, with the same bits.
#[inline(always)]
fn exp_minus_of_eight<S: Simd>(simd: S, x: f32x8<S>) -> f32x8<S> {
    let one = f32x8::splat(simd, 1.0);
    let z = (x * std::f32::consts::LOG2_E).min(126.0);
    let whole: i32x8<S> = z.to_int();
    let fraction = z - f32x8::float_from(whole);
    let y = (f32x8::splat(simd, 0.5) - fraction) * std::f32::consts::LN_2;
    let mut p = y * (1.0 / 5040.0) + 1.0 / 720.0;
    for factor in [1.0 / 120.0, 1.0 / 24.0, 1.0 / 6.0, 0.5, 1.0, 1.0] {
        p = p * y + factor;
    }
    let power: f32x8<S> = ((i32x8::splat(simd, 127) - whole) << 23).bitcast();
    let result = p * std::f32::consts::FRAC_1_SQRT_2 * power;
    x.simd_gt(0.0).select(result.min(one), one)
}

/// x^n for x from 0 to 1 and n ≥ 0.
#[inline(always)]
pub(crate) fn power(x: f32, n: f32) -> f32 {
    if n == 0.0 || x >= 1.0 {
        1.0
    } else if x < f32::MIN_POSITIVE {
        0.0
    } else {
        exp_minus(-ln(x) * n)
    }
}

/// x^n for x ≥ 0 and n > 0, as far as it is from 1e-37 to 1e37; relative error below 4e-6 for
/// results from 1e-3 to 1e3.
#[inline(always)]
fn raised(x: f32, n: f32) -> f32 {
    let exponent = ln(x.max(f32::MIN_POSITIVE)) * n;
    let of_its_size = exp_minus(exponent.abs());
    if exponent > 0.0 { 1.0 / of_its_size } else { of_its_size }
}

/// The value that a display is given for linear light x ≥ 0 (IEC 61966-2-1), relative error below
/// 4e-6.
#[inline(always)]
pub(crate) fn display_from_linear(x: f32) -> f32 {
    let bright = 1.055 * raised(x, 1.0 / 2.4) - 0.055;
    if x > 0.003_130_8 { bright } else { 12.92 * x }
}

/// The linear light of a value v ≥ 0 that a display is given, relative error below 4e-6.
#[inline(always)]
pub(crate) fn linear_from_display(v: f32) -> f32 {
    let bright = raised((v + 0.055) * (1.0 / 1.055), 2.4);
    if v > 0.040_45 { bright } else { v * (1.0 / 12.92) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use fearless_simd::{Level, dispatch};

    #[test]
    fn ln_is_exact_at_one_and_close_elsewhere() {
        assert_eq!(ln(1.0), 0.0);
        for i in 0..200_000_u32 {
            let x = 1.0 - (1.0 - 1.0 / 4096.0) * i as f32 / 200_000.0;
            let error = (f64::from(ln(x)) - f64::from(x).ln()).abs();
            assert!(
                error <= 1e-6 * (1.0 - f64::from(x)) + 2e-7 * f64::from(x).ln().abs(),
                "x = {x}: {error}"
            );
        }
    }

    #[test]
    fn exp_minus_is_exact_at_zero_and_close_elsewhere() {
        assert_eq!(exp_minus(0.0), 1.0);
        for i in 0..200_000 {
            let x = i as f32 * 4e-4;
            assert!((f64::from(exp_minus(x)) - f64::from(-x).exp()).abs() < 2e-7, "x = {x}");
        }
        assert!(exp_minus(f32::INFINITY) < 1e-37);
    }

    #[test]
    fn what_is_absorbed_is_right_however_little_it_is() {
        assert_eq!(absorbed(0.0), 0.0);
        for i in 0..400 {
            let x = 1e-30_f32 * 1.2_f32.powi(i);
            let exact = -(-f64::from(x)).exp_m1();
            assert!((f64::from(absorbed(x)) / exact - 1.0).abs() < 1e-6, "x = {x}");
        }
    }

    #[test]
    fn of_eight_numbers_the_same_is_absorbed_as_of_each() {
        let numbers = (0..40_000).map(|i| i as f32 * 5e-5).chain((0..400).map(|i| 1e-30 * 1.5_f32.powi(i)));
        let numbers: Vec<f32> =
            numbers.chain([0.0, f32::MAX, f32::INFINITY, -1.0, -0.0, f32::NAN, 8.0, 0.25]).collect();
        for level in [Level::new(), Level::baseline()] {
            for eight in numbers.chunks_exact(8) {
                let mut of_eight = [0.0; 8];
                dispatch!(level, simd => {
                    absorbed_of_eight(simd, f32x8::from_slice(simd, eight)).store_slice(&mut of_eight);
                });
                let each: Vec<u32> = eight.iter().map(|&x| absorbed(x).to_bits()).collect();
                assert_eq!(of_eight.map(f32::to_bits), *each, "{eight:?}");
            }
        }
    }

    #[test]
    fn powers_are_close() {
        for i in 0..=1000 {
            let x = i as f32 / 1000.0;
            for n in [0.0, 1.0, 2.5, 32.0, 1000.0] {
                assert!((f64::from(power(x, n)) - f64::from(x).powf(f64::from(n))).abs() < 2e-5, "{x}^{n}");
            }
        }
    }
}
