//! Gaussian splats as extinction: volumes that absorb of every ray what a splat of a splat renderer
//! takes of it.
//!
//! A splat of opacity o leaves 1 − o·exp(−b²/2) of a ray that passes its centre at b deviations. By
//! Abel's inversion there is an extinction that does the same along every ray: in deviations, and
//! with x² = b² + s², it is Li½(o·exp(−x²/2))/√(2π) per deviation, where Li½(z) = Σ zᵏ/√k. It is
//! high in the middle and has no bound as o goes to 1. So what counts is not its value at samples,
//! but what the *interval* of each sample absorbs, from s₁ to s₂: H(s₂) − H(s₁).
//!
//! With w = −ln o + b²/2, so that z = exp(−w − s²/2), Li½(exp(−v)) = √(π/v) + g(v), where g has no
//! singularity below |v| = 2π. Splats end where z is 1/512, so that v ≤ 6.24 in all of them, and
//! g is a polynomial of degree 5 to 3e-5. Term by term,
//!
//! H(s) = asinh(s/√(2w)) + ∫₀ˢ g(w + s²/2) ds / √(2π),
//!
//! of which what is left of the light is right to 6e-5. What ends at z = 1/512 absorbs at most
//! 1/512 less of a ray than what does not end.

use fearless_simd::prelude::*;
use fearless_simd::{f32x8, i32x8};

use crate::math::ln;

/// Splats end where they would absorb one part in so many.
const CUT: f64 = 512.0;
/// ln `CUT`.
const LN_CUT: f32 = 6.238_324_6;
/// No splat is more opaque.
pub(super) const MOST_OPAQUE: f64 = 0.999;
/// No splat is wider, in deviations: √(2·ln(`CUT`·`MOST_OPAQUE`)), rounded up.
pub(super) const MOST_DEVIATIONS: f64 = 3.532;
/// The coefficients of g.
const SMOOTH: [f32; TERMS] =
    [-1.460_365_4, 0.207_959_28, -0.012_729_554, -0.001_592_518_3, 3.254_315_7e-4, -1.646_080_6e-5];
const TERMS: usize = 6;
/// 1/(2ᵐ(2m + 1)√(2π)), of which the term m of g is multiplied in the integral.
const INTEGRATED: [f32; TERMS] =
    [0.398_942_3, 0.066_490_38, 0.019_947_114, 0.007_123_97, 0.002_770_433, 0.001_133_358_9];

/// ln(512·o) of an opacity o: half the square of the radius, in deviations. Zero for splats that
/// absorb too little, or nothing at all.
pub(super) fn extent(opacity: f32) -> f32 {
    // A number that is none is not above it.
    if opacity > (1.0 / CUT) as f32 { (LN_CUT + ln(opacity.min(MOST_OPAQUE as f32))).max(0.0) } else { 0.0 }
}

/// A ray through a splat. Distances along it are from the place nearest to the centre, in radii.
pub(super) struct Chord {
    /// Half of its length.
    half: f32,
    /// Deviations in a radius.
    deviations: f32,
    /// 1/√(2w).
    sharpness: f32,
    /// Of the polynomial of s² that is multiplied by s.
    smooth: [f32; TERMS],
}

impl Chord {
    /// The ray that passes a splat of this [`extent`] at the distance of which `inside` is 1 − d².
    #[inline(always)]
    pub(super) fn new(extent: f32, inside: f32) -> Self {
        let inside = inside.max(0.0);
        let w = (LN_CUT - extent * inside).max(0.5e-3);
        // The polynomial about w: Horner's scheme, again and again.
        let mut smooth = SMOOTH;
        for first in 0..TERMS - 1 {
            for term in (first..TERMS - 1).rev() {
                smooth[term] += w * smooth[term + 1];
            }
        }
        for (term, factor) in smooth.iter_mut().zip(INTEGRATED) {
            *term *= factor;
        }
        let deviations = (2.0 * extent).sqrt();
        Self { half: inside.sqrt(), deviations, sharpness: 1.0 / (2.0 * w).sqrt(), smooth }
    }

    /// Where the ray enters the splat, or a place in it.
    #[inline(always)]
    pub(super) fn entered<S: Simd>(&self, from: f32x8<S>) -> f32x8<S> {
        from.max(-self.half)
    }

