//! Half precision: IEEE 754 binary16, a sign, 5 bits of exponent, 10 of fraction.

/// How far the fraction of single precision goes on behind that of half precision, in bits.
const MORE_FRACTION: u32 = 23 - 10;
/// The difference of the biases of both exponents.
const MORE_BIAS: u32 = 127 - 15;
/// The smallest number above 0.
const SMALLEST: f32 = 1.0 / (1 << 24) as f32;

/// The value of a number with these bits, which single precision holds exactly.
pub fn from_bits(half: u16) -> f32 {
    let (exponent, fraction) = (u32::from(half >> 10 & 0x1f), u32::from(half & 0x3ff));
    let magnitude = match exponent {
        0 => fraction as f32 * SMALLEST,
        31 => f32::from_bits(0xff << 23 | fraction << MORE_FRACTION),
        _ => f32::from_bits((exponent + MORE_BIAS) << 23 | fraction << MORE_FRACTION),
    };
    if half >> 15 == 0 { magnitude } else { -magnitude }
}

/// The value of two bytes, the lower one first.
pub fn from_le_bytes(half: [u8; 2]) -> f32 {
    from_bits(u16::from_le_bytes(half))
}

#[cfg(test)]
mod tests {
    use super::{from_bits, from_le_bytes};

    #[test]
    fn numbers_of_half_precision_are_decoded_exactly() {
        for (half, value) in [
            (0x0000, 0.0),
            (0x0001, 5.960_464_5e-8),
            (0x03ff, 6.097_555e-5),
            (0x0400, 6.103_515_6e-5),
            (0x3555, 0.333_251_95),
            (0x3c00, 1.0),
            (0xc000, -2.0),
            (0x7bff, 65504.0),
            (0x7c00, f32::INFINITY),
            (0xfc00, f32::NEG_INFINITY),
        ] {
            assert_eq!(from_bits(half), value, "{half:#x}");
        }
        assert!(from_bits(0x7e01).is_nan() && from_bits(0x8000).is_sign_negative());
        assert_eq!(from_le_bytes([0x00, 0xc0]), -2.0);
    }

    #[test]
    fn each_number_is_its_fraction_times_a_power_of_two() {
        for half in (0..=u16::MAX).filter(|half| half >> 10 & 0x1f != 31) {
            let (exponent, fraction) = (i32::from(half >> 10 & 0x1f), f64::from(half & 0x3ff));
            let hidden = if exponent == 0 { 0.0 } else { 1024.0 };
            let sign = if half >> 15 == 0 { 1.0 } else { -1.0 };
            let expected = sign * (hidden + fraction) * 2_f64.powi(exponent.max(1) - 25);
            assert_eq!(f64::from(from_bits(half)), expected, "{half:#x}");
        }
    }
}
