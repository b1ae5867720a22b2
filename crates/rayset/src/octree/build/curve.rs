//! Records along the Hilbert curve, and the distances of their points to their neighbours.

use std::ops::Range;

use super::context::Context;
use super::control::Stage;
use super::error::BuildError;
use super::neighbours::{STRETCH, Search, Stretches, square_between};
use super::pipeline;
use super::record::{self, KeyMaker};
use super::typical::Measured;
use crate::geometry::{Aabb, DVec3};
use crate::spill::Spill;

/// Chosen by measurement (docs/benchmarks.md, "Automatic radii"): a compromise of a thin surface and one without pores.
const RADII_PER_DISTANCE: f64 = 0.85;
/// Number of records that share a box, if there is memory for so many boxes.
pub(super) const GRAIN: u64 = 256;
/// Largest number of records in a block.
const MOST_IN_BLOCK: u64 = 1 << 15;
/// More records than this with one Hilbert code are a crowd.
const CROWD: u64 = 8192;

/// Largest number of boxes for which there is memory.
pub(super) fn most_boxes(memory_bytes: u64) -> usize {
    memory_bytes as usize / 16 / size_of::<Aabb>()
}

/// Records that share a Hilbert code, which happens where a cloud is a million times as wide as a part of it.
#[derive(Clone)]
pub(super) struct Crowd {
    pub(super) records: Range<u64>,
    code: u64,
    pub(super) bounds: Aabb,
}

impl Crowd {
    /// The radius of its points before scaling, as if they were spread over a square; 0 if they coincide.
    fn radius(&self) -> f64 {
        let count = (self.records.end - self.records.start) as f64;
        0.75 * self.bounds.size().max_element() / count.sqrt()
    }
}

impl Crowd {
    pub(super) fn new(records: Range<u64>, bounds: Aabb) -> Self {
        Self { records, code: u64::MAX, bounds }
    }
}

/// Consecutive records that are measured in the same way, in blocks.
struct Section {
    records: Range<u64>,
    first_block: u64,
    /// The radius of a crowd before scaling.
    radius: Option<f64>,
}

/// What is kept of records in the order of the curve: boxes around each `grain` of them, and crowds.
pub(super) struct Sketch {
    keys: KeyMaker,
    /// The records with the latest code.
    latest: Crowd,
    pub(super) crowds: Vec<Crowd>,
    pub(super) count: u64,
    pub(super) boxes: Vec<Aabb>,
    pub(super) grain: u64,
    most_boxes: usize,
}

impl Sketch {
    /// Boxes are of `grain` records at first, and of twice as many whenever there would be more than `most_boxes`.
    pub(super) fn new(keys: KeyMaker, grain: u64, most_boxes: usize) -> Self {
        let latest = Crowd::new(0..0, Aabb::EMPTY);
        Self { keys, latest, crowds: Vec::new(), count: 0, boxes: Vec::new(), grain, most_boxes }
    }

    /// Includes the next record.
    pub(super) fn follow(&mut self, record: &[u8]) {
        let position = DVec3::from_array(record::position(record));
        if self.count.is_multiple_of(self.grain) {
            if self.boxes.len() >= self.most_boxes && self.boxes.len().is_multiple_of(2) {
                self.boxes = self.boxes.chunks(2).map(|pair| pair[0].union(pair[1])).collect();
                self.grain *= 2;
            }
            self.boxes.push(Aabb::EMPTY);
        }
        if let Some(last) = self.boxes.last_mut() {
            last.include(position);
        }
        let code = self.keys.key(record).code();
        if code != self.latest.code {
            self.end_crowd();
            self.latest = Crowd { records: self.count..self.count, code, bounds: Aabb::EMPTY };
        }
        self.count += 1;
        self.latest.records.end = self.count;
        self.latest.bounds.include(position);
    }

    /// Ends the records with the latest code, which are a crowd if they are many.
    pub(super) fn end_crowd(&mut self) {
        let ended = std::mem::replace(&mut self.latest, Crowd::new(0..0, Aabb::EMPTY));
        if ended.records.end - ended.records.start > CROWD {
            self.crowds.push(ended);
        }
    }
}

/// Boxes around consecutive records, in stretches that may end with a box of fewer records.
#[derive(Default)]
pub(super) struct Boxes {
    boxes: Vec<Aabb>,
    grain: u64,
    /// First box and first record of each stretch.
    stretches: Vec<(usize, u64)>,
    count: u64,
}

impl Boxes {
    /// Appends the boxes of `count` records, each of `grain` of them, which is the same for all stretches.
    pub(super) fn push(&mut self, boxes: &[Aabb], grain: u64, count: u64) {
        self.stretches.push((self.boxes.len(), self.count));
        self.boxes.extend_from_slice(boxes);
        self.grain = grain;
        self.count += count;
    }

    /// The records of a box.
    fn records(&self, number: usize) -> Range<u64> {
        let next = self.stretches.partition_point(|&(first, _)| first <= number);
        let (first_box, first_record) = self.stretches[next - 1];
        // Stretches without records have no boxes, and begin where the next one does.
        let end = self.stretches.get(next).map_or(self.count, |&(_, record)| record);
        let first = first_record + (number - first_box) as u64 * self.grain;
        first..(first + self.grain).min(end)
    }
}