    /// The optical depths of intervals.
    #[inline(always)]
    pub(super) fn depth<S: Simd>(&self, from: f32x8<S>, to: f32x8<S>) -> f32x8<S> {
        let within = |s: f32x8<S>| s.max(-self.half).min(f32x8::splat(from.simd, self.half));
        let (from, to) = (within(from) * self.deviations, within(to) * self.deviations);
        let one = f32x8::splat(from.simd, 1.0);
        // exp(asinh x), of |x| and the reciprocal: nothing cancels.
        let (a, b) = (from * self.sharpness, to * self.sharpness);
        let raised_a = a.abs() + a.mul_add(a, one).sqrt();
        let raised_b = b.abs() + b.mul_add(b, one).sqrt();
        let ratio =
            b.simd_lt(0.0).select(one / raised_b, raised_b) * a.simd_lt(0.0).select(raised_a, one / raised_a);
        (ln_of_eight(ratio) + (self.smooth(to) - self.smooth(from))).max(0.0)
    }

    #[inline(always)]
    fn smooth<S: Simd>(&self, s: f32x8<S>) -> f32x8<S> {
        let square = s * s;
        let mut sum = f32x8::splat(s.simd, self.smooth[TERMS - 1]);
        for term in (0..TERMS - 1).rev() {
            sum = sum.mul_add(square, f32x8::splat(s.simd, self.smooth[term]));
        }
        sum * s
    }

    /// The optical depth of one interval.
    pub(super) fn depth_of_one(&self, from: f32, to: f32) -> f32 {
        let within = |s: f32| s.clamp(-self.half, self.half) * self.deviations;
        let (from, to) = (within(from), within(to));
        let raised = |x: f32| x.abs() + (x * x + 1.0).sqrt();
        let (a, b) = (from * self.sharpness, to * self.sharpness);
        let ratio = if b < 0.0 { 1.0 / raised(b) } else { raised(b) }
            * if a < 0.0 { raised(a) } else { 1.0 / raised(a) };
        let smooth = |s: f32| s * self.smooth.iter().rev().fold(0.0, |sum, term| sum * s * s + term);
        (ln(ratio) + (smooth(to) - smooth(from))).max(0.0)
    }
}

/// The logarithm of eight numbers of at least about one, with an error below 3e-7 or that part of
/// it.
#[inline(always)]
fn ln_of_eight<S: Simd>(x: f32x8<S>) -> f32x8<S> {
    let simd = x.simd;
    let bits: i32x8<S> = x.bitcast();
    // Mantissas from √½ to √2.
    let rounded = bits + i32x8::splat(simd, 0x0080_0000 - 0x0035_04f3);
    let exponent = (rounded >> 23) - i32x8::splat(simd, 127);
    let mantissa: f32x8<S> =
        ((rounded & i32x8::splat(simd, 0x007f_ffff)) + i32x8::splat(simd, 0x3f35_04f3)).bitcast();
    let exponent = f32x8::float_from(exponent);
    let one = f32x8::splat(simd, 1.0);
    let s = (mantissa - one) / (mantissa + one);
    let z = s * s;
    let mut series = f32x8::splat(simd, 2.0 / 9.0);
    for term in [2.0 / 7.0, 2.0 / 5.0, 2.0 / 3.0, 2.0] {
        series = series.mul_add(z, f32x8::splat(simd, term));
    }
    exponent.mul_add(f32x8::splat(simd, std::f32::consts::LN_2), s * series)
}

/// The same in double precision, from the formula alone: for the reference.
pub(super) mod exact {
    use super::{CUT, MOST_OPAQUE};

    /// The optical depth, from `from` to `to` deviations along a ray that passes a splat of this
    /// opacity at `b` deviations, of what of it is within its cut.
    pub(in crate::field) fn depth(opacity: f64, b: f64, from: f64, to: f64) -> f64 {
        let opacity = opacity.min(MOST_OPAQUE);
        let square = 2.0 * (CUT * opacity).ln() - b * b;
        if !(opacity > 1.0 / CUT && square > 0.0) {
            return 0.0;
        }
        let half = square.sqrt();
        let z = opacity * (-0.5 * b * b).exp();
        (integral(z, to.clamp(-half, half)) - integral(z, from.clamp(-half, half))).max(0.0)
    }

    /// Where a splat of this opacity ends, in deviations.
    pub(in crate::field) fn splat_radius(opacity: f64) -> f64 {
        (2.0 * (CUT * opacity.min(MOST_OPAQUE)).ln()).max(0.0).sqrt()
    }

    /// H(z, s) = Σ zᵏ/k · ½ erf(s√(k/2)).
    fn integral(z: f64, s: f64) -> f64 {
        let (mut sum, mut power) = (0.0, 1.0);
        for k in 1..100_000 {
            let k = f64::from(k);
            power *= z;
            sum += power / k * 0.5 * erf(s * (0.5 * k).sqrt());
            if power / k < 1e-9 * (1.0 - z) {
                break;
            }
        }
        sum
    }

