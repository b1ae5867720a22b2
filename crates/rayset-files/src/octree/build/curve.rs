//! Records along the Hilbert curve, and what their neighbours say of the radii and shapes of their
//! points.
//!
//! Points with equal coordinates are one place. Their records follow each other, for records of one
//! Hilbert code are sorted by their bytes, and those begin with the coordinates. Only the first
//! record of a place counts as a neighbour.

use std::ops::Range;

use super::context::Context;
use super::control::Stage;
use super::error::BuildError;
use super::neighbourhood::{OfPlace, Suggested};
use super::neighbours::{FOR_DISTANCE, FOR_FLUID, FOR_SHAPE, STRETCH, Search, Stretches, square_between};
use super::record::{self, KeyMaker};
use super::shapes_of::ShapesOf;
use super::typical::Measured;
use crate::octree::pipeline;
use rayset_base::geometry::{Aabb, DVec3};
use rayset_store::spill::Spill;

/// Chosen by measurement (docs/benchmarks.md, "Automatic radii and shapes"): a compromise of a thin
/// surface and one without pores.
const RADII_PER_DISTANCE: f64 = 0.85;
/// Number of records that share a box, if there is memory for so many boxes.
pub(super) const GRAIN: u64 = 256;
/// Largest number of records in a block.
const MOST_IN_BLOCK: u64 = 1 << 15;
/// More places than this with one Hilbert code are a crowd, and so are more records at one place.
const CROWD: u64 = 8192;

/// Largest number of boxes for which there is memory.
pub(super) fn most_boxes(memory_bytes: u64) -> usize {
    memory_bytes as usize / 16 / size_of::<Aabb>()
}

/// Records that share a Hilbert code, which happens where a cloud is a million times as wide as a
/// part of it, or where many points coincide.
#[derive(Clone)]
pub(super) struct Crowd {
    pub(super) records: Range<u64>,
    code: u64,
    pub(super) bounds: Aabb,
    /// Number of its places.
    pub(super) places: u64,
}

impl Crowd {
    pub(super) fn new(records: Range<u64>, bounds: Aabb, places: u64) -> Self {
        Self { records, code: u64::MAX, bounds, places }
    }

    fn way(&self) -> Way {
        if self.places == 1 {
            return Way::OnePlace;
        }
        let radius = 0.75 * self.bounds.size().max_element() / (self.places as f64).sqrt();
        Way::Spread { radius, places: self.places }
    }
}

/// How the radii of a section are found.
#[derive(Clone, Copy)]
enum Way {
    /// By the neighbours of each place.
    EachPlace,
    /// By the neighbours of the only place.
    OnePlace,
    /// As if its places were spread over a square. The radius is the one before scaling.
    Spread { radius: f64, places: u64 },
}

/// Consecutive records that are measured in the same way, in blocks.
struct Section {
    records: Range<u64>,
    first_block: u64,
    way: Way,
}

/// What is measured of a block.
struct BlockMeasures {
    of_records: Vec<OfPlace>,
    /// Of places that begin in the block, and of how many places each is.
    of_places: Vec<OfPlace>,
    times: u64,
}

/// What is kept of records in the order of the curve: boxes around each `grain` of them, and
/// crowds.
pub(super) struct Sketch {
    keys: KeyMaker,
    /// The records with the latest code.
    latest: Crowd,
    /// The position of the latest record.
    place: Option<DVec3>,
    record: Vec<u8>,
    /// Records that are equal to the one before.
    pub(super) copies: u64,
    pub(super) crowds: Vec<Crowd>,
    pub(super) count: u64,
    pub(super) boxes: Vec<Aabb>,
    pub(super) grain: u64,
    most_boxes: usize,
}

