//! What is found in a file of VTK, of either kind: parts with points, and the arrays that these have.

use crate::points::ColumnType;

/// Where the numbers of an array are.
#[derive(Clone, Debug)]
pub(super) enum Stored {
    /// As they are, from this byte on.
    Plain { start: u64, big_endian: bool },
    /// As text separated by white space, from this byte on.
    Text(u64),
    /// In the array of this index of a piece in XML: among the positions, or among what points have.
    Xml { piece: usize, is_position: bool, index: usize },
}

/// An array with a row for each point.
#[derive(Clone, Debug)]
pub(super) struct VtkArray {
    pub(super) name: String,
    pub(super) kind: ColumnType,
    /// Numbers in a row.
    pub(super) width: usize,
    pub(super) stored: Stored,
}

impl VtkArray {
    pub(super) fn row_bytes(&self) -> usize {
        self.width * self.kind.bytes()
    }
}

/// Points, and the arrays that go with them.
#[derive(Debug)]
pub(super) struct Part {
    pub(super) rows: u64,
    pub(super) positions: VtkArray,
    pub(super) arrays: Vec<VtkArray>,
}

/// The little-endian bytes of a number in text. `None` if it is none of this type, or out of its range.
pub(super) fn parse(kind: ColumnType, text: &str) -> Option<Vec<u8>> {
    macro_rules! number {
        ($t:ty) => {
            text.parse::<$t>().ok()?.to_le_bytes().to_vec()
        };
    }
    Some(match kind {
        ColumnType::U8 => number!(u8),
        ColumnType::I8 => number!(i8),
        ColumnType::U16 => number!(u16),
        ColumnType::I16 => number!(i16),
        ColumnType::U32 => number!(u32),
        ColumnType::I32 => number!(i32),
        ColumnType::U64 => number!(u64),
        ColumnType::I64 => number!(i64),
        ColumnType::F32 => number!(f32),
        ColumnType::F64 => number!(f64),
    })
}
