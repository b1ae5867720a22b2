//! The type of a number in a file.

use crate::bytes_of;
use crate::text_numbers::TextNumber;

/// The type of the numbers in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stored {
    /// A whole number of 8 bits, with a sign.
    I8,
    /// A whole number of 8 bits.
    U8,
    /// A whole number of 16 bits, with a sign.
    I16,
    /// A whole number of 16 bits.
    U16,
    /// A whole number of 32 bits, with a sign.
    I32,
    /// A whole number of 32 bits.
    U32,
    /// A whole number of 64 bits, with a sign.
    I64,
    /// A whole number of 64 bits.
    U64,
    /// Half precision.
    F16,
    /// Single precision.
    F32,
    /// Double precision.
    F64,
}

impl Stored {
    /// Bytes of a number.
    #[must_use]
    pub fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 | Self::F16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::I64 | Self::U64 | Self::F64 => 8,
        }
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
