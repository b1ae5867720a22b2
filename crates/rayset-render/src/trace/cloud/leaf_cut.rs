//! The cut through the cells of one leaf. It is the same for all packets of a picture: those of one
//! thread find it once.

use std::ops::Range;
use std::sync::Arc;

use super::parts::{NONE, NodePart, RecordRange, Seen, Walked};
use super::record_pages::RecordPages;
use crate::field::Sight;
use crate::lod::{LEAST_PART, part_of_cell, part_of_last_cell};
use crate::trace::access::Halt;
use rayset_base::bytes::list_bytes;
use rayset_base::geometry::Aabb;
use rayset_files::octree::aggregates::CellPlace;
use rayset_files::octree::layout::{DEEPEST_LEVEL, RUN_POINTS};
use rayset_files::octree::node::Node;

/// Records that are decoded together.
const GROUP: u32 = 32;

/// The cut through the cells of a leaf.
#[derive(Debug, Default)]
pub(super) struct LeafCut {
    /// Records that follow each other, of which some are seen, and the boxes that they reach in.
    pub(super) groups: Vec<(RecordRange, Aabb)>,
    /// By which parts they are.
    parts: Vec<f32>,
    /// The points that are not wholly seen as cells; `None` if that may be any.
    pub(super) left: Option<Left>,
    /// The cells that have some of these, level by level.
    pub(super) levels: Vec<Covers>,
    /// How many records were looked at.
    walked: u32,
}

/// Points of a leaf that are left, by their numbers: ranges that have nothing in common.
#[derive(Clone, Debug, Default)]
pub(super) struct Left(Vec<(u32, u32)>);

impl Left {
    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Whether some of so many points from one on are left.
    pub(super) fn has_some_of(&self, first: u32, count: u32) -> bool {
        let at = self.0.partition_point(|&(_, end)| end <= first);
        self.0.get(at).is_some_and(|&(begin, _)| begin < first + count)
    }
}

/// The cells of a leaf at a level, by their points, of which records follow each other.
#[derive(Debug)]
pub(super) struct Covers {
    pub(super) first_record: u32,
    pub(super) level: u8,
    /// Points with larger radii are not in the records.
    pub(super) edge: f64,
    pub(super) cells: Vec<Cover>,
    /// If points are left of cells that are not divided, the area that a unit of the mass of each
    /// takes of the light, not a number of others, and its colour; otherwise none.
    pub(super) of_mass: Vec<(f64, [f32; 3])>,
}

/// A cell that stands for a part of some points.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cover {
    /// The number of its first point, and how many more it has.
    pub(super) from: u32,
    more: u16,
    /// The part of its points for which it stands.
    pub(super) part: f32,
}

impl Cover {
    /// One past the number of its last point.
    pub(super) fn end(&self) -> u32 {
        self.from + u32::from(self.more) + 1
    }
}

/// The cells of a leaf at a level: records that follow each other.
#[derive(Clone, Copy, Debug)]
struct CellLevel {
    first: u32,
    end: u32,
    level: u8,
    edge: f64,
    /// The part of their points for which those that are divided stand, and others.
    part: f32,
    part_of_last: f32,
    /// Whether points of those that are not divided are left.
    leaves_points: bool,
}

impl CellLevel {
    /// The part for which a cell stands.
    fn part_of(&self, cell: &CellPlace) -> f32 {
        if cell.cells == 0 { self.part_of_last } else { self.part }
    }
}

