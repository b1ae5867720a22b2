//! The seven radial basis functions, in `f64` for the reference renderer and in `f32` for sixteen samples at a time.
//!
//! A kernel ω takes x = d/r. It is 1 at x = 0 and 0 for x ≥ 1. The functions here take s = x², because all kernels but
//! two can be evaluated from s without a square root. For gradients the useful form is ω'(x)/x = 2·dω/ds, which is
//! finite at the centre for every kernel here.

use std::f64::consts::PI;
use std::fmt;
use std::str::FromStr;

use fearless_simd::f32x16;
use fearless_simd::prelude::*;

use crate::parse::ParseError;

/// A radial basis function ω(x) with x = d/r: 1 at the centre, 0 for x ≥ 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Kernel {
    /// 1 − 22/9 x² + 17/9 x⁴ − 4/9 x⁶ (Wyvill, McPheeters, Wyvill 1986). The paper's kernel.
    #[default]
    Wyvill,
    /// (1 − x²)². The formula of Chen 2005 (*Combining Point Clouds and Volume Objects in Volume Scene Graphs*) could
    /// not be found in any available source. This biweight, the usual quartic of implicit modelling, takes its place
    /// until it is.
    Chen,
    /// (exp(−x²/2σ²) − c) / (1 − c) with σ = 1/3 and c the Gaussian's value at the cut-off, so that it is continuous at
    /// x = 1.
    Gaussian,
    /// The M4 cubic spline of smoothed-particle hydrodynamics with support r = 2h, scaled to a peak of 1.
    CubicSpline,
    /// (1 − x)⁴ (4x + 1) (Wendland 1995).
    WendlandC2,
    /// 1 − x².
    Epanechnikov,
    /// (1 − x²)³.
    Triweight,
}

impl Kernel {
    /// All kernels, in the order of the documentation.
    pub const ALL: &[Self] = &[
        Self::Wyvill,
        Self::Chen,
        Self::Gaussian,
        Self::CubicSpline,
        Self::WendlandC2,
        Self::Epanechnikov,
        Self::Triweight,
    ];

    /// The name used on the command line and in scene files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Wyvill => "wyvill",
            Self::Chen => "chen",
            Self::Gaussian => "gaussian",
            Self::CubicSpline => "cubic-spline",
            Self::WendlandC2 => "wendland-c2",
            Self::Epanechnikov => "epanechnikov",
            Self::Triweight => "triweight",
        }
    }

    /// ω as a function of s = x² ≥ 0, in `f64`.
    #[must_use]
    pub fn value(self, s: f64) -> f64 {
        if s >= 1.0 {
            return 0.0;
        }
        match self {
            Self::Wyvill => 1.0 + s * (-22.0 / 9.0 + s * (17.0 / 9.0 - s * (4.0 / 9.0))),
            Self::Chen => (1.0 - s).powi(2),
            Self::Gaussian => ((-4.5 * s).exp() - GAUSSIAN_CUT) / (1.0 - GAUSSIAN_CUT),
            Self::CubicSpline => {
                let q = 2.0 * s.sqrt();
                if q < 1.0 { 1.0 - 1.5 * q * q + 0.75 * q * q * q } else { 0.25 * (2.0 - q).powi(3) }
            }
            Self::WendlandC2 => {
                let x = s.sqrt();
                (1.0 - x).powi(4) * (4.0 * x + 1.0)
            }
            Self::Epanechnikov => 1.0 - s,
            Self::Triweight => (1.0 - s).powi(3),
        }
    }

    /// ω'(x)/x as a function of s = x² ≥ 0, in `f64`; never positive.
    #[must_use]
    pub fn slope_over_x(self, s: f64) -> f64 {
        if s >= 1.0 {
            return 0.0;
        }
        match self {
            Self::Wyvill => 2.0 * (-22.0 / 9.0 + s * (34.0 / 9.0 - s * (12.0 / 9.0))),
            Self::Chen => -4.0 * (1.0 - s),
            Self::Gaussian => -9.0 * (-4.5 * s).exp() / (1.0 - GAUSSIAN_CUT),
            Self::CubicSpline => {
                let q = 2.0 * s.sqrt();
                if q < 1.0 { 4.0 * (-3.0 + 2.25 * q) } else { -3.0 * (2.0 - q).powi(2) / q }
            }
            Self::WendlandC2 => -20.0 * (1.0 - s.sqrt()).powi(3),
            Self::Epanechnikov => -2.0,
            Self::Triweight => -6.0 * (1.0 - s).powi(2),
        }
    }

    /// ∫ω dV over the unit ball, so that ω/(r³·integral) integrates to one.
    #[must_use]
    pub fn integral(self) -> f64 {
        match self {
            // 4π ∫ x² ω dx, term by term.
            Self::Wyvill => 4.0 * PI * (1.0 / 3.0 - 22.0 / 45.0 + 17.0 / 63.0 - 4.0 / 81.0),
            Self::Chen => 4.0 * PI * (1.0 / 3.0 - 2.0 / 5.0 + 1.0 / 7.0),
            Self::Gaussian => {
                // ∫₀¹ x² exp(−a x²) dx = √π erf(√a)/(4 a^1.5) − exp(−a)/(2a), a = 4.5; erf(√4.5) to 16 digits.
                const ERF_SQRT_4_5: f64 = 0.997_300_203_936_739_8;
                let a = 4.5_f64;
                let moment = PI.sqrt() * ERF_SQRT_4_5 / (4.0 * a.powf(1.5)) - GAUSSIAN_CUT / (2.0 * a);
                4.0 * PI * (moment - GAUSSIAN_CUT / 3.0) / (1.0 - GAUSSIAN_CUT)
            }
            // σ₃ = 1/π for M4 with peak 1/(π h³), h = r/2.
            Self::CubicSpline => PI / 8.0,
            Self::WendlandC2 => 2.0 * PI / 21.0,
            Self::Epanechnikov => 8.0 * PI / 15.0,
            Self::Triweight => 64.0 * PI / 315.0,
        }
    }
}

