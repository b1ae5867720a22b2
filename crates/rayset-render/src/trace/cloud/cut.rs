//! The cut through a cloud for one packet: which part of each node and of each cell of a leaf is
//! seen in place of its points. It is a function of the view and of the file alone, whatever packet
//! asks.

use std::sync::Arc;

use super::leaf_cut::{LeafCut, LeafCuts};
use super::parts::{NONE, NodePart, RecordRange, Seen, Walked};
use super::record_pages::RecordPages;
use crate::lod::{LEAST_PART, part_of_cell, part_of_last_cell};
use crate::trace::access::Halt;
use rayset_base::geometry::Aabb;
use rayset_files::octree::node::Node;

/// How much of a node's points is seen.
#[derive(Clone, Copy, Debug)]
pub(super) enum NodeCut {
    /// Every point, as a density.
    Whole,
    Part(NodePart),
}

impl NodeCut {
    /// What is seen of a node: every point where all are at least two pixels in radius, as their
    /// cells are then, too.
    pub(super) fn of(seen: Seen<'_>, node: &Node, part: NodePart) -> Self {
        let largest = || seen.sight.largest_pixel_in(&node.bounds(seen.cloud.root_cell));
        let is_whole = part.rest == 1.0 && f64::from(node.detail_min) >= 2.0 * largest();
        if is_whole { Self::Whole } else { Self::Part(part) }
    }
}

/// Points of one node that are seen in parts.
#[derive(Clone, Debug)]
pub(super) struct PointsOfNode {
    pub(super) part: NodePart,
    /// Edge of its cell.
    pub(super) edge: f64,
    /// Of a leaf, the cells below it, until all is passed.
    pub(super) leaf: Option<Arc<LeafCut>>,
    /// The last tick that its points may reach.
    pub(super) last: u64,
}

/// What is kept of the cut for a packet.
#[derive(Default)]
pub(super) struct Cut {
    pub(super) nodes: Vec<PointsOfNode>,
    parts: Vec<f32>,
    walked: Walked,
    /// Of the node that is opened, its children.
    children: Vec<NodePart>,
    met: usize,
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

    /// Forgets the cells of leaves to which no ray comes any more: a packet goes through many.
    pub(super) fn pass(&mut self, since: u64) {
        self.nodes.iter_mut().filter(|of| of.last < since).for_each(|of| of.leaf = None);
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
        self.walked.add(seen.cloud, pages, 1)?;
        let place = pages.place(record, level)?;
        let pixel = seen.sight.pixel_at(place.centroid);
        let is_last = place.children() == 0;
        let part_of = if is_last { part_of_last_cell } else { part_of_cell };
        let own = above.rest * part_of(seen.edge(level), pixel) as f32;
        let rest = above.rest - own;
        let rest = if f64::from(rest) > LEAST_PART { rest } else { 0.0 };
        Ok(NodePart { record, nearest: (record, level), whole: above.rest, rest })
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
                // A number that is none is refused.
                let own = record;
                record = record.saturating_add(1);
                self.of_record(seen, pages, (own, node.level + 1), part)?
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

    /// The cells of a leaf whose part is known, of which some points are left behind its own
    /// record. Calls `see` with those that are seen, in groups, and the box that these reach in.
    pub(super) fn cells(
        &mut self,
        leaves: &mut LeafCuts,
        (cloud, seen): (usize, Seen<'_>),
        pages: &mut RecordPages<'_>,
        (node, part): (&Node, NodePart),
        mut see: impl FnMut(RecordRange, &Aabb) -> bool,
    ) -> Result<Option<Arc<LeafCut>>, Halt> {
        let leaf = leaves.of((cloud, seen), pages, (node, part), &mut self.walked)?;
        if let Some(leaf) = &leaf {
            for (range, bounds) in &leaf.groups {
                if see(RecordRange { parts: self.parts.len() as u32, ..*range }, bounds) {
                    self.parts.extend(leaf.parts_of(range));
                }
            }
        }
        Ok(leaf)
    }
}