    /// The error function, to 1e-12: its Maclaurin series, and the continued fraction of what it
    /// lacks to 1 (Abramowitz and Stegun, 7.1.6 and 7.1.14).
    fn erf(x: f64) -> f64 {
        let a = x.abs();
        if a > 6.0 {
            return x.signum();
        }
        let value = if a < 2.5 {
            let (mut sum, mut term) = (a, a);
            for n in 1..100 {
                term *= 2.0 * a * a / (2.0 * f64::from(n) + 1.0);
                sum += term;
            }
            sum * (-a * a).exp() * std::f64::consts::FRAC_2_SQRT_PI
        } else {
            let fraction = (1..=60).rev().fold(a, |below, n| a + 0.5 * f64::from(n) / below);
            1.0 - (-a * a).exp() / (std::f64::consts::PI.sqrt() * fraction)
        };
        value.copysign(x)
    }

    #[cfg(test)]
    mod tests {
        #[test]
        fn the_error_function_has_the_values_of_tables() {
            let known =
                [(0.5, 0.520_499_877_813_047), (1.0, 0.842_700_792_949_715), (3.0, 0.999_977_909_503_001)];
            for (x, erf) in known {
                assert!((super::erf(x) - erf).abs() < 1e-12 && super::erf(-x) == -super::erf(x), "{x}");
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::simd::{SimdLevel, dispatch};
    use proptest::prelude::*;

    fn depths(chord: &Chord, from: [f32; 8], to: [f32; 8]) -> [f32; 8] {
        let mut depths = [0.0; 8];
        dispatch!(SimdLevel::default().level(), simd => {
            let (from, to) = (f32x8::from_slice(simd, &from), f32x8::from_slice(simd, &to));
            chord.depth(from, to).store_slice(&mut depths);
        });
        depths
    }

    proptest! {
        #[test]
        fn every_interval_absorbs_what_the_series_says(
            opacity in prop_oneof![0.002..0.999_f32, Just(0.999_f32), 0.9..0.999_f32],
            distance in 0.0..1.1_f64,
            places in prop::array::uniform9(-1.2..1.2_f32),
        ) {
            let mut places = places;
            places.sort_by(f32::total_cmp);
            let (from, to): ([f32; 8], [f32; 8]) =
                (std::array::from_fn(|i| places[i]), std::array::from_fn(|i| places[i + 1]));
            let extent = extent(opacity);
            let chord = Chord::new(extent, (1.0 - distance * distance) as f32);
            let radius = (2.0 * f64::from(extent)).sqrt();
            let found = depths(&chord, from, to);
            for i in 0..8 {
                let [from, to] = [from[i], to[i]].map(|s| f64::from(s) * radius);
                let expected = exact::depth(opacity.into(), distance * radius, from, to);
                let light = [f64::from(found[i]), expected].map(|depth| (-depth).exp());
                prop_assert!((light[0] - light[1]).abs() < 6e-5, "{} {expected}", found[i]);
                let one = chord.depth_of_one(places[i], places[i + 1]);
                prop_assert!((one - found[i]).abs() < 4e-6, "{one} {}", found[i]);
            }
        }

        #[test]
        fn a_whole_chord_leaves_what_a_splat_renderer_leaves(
            opacity in 0.002..0.999_f32,
            distance in 0.0..1.0_f64,
        ) {
            let extent = extent(opacity);
            let chord = Chord::new(extent, (1.0 - distance * distance) as f32);
            let sum: f32 = depths(&chord, [-1.0, -0.3, -0.1, 0.0, 0.1, 0.2, 0.5, 1.0], [-0.3, -0.1, 0.0, 0.1, 0.2, 0.5, 1.0, 2.0]).iter().sum();
            let b_squared = 2.0 * f64::from(extent) * distance * distance;
            let drawn = f64::from(opacity) * (-0.5 * b_squared).exp();
            let absorbed = -(-f64::from(sum)).exp_m1();
            prop_assert!((-1e-4..1.0 / CUT + 1e-4).contains(&(drawn - absorbed)), "{drawn} {absorbed}");
        }
    }

    #[test]
    fn no_splat_is_wider_than_is_said() {
        let widest = exact::splat_radius(1.0);
        assert!((MOST_DEVIATIONS - 1e-3..MOST_DEVIATIONS).contains(&widest), "{widest}");
    }

    #[test]
    fn what_is_no_splat_absorbs_nothing() {
        for opacity in [f32::NAN, -1.0, 0.0, 1e-30, 1.0 / 512.0] {
            let extent = extent(opacity);
            assert_eq!(depths(&Chord::new(extent, 1.0), [-1.0; 8], [1.0; 8]), [0.0; 8], "{opacity}");
        }
        assert!(extent(f32::INFINITY) == extent(0.999) && extent(2.0) == extent(0.999));
    }
}
