//! Half precision.

/// The value of an IEEE 754 binary16 with these bits.
pub(super) fn from_bits(bits: u16) -> f64 {
    let (exponent, fraction) = (i32::from(bits >> 10 & 0x1f), f64::from(bits & 0x3ff));
    let magnitude = match exponent {
        0 => fraction * 2_f64.powi(-24),
        31 if fraction == 0.0 => f64::INFINITY,
        31 => f64::NAN,
        _ => (1024.0 + fraction) * 2_f64.powi(exponent - 25),
    };
    if bits >> 15 == 0 { magnitude } else { -magnitude }
}

#[cfg(test)]
mod tests {
    use super::from_bits;

    #[test]
    fn halves_are_decoded() {
        let found =
            [0x0000, 0x3c00, 0xc000, 0x3555, 0x7bff, 0x0001, 0x03ff, 0x0400, 0x7c00, 0xfc00].map(from_bits);
        let expected = [
            0.0,
            1.0,
            -2.0,
            0.333_251_953_125,
            65504.0,
            5.960_464_477_539_063e-8,
            6.097_555_160_522_461e-5,
            6.103_515_625e-5,
            f64::INFINITY,
            f64::NEG_INFINITY,
        ];
        assert_eq!(found, expected);
        assert!(from_bits(0x7e00).is_nan() && from_bits(0x8000).is_sign_negative());
    }
}
