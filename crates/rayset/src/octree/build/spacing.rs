//! Out-of-core estimation of radii from the local spacing, for points that have none.
//!
//! The radius of a point is 0.85 times the distance to its eighth nearest neighbour. Stray points, which are much farther from
//! others than is usual in the cloud, and those of which nine or more coincide, get the median radius: see [`Typical`].
//!
//! Records are first sorted along the Hilbert curve, with a box around every few hundred. Then they are loaded again a block
//! at a time: neighbours are looked for in the block, and after that in the records elsewhere whose boxes are near enough
//! (`neighbours`). Where so many records share a Hilbert code that the curve says nothing of their places, boxes would be of no
//! use: they have one radius, by their number and extent ([`Crowd`]). Other distances are exact, and the rest are counts of them, so the result depends on the points alone.

use super::context::Context;
use super::control::Stage;
use super::error::{BuildError, Quantity};
use super::ingest::{Ingested, LIMIT};
use super::neighbours::{STRETCH, Search, Stretches, square_between};
use super::partition::{Assemble, Pack, Partition, Region, Sorted};
use super::pipeline;
use super::plan::Cell;
use super::record::{self, KeyMaker};
use crate::geometry::{Aabb, DVec3};
use crate::spill::{Spill, SpillWriter};

/// Chosen by measurement (docs/benchmarks.md, "Automatic radii"): a compromise of a thin surface and one without pores.
const RADII_PER_DISTANCE: f64 = 0.85;
/// Number of records that share a box, if there is memory for so many boxes.
const GRAIN: u64 = 256;
/// Largest number of records in a block.
const MOST_IN_BLOCK: u64 = 1 << 15;
/// More records than this with one Hilbert code are a crowd.
const CROWD: u64 = 8192;
/// Position and radius of a record.
const HEAD: usize = 28;

/// Rewrites all records, each with a radius.
pub(super) fn assign_radii(context: &Context<'_>, ingested: Ingested) -> Result<Ingested, BuildError> {
    // Owner cells do not matter yet: with a tiny radius, points are sorted by their Hilbert codes alone.
    let keys = KeyMaker { root: ingested.root, radius: Some(f32::MIN_POSITIVE) };
    let stride = ingested.layout.stride();
    let partition = Partition::new(context, stride, keys, ingested.count, Stage::Spacing).in_passes(2);
    let mut curve = CurveWriter::new(context, stride, keys)?;
    partition.run(Region::all(&ingested.spill, ingested.count), &Copy, &mut curve)?;
    let layout = ingested.layout.with_radius();
    let sorted = curve.finish(ingested.count, layout.stride())?;
    let measured = sorted.measure(context, ingested.auto_scale)?;
    measured.check_range(context, &ingested)?;
    let typical = measured.typical().unwrap_or_else(|| Typical::alone(fallback(&ingested)));
    let radius_range = sorted.settle(context, &measured, &typical)?;
    Ok(Ingested { spill: sorted.spill, layout, radius: None, radius_range, ..ingested })
}

/// Passes records on as they are.
struct Copy;

impl Copy {
    fn bytes(records: Sorted<'_>) -> Vec<u8> {
        let stride = if records.len() > 0 { records.record(0).len() } else { 0 };
        let mut bytes = Vec::with_capacity(records.len() * stride);
        (0..records.len()).for_each(|i| bytes.extend_from_slice(records.record(i)));
        bytes
    }
}

impl Pack for Copy {
    type Piece = Vec<u8>;

    fn subtree(&self, _: Cell, records: Sorted<'_>) -> Vec<u8> {
        Self::bytes(records)
    }

    fn own(&self, records: Sorted<'_>) -> Vec<u8> {
        Self::bytes(records)
    }
}

/// Records that share a Hilbert code, which happens where a cloud is a million times as wide as a part of it.
struct Crowd {
    records: std::ops::Range<u64>,
    code: u64,
    bounds: Aabb,
}

impl Crowd {
    /// The radius of its points before scaling, as if they were spread over a square; 0 if they coincide.
    fn radius(&self) -> f64 {
        let count = (self.records.end - self.records.start) as f64;
        0.75 * self.bounds.size().max_element() / count.sqrt()
    }
}

/// Consecutive records that are measured in the same way, in blocks.
struct Section {
    records: std::ops::Range<u64>,
    first_block: u64,
    /// The radius of a crowd before scaling.
    radius: Option<f64>,
}

/// Writes sorted records, each with room for a radius, and keeps boxes around them.
struct CurveWriter<'a> {
    context: &'a Context<'a>,
    keys: KeyMaker,
    /// The records with the latest code, and those before that were a crowd.
    latest: Crowd,
    crowds: Vec<Crowd>,
    writer: SpillWriter,
    stride: usize,
    written: u64,
    boxes: Vec<Aabb>,
    grain: u64,
    most_boxes: usize,
}