impl fmt::Display for Kernel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Kernel {
    type Err = ParseError;

    fn from_str(s: &str) -> Result<Self, Self::Err> {
        let known = Self::ALL.iter().copied().find(|k| k.name() == s);
        known.ok_or_else(|| {
            let names: Vec<&str> = Self::ALL.iter().map(|kernel| kernel.name()).collect();
            let names = names.join(", ");
            ParseError::new(s, |s| format!("unknown kernel `{s}`; expected one of {names}"))
        })
    }
}

/// exp(−4.5), the Gaussian's value at the cut-off.
const GAUSSIAN_CUT: f64 = 0.011_108_996_538_242_306;

/// A kernel as a type, so that the inner loop is compiled separately for each. The argument is q = 1 − x², which the
/// loop has computed already. Results are exactly zero for q ≤ 0, so that culling a pair that does not contribute never
/// changes a bit.
pub(crate) trait LaneKernel: Copy {
    /// ω for sixteen samples.
    fn value<S: Simd>(q: f32x16<S>) -> f32x16<S>;
    /// ω'(x)/x for sixteen samples.
    fn slope_over_x<S: Simd>(q: f32x16<S>) -> f32x16<S>;
}

/// `value` if q > 0, otherwise zero.
#[inline(always)]
fn within<S: Simd>(q: f32x16<S>, value: f32x16<S>) -> f32x16<S> {
    q.simd_gt(0.0).select(value, f32x16::splat(q.simd, 0.0))
}

/// x from q = 1 − x², limited to 1 outside the support.
#[inline(always)]
fn x_of<S: Simd>(q: f32x16<S>) -> f32x16<S> {
    // Rounding may make q slightly greater than 1 at the centre.
    (1.0 - q.max(0.0)).max(0.0).sqrt()
}

macro_rules! lane_kernels {
    ($($name:ident { $q:ident : value $value:block slope $slope:block })*) => {$(
        #[derive(Clone, Copy)]
        pub(crate) struct $name;
        impl LaneKernel for $name {
            #[inline(always)]
            fn value<S: Simd>($q: f32x16<S>) -> f32x16<S> $value
            #[inline(always)]
            fn slope_over_x<S: Simd>($q: f32x16<S>) -> f32x16<S> $slope
        }
    )*};
}

lane_kernels! {
    Wyvill { q:
        // The polynomial has a double root at x = 1: (1 − x²)²·(1 − 4/9 x²).
        value { let q = q.max(0.0); q * q * (q * (4.0 / 9.0) + 5.0 / 9.0) }
        slope { let q = q.max(0.0); q * (q * (-24.0 / 9.0) - 20.0 / 9.0) }
    }
    Chen { q:
        value { let q = q.max(0.0); q * q }
        slope { q.max(0.0) * -4.0 }
    }
    Gaussian { q:
        value { within(q, (exp_minus_4_5(1.0 - q) - GAUSSIAN_CUT as f32) * (1.0 / (1.0 - GAUSSIAN_CUT)) as f32) }
        slope { within(q, exp_minus_4_5(1.0 - q) * (-9.0 / (1.0 - GAUSSIAN_CUT)) as f32) }
    }
    CubicSpline { q:
        value {
            // ¼[(2−p)³₊ − 4(1−p)³₊] with p = 2x: both pieces of the spline without a branch.
            let p = x_of(q) * 2.0;
            let (outer, inner) = ((2.0 - p).max(0.0), (1.0 - p).max(0.0));
            (outer * outer * outer - inner * inner * inner * 4.0) * 0.25
        }
        slope {
            let p = x_of(q) * 2.0;
            let outer = (2.0 - p).max(0.0);
            let inside = p * 9.0 - 12.0;
            let outside = outer * outer * -3.0 / p.max(1.0);
            p.simd_lt(1.0).select(inside, outside)
        }
    }
    WendlandC2 { q:
        value {
            let x = x_of(q);
            let y = (1.0 - x).max(0.0);
            let y2 = y * y;
            y2 * y2 * (x * 4.0 + 1.0)
        }
        slope {
            let y = (1.0 - x_of(q)).max(0.0);
            y * y * y * -20.0
        }
    }
    Epanechnikov { q:
        value { q.max(0.0) }
        slope { within(q, f32x16::splat(q.simd, -2.0)) }
    }
    Triweight { q:
        value { let q = q.max(0.0); q * q * q }
        slope { let q = q.max(0.0); q * q * -6.0 }
    }
}

