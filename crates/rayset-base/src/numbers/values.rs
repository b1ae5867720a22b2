//! The values of numbers in files, and as a grid stores them.

use super::{Stored, half};

impl Stored {
    /// The value of one number, little-endian. Integers of 64 bits are rounded.
    pub fn number(self, from: &[u8]) -> f64 {
        let two = || [from[0], from[1]];
        let four = || [from[0], from[1], from[2], from[3]];
        let eight = || [from[0], from[1], from[2], from[3], from[4], from[5], from[6], from[7]];
        match self {
            Self::I8 => f64::from(from[0] as i8),
            Self::U8 => f64::from(from[0]),
            Self::I16 => f64::from(i16::from_le_bytes(two())),
            Self::U16 => f64::from(u16::from_le_bytes(two())),
            Self::I32 => f64::from(i32::from_le_bytes(four())),
            Self::U32 => f64::from(u32::from_le_bytes(four())),
            Self::I64 => i64::from_le_bytes(eight()) as f64,
            Self::U64 => u64::from_le_bytes(eight()) as f64,
            Self::F16 => f64::from(half::from_le_bytes(two())),
            Self::F32 => f64::from(f32::from_le_bytes(four())),
            Self::F64 => f64::from_le_bytes(eight()),
        }
    }

    /// Converts one number; `from` and `to` are little-endian. Infinities and NaN become 0. Returns
    /// false if a finite number is out of the range of single precision.
    pub fn convert(self, from: &[u8], to: &mut [u8]) -> bool {
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
            Self::F16 => to.copy_from_slice(&number(half::from_le_bytes([from[0], from[1]])).to_le_bytes()),
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
