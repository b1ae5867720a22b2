//! The types of numbers in files, and their conversion to those of a grid.

use crate::grid::VoxelKind;
use crate::text_numbers::{TextNumber, bytes_of};

/// The type of the numbers in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Stored {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    U64,
    F16,
    F32,
    F64,
}

impl Stored {
    pub(super) fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 | Self::F16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::I64 | Self::U64 | Self::F64 => 8,
        }
    }

    /// The type to which it is converted. Integers of 32 bits and more and double precision are rounded to single precision.
    pub(super) fn kind(self) -> VoxelKind {
        match self {
            Self::U8 => VoxelKind::U8,
            Self::I8 | Self::I16 => VoxelKind::I16,
            Self::U16 => VoxelKind::U16,
            _ => VoxelKind::F32,
        }
    }

    /// Converts one number; `from` and `to` are little-endian. Infinities and NaN become 0. Returns false if a finite number
    /// is out of the range of single precision.
    pub(super) fn convert(self, from: &[u8], to: &mut [u8]) -> bool {
        let four = || [from[0], from[1], from[2], from[3]];
        let eight = || [from[0], from[1], from[2], from[3], from[4], from[5], from[6], from[7]];
        let number = |v: f32| if v.is_finite() { v } else { 0.0 };
        match self {
            Self::U8 | Self::I16 | Self::U16 => to.copy_from_slice(from),
            Self::I8 => to.copy_from_slice(&i16::from(from[0] as i8).to_le_bytes()),
            Self::I32 => to.copy_from_slice(&(i32::from_le_bytes(four()) as f32).to_le_bytes()),
            Self::U32 => to.copy_from_slice(&(u32::from_le_bytes(four()) as f32).to_le_bytes()),
            Self::I64 => to.copy_from_slice(&(i64::from_le_bytes(eight()) as f32).to_le_bytes()),
            Self::U64 => to.copy_from_slice(&(u64::from_le_bytes(eight()) as f32).to_le_bytes()),
            Self::F16 => to.copy_from_slice(&number(single_of_half([from[0], from[1]])).to_le_bytes()),
            Self::F32 => to.copy_from_slice(&number(f32::from_le_bytes(four())).to_le_bytes()),
            Self::F64 => {
                let double = f64::from_le_bytes(eight());
                let single = double as f32;
                to.copy_from_slice(&number(single).to_le_bytes());
                return single.is_finite() || !double.is_finite();
            }
        }
        true
    }
}

impl TextNumber for Stored {
    fn parse(&self, text: &str) -> Option<([u8; 8], usize)> {
        match self {
            Self::I8 => bytes_of!(text, i8),
            Self::U8 => bytes_of!(text, u8),
            Self::I16 => bytes_of!(text, i16),
            Self::U16 => bytes_of!(text, u16),
            Self::I32 => bytes_of!(text, i32),
            Self::U32 => bytes_of!(text, u32),
            Self::I64 => bytes_of!(text, i64),
            Self::U64 => bytes_of!(text, u64),
            // No format has such numbers as text.
            Self::F16 => None,
            Self::F32 => bytes_of!(text, f32),
            Self::F64 => bytes_of!(text, f64),
        }
    }

    fn type_name(&self) -> String {
        format!("{self:?}").to_lowercase()
    }
}

/// Decodes little-endian IEEE 754 binary16: a sign, 5 bits of exponent, 10 of fraction.
pub(super) fn single_of_half(half: [u8; 2]) -> f32 {
    let half = u16::from_le_bytes(half);
    let sign = if half >> 15 == 0 { 1.0 } else { -1.0 };
    let (exponent, fraction) = (i32::from(half >> 10 & 0x1f), f32::from(half & 0x3ff));
    sign * match exponent {
        0 => fraction * 2_f32.powi(-24),
        31 if fraction == 0.0 => f32::INFINITY,
        31 => f32::NAN,
        _ => (1024.0 + fraction) * 2_f32.powi(exponent - 25),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
            assert_eq!(single_of_half(u16::to_le_bytes(half)), value, "{half:#x}");
        }
        assert!(single_of_half([1, 0x7e]).is_nan());
    }
}
