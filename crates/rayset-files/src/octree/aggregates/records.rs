//! Records as they are made, level by level.

use super::error::AggregateError;
use super::header::AggregateHeader;
use super::moments::{Carried, Moments};
use super::record::{AGGREGATE_BYTES, Aggregate};
use crate::octree::layout::RootCell;
use rayset_base::srgb::srgb_from_linear;

/// Where the number of the first child is in a record.
const FIRST_CHILD_AT: usize = 28;
/// Where the mask of children is.
const CHILD_MASK_AT: usize = 27;

/// Where records go as they are made.
pub(super) trait RecordSink {
    /// Takes records of a level; `first` is the number of the first in the level, as are those of
    /// their children in theirs.
    fn append(&mut self, level: usize, first: u32, records: Vec<u8>) -> Result<(), AggregateError>;
}

/// Makes records of moments.
pub(super) struct RecordMaker {
    pub(super) root: RootCell,
    pub(super) carried: Carried,
}

impl RecordMaker {
    pub(super) fn record_bytes(&self) -> usize {
        AggregateHeader::bytes_of_record(self.carried.color, self.carried.classes.len())
    }

    /// The edge of a cell at a level, world space.
    pub(super) fn edge(&self, level: u32) -> f64 {
        self.root.size * 2_f64.powi(-(level as i32))
    }

    /// Appends the record of a cell at a level, with its columns.
    pub(super) fn encode(&self, aggregate: &Aggregate, moments: &Moments, level: u32, records: &mut Vec<u8>) {
        let at = records.len();
        records.resize(at + AGGREGATE_BYTES, 0);
        aggregate.encode(self.root, self.edge(level), &mut records[at..]);
        if self.carried.color {
            let display = moments.color().map(|light| (srgb_from_linear(light) * 255.0).round() as u8);
            records.extend([display[0], display[1], display[2], 0]);
        }
        moments.attributes().for_each(|value| records.extend(value.to_le_bytes()));
    }
}

/// The records below a node, by level, from the one below it on. Numbers of children are counted in
/// their own level.
#[derive(Clone, Debug, Default)]
pub(super) struct RecordsByLevel {
    pub(super) levels: Vec<Vec<u8>>,
}

impl RecordsByLevel {
    /// Appends siblings, so many levels below the first; returns the number of the first.
    pub(super) fn append(&mut self, depth: usize, siblings: &[u8], record_bytes: usize) -> u32 {
        if siblings.is_empty() {
            return 0;
        }
        if self.levels.len() <= depth {
            self.levels.resize_with(depth + 1, Vec::new);
        }
        let level = &mut self.levels[depth];
        let first = (level.len() / record_bytes) as u32;
        level.extend_from_slice(siblings);
        first
    }
}

/// Adds a number to those of first children, of records that have any.
pub(super) fn move_children(records: &mut [u8], record_bytes: usize, by: u32) {
    for record in records.chunks_exact_mut(record_bytes) {
        if record[CHILD_MASK_AT] != 0 {
            let at = FIRST_CHILD_AT;
            let first = u32::from_le_bytes([record[at], record[at + 1], record[at + 2], record[at + 3]]);
            record[at..at + 4].copy_from_slice(&(first + by).to_le_bytes());
        }
    }
}
