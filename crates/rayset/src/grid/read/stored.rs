//! The types of numbers in files, and their conversion to those of a grid.

use crate::grid::VoxelKind;

/// The type of the numbers in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Stored {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Stored {
    pub(super) fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// The type to which it is converted. 32-bit integers and double precision are rounded to single precision.
    pub(super) fn kind(self) -> VoxelKind {
        match self {
            Self::U8 => VoxelKind::U8,
            Self::I8 | Self::I16 => VoxelKind::I16,
            Self::U16 => VoxelKind::U16,
            Self::I32 | Self::U32 | Self::F32 | Self::F64 => VoxelKind::F32,
        }
    }

    /// Converts one number; `from` and `to` are little-endian. Infinities and NaN become 0. Returns false if a finite number
    /// is out of the range of single precision.
    pub(super) fn convert(self, from: &[u8], to: &mut [u8]) -> bool {
        let four = || [from[0], from[1], from[2], from[3]];
        let number = |v: f32| if v.is_finite() { v } else { 0.0 };
        match self {
            Self::U8 | Self::I16 | Self::U16 => to.copy_from_slice(from),
            Self::I8 => to.copy_from_slice(&i16::from(from[0] as i8).to_le_bytes()),
            Self::I32 => to.copy_from_slice(&(i32::from_le_bytes(four()) as f32).to_le_bytes()),
            Self::U32 => to.copy_from_slice(&(u32::from_le_bytes(four()) as f32).to_le_bytes()),
            Self::F32 => to.copy_from_slice(&number(f32::from_le_bytes(four())).to_le_bytes()),
            Self::F64 => {
                let mut eight = [0; 8];
                eight.copy_from_slice(from);
                let double = f64::from_le_bytes(eight);
                let single = double as f32;
                to.copy_from_slice(&number(single).to_le_bytes());
                return single.is_finite() || !double.is_finite();
            }
        }
        true
    }

    /// Parses a number and returns its little-endian bytes and their count. `None` if the text is not a number of this type,
    /// or is out of range.
    pub(super) fn parse(self, text: &str) -> Option<([u8; 8], usize)> {
        let mut bytes = [0; 8];
        let mut put = |of: &[u8]| bytes[..of.len()].copy_from_slice(of);
        match self {
            Self::I8 => put(&text.parse::<i8>().ok()?.to_le_bytes()),
            Self::U8 => put(&text.parse::<u8>().ok()?.to_le_bytes()),
            Self::I16 => put(&text.parse::<i16>().ok()?.to_le_bytes()),
            Self::U16 => put(&text.parse::<u16>().ok()?.to_le_bytes()),
            Self::I32 => put(&text.parse::<i32>().ok()?.to_le_bytes()),
            Self::U32 => put(&text.parse::<u32>().ok()?.to_le_bytes()),
            Self::F32 => put(&text.parse::<f32>().ok()?.to_le_bytes()),
            Self::F64 => put(&text.parse::<f64>().ok()?.to_le_bytes()),
        }
        Some((bytes, self.bytes()))
    }
}
