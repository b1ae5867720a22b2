//! The measures of what lies in pages: runs and their columns, nodes, and the root cell that places refer to.

use crate::container::{BLOCK_BYTES, MAX_PAGE_BYTES, PAGE_HEAD_BYTES};
use crate::geometry::DVec3;
use crate::geometry::curve::MAX_LEVEL;

/// Most points in a run.
pub const RUN_POINTS: usize = 128;
/// Bytes of a run's record.
pub const RUN_HEAD_BYTES: usize = 18;
/// Bytes of a record.
pub const NODE_BYTES: usize = 80;
/// Deepest level of a node.
pub const DEEPEST_LEVEL: u8 = MAX_LEVEL as u8;

/// Where a node's record is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct NodeRef {
    /// Number among the node pages, which follow the point pages.
    pub page: u32,
    /// Index of the record in the page.
    pub index: u16,
}

/// The root cell, which every run's frame refers to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RootCell {
    /// Smallest corner, world space.
    pub min: DVec3,
    /// Edge, a power of two, world space.
    pub size: f64,
}

/// Where the columns of a run stand behind its positions. Every column is padded to four bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ColumnLayout {
    /// Bytes of a point in columns of four and eight bytes a value, which need no padding.
    words: u32,
    /// Columns of two bytes a value.
    halves: u32,
    /// Columns of one byte a value.
    bytes: u32,
}

impl ColumnLayout {
    /// The layout with another column behind the others.
    #[must_use]
    pub fn with(self, value_bytes: usize) -> Self {
        match value_bytes {
            1 => Self { bytes: self.bytes + 1, ..self },
            2 => Self { halves: self.halves + 1, ..self },
            wide => Self { words: self.words + wide as u32, ..self },
        }
    }

    /// Bytes that the columns of `points` points take.
    #[must_use]
    #[inline]
    pub fn run_bytes(self, points: usize) -> usize {
        points * self.words as usize
            + self.halves as usize * (2 * points).next_multiple_of(4)
            + self.bytes as usize * points.next_multiple_of(4)
    }
}

/// Most records in a page.
#[must_use]
pub fn nodes_per_page(page_bytes: usize) -> usize {
    (page_bytes - PAGE_HEAD_BYTES) / NODE_BYTES
}

/// Largest run of `layout` at the widest encoding of positions, with its record and the head of its page: the least that
/// a page must have.
#[must_use]
pub fn least_page_bytes(layout: ColumnLayout) -> usize {
    let run = RUN_POINTS * 24 + layout.run_bytes(RUN_POINTS);
    ((PAGE_HEAD_BYTES + RUN_HEAD_BYTES).next_multiple_of(4) + run)
        .next_multiple_of(BLOCK_BYTES)
        .min(MAX_PAGE_BYTES)
}
