//! The kernels in `f32`, for eight samples at a time; splats, which are none, are in
//! `gaussian_splat`.

use fearless_simd::f32x8;
use fearless_simd::prelude::*;

use rayset_base::kernel::GAUSSIAN_CUT;

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
    use rayset_base::kernel::Kernel;

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
}
