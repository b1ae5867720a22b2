//! The cut through a cloud for one packet: which part of each node and of each cell of a leaf is
//! seen in place of its points. It is a function of the view and of the file alone, whatever packet
//! asks.

use std::ops::Range;

use super::lod::CloudLod;
use super::placement::CloudPlacement;
use super::record_pages::RecordPages;
use crate::field::Sight;
use crate::lod::{LEAST_PART, part_of_cell, part_of_last_cell};
use crate::trace::access::Halt;
use rayset_base::geometry::Aabb;
use rayset_files::octree::aggregates::CellPlace;
use rayset_files::octree::node::Node;

/// No record.
pub(super) const NONE: u32 = u32::MAX;
/// Records that are decoded together, of cells of a leaf.
const GROUP: u32 = 32;

/// How much of a node's points is seen.
#[derive(Clone, Copy, Debug)]
pub(super) enum NodeCut {
    /// Every point, as a density.
    Whole,
    Part(NodePart),
}

/// A node whose points may be seen as one.
#[derive(Clone, Copy, Debug)]
pub(super) struct NodePart {
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

/// Points of one node that are seen in parts.
#[derive(Clone, Debug)]
pub(super) struct PointsOfNode {
    pub(super) part: NodePart,
    /// Edge of its cell.
    pub(super) edge: f64,
    /// Of a leaf, the cells below it, level by level.
    pub(super) levels: Vec<CellLevel>,
    /// The points that are not wholly seen as cells; `None` if that may be any.
    pub(super) left: Option<Left>,
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

/// The cells of a leaf at a level: records that follow each other.
#[derive(Clone, Copy, Debug)]
pub(super) struct CellLevel {
    pub(super) first: u32,
    pub(super) end: u32,
    pub(super) level: u8,
    pub(super) edge: f64,
    /// The part of their points for which those that are divided stand, and others.
    pub(super) part: f32,
    pub(super) part_of_last: f32,
}

impl CellLevel {
    /// The part for which a cell stands.
    pub(super) fn part_of(&self, cell: &CellPlace) -> f32 {
        if cell.cells == 0 { self.part_of_last } else { self.part }
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

/// What is kept of the cut for a packet.
#[derive(Default)]
pub(super) struct Cut {
    pub(super) nodes: Vec<PointsOfNode>,
    parts: Vec<f32>,
    /// Records that were looked at.
    walked: u64,
    /// Of the node that is opened, its children.
    children: Vec<NodePart>,
    met: usize,
}

/// Where the cut is: a cloud as it is seen, in the cloud's space.
#[derive(Clone, Copy)]
pub(super) struct Seen<'a> {
    pub(super) cloud: &'a CloudPlacement,
    pub(super) lod: &'a CloudLod,
    pub(super) sight: &'a Sight,
}

impl Seen<'_> {
    fn edge(&self, level: u8) -> f64 {
        self.cloud.root_cell.size * 2_f64.powi(-i32::from(level))
    }
}

impl Cut {
    /// Forgets everything.
    pub(super) fn clear(&mut self) {
        *self = Self {
            nodes: std::mem::take(&mut self.nodes),
            parts: std::mem::take(&mut self.parts),
            ..Self::default()
        };
        self.nodes.clear();
        self.parts.clear();
    }

    /// The parts of some records.
    pub(super) fn parts_of(&self, range: RecordRange) -> &[f32] {
        let first = range.parts as usize;
        &self.parts[first..first + usize::from(range.count)]
    }

    /// The root is about to be met.
    pub(super) fn begin(&mut self, seen: Seen<'_>, pages: &mut RecordPages<'_>) -> Result<(), Halt> {
        let above = NodePart { record: NONE, nearest: (NONE, 0), whole: 1.0, rest: 1.0 };
        let root = self.of_record(seen, pages, (0, 0), above)?;
        self.children.clear();
        self.children.push(root);
        self.met = 0;
        Ok(())
    }

    /// The part of a node with this record and at this level, below another.
    fn of_record(
        &mut self,
        seen: Seen<'_>,
        pages: &mut RecordPages<'_>,
        (record, level): (u32, u8),
        above: NodePart,
    ) -> Result<NodePart, Halt> {
        self.walk(seen.cloud, pages, 1)?;
        let place = pages.place(record, level)?;
        let pixel = seen.sight.pixel_at(place.centroid);
        let is_last = place.children() == 0;
        let part_of = if is_last { part_of_last_cell } else { part_of_cell };
        let own = above.rest * part_of(seen.edge(level), pixel) as f32;
        let rest = above.rest - own;
        let rest = if f64::from(rest) > LEAST_PART { rest } else { 0.0 };
        Ok(NodePart { record, nearest: (record, level), whole: above.rest, rest })
    }

    /// Counts records that are about to be looked at: of a file that is whole, no packet comes to
    /// one more than a few times.
    fn walk(&mut self, cloud: &CloudPlacement, pages: &RecordPages<'_>, records: u64) -> Result<(), Halt> {
        self.walked += records;
        let most = 16 + 4 * u64::from(pages.records());
        if self.walked > most { Err(cloud.broken(cloud.first_record_page()).into()) } else { Ok(()) }
    }

    /// A node is opened: finds the parts of its children, which are then met one by one.
    pub(super) fn open(
        &mut self,
        seen: Seen<'_>,
        pages: &mut RecordPages<'_>,
        (node, part): (&Node, NodePart),
    ) -> Result<(), Halt> {
        self.children.clear();
        self.met = 0;
        let of_node = if part.record == NONE { None } else { Some(pages.place(part.record, node.level)?) };
        let mut record = of_node.map_or(0, |place| place.first_child);
        let mask = of_node.map_or(0, |place| place.child_mask);
        for rank in (0..8).filter(|rank| node.child_mask >> rank & 1 == 1) {
            let child = if mask >> rank & 1 == 1 {
                record += 1;
                self.of_record(seen, pages, (record - 1, node.level + 1), part)?
            } else {
                NodePart { record: NONE, nearest: part.nearest, whole: part.rest, rest: part.rest }
            };
            self.children.push(child);
        }
        Ok(())
    }

