//! Points that are equal in every column: where they are many, those of one place become one point,
//! whose weight is the sum of theirs.
//!
//! It is a pass of its own over records in the order of the curve, where equal ones follow each
//! other. Records whose radii were measured are in that order already; others are sorted by it if
//! many of them seem to be copies (`distinct`). What it makes depends on the records alone.

use super::context::Context;
use super::control::Stage;
use super::error::BuildError;
use super::ingest::Ingested;
use super::partition::Partition;
use super::pieces::{Assemble, Copy};
use super::plan::Cell;
use super::record::{self, RecordLayout};
use super::region::Region;
use super::survey::{LIMIT, Merged, NO_RANGE};
use rayset_store::spill::{Spill, SpillWriter};

/// Records that are read at a time.
const CHUNK_RECORDS: u64 = 8192;

/// Merges copies among records that come in the order of the curve.
pub(super) struct Merger {
    layout: RecordLayout,
    /// The weight of records that have none of their own.
    weight: f32,
    /// The latest record; empty before the first.
    latest: Vec<u8>,
    /// How often it has come.
    times: u64,
    /// The point that it becomes.
    point: Vec<u8>,
    pub(super) merged: Merged,
}

impl Merger {
    /// `layout` is that of the records.
    pub(super) fn new(layout: &RecordLayout, weight: f32) -> Self {
        let merged = Merged { points: 0, weight_range: NO_RANGE };
        Self { layout: layout.clone(), weight, latest: Vec::new(), times: 0, point: Vec::new(), merged }
    }

    /// Includes the next record, and hands on the point before it, if that has no more copies.
    pub(super) fn follow(
        &mut self,
        record: &[u8],
        write: &mut impl FnMut(&[u8]) -> Result<(), BuildError>,
    ) -> Result<(), BuildError> {
        let sum = self.weight_of(record) * (self.times + 1) as f64;
        if record == self.latest && sum.abs() <= LIMIT {
            self.times += 1;
            return Ok(());
        }
        self.end(write)?;
        self.latest.clear();
        self.latest.extend_from_slice(record);
        self.times = 1;
        Ok(())
    }

    /// Hands on the last point.
    pub(super) fn end(
        &mut self,
        write: &mut impl FnMut(&[u8]) -> Result<(), BuildError>,
    ) -> Result<(), BuildError> {
        if self.latest.is_empty() {
            return Ok(());
        }
        let weight = (self.weight_of(&self.latest) * self.times as f64) as f32;
        let at = self.layout.weight_at();
        let behind = if self.layout.has_weight { at + 4 } else { at };
        self.point.clear();
        self.point.extend_from_slice(&self.latest[..at]);
        self.point.extend_from_slice(&weight.to_le_bytes());
        self.point.extend_from_slice(&self.latest[behind..]);
        let range = &mut self.merged.weight_range;
        *range = (range.0.min(weight), range.1.max(weight));
        self.merged.points += 1;
        write(&self.point)
    }

    fn weight_of(&self, record: &[u8]) -> f64 {
        let own = || record::float(record, self.layout.weight_at());
        if self.layout.has_weight { own().into() } else { self.weight.into() }
    }
}

/// Merges the copies among all records if they are many. Their radii are given.
pub(super) fn find(context: &Context<'_>, ingested: Ingested) -> Result<Ingested, BuildError> {
    let Ingested { spill, survey } = ingested;
    let stride = survey.layout.stride();
    let partition = Partition::new(context, stride, survey.curve_keys(), survey.count, Stage::Spacing);
    let writer = SpillWriter::new(context.spill()?, 1 << 20);
    let mut writer = InOrder { context, writer, stride, latest: Vec::new(), copies: 0 };
    partition.run(Region::all(&spill, survey.count), &Copy, &mut writer)?;
    drop(spill);
    let InOrder { writer, copies, .. } = writer;
    let spill = writer.finish().map_err(context.io("write temporary files in"))?;
    let sorted = Ingested { spill, survey };
    if sorted.survey.merges(copies) { merge(context, sorted) } else { Ok(sorted) }
}

/// Writes sorted records, and counts those that are equal to the one before.
struct InOrder<'a> {
    context: &'a Context<'a>,
    writer: SpillWriter,
    stride: usize,
    latest: Vec<u8>,
    copies: u64,
}

impl Assemble<Vec<u8>> for InOrder<'_> {
    fn open(&mut self, _: Cell) {}

    fn own(&mut self, records: Vec<u8>) -> Result<(), BuildError> {
        for record in records.chunks_exact(self.stride) {
            self.copies += u64::from(self.latest == record);
            self.latest.clear();
            self.latest.extend_from_slice(record);
        }
        self.writer.push(&records).map_err(self.context.io("write temporary files in"))
    }

    fn subtree(&mut self, _: Cell, records: Vec<u8>) -> Result<(), BuildError> {
        self.own(records)
    }

    fn close(&mut self) -> Result<(), BuildError> {
        Ok(())
    }
}

/// Merges the copies among all records, which are in the order of the curve.
pub(super) fn merge(context: &Context<'_>, ingested: Ingested) -> Result<Ingested, BuildError> {
    let Ingested { spill, survey } = ingested;
    let mut merger = Merger::new(&survey.layout, survey.weight);
    let mut writer = SpillWriter::new(context.spill()?, 1 << 20);
    let mut write = |point: &[u8]| writer.push(point).map_err(context.io("write temporary files in"));
    each(context, &spill, survey.layout.stride(), survey.count, |record| merger.follow(record, &mut write))?;
    merger.end(&mut write)?;
    let spill = writer.finish().map_err(context.io("write temporary files in"))?;
    Ok(Ingested { spill, survey: survey.with_merged_copies(merger.merged) })
}

/// Reads records in order.
fn each(
    context: &Context<'_>,
    spill: &Spill,
    stride: usize,
    count: u64,
    mut visit: impl FnMut(&[u8]) -> Result<(), BuildError>,
) -> Result<(), BuildError> {
    let mut bytes = Vec::new();
    for first in (0..count).step_by(CHUNK_RECORDS as usize) {
        context.check()?;
        bytes.resize((count - first).min(CHUNK_RECORDS) as usize * stride, 0);
        spill.read_at(&mut bytes, first * stride as u64).map_err(context.io("read temporary files in"))?;
        bytes.chunks_exact(stride).try_for_each(&mut visit)?;
    }
    Ok(())
}
