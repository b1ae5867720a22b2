//! The type of a number in a file.

use crate::text_numbers::{TextNumber, bytes_of};

/// The type of the numbers in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Stored {
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
    pub(crate) fn bytes(self) -> usize {
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
