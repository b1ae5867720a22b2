//! Sizes and limits of the contents of pages: runs and their columns, nodes, and the root cell to
//! which positions are relative.

use super::shape::SHAPE_COLUMNS;
use rayset_base::geometry::DVec3;
use rayset_base::geometry::curve::MAX_LEVEL;
use rayset_store::container::{BLOCK_BYTES, MAX_PAGE_BYTES, PAGE_HEAD_BYTES};

/// Largest number of points in a run.
pub const RUN_POINTS: usize = 128;
/// Size of a run's record in bytes.
pub const RUN_HEAD_BYTES: usize = 18;
/// Size of a node's record in bytes.
pub const NODE_BYTES: usize = 80;
/// Deepest level of a node.
pub const DEEPEST_LEVEL: u8 = MAX_LEVEL as u8;

/// The place of a node's record.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct NodeRef {
    /// Index among the node pages, which follow the point pages.
    pub page: u32,
    /// Index of the record in the page.
    pub index: u16,
}

/// The root cell, to which the frame of every run is relative.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RootCell {
    /// Smallest corner, world space.
    pub min: DVec3,
    /// Edge length, a power of two, world space.
    pub size: f64,
}

/// The layout of the columns of a run, which follow its positions. Every column is padded to a
/// multiple of four bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ColumnLayout {
    /// Bytes per point in columns of four and eight bytes per value, which need no padding.
    words: u32,
    /// Number of columns of two bytes per value.
    halves: u32,
    /// Number of columns of one byte per value.
    bytes: u32,
}

impl ColumnLayout {
    /// The layout with another column after the others.
    #[must_use]
    pub fn with(self, value_bytes: usize) -> Self {
        match value_bytes {
            0 => self,
            1 => Self { bytes: self.bytes + 1, ..self },
            2 => Self { halves: self.halves + 1, ..self },
            wide => Self { words: self.words + wide as u32, ..self },
        }
    }

    /// The layout with shapes after the other columns.
    #[must_use]
    pub fn with_shape(self) -> Self {
        (0..SHAPE_COLUMNS).fold(self, |layout, _| layout.with(2))
    }

    /// Size in bytes of the columns of a run of `points` points.
    #[must_use]
    #[inline]
    pub fn run_bytes(self, points: usize) -> usize {
        points * self.words as usize
            + self.halves as usize * (2 * points).next_multiple_of(4)
            + self.bytes as usize * points.next_multiple_of(4)
    }
}

/// Largest number of node records in a page.
#[must_use]
pub fn nodes_per_page(page_bytes: usize) -> usize {
    (page_bytes - PAGE_HEAD_BYTES) / NODE_BYTES
}

/// Smallest page size in bytes for `layout`: that of a page with one run of the largest size, in
/// the widest encoding of positions.
#[must_use]
pub fn least_page_bytes(layout: ColumnLayout) -> usize {
    let run = RUN_POINTS * 24 + layout.run_bytes(RUN_POINTS);
    ((PAGE_HEAD_BYTES + RUN_HEAD_BYTES).next_multiple_of(4) + run)
        .next_multiple_of(BLOCK_BYTES)
        .min(MAX_PAGE_BYTES)
}