impl LeafCut {
    /// Of a leaf that has a record, of which a part is left: level by level, until cells stand for
    /// all of its points.
    fn find(
        seen: Seen<'_>,
        pages: &mut RecordPages<'_>,
        (node, part): (&Node, NodePart),
        walked: &mut Walked,
    ) -> Result<Self, Halt> {
        let mut cut = Self::default();
        let place = pages.place(part.record, node.level)?;
        let pixel = seen.sight.pixel_at(place.centroid);
        let seen_part = |part: f32| if f64::from(part) > LEAST_PART { part } else { 0.0 };
        let (mut ranges, mut left, mut some_larger) = (Left::default(), part.rest, false);
        let (mut first, mut end, mut level) = (part.record, part.record + 1, node.level);
        while f64::from(left) > LEAST_PART
            && level < DEEPEST_LEVEL
            && let Some((first_child, last_child)) = children_of(seen, pages, (first..end, level), walked)?
        {
            (first, end, level) = (first_child, last_child, level + 1);
            // Each cell has a point of its own.
            if (end - first) as usize > node.own.runs as usize * RUN_POINTS {
                return Err(seen.cloud.broken(seen.cloud.first_record_page()).into());
            }
            let edge = seen.edge(level);
            let here = seen_part(left * part_of_cell(edge, pixel) as f32);
            let of_last = seen_part(left * part_of_last_cell(edge, pixel) as f32);
            let leaves_points = seen_part(left - of_last) > 0.0;
            left = seen_part(left - here);
            if of_last > 0.0 || leaves_points {
                let cells =
                    CellLevel { first, end, level, edge, part: here, part_of_last: of_last, leaves_points };
                cut.add(seen, pages, cells, (&mut ranges, walked))?;
            }
            // Those that are in no record are in no range.
            some_larger |= f64::from(node.radius_max) > edge;
        }
        ranges.0.sort_unstable();
        cut.left = (!some_larger).then_some(ranges);
        if cut.left.as_ref().is_some_and(Left::is_empty) {
            cut.levels.clear();
        }
        Ok(cut)
    }

    /// Adds the cells of a level in groups, and the points of those that are not divided to those
    /// that are left.
    fn add(
        &mut self,
        seen: Seen<'_>,
        pages: &mut RecordPages<'_>,
        cells: CellLevel,
        (left, walked): (&mut Left, &mut Walked),
    ) -> Result<(), Halt> {
        let mut covers = Covers {
            first_record: cells.first,
            level: cells.level,
            edge: cells.edge,
            cells: Vec::with_capacity((cells.end - cells.first).min(GROUP) as usize),
            of_mass: Vec::new(),
        };
        let mut first = cells.first;
        while first < cells.end {
            let count = GROUP.min(cells.end - first).min(pages.left_in_page(first));
            walked.add(seen.cloud, pages, count)?;
            let (mut bounds, parts) = (Aabb::EMPTY, self.parts.len() as u32);
            for record in first..first + count {
                let place = pages.place(record, cells.level)?;
                let part = cells.part_of(&place);
                if part > 0.0 {
                    bounds = bounds.union(seen.lod.around(&place, seen.sight));
                }
                self.parts.push(part);
                let cover = Cover { from: place.first_point.into(), more: place.more_points, part };
                covers.cells.push(cover);
                if cells.leaves_points {
                    let is_last = place.cells == 0;
                    covers.of_mass.push(match is_last {
                        true => seen.lod.decoder.of_mass(&pages.record(record, cells.level)?),
                        false => (f64::NAN, [0.0; 3]),
                    });
                    left.0.extend(is_last.then_some((cover.from, cover.end())));
                }
            }
            if !bounds.is_empty() {
                self.groups
                    .push((RecordRange { first, count: count as u16, level: cells.level, parts }, bounds));
            }
            first += count;
        }
        self.levels.push(covers);
        Ok(())
    }

    /// The parts of some of its records.
    pub(super) fn parts_of(&self, range: &RecordRange) -> &[f32] {
        let first = range.parts as usize;
        &self.parts[first..first + usize::from(range.count)]
    }

    fn bytes(&self) -> usize {
        let of_level = |covers: &Covers| list_bytes(&covers.cells) + list_bytes(&covers.of_mass);
        let lists: usize = self.levels.iter().map(of_level).sum();
        let left = self.left.as_ref().map_or(0, |left| list_bytes(&left.0));
        lists + left + list_bytes(&self.levels) + list_bytes(&self.groups) + list_bytes(&self.parts)
    }
}