impl<'a> CurveWriter<'a> {
    fn new(context: &'a Context<'a>, stride: usize, keys: KeyMaker) -> Result<Self, BuildError> {
        let writer = SpillWriter::new(context.spill()?, 1 << 20);
        let most_boxes = context.options.memory_bytes as usize / 16 / size_of::<Aabb>();
        let latest = Crowd { records: 0..0, code: u64::MAX, bounds: Aabb::EMPTY };
        Ok(Self {
            context,
            keys,
            latest,
            crowds: Vec::new(),
            writer,
            stride,
            written: 0,
            boxes: Vec::new(),
            grain: GRAIN,
            most_boxes,
        })
    }

    /// Counts the next record as one of the latest code.
    fn follow(&mut self, record: &[u8]) {
        let code = self.keys.key(record).code();
        if code != self.latest.code {
            self.end_crowd();
            self.latest = Crowd { records: self.written..self.written, code, bounds: Aabb::EMPTY };
        }
        self.latest.records.end += 1;
        self.latest.bounds.include(DVec3::from_array(record::position(record)));
    }

    fn end_crowd(&mut self) {
        let empty = Crowd { records: 0..0, code: u64::MAX, bounds: Aabb::EMPTY };
        let ended = std::mem::replace(&mut self.latest, empty);
        if ended.records.end - ended.records.start > CROWD {
            self.crowds.push(ended);
        }
    }

    fn take(&mut self, records: &[u8]) -> Result<(), BuildError> {
        for record in records.chunks_exact(self.stride) {
            if self.written.is_multiple_of(self.grain) {
                if self.boxes.len() >= self.most_boxes && self.boxes.len().is_multiple_of(2) {
                    self.boxes = self.boxes.chunks(2).map(|pair| pair[0].union(pair[1])).collect();
                    self.grain *= 2;
                }
                self.boxes.push(Aabb::EMPTY);
            }
            if let Some(last) = self.boxes.last_mut() {
                last.include(DVec3::from_array(record::position(record)));
            }
            self.follow(record);
            self.written += 1;
            let io = self.context.io("write temporary files in");
            self.writer.push(&record[..24]).map_err(&io)?;
            self.writer.push(&[0; 4]).map_err(&io)?;
            self.writer.push(&record[24..]).map_err(&io)?;
        }
        Ok(())
    }

    fn finish(mut self, count: u64, stride: usize) -> Result<Curve, BuildError> {
        self.end_crowd();
        let spill = self.writer.finish().map_err(self.context.io("write temporary files in"))?;
        Ok(Curve { spill, stride, count, crowds: self.crowds, boxes: self.boxes, grain: self.grain })
    }
}

impl Assemble<Vec<u8>> for CurveWriter<'_> {
    fn open(&mut self, _: Cell) {}

    fn own(&mut self, piece: Vec<u8>) -> Result<(), BuildError> {
        self.take(&piece)
    }

    fn subtree(&mut self, _: Cell, piece: Vec<u8>) -> Result<(), BuildError> {
        self.take(&piece)
    }

    fn close(&mut self) -> Result<(), BuildError> {
        Ok(())
    }
}

/// All records along the Hilbert curve, and a box around each `grain` of them.
struct Curve {
    spill: Spill,
    stride: usize,
    count: u64,
    crowds: Vec<Crowd>,
    boxes: Vec<Aabb>,
    grain: u64,
}

impl Curve {
    /// Crowds and what lies between them, of blocks of at most `block` records; and the number of blocks.
    fn sections(&self, block: u64) -> (Vec<Section>, u64) {
        let (mut sections, mut blocks, mut at) = (Vec::new(), 0, 0);
        let mut add = |records: std::ops::Range<u64>, radius: Option<f64>| {
            let first_block = blocks;
            blocks += (records.end - records.start).div_ceil(block);
            sections.push(Section { records, first_block, radius });
        };
        for crowd in &self.crowds {
            if at < crowd.records.start {
                add(at..crowd.records.start, None);
            }
            add(crowd.records.clone(), Some(crowd.radius()));
            at = crowd.records.end;
        }
        if at < self.count {
            add(at..self.count, None);
        }
        (sections, blocks)
    }

