//! The seven radial basis functions, in `f64`; and splats, which are none.
//!
//! A kernel ω takes x = d/r. It is 1 at x = 0 and 0 for x ≥ 1. The functions here take s = x²,
//! because all kernels but two can be evaluated from s without a square root. For gradients the
//! useful form is ω'(x)/x = 2·dω/ds, which is finite at the centre for every kernel here.

use std::f64::consts::PI;
use std::fmt;
use std::str::FromStr;

use crate::parse::ParseError;

/// A radial basis function ω(x) with x = d/r: 1 at the centre, 0 for x ≥ 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
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

    /// ∫x₁²ω dV / ∫ω dV over the unit ball: the variance, along any axis, of places that are
    /// distributed as the kernel.
    #[must_use]
    pub fn variance(self) -> f64 {
        match self {
            // A third of ∫x⁴ω dx / ∫x²ω dx, term by term.
            Self::Wyvill => {
                let fourth = 1.0 / 5.0 - 22.0 / 63.0 + 17.0 / 81.0 - 4.0 / 99.0;
                fourth * 4.0 * PI / (3.0 * self.integral())
            }
            Self::Gaussian | Self::Splat => {
                // ∫₀¹ x⁴ exp(−a x²) dx = (3∫₀¹ x² exp(−a x²) dx − exp(−a)) / (2a).
                let a = 4.5_f64;
                let second = (1.0 - GAUSSIAN_CUT) * self.integral() / (4.0 * PI) + GAUSSIAN_CUT / 3.0;
                let fourth = (3.0 * second - GAUSSIAN_CUT) / (2.0 * a) - GAUSSIAN_CUT / 5.0;
                fourth / (1.0 - GAUSSIAN_CUT) * 4.0 * PI / (3.0 * self.integral())
            }
            Self::CubicSpline => 3.0 / 40.0,
            Self::WendlandC2 => 1.0 / 15.0,
            // Those of (1 − x²)ʲ: 1/(2j + 5).
            Self::Epanechnikov => 1.0 / 7.0,
            Self::Chen => 1.0 / 9.0,
            Self::Triweight => 1.0 / 11.0,
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

/// exp(−4.5), the value at the cut-off of the Gaussian.
pub const GAUSSIAN_CUT: f64 = 0.011_108_996_538_242_306;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kernels_peak_at_one_and_their_slope_integral_and_variance_match_the_value() {
        for &kernel in Kernel::OF_DENSITIES {
            assert!((kernel.value(0.0) - 1.0).abs() < 1e-12);
            let (n, mut sum, mut fourth) = (200_000, 0.0, 0.0);
            for i in 0..n {
                let x = (f64::from(i) + 0.5) / f64::from(n);
                sum += 4.0 * PI * x * x * kernel.value(x * x) / f64::from(n);
                fourth += 4.0 * PI * x.powi(4) * kernel.value(x * x) / f64::from(n);
                if i % 1000 == 500 {
                    let h = 1e-6;
                    let numeric = (kernel.value((x + h).powi(2)) - kernel.value((x - h).powi(2))) / (2.0 * h);
                    assert!((numeric - x * kernel.slope_over_x(x * x)).abs() < 1e-6, "{kernel}' at x = {x}");
                }
            }
            assert!((sum - kernel.integral()).abs() < 1e-8, "{kernel}: ∫ω = {sum}");
            let variance = fourth / (3.0 * sum);
            assert!((variance - kernel.variance()).abs() < 1e-8, "{kernel}: {variance}");
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
