//! The seven radial basis functions, in `f64` for the reference renderer and in `f32` for eight
//! samples at a time; and splats, which are none (`gaussian_splat`).
//!
//! A kernel ω takes x = d/r. It is 1 at x = 0 and 0 for x ≥ 1. The functions here take s = x²,
//! because all kernels but two can be evaluated from s without a square root. For gradients the
//! useful form is ω'(x)/x = 2·dω/ds, which is finite at the centre for every kernel here.

use std::f64::consts::PI;
use std::fmt;
use std::str::FromStr;

use fearless_simd::f32x8;
use fearless_simd::prelude::*;

use rayset_base::parse::ParseError;

/// A radial basis function ω(x) with x = d/r: 1 at the centre, 0 for x ≥ 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Kernel {
    /// 1 − 22/9 x² + 17/9 x⁴ − 4/9 x⁶ (Wyvill, McPheeters, Wyvill 1986). The paper's kernel.
    #[default]
    Wyvill,
    /// (1 − x²)². The formula of Chen 2005 (*Combining Point Clouds and Volume Objects in Volume
    /// Scene Graphs*) could not be found in any available source. This biweight, the usual quartic
    /// of implicit modelling, takes its place until it is.
    Chen,
    /// (exp(−x²/2σ²) − c) / (1 − c) with σ = 1/3 and c the Gaussian's value at the cut-off, so that
    /// it is continuous at x = 1.
    Gaussian,
    /// The M4 cubic spline of smoothed-particle hydrodynamics with support r = 2h, scaled to a peak
    /// of 1.
    CubicSpline,
    /// (1 − x)⁴ (4x + 1) (Wendland 1995).
    WendlandC2,
    /// 1 − x².
    Epanechnikov,
    /// (1 − x²)³.
    Triweight,
    /// Gaussian splats, which are no density: a point absorbs o·exp(−b²/2) of a ray that passes its
    /// centre at b deviations, with its weight as the opacity o, whatever the step is. What it
    /// absorbs ends where that is 1/512, which is at the radius: √(2 ln(512·o)) deviations. In
    /// place of a density, samples have the mean extinction of their intervals, per unit of world
    /// space.
    Splat,
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
        Self::Splat,
    ];

    /// Those of densities: all but [`Splat`](Self::Splat).
    pub const OF_DENSITIES: &[Self] = Self::ALL.split_at(7).0;

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
            Self::Splat => "splat",
        }
    }

    /// ω as a function of s = x² ≥ 0, in `f64`. Splats have none; what is said of them is that of
    /// the Gaussian.
    #[must_use]
    pub fn value(self, s: f64) -> f64 {
        if s >= 1.0 {
            return 0.0;
        }
        match self {
            Self::Wyvill => 1.0 + s * (-22.0 / 9.0 + s * (17.0 / 9.0 - s * (4.0 / 9.0))),
            Self::Chen => (1.0 - s).powi(2),
            Self::Gaussian | Self::Splat => ((-4.5 * s).exp() - GAUSSIAN_CUT) / (1.0 - GAUSSIAN_CUT),
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
            Self::Gaussian | Self::Splat => -9.0 * (-4.5 * s).exp() / (1.0 - GAUSSIAN_CUT),
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
            Self::Gaussian | Self::Splat => {
                // ∫₀¹ x² exp(−a x²) dx = √π erf(√a)/(4 a^1.5) − exp(−a)/(2a), a = 4.5; erf(√4.5) to
                // 16 digits.
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

/// A kernel as a type, so that the inner loop is compiled separately for each. The argument is q =
/// 1 − x², which the loop has computed already. Results are exactly zero for q ≤ 0, so that culling
/// a pair that does not contribute never changes a bit.
pub(crate) trait LaneKernel: Copy {
    /// Whether points are splats, of which the intervals of samples count, and no ω.
    const IS_SPLAT: bool = false;
    /// ω for eight samples.
    fn value<S: Simd>(q: f32x8<S>) -> f32x8<S>;
    /// ω'(x)/x for eight samples.
    fn slope_over_x<S: Simd>(q: f32x8<S>) -> f32x8<S>;
}

/// `value` if q > 0, otherwise zero.
#[inline(always)]
fn within<S: Simd>(q: f32x8<S>, value: f32x8<S>) -> f32x8<S> {
    q.simd_gt(0.0).select(value, f32x8::splat(q.simd, 0.0))
}

/// x from q = 1 − x², which is never more than 1: the loop takes a square from what is at most 1.
#[inline(always)]
fn x_of<S: Simd>(q: f32x8<S>) -> f32x8<S> {
    (1.0 - q).sqrt()
}

macro_rules! lane_kernels {
    ($($name:ident { $q:ident : value $value:block slope $slope:block })*) => {$(
        #[derive(Clone, Copy)]
        pub(crate) struct $name;
        impl LaneKernel for $name {
            #[inline(always)]
            fn value<S: Simd>($q: f32x8<S>) -> f32x8<S> $value
            #[inline(always)]
            fn slope_over_x<S: Simd>($q: f32x8<S>) -> f32x8<S> $slope
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
        value { gaussian(q.max(0.0)) }
        // With ω = C (exp(4.5 q) − 1), ω'(x)/x = −2 dω/dq is −9 (ω + C).
        slope { within(q, (gaussian(q.max(0.0)) + GAUSSIAN_SCALE) * -9.0) }
    }
    CubicSpline { q:
        value {
            // 2(1 − x)³₊ − (1 − 2x)³₊: both pieces of the spline without a branch.
            let (x, one) = (x_of(q), f32x8::splat(q.simd, 1.0));
            let outer = (1.0 - x).max(0.0);
            let inner = x.mul_add(-2.0, one).max(0.0);
            (outer * outer * outer).mul_add(2.0, -(inner * inner * inner))
        }
        slope {
            let x = x_of(q);
            let outer = (1.0 - x).max(0.0);
            let inside = x * 18.0 - 12.0;
            let outside = outer * outer * -6.0 / x.max(0.5);
            x.simd_lt(0.5).select(inside, outside)
        }
    }
    WendlandC2 { q:
        value {
            let x = x_of(q);
            let y = (1.0 - x).max(0.0);
            let y2 = y * y;
            y2 * y2 * x.mul_add(4.0, f32x8::splat(q.simd, 1.0))
        }
        slope {
            let y = (1.0 - x_of(q)).max(0.0);
            y * y * y * -20.0
        }
    }
    Epanechnikov { q:
        value { q.max(0.0) }
        slope { within(q, f32x8::splat(q.simd, -2.0)) }
    }
    Triweight { q:
        value { let q = q.max(0.0); q * q * q }
        slope { let q = q.max(0.0); q * q * -6.0 }
    }
}

/// Splats, which are added in a way of their own.
#[derive(Clone, Copy)]
pub(crate) struct Splat;

impl LaneKernel for Splat {
    const IS_SPLAT: bool = true;

    #[inline(always)]
    fn value<S: Simd>(q: f32x8<S>) -> f32x8<S> {
        Gaussian::value(q)
    }

    #[inline(always)]
    fn slope_over_x<S: Simd>(q: f32x8<S>) -> f32x8<S> {
        Gaussian::slope_over_x(q)
    }
}

/// exp(−4.5)/(1 − exp(−4.5)), the Gaussian's C.
const GAUSSIAN_SCALE: f32 = (GAUSSIAN_CUT / (1.0 - GAUSSIAN_CUT)) as f32;

/// The Gaussian, C (exp(4.5 q) − 1), for 0 ≤ q ≤ 1: the polynomial without a constant term, exactly
/// zero at 0, whose largest error is least, 2.4e-8; with what is rounded, below 2e-7.
#[inline(always)]
fn gaussian<S: Simd>(q: f32x8<S>) -> f32x8<S> {
    let simd = q.simd;
    let mut p = q.mul_add(0.112_022_094, f32x8::splat(simd, -0.307_748_9));
    p = p.mul_add(q, f32x8::splat(simd, 0.565_648_9));
    p = p.mul_add(q, f32x8::splat(simd, -0.390_719_53));
    p = p.mul_add(q, f32x8::splat(simd, 0.398_745_06));
    p = p.mul_add(q, f32x8::splat(simd, 0.076_680_25));
    p = p.mul_add(q, f32x8::splat(simd, 0.212_923_42));
    p = p.mul_add(q, f32x8::splat(simd, 0.167_997_03));
    p = p.mul_add(q, f32x8::splat(simd, 0.113_903));
    p = p.mul_add(q, f32x8::splat(simd, 0.050_548_65));
    p * q
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::dispatch;
    use fearless_simd::Level;

    #[inline(always)]
    fn lanes<S: Simd, K: LaneKernel>(simd: S, q: [f32; 8]) -> ([f32; 8], [f32; 8]) {
        let v = f32x8::from_slice(simd, &q);
        let (mut a, mut b) = ([0.0; 8], [0.0; 8]);
        K::value(v).store_slice(&mut a);
        K::slope_over_x(v).store_slice(&mut b);
        (a, b)
    }

    fn both(kernel: Kernel, s: [f32; 8]) -> ([f32; 8], [f32; 8]) {
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
            Kernel::Splat => dispatch!(level, simd => lanes::<_, Splat>(simd, s)),
        }
    }

    #[test]
    fn lanes_agree_with_f64_and_vanish_outside() {
        for &kernel in Kernel::OF_DENSITIES {
            for start in 0..80 {
                let s: [f32; 8] = std::array::from_fn(|i| (start * 8 + i) as f32 / 512.0);
                let (value, slope) = both(kernel, s);
                for i in 0..8 {
                    let exact = f64::from(s[i]);
                    assert!(
                        (f64::from(value[i]) - kernel.value(exact)).abs() < 4e-7,
                        "{kernel} at s = {exact}"
                    );
                    assert!(
                        (f64::from(slope[i]) - kernel.slope_over_x(exact)).abs() < 1e-5,
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
        for &kernel in Kernel::OF_DENSITIES {
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