    /// Gives every record the radius that its neighbours suggest, or 0 if they suggest none.
    fn measure(&self, context: &Context<'_>, scale: f64) -> Result<Measured, BuildError> {
        let threads = context.options.threads.max(1);
        // A block needs memory for its records, their positions and distances, and as much again for records elsewhere.
        let per_record = (self.stride + 24 + 8 * 9 + 16) as u64;
        let block = context.options.memory_bytes / 3 / (threads as u64 + 2) / per_record;
        let block = block.clamp(512, MOST_IN_BLOCK) / STRETCH as u64 * STRETCH as u64;
        let mut measured = Measured::default();
        let (sections, blocks) = self.sections(block);
        let work = |number: usize| {
            let section = sections.partition_point(|section| section.first_block <= number as u64) - 1;
            let Section { records, first_block, radius } = &sections[section];
            let first = records.start + (number as u64 - first_block) * block;
            let range = first..(first + block).min(records.end);
            match radius {
                Some(radius) => {
                    let radii = vec![scale * radius; (range.end - range.start) as usize];
                    self.store(context, &range, radii)
                }
                None => self.measure_block(context, range, scale),
            }
        };
        let mut done = self.count;
        pipeline::ordered(blocks as usize, threads, work, |_, radii| {
            radii.iter().for_each(|&radius| measured.count(radius));
            done += radii.len() as u64;
            context.progress(Stage::Spacing, done / 2, self.count);
            Ok(())
        })?;
        Ok(measured)
    }

    /// Measures the radii of a block and stores them.
    fn measure_block(
        &self,
        context: &Context<'_>,
        block: std::ops::Range<u64>,
        scale: f64,
    ) -> Result<Vec<f64>, BuildError> {
        let mut bytes = Vec::new();
        self.read(context, &block, &mut bytes)?;
        let mut points = Stretches::default();
        bytes.chunks_exact(self.stride).for_each(|record| points.push(record::position(record)));
        drop(bytes);
        let mut search = Search::among(&points, || !context.is_cancelled());
        context.check()?;
        self.search_elsewhere(context, &block, &mut search)?;
        let radius = |distance: f64| {
            if distance.is_finite() { RADII_PER_DISTANCE * scale * distance } else { 0.0 }
        };
        self.store(context, &block, search.distances().map(radius).collect())
    }

    /// Stores the radii of a block, within the range of an `f32`; returns them.
    fn store(
        &self,
        context: &Context<'_>,
        block: &std::ops::Range<u64>,
        radii: Vec<f64>,
    ) -> Result<Vec<f64>, BuildError> {
        let mut bytes = Vec::new();
        self.read(context, block, &mut bytes)?;
        for (record, &radius) in bytes.chunks_exact_mut(self.stride).zip(&radii) {
            let stored = if radius > 0.0 { radius.clamp(1.0 / LIMIT, LIMIT) as f32 } else { 0.0 };
            record[24..HEAD].copy_from_slice(&stored.to_le_bytes());
        }
        // Others may read these records meanwhile, but only their positions, which stay as they are.
        let at = block.start * self.stride as u64;
        self.spill.write_at(&bytes, at).map_err(context.io("rewrite temporary files in"))?;
        Ok(radii)
    }

    /// Looks for neighbours outside of the block that is searched for.
    fn search_elsewhere(
        &self,
        context: &Context<'_>,
        block: &std::ops::Range<u64>,
        search: &mut Search<'_>,
    ) -> Result<(), BuildError> {
        let (bounds, reach) = search.extent();
        let mut near: Vec<(f64, u64)> = self
            .boxes
            .iter()
            .enumerate()
            .map(|(number, other)| (square_between(&bounds, other), number as u64))
            .filter(|&(square, number)| {
                let range = number * self.grain..((number + 1) * self.grain).min(self.count);
                square < reach && !(block.start <= range.start && range.end <= block.end)
            })
            .collect();
        // The nearest first: what is found there makes the others too far away.
        near.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let (mut bytes, mut others) = (Vec::new(), Stretches::default());
        for (_, number) in near {
            if !search.reaches(&self.boxes[number as usize]) {
                continue;
            }
            let end = ((number + 1) * self.grain).min(self.count);
            for first in (number * self.grain..end).step_by(GRAIN as usize) {
                let piece = first..(first + GRAIN).min(end);
                if block.start <= piece.start && piece.end <= block.end {
                    continue;
                }
                self.read(context, &piece, &mut bytes)?;
                others.clear();
                let records = piece.zip(bytes.chunks_exact(self.stride));
                records
                    .filter(|(index, _)| !block.contains(index))
                    .for_each(|(_, record)| others.push(record::position(record)));
                search.extend(&others);
            }
        }
        Ok(())
    }

    fn read(
        &self,
        context: &Context<'_>,
        range: &std::ops::Range<u64>,
        bytes: &mut Vec<u8>,
    ) -> Result<(), BuildError> {
        context.check()?;
        bytes.resize((range.end - range.start) as usize * self.stride, 0);
        let at = range.start * self.stride as u64;
        self.spill.read_at(bytes, at).map_err(context.io("read temporary files in"))
    }

