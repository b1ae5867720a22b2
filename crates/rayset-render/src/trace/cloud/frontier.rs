//! The part of the octree that a packet has not passed yet, nearest first.
//!
//! A node is opened only when a slab reaches it and live rays may meet it, so nothing behind an
//! opaque surface is ever requested; and each node is opened once per packet, however many slabs
//! there are.

use super::ahead::{Active, Ahead, Item, PacketInCloud};
use super::cut::Cut;
use super::leaf_cut::LeafCuts;
use super::nodes::NodesInMemory;
use super::opening::Opening;
use super::placement::CloudPlacement;
use crate::field::{SLAB_SAMPLES, Slab};
use crate::trace::access::Halt;
use rayset_base::geometry::Ray;
use rayset_base::nearest_first::NearestFirst;
use rayset_files::octree::node::Node;
use rayset_files::octree::walk::{NodePages, Visit, Visitor, Walk};

/// Nodes and runs ahead of a packet.
#[derive(Default)]
pub(super) struct Frontier {
    /// By the first tick that an entry may reach. The order of ties does not matter: runs are
    /// sorted before they are used.
    heap: NearestFirst<u64, Ahead>,
    /// What only rays need that come to the slab with finer steps, while it is advanced to.
    aside: Vec<(u64, Ahead)>,
    walk: Walk,
    pub(super) cut: Cut,
}

/// Before all samples.
const NOWHERE: Slab = Slab { first: 0, samples: 0, level: 0 };

impl Frontier {
    /// Restarts at the root.
    pub(super) fn begin(&mut self, place: PacketInCloud<'_>) -> Result<(), Halt> {
        self.heap.clear();
        self.aside.clear();
        self.cut.clear();
        let (mut none, mut no_leaves) = (Active::default(), LeafCuts::default());
        let Self { heap, aside, walk, cut } = self;
        let mut opening = Opening::new(place, (heap, aside, cut), &mut no_leaves, (NOWHERE, 0), &mut none);
        opening.begin()?;
        walk.begin(&mut place.nodes(), &mut opening)
    }

    /// The first tick that anything ahead may reach.
    pub(super) fn next_tick(&self) -> Option<u64> {
        self.heap.nearest()
    }

    /// Opens everything that samples of a slab may need and moves its runs to `active`. Nodes that
    /// only samples without effect can reach are left for later. No ray comes to anything before
    /// the tick `since` any more.
    pub(super) fn advance(
        &mut self,
        place: PacketInCloud<'_>,
        slab: Slab,
        since: u64,
        (active, leaves): (&mut Active, &mut LeafCuts),
    ) -> Result<(), Halt> {
        let Self { heap, aside, walk, cut } = self;
        let mut opening = Opening::new(place, (heap, aside, cut), leaves, (slab, since), active);
        let outcome = walk.go_on(&mut place.nodes(), &mut opening);
        let opened_last = opening.entry;
        self.aside.drain(..).for_each(|(first, entry)| self.heap.push(first, entry));
        if let (Err(Halt::Deferred(_)), Some((_, Ahead { item: Item::Node(node, _), .. }))) =
            (&outcome, opened_last)
        {
            self.request_ahead(place, &node, slab);
        }
        outcome
    }

    /// Called when a page of a node is absent: requests, in one batch, all pages that this slab and
    /// the next `slabs_on_a_miss` slabs will open.
    fn request_ahead(&self, place: PacketInCloud<'_>, node: &Node, slab: Slab) {
        let PacketInCloud { access, cloud, packet, rays, .. } = place;
        let until = slab.end_tick() + ((access.slabs_on_a_miss * SLAB_SAMPLES as u64) << slab.level);
        let mut pages: Vec<u32> = place.pages_to_open(node).collect();
        for (_, entry) in self.heap.iter().filter(|(first, _)| *first < until) {
            if let Item::Node(node, _) = &entry.item
                && rays.ticks_in(packet, &place.bounds(node)).is_some()
            {
                pages.extend(place.pages_to_open(node));
            }
        }
        access.pages.hint(&cloud.pages, &pages, u64::MAX);
    }

    /// Starts at the nearest node ahead that the packet's middle ray meets and descends to where
    /// the ray first meets points, through nodes in memory only; requests the first page that is
    /// absent.
    pub(super) fn precache(&self, place: PacketInCloud<'_>) {
        let PacketInCloud { access, cloud, packet, .. } = place;
        let middle = packet.ray(packet.len() / 2);
        let mut line = Line { cloud, middle, nearest: None, pages: Vec::new() };
        let mut nodes = NodesInMemory::new(access.pages, cloud);
        for (_, entry) in self.heap.iter() {
            if let Item::Node(node, _) = entry.item {
                Visitor::<NodesInMemory<'_>>::meet(&mut line, node);
            }
        }
        let Ok(()) = Walk::new().go_on(&mut nodes, &mut line);
        line.pages.append(&mut nodes.absent);
        if line.pages.is_empty() {
            return;
        }
        access.pages.hint(&cloud.pages, &line.pages, u64::MAX);
    }
}

/// The way of a ray to where it first meets points, along the nearest of the nodes that it meets.
struct Line<'t> {
    cloud: &'t CloudPlacement,
    middle: Ray,
    /// Of the nodes met since the last was visited, the one that the ray enters first, and where.
    nearest: Option<(f64, Node)>,
    /// The pages of the points.
    pages: Vec<u32>,
}

impl<P: NodePages> Visitor<P> for Line<'_> {
    fn meet(&mut self, node: Node) {
        let Some((enter, _)) = node.bounds(self.cloud.root_cell).clip(&self.middle) else { return };
        if self.nearest.is_none_or(|(nearest, _)| enter < nearest) {
            self.nearest = Some((enter, node));
        }
    }

    fn next(&mut self) -> Option<Node> {
        self.nearest.take().map(|(_, node)| node)
    }

    fn visit(&mut self, node: &Node, _: &mut Walk, _: &mut P) -> Result<Visit, P::Error> {
        if node.child_mask != 0 {
            return Ok(Visit::Open);
        }
        self.pages.extend(self.cloud.own_pages(node));
        Ok(Visit::Stop)
    }
}