/// exp(−4.5 s) for 0 ≤ s ≤ 1, as the eighth power of a Taylor polynomial; relative error below 2e-6. `s` is clamped to
/// this range.
#[inline(always)]
fn exp_minus_4_5<S: Simd>(s: f32x16<S>) -> f32x16<S> {
    let y = s.max(0.0).min(1.0) * -0.5625;
    let mut p = y * (1.0 / 5040.0) + 1.0 / 720.0;
    p = p * y + 1.0 / 120.0;
    p = p * y + 1.0 / 24.0;
    p = p * y + 1.0 / 6.0;
    p = p * y + 0.5;
    p = p * y + 1.0;
    p = p * y + 1.0;
    let p2 = p * p;
    let p4 = p2 * p2;
    p4 * p4
}

#[cfg(test)]
mod tests {
    use super::*;
    use fearless_simd::{Level, dispatch};

    #[inline(always)]
    fn lanes<S: Simd, K: LaneKernel>(simd: S, q: [f32; 16]) -> ([f32; 16], [f32; 16]) {
        let v = f32x16::from_slice(simd, &q);
        let (mut a, mut b) = ([0.0; 16], [0.0; 16]);
        K::value(v).store_slice(&mut a);
        K::slope_over_x(v).store_slice(&mut b);
        (a, b)
    }

    fn both(kernel: Kernel, s: [f32; 16]) -> ([f32; 16], [f32; 16]) {
        let s = s.map(|s| 1.0 - s);
        let level = Level::new();
        match kernel {
            Kernel::Wyvill => dispatch!(level, simd => lanes::<_, Wyvill>(simd, s)),
            Kernel::Chen => dispatch!(level, simd => lanes::<_, Chen>(simd, s)),
            Kernel::Gaussian => dispatch!(level, simd => lanes::<_, Gaussian>(simd, s)),
            Kernel::CubicSpline => dispatch!(level, simd => lanes::<_, CubicSpline>(simd, s)),
            Kernel::WendlandC2 => dispatch!(level, simd => lanes::<_, WendlandC2>(simd, s)),
            Kernel::Epanechnikov => dispatch!(level, simd => lanes::<_, Epanechnikov>(simd, s)),
            Kernel::Triweight => dispatch!(level, simd => lanes::<_, Triweight>(simd, s)),
        }
    }

    #[test]
    fn lanes_agree_with_f64_and_vanish_outside() {
        for &kernel in Kernel::ALL {
            for start in 0..40 {
                let s: [f32; 16] = std::array::from_fn(|i| (start * 16 + i) as f32 / 512.0);
                let (value, slope) = both(kernel, s);
                for i in 0..16 {
                    let exact = f64::from(s[i]);
                    assert!(
                        (f64::from(value[i]) - kernel.value(exact)).abs() < 2e-6,
                        "{kernel} at s = {exact}"
                    );
                    assert!(
                        (f64::from(slope[i]) - kernel.slope_over_x(exact)).abs() < 5e-5,
                        "{kernel}' at {exact}"
                    );
                    if s[i] >= 1.0 {
                        assert_eq!((value[i], slope[i].abs()), (0.0, 0.0), "{kernel} beyond its support");
                    }
                }
            }
        }
    }

    #[test]
    fn kernels_peak_at_one_and_their_slope_and_integral_match_the_value() {
        for &kernel in Kernel::ALL {
            assert!((kernel.value(0.0) - 1.0).abs() < 1e-12);
            let (n, mut sum) = (200_000, 0.0);
            for i in 0..n {
                let x = (f64::from(i) + 0.5) / f64::from(n);
                sum += 4.0 * PI * x * x * kernel.value(x * x) / f64::from(n);
                if i % 1000 == 500 {
                    let h = 1e-6;
                    let numeric = (kernel.value((x + h).powi(2)) - kernel.value((x - h).powi(2))) / (2.0 * h);
                    assert!((numeric - x * kernel.slope_over_x(x * x)).abs() < 1e-6, "{kernel}' at x = {x}");
                }
            }
            assert!((sum - kernel.integral()).abs() < 1e-8, "{kernel}: ∫ω = {sum}");
        }
    }

    #[test]
    fn names_round_trip() {
        for &kernel in Kernel::ALL {
            assert_eq!(kernel.name().parse::<Kernel>().ok(), Some(kernel));
        }
        assert!("spline".parse::<Kernel>().is_err());
    }
}