/// The records below those of a range of cells, which follow each other.
fn children_of(
    seen: Seen<'_>,
    pages: &mut RecordPages<'_>,
    (cells, level): (Range<u32>, u8),
    walked: &mut Walked,
) -> Result<Option<(u32, u32)>, Halt> {
    let mut with_children = |cells: &mut dyn Iterator<Item = u32>| loop {
        let Some(cell) = cells.next() else { return Ok(None) };
        walked.add(seen.cloud, pages, 1)?;
        let place = pages.place(cell, level)?;
        if place.cells != 0 {
            return Ok::<_, Halt>(Some(place));
        }
    };
    let Some(first) = with_children(&mut cells.clone())? else { return Ok(None) };
    let Some(last) = with_children(&mut cells.rev())? else { return Ok(None) };
    let end = last.first_child.saturating_add(last.children());
    Ok((end > first.first_child).then_some((first.first_child, end)))
}

/// For which leaf a cut is: all that it follows from.
#[derive(Clone, Copy, PartialEq)]
struct Key {
    cloud: usize,
    own: (u32, u16),
    level: u8,
    radius_max: f32,
    record: u32,
    part: (f32, f32),
    sight: Sight,
}

/// Sets of cuts, by the place of the leaf, so that few are looked through.
const SETS: usize = 8;

/// Cuts that a thread has found, of which the one of a set that has not been used for longest goes
/// first.
#[derive(Default)]
pub(super) struct LeafCuts {
    sets: [Set; SETS],
    /// Bytes that may be kept besides [`BYTES`](Self::BYTES).
    more: usize,
}

#[derive(Default)]
struct Set {
    /// In the order of their last use.
    kept: Vec<(Key, usize, Arc<LeafCut>)>,
    bytes: usize,
}

impl Set {
    /// Forgets cuts until no more than so many bytes are kept.
    fn shrink(&mut self, most: usize) {
        while self.bytes > most && !self.kept.is_empty() {
            self.bytes -= self.kept.remove(0).1;
        }
    }
}

impl LeafCuts {
    /// The most bytes that are kept, unless there is room for more.
    pub(super) const BYTES: usize = 384 << 10;

    /// Gives it so many more bytes.
    pub(super) fn set_more(&mut self, bytes: usize) {
        self.more = bytes;
        let most = (Self::BYTES + bytes) / SETS;
        self.sets.iter_mut().for_each(|set| set.shrink(most));
    }

    /// The cut through a leaf, of which some points are left behind its own record.
    pub(super) fn of(
        &mut self,
        (cloud, seen): (usize, Seen<'_>),
        pages: &mut RecordPages<'_>,
        (node, part): (&Node, NodePart),
        walked: &mut Walked,
    ) -> Result<Option<Arc<LeafCut>>, Halt> {
        if node.child_mask != 0 || part.record == NONE || !(part.rest > 0.0) {
            return Ok(None);
        }
        // A leaf that is not divided has no cells.
        if pages.place(part.record, node.level)?.cells == 0 {
            return Ok(None);
        }
        let own = (node.own.first_page, node.own.first_run);
        let (level, radius_max, sight) = (node.level, node.radius_max, *seen.sight);
        let key =
            Key { cloud, own, level, radius_max, record: part.record, part: (part.whole, part.rest), sight };
        let most = (Self::BYTES + self.more) / SETS;
        let set = &mut self.sets[(own.0 as usize + usize::from(own.1 / 16)) % SETS];
        if let Some(at) = set.kept.iter().rposition(|(kept, ..)| *kept == key) {
            let last = set.kept.len() - 1;
            set.kept[at..=last].rotate_left(1);
            let kept = set.kept[last].2.clone();
            // As if it had been found now: whether a packet looks at too many must not depend on
            // what was kept.
            walked.add(seen.cloud, pages, kept.walked)?;
            return Ok(Some(kept));
        }
        let before = *walked;
        let mut found = LeafCut::find(seen, pages, (node, part), walked)?;
        found.walked = walked.since(before);
        let found = Arc::new(found);
        let bytes = size_of::<(Key, usize, Arc<LeafCut>)>() + size_of::<LeafCut>() + found.bytes();
        if bytes <= most {
            set.shrink(most - bytes);
            set.bytes += bytes;
            set.kept.push((key, bytes, found.clone()));
        }
        Ok(Some(found))
    }
}