impl Sketch {
    /// Boxes are of `grain` records at first, and of twice as many whenever there would be more
    /// than `most_boxes`.
    pub(super) fn new(keys: KeyMaker, grain: u64, most_boxes: usize) -> Self {
        Self {
            keys,
            latest: Crowd::new(0..0, Aabb::EMPTY, 0),
            place: None,
            record: Vec::new(),
            copies: 0,
            crowds: Vec::new(),
            count: 0,
            boxes: Vec::new(),
            grain,
            most_boxes,
        }
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
            self.latest = Crowd { code, ..Crowd::new(self.count..self.count, Aabb::EMPTY, 0) };
        }
        let begins = self.place != Some(position);
        self.copies += u64::from(!begins && self.record == record);
        self.record.clear();
        self.record.extend_from_slice(record);
        self.latest.places += u64::from(begins);
        self.place = Some(position);
        self.count += 1;
        self.latest.records.end = self.count;
        self.latest.bounds.include(position);
    }

    /// Ends the records with the latest code, which are a crowd if their places are many, or they
    /// are many at one place.
    pub(super) fn end_crowd(&mut self) {
        let ended = std::mem::replace(&mut self.latest, Crowd::new(0..0, Aabb::EMPTY, 0));
        let records = ended.records.end - ended.records.start;
        if ended.places > CROWD || (ended.places == 1 && records > CROWD) {
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
    /// Appends the boxes of `count` records, each of `grain` of them, which is the same for all
    /// stretches.
    pub(super) fn push(&mut self, boxes: &[Aabb], grain: u64, count: u64) {
        self.stretches.push((self.boxes.len(), self.count));
        self.boxes.extend_from_slice(boxes);
        self.grain = grain;
        self.count += count;
    }

    /// The point that a box consists of, if its records are at one place.
    fn only_place(&self, number: usize) -> Option<DVec3> {
        let bounds = self.boxes.get(number)?;
        (bounds.min == bounds.max).then_some(bounds.min)
    }

    /// Whether no place begins in a box, because all of its records and those of the box before are
    /// at one place.
    fn goes_on(&self, number: usize) -> bool {
        let before = number.checked_sub(1).and_then(|before| self.only_place(before));
        before.is_some() && before == self.only_place(number)
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
    pub(super) shapes_of: ShapesOf,
}

/// Crowds and what lies between them, within a range, of blocks of at most `block` records; and the
/// number of blocks.
fn sections(crowds: &[Crowd], range: &Range<u64>, block: u64) -> (Vec<Section>, u64) {
    let (mut sections, mut blocks, mut at) = (Vec::new(), 0, range.start);
    let mut add = |records: Range<u64>, way: Way| {
        let first_block = blocks;
        blocks += (records.end - records.start).div_ceil(block);
        sections.push(Section { records, first_block, way });
    };
    let is_within = |crowd: &&Crowd| range.start <= crowd.records.start && crowd.records.end <= range.end;
    for crowd in crowds.iter().filter(is_within) {
        if at < crowd.records.start {
            add(at..crowd.records.start, Way::EachPlace);
        }
        add(crowd.records.clone(), crowd.way());
        at = crowd.records.end;
    }
    if at < range.end {
        add(at..range.end, Way::EachPlace);
    }
    (sections, blocks)
}

impl Curve<'_> {
    /// Measures what the neighbours of the records of a range suggest. `store` is given that of
    /// some records, by any thread; then `pass` is, in the order of the curve. No crowd may be
    /// partly in the range.
    pub(super) fn measure(
        &self,
        context: &Context<'_>,
        scale: f64,
        range: &Range<u64>,
        store: impl Fn(&Range<u64>, &[OfPlace]) -> Result<(), BuildError> + Sync,
        pass: impl FnMut(&[OfPlace]) -> Result<(), BuildError>,
    ) -> Result<Measured, BuildError> {
        match self.shapes_of {
            ShapesOf::Nothing => self.measure_by::<FOR_DISTANCE>(context, scale, range, store, pass),
            ShapesOf::Surfaces => self.measure_by::<FOR_SHAPE>(context, scale, range, store, pass),
            ShapesOf::Fluid => self.measure_by::<FOR_FLUID>(context, scale, range, store, pass),
        }
    }

    /// The same by `LEN` neighbours.
    fn measure_by<const LEN: usize>(
        &self,
        context: &Context<'_>,
        scale: f64,
        range: &Range<u64>,
        store: impl Fn(&Range<u64>, &[OfPlace]) -> Result<(), BuildError> + Sync,
        mut pass: impl FnMut(&[OfPlace]) -> Result<(), BuildError>,
    ) -> Result<Measured, BuildError> {
        let threads = context.options.threads.max(1);
        // A block needs memory for its records, their positions and distances, and as much again
        // for records elsewhere.
        let of_place = Search::<LEN>::POINT_BYTES + 2 * size_of::<OfPlace>();
        let per_record = (self.stride + 24 + of_place + 12) as u64;
        let block = context.options.memory_bytes / 3 / (threads as u64 + 2) / per_record;
        let block = block.clamp(512, MOST_IN_BLOCK) / STRETCH as u64 * STRETCH as u64;
        let mut measured = Measured::default();
        let (sections, blocks) = sections(&self.crowds, range, block);
        let work = |number: usize| {
            let section = sections.partition_point(|section| section.first_block <= number as u64) - 1;
            let Section { records, first_block, way } = &sections[section];
            let first = records.start + (number as u64 - first_block) * block;
            let range = first..(first + block).min(records.end);
            let begins = first == records.start;
            let all_of = |place: OfPlace, times: u64| BlockMeasures {
                of_records: vec![place; (range.end - range.start) as usize],
                of_places: if begins { vec![place] } else { Vec::new() },
                times,
            };
            let measures = match way {
                Way::EachPlace => self.measure_block::<LEN>(context, &range, scale)?,
                Way::OnePlace => {
                    let first = records.start..records.start + 1;
                    let one = self.measure_block::<LEN>(context, &first, scale)?;
                    all_of(one.of_records.first().copied().unwrap_or(OfPlace::ball(0.0)), 1)
                }
                Way::Spread { radius, places } => all_of(OfPlace::ball(scale * radius), *places),
            };
            store(&range, &measures.of_records)?;
            Ok(measures)
        };
        let count = range.end - range.start;
        let mut done = count;
        pipeline::ordered(blocks as usize, threads, work, |_, measures| {
            measures.of_places.iter().for_each(|place| measured.count(place, measures.times));
            done += measures.of_records.len() as u64;
            context.progress(Stage::Spacing, done / 2, count);
            pass(&measures.of_records)
        })?;
        Ok(measured)
    }

    /// Measures the places of a block.
    fn measure_block<const LEN: usize>(
        &self,
        context: &Context<'_>,
        block: &Range<u64>,
        scale: f64,
    ) -> Result<BlockMeasures, BuildError> {
        let (mut bytes, mut points) = (Vec::new(), Stretches::default());
        let mut place_of_record = Vec::with_capacity((block.end - block.start) as usize);
        // The first place, if it began before the block.
        let mut continued = None;
        self.each(context, block, &mut bytes, |index, position, begins| {
            if index == block.start && !begins {
                continued = Some(position);
            }
            if index == block.start || begins {
                points.push(position);
            }
            place_of_record.push(points.len() as u32 - 1);
        })?;
        drop(bytes);
        let mut search = Search::<LEN>::among(&points, || !context.is_cancelled());
        context.check()?;
        self.search_elsewhere(context, block, continued, &mut search)?;
        let radius = |distance: f64| {
            if distance.is_finite() { RADII_PER_DISTANCE * scale * distance } else { 0.0 }
        };
        let suggest = |near: &[[f32; 3]]| self.shapes_of.by_neighbours(near);
        let of_place = |(distance, near): (f64, Option<&[[f32; 3]]>)| OfPlace {
            radius: radius(distance),
            suggested: near.map_or(Suggested::NOTHING, suggest),
        };
        let mut of_places: Vec<OfPlace> = search.found().map(of_place).collect();
        let of_records = place_of_record.into_iter().map(|place| of_places[place as usize]).collect();
        if continued.is_some() {
            of_places.remove(0);
        }
        Ok(BlockMeasures { of_records, of_places, times: 1 })
    }

    /// Looks for neighbours outside of the block that is searched for. `continued` is its first
    /// place, if that began before.
    fn search_elsewhere<const LEN: usize>(
        &self,
        context: &Context<'_>,
        block: &Range<u64>,
        continued: Option<[f64; 3]>,
        search: &mut Search<'_, LEN>,
    ) -> Result<(), BuildError> {
        let (bounds, reach) = search.extent();
        let boxes = &self.boxes.boxes;
        let mut near: Vec<(f64, usize)> = (boxes.iter().enumerate())
            .map(|(number, other)| (square_between(&bounds, other), number))
            .filter(|&(square, number)| {
                let range = self.boxes.records(number);
                let is_within = block.start <= range.start && range.end <= block.end;
                Search::<LEN>::is_within(square, reach) && !is_within && !self.boxes.goes_on(number)
            })
            .collect();
        // The nearest first: what is found there makes the others too far away.
        near.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let (mut bytes, mut others) = (Vec::new(), Stretches::default());
        for (_, number) in near {
            if !search.reaches(&boxes[number]) {
                continue;
            }
            let mut records = self.boxes.records(number);
            if self.boxes.only_place(number).is_some() {
                records.end = records.start + 1;
            }
            for first in records.clone().step_by(GRAIN as usize) {
                let piece = first..(first + GRAIN).min(records.end);
                if block.start <= piece.start && piece.end <= block.end {
                    continue;
                }
                others.clear();
                self.each(context, &piece, &mut bytes, |index, position, begins| {
                    if begins && !block.contains(&index) && continued != Some(position) {
                        others.push(position);
                    }
                })?;
                search.extend(&others);
            }
        }
        Ok(())
    }

    /// Reads records, and passes on the number and the position of each, and whether a place begins
    /// with it.
    fn each(
        &self,
        context: &Context<'_>,
        range: &Range<u64>,
        bytes: &mut Vec<u8>,
        mut visit: impl FnMut(u64, [f64; 3], bool),
    ) -> Result<(), BuildError> {
        let first = range.start.saturating_sub(1);
        self.read(context, &(first..range.end), bytes)?;
        let mut before = None;
        for (index, record) in (first..).zip(bytes.chunks_exact(self.stride)) {
            let position = record::position(record);
            if index >= range.start {
                visit(index, position, before != Some(position));
            }
            before = Some(position);
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
