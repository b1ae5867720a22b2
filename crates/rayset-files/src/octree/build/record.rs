//! Points between input and pages: fixed-size records in temporary files, and their sort key.
//!
//! The file order is that of (curve prefix at the owner's level, owner's level, position along the
//! curve, record bytes): a node's own points come before those of its children, and records that
//! compare equal are identical, so the order does not depend on threads or buckets.

use std::ops::Range;

use crate::octree::harmonics::stored_bytes;
use crate::octree::layout::RootCell;
use crate::octree::shape::{SHAPE_COLUMNS, StoredShape};
use crate::points::ColumnType;
use rayset_base::geometry::DVec3;
use rayset_base::geometry::curve::{MAX_LEVEL, hilbert};

/// Number of bits of a position along the Hilbert curve.
const CURVE_BITS: u32 = 3 * MAX_LEVEL;

/// The layout of a record: position (three `f64`), radius (`f32`), shape (as it is stored, five
/// `u16`), weight (`f32`), colour (three `f32` and
/// an `u32` for their depth, see [`Depths`](super::depths::Depths)), coefficients of harmonics (as
/// they are stored), attributes in their own types.
/// Nothing is aligned.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct RecordLayout {
    pub(super) has_radius: bool,
    pub(super) has_shape: bool,
    pub(super) has_weight: bool,
    pub(super) has_color: bool,
    /// Degree.
    pub(super) harmonics: u8,
    pub(super) attributes: Vec<ColumnType>,
}

const POSITION_BYTES: usize = 24;
/// Bytes of a shape.
pub(super) const SHAPE_BYTES: usize = 2 * SHAPE_COLUMNS;
const COLOR_BYTES: usize = 16;

impl RecordLayout {
    /// Size of a record in bytes.
    pub(super) fn stride(&self) -> usize {
        self.attribute_at(self.attributes.len())
    }

    /// Byte offset of the shape.
    pub(super) fn shape_at(&self) -> usize {
        POSITION_BYTES + 4 * usize::from(self.has_radius)
    }

    /// Byte offset of the weight.
    pub(super) fn weight_at(&self) -> usize {
        self.shape_at() + SHAPE_BYTES * usize::from(self.has_shape)
    }

    /// Byte offset of the first channel of the colour.
    pub(super) fn color_at(&self) -> usize {
        self.weight_at() + 4 * usize::from(self.has_weight)
    }

    /// Byte range of the coefficients of harmonics.
    pub(super) fn harmonics(&self) -> Range<usize> {
        let start = self.color_at() + COLOR_BYTES * usize::from(self.has_color);
        start..start + stored_bytes(self.harmonics)
    }

    /// Byte offset of an attribute.
    pub(super) fn attribute_at(&self, index: usize) -> usize {
        let before: usize = self.attributes[..index].iter().map(|kind| kind.bytes()).sum();
        self.harmonics().end + before
    }

    /// The same layout with a weight behind the radius.
    pub(super) fn with_weight(&self) -> Self {
        Self { has_weight: true, ..self.clone() }
    }

    /// The same layout with a radius in front of the other columns, and behind it a shape if that
    /// is measured, too.
    pub(super) fn with_measures(&self, with_shape: bool) -> Self {
        Self { has_radius: true, has_shape: self.has_shape || with_shape, ..self.clone() }
    }
}

pub(super) fn position(record: &[u8]) -> [f64; 3] {
    std::array::from_fn(|axis| {
        let b = &record[8 * axis..8 * axis + 8];
        f64::from_le_bytes([b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7]])
    })
}

/// The `f32` at a byte offset of a record.
pub(super) fn float(record: &[u8], at: usize) -> f32 {
    let b = &record[at..at + 4];
    f32::from_le_bytes([b[0], b[1], b[2], b[3]])
}

/// The colour at a byte offset of a record, and the number that denotes its depth.
pub(super) fn color(record: &[u8], at: usize) -> ([f32; 3], u32) {
    let b = &record[at + 12..at + COLOR_BYTES];
    ([0, 4, 8].map(|channel| float(record, at + channel)), u32::from_le_bytes([b[0], b[1], b[2], b[3]]))
}

/// The shape at a byte offset of a record.
pub(super) fn shape(record: &[u8], at: usize) -> StoredShape {
    StoredShape::from_bytes(std::array::from_fn(|i| record[at + i]))
}

/// The radius of a record that has one.
pub(super) fn radius(record: &[u8]) -> f32 {
    float(record, POSITION_BYTES)
}

/// The sort key of records, in file order except for ties: curve prefix at the owner's level (60
/// bits), level (5 bits), Hilbert code (60 bits).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Key(u128);

impl Key {
    fn new(code: u64, level: u32) -> Self {
        let below = CURVE_BITS - 3 * level;
        let prefix = code >> below << below;
        Self(u128::from(prefix) << (CURVE_BITS + 5) | u128::from(level) << CURVE_BITS | u128::from(code))
    }

    /// The deepest level whose cell is not smaller than the point's radius.
    pub(super) fn level(self) -> u32 {
        (self.0 >> CURVE_BITS) as u32 & 31
    }

    pub(super) fn code(self) -> u64 {
        self.0 as u64 & ((1 << CURVE_BITS) - 1)
    }

    /// Index, among all cells of `level`, of the cell that contains the point.
    pub(super) fn cell_at(self, level: u32) -> u64 {
        self.code() >> (CURVE_BITS - 3 * level)
    }
}

/// Computes the keys of records.
#[derive(Clone, Copy, Debug)]
pub(super) struct KeyMaker {
    pub(super) root: RootCell,
    /// The radius of all points, or `None` if it is stored in the records.
    pub(super) radius: Option<f32>,
}

impl KeyMaker {
    pub(super) fn key(&self, record: &[u8]) -> Key {
        let cells = f64::from(1_u32 << MAX_LEVEL);
        let p = (DVec3::from_array(position(record)) - self.root.min) * (cells / self.root.size);
        let cell = p.to_array().map(|v| v.clamp(0.0, cells - 1.0) as u32);
        Key::new(hilbert(cell), owner_level(self.radius(record), self.root.size))
    }

    pub(super) fn radius(&self, record: &[u8]) -> f32 {
        self.radius.unwrap_or_else(|| radius(record))
    }
}

/// The deepest level whose cell is not smaller than `radius`.
fn owner_level(radius: f32, root_size: f64) -> u32 {
    let ratio = root_size / f64::from(radius).max(f64::MIN_POSITIVE);
    if ratio < 1.0 {
        return 0;
    }
    // The exponent of a normal `f64` is the floor of its binary logarithm.
    let exponent = (ratio.to_bits() >> 52) as u32 - 1023;
    exponent.min(MAX_LEVEL)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_is_owned_by_the_deepest_cell_not_smaller_than_its_radius() {
        assert_eq!(owner_level(1.0, 8.0), 3);
        assert_eq!(owner_level(1.01, 8.0), 2);
        assert_eq!(owner_level(9.0, 8.0), 0);
        assert_eq!(owner_level(1e-18, 8.0), MAX_LEVEL);
    }

    #[test]
    fn own_points_of_a_node_come_before_those_of_its_children() {
        let (wide, narrow) =
            (Key::new(0b111_000 << (CURVE_BITS - 6), 1), Key::new(0b111_000 << (CURVE_BITS - 6), 2));
        let earlier = Key::new(0b110_111 << (CURVE_BITS - 6), MAX_LEVEL);
        assert!(earlier < wide && wide < narrow);
    }
}
