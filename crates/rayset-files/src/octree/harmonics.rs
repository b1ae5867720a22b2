//! Colours that change with the direction from which a point is seen, as files store them: a byte
//! for each coefficient of the real spherical harmonics, of each channel.
//!
//! A byte is a signed number n, and stands for sgn(n)·2·(n/127)²: of a coefficient of 0.1 it errs
//! by 0.004 at most, of one of 1 by 0.011. The first coefficient is that of the constant function
//! with value 1: what is to be added to the colour that is stored as such, which ends at 0 and 1.
//! The others are those of INRIA's trainer, in its order and with its signs
//! (`docs/rendering.md`).

pub use crate::points::harmonics::{CHANNELS, CONSTANT, MOST_COEFFICIENTS, MOST_DEGREE, coefficients};

/// The largest coefficient that is stored; larger ones become this.
const LARGEST: f64 = 2.0;
const MOST: f64 = 127.0;

/// Bytes that a point stores: its coefficients, channel by channel for each; none of degree 0.
#[must_use]
pub const fn stored_bytes(degree: u8) -> usize {
    if degree == 0 { 0 } else { (CHANNELS * coefficients(degree)).next_multiple_of(4) }
}

/// The nearest coefficient that can be stored. What is no number is 0.
#[must_use]
pub fn encode(coefficient: f64) -> u8 {
    if coefficient.is_nan() {
        return 0;
    }
    let size = (coefficient.abs() / LARGEST).sqrt().min(1.0) * MOST;
    (size.round().copysign(coefficient) as i8).cast_unsigned()
}

/// A stored coefficient.
#[inline]
#[must_use]
pub fn decode(byte: u8) -> f32 {
    let number = f32::from(byte.cast_signed());
    number * number.abs() * (LARGEST / (MOST * MOST)) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coefficients_are_kept_to_what_is_said() {
        for i in -30_000..=30_000 {
            let c = f64::from(i) * 1e-4;
            let error = (f64::from(decode(encode(c))) - c.clamp(-LARGEST, LARGEST)).abs();
            assert!(error <= 0.0112 * c.abs().sqrt() + 2e-4, "{c}: {error}");
        }
        assert_eq!([encode(0.0), encode(-0.0), encode(f64::NAN)], [0; 3]);
        assert_eq!([f64::INFINITY, -1e300].map(|c| decode(encode(c))), [2.0, -2.0]);
    }

    #[test]
    fn every_byte_is_a_number_of_its_own() {
        for byte in 0..=u8::MAX {
            assert!(encode(decode(byte).into()) == byte || byte == 128, "{byte}");
            assert!(decode(byte).abs() <= 2.04, "{byte}");
        }
    }

    #[test]
    fn no_degree_takes_more_than_48_bytes() {
        assert_eq!([0, 1, 2, 3].map(stored_bytes), [0, 12, 28, 48]);
    }
}