    /// A node is opened whose points are all seen, as are those of its children.
    pub(super) fn open_whole(&mut self) {
        self.children.clear();
        self.met = 0;
    }

    /// The part of the child that is met next, and whether it is the last; `None` if the parent's
    /// points are all seen.
    pub(super) fn meet(&mut self) -> Option<(NodePart, bool)> {
        let part = self.children.get(self.met).copied()?;
        self.met += 1;
        Some((part, self.met == self.children.len()))
    }

    /// The records of the children that were met last, if some are seen.
    pub(super) fn records_of_children(&mut self, level: u8) -> Option<RecordRange> {
        let with_record = self.children.iter().filter(|child| child.record != NONE);
        let first = with_record.clone().map(|child| child.record).next()?;
        let parts = self.parts.len() as u32;
        let known: Vec<f32> = with_record.map(NodePart::of_record).collect();
        if known.iter().all(|&part| f64::from(part) <= LEAST_PART) {
            return None;
        }
        self.parts.extend(&known);
        Some(RecordRange { first, count: known.len() as u16, level, parts })
    }

    /// The cells of a leaf, level by level, until they stand for all of its points; and those that
    /// are left, which may be any if some are larger than their cells. Calls `see` with those that
    /// are seen, in groups, and the box that these reach in.
    pub(super) fn cells(
        &mut self,
        seen: Seen<'_>,
        pages: &mut RecordPages<'_>,
        (node, part): (&Node, NodePart),
        mut see: impl FnMut(RecordRange, Aabb),
    ) -> Result<(Vec<CellLevel>, Option<Left>), Halt> {
        let place = pages.place(part.record, node.level)?;
        if place.cells == 0 {
            return Ok((Vec::new(), None));
        }
        let pixel = seen.sight.pixel_at(place.centroid);
        let (mut levels, mut left) = (Vec::new(), part.rest);
        let (mut ranges, mut some_larger) = (Left::default(), false);
        let (mut first, mut end, mut level) = (part.record, part.record + 1, node.level);
        while f64::from(left) > LEAST_PART
            && let Some((first_child, last_child)) =
                self.children_of(seen.cloud, pages, (first..end, level))?
        {
            (first, end, level) = (first_child, last_child, level + 1);
            let edge = seen.edge(level);
            let seen_part = |part: f32| if f64::from(part) > LEAST_PART { part } else { 0.0 };
            let here = seen_part(left * part_of_cell(edge, pixel) as f32);
            let of_last = seen_part(left * part_of_last_cell(edge, pixel) as f32);
            let cells = CellLevel { first, end, level, edge, part: here, part_of_last: of_last };
            let rest_of_last = seen_part(left - of_last);
            left = seen_part(left - here);
            levels.push(cells);
            if of_last > 0.0 || rest_of_last > 0.0 {
                let last = (rest_of_last > 0.0).then_some(&mut ranges.0);
                self.group_cells(seen, pages, cells, (&mut see, last))?;
                some_larger |= of_last > 0.0 && f64::from(node.radius_max) > edge;
            }
        }
        ranges.0.sort_unstable();
        Ok((levels, (!some_larger).then_some(ranges)))
    }

    /// The records below those of a range of cells, which follow each other.
    fn children_of(
        &mut self,
        cloud: &CloudPlacement,
        pages: &mut RecordPages<'_>,
        (cells, level): (Range<u32>, u8),
    ) -> Result<Option<(u32, u32)>, Halt> {
        let mut with_children = |mut cells: Box<dyn Iterator<Item = u32>>| loop {
            let Some(cell) = cells.next() else { return Ok(None) };
            self.walk(cloud, pages, 1)?;
            let place = pages.place(cell, level)?;
            if place.cells != 0 {
                return Ok::<_, Halt>(Some(place));
            }
        };
        let Some(first) = with_children(Box::new(cells.clone()))? else { return Ok(None) };
        let Some(last) = with_children(Box::new(cells.rev()))? else { return Ok(None) };
        let end = last.first_child.saturating_add(last.children());
        Ok((end > first.first_child).then_some((first.first_child, end)))
    }

    /// Goes through the cells of a level in groups; adds the points of those that are not divided
    /// to `last`.
    fn group_cells(
        &mut self,
        seen: Seen<'_>,
        pages: &mut RecordPages<'_>,
        cells: CellLevel,
        (see, mut last): (&mut impl FnMut(RecordRange, Aabb), Option<&mut Vec<(u32, u32)>>),
    ) -> Result<(), Halt> {
        let mut first = cells.first;
        while first < cells.end {
            let count = GROUP.min(cells.end - first).min(pages.left_in_page(first));
            self.walk(seen.cloud, pages, u64::from(count))?;
            let (mut bounds, parts) = (Aabb::EMPTY, self.parts.len() as u32);
            for record in first..first + count {
                let place = pages.place(record, cells.level)?;
                let part = cells.part_of(&place);
                if part > 0.0 {
                    bounds = bounds.union(seen.lod.around(&place, seen.sight));
                }
                self.parts.push(part);
                if let Some(last) = last.as_mut().filter(|_| place.cells == 0) {
                    let begin = u32::from(place.first_point);
                    last.push((begin, begin + u32::from(place.more_points) + 1));
                }
            }
            if !bounds.is_empty() {
                see(RecordRange { first, count: count as u16, level: cells.level, parts }, bounds);
            }
            first += count;
        }
        Ok(())
    }
}
