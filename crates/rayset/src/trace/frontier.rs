//! The part of the octree that a packet has not yet passed, nearest first.
//!
//! A node is opened only when a slab reaches it and rays that still go on may meet it, so nothing behind an opaque
//! surface is ever asked for; and each node is opened once a packet, however many slabs there are.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use super::access::{Access, Halt, NODE_PRIORITY, POINT_PRIORITY};
use crate::field::{Packet, RayColumns, SLAB_SAMPLES, SimdLevel};
use crate::geometry::{Aabb, Beam};
use crate::octree::format::NodeRef;
use crate::octree::node::{Node, NodePage, RunRange};
use crate::octree::page::PointPage;

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

/// A packet, and those of its rays that still go on.
pub(super) struct LiveRays<'a> {
    packet: &'a Packet,
    beam: Beam,
    /// Each ray by itself, where some have ended: the bound of the others may hold much that none of them meets.
    each: Option<RayColumns>,
}

impl<'a> LiveRays<'a> {
    pub(super) fn new(packet: &'a Packet, lanes: u64, simd: SimdLevel) -> Self {
        let each = (lanes != packet.all() && lanes != 0).then(|| RayColumns::new(simd, packet.rays(lanes)));
        Self { packet, beam: packet.beam(lanes), each }
    }

    /// The samples that may lie in a box, or nothing where none does.
    fn samples_in(&self, bounds: &Aabb) -> Option<(u64, u64)> {
        let samples = self.packet.samples_in(&self.beam, bounds)?;
        let met = self.each.as_ref().is_none_or(|rays| rays.cross(bounds, 0.0).near != 0);
        met.then_some(samples)
    }
}

/// Nodes and runs ahead of a packet.
#[derive(Default)]
pub(super) struct Frontier {
    heap: BinaryHeap<Entry>,
}

impl Frontier {
    /// Starts again at the root.
    pub(super) fn begin(&mut self, access: Access<'_>, rays: &LiveRays<'_>) -> Result<(), Halt> {
        self.heap.clear();
        if let Some(root) = access.root()? {
            self.push_node(access, rays, root);
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
        access: Access<'_>,
        rays: &LiveRays<'_>,
        end: u64,
        active: &mut Vec<ActiveRun>,
    ) -> Result<(), Halt> {
        while let Some(entry) = self.heap.peek().copied().filter(|e| e.first < end) {
            self.heap.pop();
            match entry.item {
                Item::Run { page, run } => active.push(ActiveRun { page, run, last: entry.last }),
                // Rays that met it may have ended since.
                Item::Node(node) if rays.samples_in(&node.bounds(access.world.root_cell)).is_none() => {}
                Item::Node(node) => {
                    let opened = self.open(access, rays, &node);
                    if matches!(opened, Err(Halt::PutOff { .. })) {
                        self.request_ahead(access, rays, &node, end);
                    }
                    opened?;
                }
            }
        }
        Ok(())
    }

    /// A page of a node was absent: asks, in one batch, for all that this slab and the next will open.
    fn request_ahead(&self, access: Access<'_>, rays: &LiveRays<'_>, node: &Node, end: u64) {
        let world = access.world;
        let until = end + world.slabs_on_a_miss * SLAB_SAMPLES as u64;
        let mut pages: Vec<u32> = world.pages_to_open(node).collect();
        for entry in self.heap.iter().filter(|entry| entry.first < until) {
            if let Item::Node(node) = &entry.item
                && rays.samples_in(&node.bounds(world.root_cell)).is_some()
            {
                pages.extend(world.pages_to_open(node));
            }
        }
        world.pages.hint(&world.object, &pages, POINT_PRIORITY, u64::MAX);
    }

    fn push_node(&mut self, access: Access<'_>, rays: &LiveRays<'_>, node: Node) {
        let world = access.world;
        if let Some((first, last)) = rays.samples_in(&node.bounds(world.root_cell)) {
            self.heap.push(Entry { first, last, item: Item::Node(node) });
        }
    }

    fn open(&mut self, access: Access<'_>, rays: &LiveRays<'_>, node: &Node) -> Result<(), Halt> {
        self.open_own(access, rays, node.own)?;
        self.open_children(access, rays, node)
    }

    fn open_children(&mut self, access: Access<'_>, rays: &LiveRays<'_>, node: &Node) -> Result<(), Halt> {
        if node.child_mask == 0 {
            return Ok(());
        }
        let world = access.world;
        let NodeRef { page, index } = node.first_child;
        let guard = access.retain(world.first_node_page + page, NODE_PRIORITY)?;
        let nodes = NodePage::trusted(&guard);
        for k in 0..node.child_mask.count_ones() as usize {
            let child = nodes.get(usize::from(index) + k).ok_or_else(|| world.broken(page))?;
            self.push_node(access, rays, child);
        }
        Ok(())
    }

    /// Looks at the bounds of a node's own runs. Their pages are needed for that, and soon again for the points.
    fn open_own(&mut self, access: Access<'_>, rays: &LiveRays<'_>, own: RunRange) -> Result<(), Halt> {
        let world = access.world;
        let (mut page, mut run, mut left) = (own.first_page, usize::from(own.first_run), own.runs as usize);
        while left > 0 {
            if page >= world.first_node_page {
                return Err(world.broken(page).into());
            }
            let guard = access.retain(page, POINT_PRIORITY)?;
            let points = PointPage::trusted(&guard, world.header);
            let here = left.min(points.len().saturating_sub(run));
            if here == 0 {
                return Err(world.broken(page).into());
            }
            for index in run..run + here {
                let head = points.head(index);
                let bounds = head.position_bounds(world.root_cell).inflated(f64::from(head.radius_max()));
                if let Some((first, last)) = rays.samples_in(&bounds) {
                    self.heap.push(Entry { first, last, item: Item::Run { page, run: index as u16 } });
                }
            }
            left -= here;
            (page, run) = (page + 1, 0);
        }
        Ok(())
    }
}
