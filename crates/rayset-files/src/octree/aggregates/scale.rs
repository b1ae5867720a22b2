//! Numbers in few bytes, of which a cell's edge, or nothing, is the unit: lengths on a logarithmic
//! scale, and masses of any size. Made of comparisons and multiplications alone, so that their
//! bytes are the same on every machine.

/// 2^(k/16).
const ROOTS: [f64; 16] = [
    1.0,
    1.044_273_782_427_413_8,
    1.090_507_732_665_257_7,
    1.138_788_634_756_691_6,
    1.189_207_115_002_721,
    1.241_857_812_073_484,
    1.296_839_554_651_009_6,
    1.354_255_546_936_892_7,
    std::f64::consts::SQRT_2,
    1.476_826_145_939_499_3,
    1.542_210_825_407_940_7,
    1.610_490_331_949_254_3,
    1.681_792_830_507_429,
    1.756_252_160_373_299_5,
    1.834_008_086_409_342_4,
    1.915_206_561_397_147_4,
];

/// 2^((2k + 1)/32), where lengths of sixteenths of an octave are rounded up.
const MIDDLES: [f64; 16] = [
    1.021_897_148_654_116_6,
    1.067_140_400_676_823_7,
    1.114_386_742_595_892_4,
    1.163_724_858_777_577_5,
    1.215_247_359_980_469,
    1.269_050_957_191_733_2,
    1.325_236_643_159_741_3,
    1.383_909_881_963_832,
    1.445_180_806_977_046_7,
    1.509_164_427_593_422_8,
    1.575_980_845_107_886_5,
    1.645_755_478_153_965,
    1.718_619_298_122_478,
    1.794_709_075_003_107_2,
    1.874_167_634_110_3,
    1.957_144_124_175_400_2,
];

/// The length of code 0, in edges of the cell.
const LONGEST: f64 = 4.0;

/// A logarithmic scale of lengths in a byte, down from four edges of a cell; 255 is the shortest.
#[derive(Clone, Copy)]
pub(super) enum Scale {
    /// Sixteenths of an octave, to 2^−13.9 edges.
    Sixteenths,
    /// Eighths of an octave, to 2^−29.9 edges.
    Eighths,
}

impl Scale {
    /// The code of a length in edges of the cell, the nearest by ratio.
    pub(super) fn code(self, length: f64) -> u8 {
        // Also of what is no number.
        if !(length > f64::MIN_POSITIVE) {
            return u8::MAX;
        }
        let ratio = (length / LONGEST).min(1.0);
        let (exponent, mantissa) = exponent_and_mantissa(ratio);
        let parts = match self {
            Self::Sixteenths => {
                16 * exponent + MIDDLES.iter().filter(|&&middle| mantissa >= middle).count() as i32
            }
            Self::Eighths => {
                let middles = ROOTS.iter().skip(1).step_by(2);
                8 * exponent + middles.filter(|&&middle| mantissa >= middle).count() as i32
            }
        };
        (-parts).clamp(0, 255) as u8
    }

    /// The length of a code, in edges of the cell.
    #[inline]
    pub(super) fn length(self, code: u8) -> f64 {
        let sixteenths = match self {
            Self::Sixteenths => u32::from(code),
            Self::Eighths => 2 * u32::from(code),
        };
        // 2^(−s/16) = 2^(k/16) · 2^−o, with s + k = 16 o.
        let octaves = sixteenths.div_ceil(16);
        LONGEST * ROOTS[(16 * octaves - sixteenths) as usize] * power_of_two(-(octaves as i32))
    }
}

/// A number from 0 on, of any size, in four bytes: its exponent, and 16 bits of its mantissa.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct ShortFloat {
    pub(super) mantissa: u16,
    pub(super) exponent: i16,
}

impl ShortFloat {
    /// Exponents of numbers that are 0.
    const OF_ZERO: i16 = i16::MIN;

    /// The nearest of a number; 0 of what is no normal number above 0.
    pub(super) fn of(number: f64) -> Self {
        if !(number >= f64::MIN_POSITIVE && number.is_finite()) {
            return Self { mantissa: 0, exponent: Self::OF_ZERO };
        }
        // Rounding may carry into the exponent.
        let bits = (number.to_bits() + (1 << 35)) >> 36;
        Self { mantissa: bits as u16, exponent: (bits >> 16) as i16 - 1023 }
    }

    #[inline]
    pub(super) fn number(self) -> f64 {
        if self.exponent < -1022 || self.exponent > 1023 {
            return 0.0;
        }
        (1.0 + f64::from(self.mantissa) / 65_536.0) * power_of_two(i32::from(self.exponent))
    }
}

/// A normal number above 0 as 2^exponent · mantissa, with a mantissa from 1 to 2.
pub(super) fn exponent_and_mantissa(number: f64) -> (i32, f64) {
    let bits = number.to_bits();
    let exponent = (bits >> 52 & 0x7ff) as i32 - 1023;
    (exponent, f64::from_bits(bits & 0x000f_ffff_ffff_ffff | 1023 << 52))
}

/// 2^exponent, from −1022 to 1023.
#[inline]
pub(super) fn power_of_two(exponent: i32) -> f64 {
    f64::from_bits(((exponent + 1023) as u64) << 52)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn lengths_are_those_of_the_nearest_code(exponent in -13.0..2.0_f64) {
            let length = exponent.exp2();
            for (scale, parts) in [(Scale::Sixteenths, 16.0), (Scale::Eighths, 8.0)] {
                let code = scale.code(length);
                let off = (scale.length(code) / length).log2().abs();
                prop_assert!(off <= 0.5 / parts + 1e-9, "{length}: {off}");
                prop_assert_eq!(scale.code(scale.length(code)), code);
            }
        }

        #[test]
        fn short_numbers_are_right_to_eight_millionths(exponent in -1022.0..1023.0_f64) {
            let number = exponent.exp2();
            let short = ShortFloat::of(number).number();
            prop_assert!((short / number - 1.0).abs() <= 0.5_f64.powi(17), "{number}: {short}");
        }
    }

    #[test]
    fn what_is_out_of_range_has_the_nearest_code() {
        for (scale, least) in [(Scale::Sixteenths, -13.9375), (Scale::Eighths, -29.875)] {
            for length in [0.0, -1.0, f64::NAN, 1e-300] {
                assert_eq!(scale.code(length), 255);
            }
            assert!((scale.length(255).log2() - least).abs() < 1e-12);
            assert_eq!((scale.code(4.0), scale.code(1e300), scale.code(f64::INFINITY)), (0, 0, 0));
        }
        for number in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e-310] {
            assert_eq!(ShortFloat::of(number).number(), 0.0);
        }
        assert_eq!(ShortFloat { mantissa: 7, exponent: i16::MAX }.number(), 0.0);
    }
}
