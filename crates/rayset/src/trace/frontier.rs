//! The part of the octree that a packet has not yet passed, nearest first.
//!
//! A node is opened only when the packet's slab reaches it, so nothing behind an opaque surface is ever asked for;
//! and each node is opened once a packet, however many slabs there are.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use super::RenderError;
use super::world::World;
use crate::field::Packet;
use crate::octree::format::NodeRef;
use crate::octree::node::{Node, NodePage, RunRange};
use crate::octree::page::PointPage;

/// Priority of node pages: every packet needs the upper ones.
pub(super) const NODE_PRIORITY: u8 = 255;
/// Priority of point pages that samples wait for.
pub(super) const POINT_PRIORITY: u8 = 200;

#[derive(Clone, Copy, Debug)]
enum Item {
    /// Its record has been seen; its children and points have not.
    Node(Node),
    Run {
        page: u32,
        run: u16,
    },
}

#[derive(Clone, Copy, Debug)]
struct Entry {
    first: u64,
    last: u64,
    item: Item,
}

impl PartialEq for Entry {
    fn eq(&self, other: &Self) -> bool {
        self.first == other.first
    }
}
impl Eq for Entry {}
impl PartialOrd for Entry {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}
impl Ord for Entry {
    /// The heap yields its greatest entry, so nearer is greater. Ties may come in any order: runs are sorted again
    /// before they are used.
    fn cmp(&self, other: &Self) -> Ordering {
        other.first.cmp(&self.first)
    }
}

/// A run that some sample of the packet may need.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct ActiveRun {
    pub(super) page: u32,
    pub(super) run: u16,
    /// Last sample that it may reach.
    pub(super) last: u64,
}

/// Nodes and runs ahead of a packet.
#[derive(Default)]
pub(super) struct Frontier {
    heap: BinaryHeap<Entry>,
}

impl Frontier {
    /// Starts again at the root.
    pub(super) fn begin(&mut self, world: &World<'_>, packet: &Packet) -> Result<(), RenderError> {
        self.heap.clear();
        if let Some(root) = world.root()? {
            self.push_node(world, packet, root);
        }
        Ok(())
    }

    /// The first sample that anything ahead may reach.
    pub(super) fn next_sample(&self) -> Option<u64> {
        self.heap.peek().map(|e| e.first)
    }

    /// Opens everything that samples before `end` may need and moves its runs to `active`.
    pub(super) fn advance(
        &mut self,
        world: &World<'_>,
        packet: &Packet,
        end: u64,
        active: &mut Vec<ActiveRun>,
    ) -> Result<(), RenderError> {
        while let Some(entry) = self.heap.peek().copied().filter(|e| e.first < end) {
            self.heap.pop();
            match entry.item {
                Item::Run { page, run } => active.push(ActiveRun { page, run, last: entry.last }),
                Item::Node(node) => {
                    self.open_own(world, packet, node.own)?;
                    self.open_children(world, packet, &node)?;
                }
            }
        }
        Ok(())
    }

    fn push_node(&mut self, world: &World<'_>, packet: &Packet, node: Node) {
        if let Some((first, last)) = packet.samples_in(&node.bounds(world.root_cell)) {
            self.heap.push(Entry { first, last, item: Item::Node(node) });
        }
    }

    fn open_children(&mut self, world: &World<'_>, packet: &Packet, node: &Node) -> Result<(), RenderError> {
        if node.child_mask == 0 {
            return Ok(());
        }
        let NodeRef { page, index } = node.first_child;
        let guard = world.retain(world.first_node_page + page, NODE_PRIORITY)?;
        let nodes = NodePage::trusted(&guard);
        for k in 0..node.child_mask.count_ones() as usize {
            let child = nodes.get(usize::from(index) + k).ok_or_else(|| world.broken(page))?;
            self.push_node(world, packet, child);
        }
        Ok(())
    }

    /// Looks at the bounds of a node's own runs. Their pages are needed for that, and soon again for the points.
    fn open_own(&mut self, world: &World<'_>, packet: &Packet, own: RunRange) -> Result<(), RenderError> {
        let (mut page, mut run, mut left) = (own.first_page, usize::from(own.first_run), own.runs as usize);
        while left > 0 {
            if page >= world.first_node_page {
                return Err(world.broken(page));
            }
            let guard = world.retain(page, POINT_PRIORITY)?;
            let points = PointPage::trusted(&guard, world.header);
            let here = left.min(points.len().saturating_sub(run));
            if here == 0 {
                return Err(world.broken(page));
            }
            for index in run..run + here {
                let head = points.head(index);
                let bounds = head.position_bounds(world.root_cell).inflated(f64::from(head.radius_max()));
                if let Some((first, last)) = packet.samples_in(&bounds) {
                    self.heap.push(Entry { first, last, item: Item::Run { page, run: index as u16 } });
                }
            }
            left -= here;
            (page, run) = (page + 1, 0);
        }
        Ok(())
    }
}