/// All records along the Hilbert curve.
pub(super) struct Curve<'a> {
    pub(super) spill: &'a Spill,
    pub(super) stride: usize,
    pub(super) crowds: Vec<Crowd>,
    pub(super) boxes: Boxes,
}

/// Crowds and what lies between them, within a range, of blocks of at most `block` records; and the number of blocks.
fn sections(crowds: &[Crowd], range: &Range<u64>, block: u64) -> (Vec<Section>, u64) {
    let (mut sections, mut blocks, mut at) = (Vec::new(), 0, range.start);
    let mut add = |records: Range<u64>, radius: Option<f64>| {
        let first_block = blocks;
        blocks += (records.end - records.start).div_ceil(block);
        sections.push(Section { records, first_block, radius });
    };
    let is_within = |crowd: &&Crowd| range.start <= crowd.records.start && crowd.records.end <= range.end;
    for crowd in crowds.iter().filter(is_within) {
        if at < crowd.records.start {
            add(at..crowd.records.start, None);
        }
        add(crowd.records.clone(), Some(crowd.radius()));
        at = crowd.records.end;
    }
    if at < range.end {
        add(at..range.end, None);
    }
    (sections, blocks)
}

impl Curve<'_> {
    /// Measures the radii that the neighbours of the records of a range suggest, 0 where they suggest none. `store` is given
    /// those of some records, by any thread; then `pass` is, in the order of the curve. No crowd may be partly in the range.
    pub(super) fn measure(
        &self,
        context: &Context<'_>,
        scale: f64,
        range: &Range<u64>,
        store: impl Fn(&Range<u64>, &[f64]) -> Result<(), BuildError> + Sync,
        mut pass: impl FnMut(&[f64]) -> Result<(), BuildError>,
    ) -> Result<Measured, BuildError> {
        let threads = context.options.threads.max(1);
        // A block needs memory for its records, their positions and distances, and as much again for records elsewhere.
        let per_record = (self.stride + 24 + 8 * 9 + 16) as u64;
        let block = context.options.memory_bytes / 3 / (threads as u64 + 2) / per_record;
        let block = block.clamp(512, MOST_IN_BLOCK) / STRETCH as u64 * STRETCH as u64;
        let mut measured = Measured::default();
        let (sections, blocks) = sections(&self.crowds, range, block);
        let work = |number: usize| {
            let section = sections.partition_point(|section| section.first_block <= number as u64) - 1;
            let Section { records, first_block, radius } = &sections[section];
            let first = records.start + (number as u64 - first_block) * block;
            let range = first..(first + block).min(records.end);
            let radii = match radius {
                Some(radius) => vec![scale * radius; (range.end - range.start) as usize],
                None => self.measure_block(context, &range, scale)?,
            };
            store(&range, &radii)?;
            Ok(radii)
        };
        let count = range.end - range.start;
        let mut done = count;
        pipeline::ordered(blocks as usize, threads, work, |_, radii| {
            radii.iter().for_each(|&radius| measured.count(radius));
            done += radii.len() as u64;
            context.progress(Stage::Spacing, done / 2, count);
            pass(&radii)
        })?;
        Ok(measured)
    }

    /// Measures the radii of a block.
    fn measure_block(
        &self,
        context: &Context<'_>,
        block: &Range<u64>,
        scale: f64,
    ) -> Result<Vec<f64>, BuildError> {
        let mut bytes = Vec::new();
        self.read(context, block, &mut bytes)?;
        let mut points = Stretches::default();
        bytes.chunks_exact(self.stride).for_each(|record| points.push(record::position(record)));
        drop(bytes);
        let mut search = Search::among(&points, || !context.is_cancelled());
        context.check()?;
        self.search_elsewhere(context, block, &mut search)?;
        let radius = |distance: f64| {
            if distance.is_finite() { RADII_PER_DISTANCE * scale * distance } else { 0.0 }
        };
        Ok(search.distances().map(radius).collect())
    }

    /// Looks for neighbours outside of the block that is searched for.
    fn search_elsewhere(
        &self,
        context: &Context<'_>,
        block: &Range<u64>,
        search: &mut Search<'_>,
    ) -> Result<(), BuildError> {
        let (bounds, reach) = search.extent();
        let boxes = &self.boxes.boxes;
        let mut near: Vec<(f64, usize)> = (boxes.iter().enumerate())
            .map(|(number, other)| (square_between(&bounds, other), number))
            .filter(|&(square, number)| {
                let range = self.boxes.records(number);
                square < reach && !(block.start <= range.start && range.end <= block.end)
            })
            .collect();
        // The nearest first: what is found there makes the others too far away.
        near.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let (mut bytes, mut others) = (Vec::new(), Stretches::default());
        for (_, number) in near {
            if !search.reaches(&boxes[number]) {
                continue;
            }
            let records = self.boxes.records(number);
            for first in records.clone().step_by(GRAIN as usize) {
                let piece = first..(first + GRAIN).min(records.end);
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

    /// Reads records.
    pub(super) fn read(
        &self,
        context: &Context<'_>,
        range: &Range<u64>,
        bytes: &mut Vec<u8>,
    ) -> Result<(), BuildError> {
        context.check()?;
        bytes.resize((range.end - range.start) as usize * self.stride, 0);
        let at = range.start * self.stride as u64;
        self.spill.read_at(bytes, at).map_err(context.io("read temporary files in"))
    }
}
