//! What cuts are made of: parts of nodes, and records that are seen.

use super::lod::CloudLod;
use super::placement::CloudPlacement;
use super::record_pages::RecordPages;
use crate::field::Sight;
use crate::trace::access::Halt;

/// No record.
pub(super) const NONE: u32 = u32::MAX;

/// A node whose points may be seen as one.
#[derive(Clone, Copy, Debug)]
pub(in crate::trace) struct NodePart {
    /// Its record, or [`NONE`].
    pub(super) record: u32,
    /// The nearest record at or above it, and its level.
    pub(super) nearest: (u32, u8),
    /// The part that is seen of it at all, and that of this which its record does not stand for.
    pub(super) whole: f32,
    pub(super) rest: f32,
}

impl NodePart {
    /// The part for which its record stands.
    pub(super) fn of_record(&self) -> f32 {
        if self.record == NONE { 0.0 } else { self.whole - self.rest }
    }
}

/// Records that follow each other, and are decoded together.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct RecordRange {
    pub(super) first: u32,
    pub(super) count: u16,
    pub(super) level: u8,
    /// Where their parts are kept.
    pub(super) parts: u32,
}

/// Records that were looked at.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Walked(u64);

impl Walked {
    /// Counts records that are about to be looked at: of a file that is whole, no packet comes to
    /// one more than a few times.
    pub(super) fn add(
        &mut self,
        cloud: &CloudPlacement,
        pages: &RecordPages<'_>,
        records: u32,
    ) -> Result<(), Halt> {
        self.0 += u64::from(records);
        let most = 16 + 4 * u64::from(pages.records());
        if self.0 > most { Err(cloud.broken(cloud.first_record_page()).into()) } else { Ok(()) }
    }

    /// Records that were looked at since.
    pub(super) fn since(self, before: Self) -> u32 {
        (self.0 - before.0).try_into().unwrap_or(u32::MAX)
    }
}

/// Where the cut is: a cloud as it is seen, in the cloud's space.
#[derive(Clone, Copy)]
pub(super) struct Seen<'a> {
    pub(super) cloud: &'a CloudPlacement,
    pub(super) lod: &'a CloudLod,
    pub(super) sight: &'a Sight,
}

impl Seen<'_> {
    /// Edge of cells at a level.
    pub(super) fn edge(&self, level: u8) -> f64 {
        self.cloud.root_cell.size * 2_f64.powi(-i32::from(level))
    }
}
