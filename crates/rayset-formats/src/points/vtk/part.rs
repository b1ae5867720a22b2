//! What is found in a file of VTK, of either kind: parts with points, and the arrays that these
//! have.

use crate::points::ColumnType;

/// Where the numbers of an array are.
#[derive(Clone, Debug)]
pub(super) enum Stored {
    /// As they are, from this byte on.
    Plain { start: u64, big_endian: bool },
    /// As text separated by white space, from this byte on.
    Text(u64),
    /// In the array of this index of a piece in XML: among the positions, or among what points
    /// have.
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