    /// Gives the typical radius to records that have none, or one beyond the limit; returns the range of all radii.
    fn settle(
        &self,
        context: &Context<'_>,
        measured: &Measured,
        typical: &Typical,
    ) -> Result<(f32, f32), BuildError> {
        let (least, most) = (measured.least as f32, measured.most as f32);
        if measured.unknown == 0 && most <= typical.limit {
            return Ok((least, most));
        }
        let mut range = (f32::INFINITY, 0.0_f32);
        let mut bytes = Vec::new();
        for first in (0..self.count).step_by(8192) {
            self.read(context, &(first..(first + 8192).min(self.count)), &mut bytes)?;
            let mut changed = false;
            for record in bytes.chunks_exact_mut(self.stride) {
                let mut radius = record::radius(record);
                if radius <= 0.0 || radius > typical.limit {
                    radius = typical.radius;
                    record[24..HEAD].copy_from_slice(&radius.to_le_bytes());
                    changed = true;
                }
                range = (range.0.min(radius), range.1.max(radius));
            }
            if changed {
                let at = first * self.stride as u64;
                self.spill.write_at(&bytes, at).map_err(context.io("rewrite temporary files in"))?;
            }
        }
        Ok(range)
    }
}

/// Counts of radii: 128 for each power of two.
struct Measured {
    counts: Vec<u64>,
    known: u64,
    unknown: u64,
    least: f64,
    most: f64,
}

/// Bits of an `f32` that a count leaves out.
const LEFT_OUT: u32 = 16;

impl Default for Measured {
    fn default() -> Self {
        let counts = vec![0; 1 << (31 - LEFT_OUT)];
        Self { counts, known: 0, unknown: 0, least: f64::INFINITY, most: 0.0 }
    }
}

impl Measured {
    fn count(&mut self, radius: f64) {
        if radius > 0.0 {
            self.known += 1;
            (self.least, self.most) = (self.least.min(radius), self.most.max(radius));
            let stored = radius.clamp(1.0 / LIMIT, LIMIT) as f32;
            self.counts[(stored.to_bits() >> LEFT_OUT) as usize] += 1;
        } else {
            self.unknown += 1;
        }
    }

    /// An error if a radius cannot be stored.
    fn check_range(&self, context: &Context<'_>, ingested: &Ingested) -> Result<(), BuildError> {
        for (quantity, farthest) in [(Quantity::SmallRadius, self.least), (Quantity::Radius, self.most)] {
            let out = if quantity == Quantity::Radius { farthest > LIMIT } else { farthest < 1.0 / LIMIT };
            if self.known > 0 && out {
                let (count, records) = (self.known, ingested.count);
                let factor = quantity.factor(farthest, context.options.length_scale);
                return Err(BuildError::OutOfRange { quantity, count, records, farthest, factor });
            }
        }
        Ok(())
    }

    /// The radius than which a part of all radii is smaller, rounded down to the beginning of its count.
    fn quantile(&self, part: f64) -> f64 {
        let mut before = (part * self.known as f64) as u64;
        let at = self.counts.iter().position(|&count| {
            let found = before < count;
            before = before.saturating_sub(count);
            found
        });
        f64::from(f32::from_bits((at.unwrap_or(0) as u32) << LEFT_OUT))
    }

    /// `None` if no radius is known.
    fn typical(&self) -> Option<Typical> {
        let [lower, median, upper] = [0.25, 0.5, 0.75].map(|part| self.quantile(part));
        let spread = upper / lower;
        let limit = (upper * spread * spread.sqrt()).max(LEAST_LIMIT * median);
        (self.known > 0).then_some(Typical { radius: median as f32, limit: limit.min(LIMIT) as f32 })
    }
}

/// The limit is at least this multiple of the median: clouds that are sampled evenly have sparse edges, too.
const LEAST_LIMIT: f64 = 3.0;

/// What radii are usual in a cloud.
///
/// With quartiles Q₁ and Q₃ of the radii, those beyond Q₃ (Q₃/Q₁)^1.5, and beyond three times the median, belong to stray points.
/// In logarithms this is the customary fence of 1.5 times the interquartile range, so a scan whose spacing
/// varies widely has a wide limit.
struct Typical {
    radius: f32,
    limit: f32,
}

impl Typical {
    fn alone(radius: f64) -> Self {
        Self { radius: radius.clamp(1.0 / LIMIT, LIMIT) as f32, limit: LIMIT as f32 }
    }
}

/// The radius for a cloud that is too small or too degenerate to measure: from the spacing of a surface of its extent, so that
/// neighbours touch but do not hide each other, or 1.
fn fallback(ingested: &Ingested) -> f64 {
    let extent = ingested.bounds.size().max_element();
    let spacing = extent / (ingested.count as f64).sqrt().max(1.0);
    let radius = if spacing > 0.0 && spacing.is_finite() { 0.75 * spacing } else { 1.0 };
    radius * ingested.auto_scale
}
