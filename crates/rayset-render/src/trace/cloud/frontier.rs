//! The part of the octree that a packet has not passed yet, nearest first.
//!
//! A node is opened only when a slab reaches it and live rays may meet it, so nothing behind an
//! opaque surface is ever requested; and each node is opened once per packet, however many slabs
//! there are.

use std::ops::Range;

use super::cut::{Cut, NONE, NodeCut, RecordRange, Seen};
use super::live_rays::LiveRays;
use super::lod::CloudLod;
use super::nodes::{NodesInMemory, RetainedNodes};
use super::opening::Opening;
use super::placement::CloudPlacement;
use crate::field::{Packet, SLAB_SAMPLES, Sight, Slab};
use crate::trace::access::{Access, Halt};
use rayset_base::geometry::{Aabb, Ray};
use rayset_base::nearest_first::NearestFirst;
use rayset_files::octree::node::Node;
use rayset_files::octree::page::PointPage;
use rayset_files::octree::walk::{NodePages, Visit, Visitor, Walk};

#[derive(Clone, Copy, Debug)]
pub(super) enum Item {
    /// A node whose record has been read, but not its children and points.
    Node(Node, NodeCut),
    Runs(Runs, RunCut),
    /// Aggregates that are seen.
    Records(RecordRange),
}

/// One run of a page, or several runs that have not been examined individually.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Runs {
    pub(super) page: u32,
    pub(super) first: u16,
    pub(super) end: u16,
}

/// How the points of runs are seen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct RunCut {
    /// Where it is kept what is seen of the node's points; [`NONE`] if that is all.
    pub(super) node: u32,
    /// The number of the first run's first point among those of the node.
    pub(super) first_point: u32,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Ahead {
    /// Last tick that it may reach.
    pub(super) last: u64,
    pub(super) item: Item,
}

/// Runs that some sample of the packet may need.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct ActiveRuns {
    pub(super) runs: Runs,
    /// First and last tick that they may reach.
    pub(super) first: u64,
    pub(super) last: u64,
    pub(super) cut: RunCut,
}

/// Aggregates that some sample of the packet may need.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct ActiveRecords {
    pub(super) records: RecordRange,
    /// First and last tick that they may reach.
    pub(super) first: u64,
    pub(super) last: u64,
}

/// All that some sample of the packet may need.
#[derive(Default)]
pub(super) struct Active {
    pub(super) runs: Vec<ActiveRuns>,
    pub(super) records: Vec<ActiveRecords>,
}

impl Active {
    pub(super) fn clear(&mut self) {
        self.runs.clear();
        self.records.clear();
    }

    /// Forgets what no ray comes to any more.
    pub(super) fn pass(&mut self, since: u64) {
        self.runs.retain(|runs| runs.last >= since);
        self.records.retain(|records| records.last >= since);
    }

    pub(super) fn is_empty(&self) -> bool {
        self.runs.is_empty() && self.records.is_empty()
    }

    /// Whether any of it is not seen whole.
    pub(super) fn some_from_afar(&self) -> bool {
        !self.records.is_empty() || self.runs.iter().any(|runs| runs.cut.node != NONE)
    }

    /// Whether anything reaches a tick or what is behind it.
    pub(super) fn reaches(&self, tick: u64) -> bool {
        self.runs.iter().any(|runs| runs.last >= tick)
            || self.records.iter().any(|records| records.last >= tick)
    }
}

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

/// Bounds of influence of a run, enlarged by more than the rounding error.
pub(in crate::trace) fn run_bounds(cloud: &CloudPlacement, points: &PointPage<'_>, run: usize) -> Aabb {
    let head = points.head(run);
    head.position_bounds(cloud.root_cell).inflated(f64::from(head.radius_max()) * (1.0 + 1e-5))
}

/// What a frontier belongs to: one packet in one cloud.
#[derive(Clone, Copy)]
pub(super) struct PacketInCloud<'a> {
    pub(super) access: Access<'a>,
    pub(super) cloud: &'a CloudPlacement,
    /// In the cloud's space.
    pub(super) packet: &'a Packet,
    pub(super) rays: &'a LiveRays,
    /// In the cloud's space.
    pub(super) sight: Option<&'a Sight>,
    /// If the cloud is seen from afar.
    pub(super) lod: Option<&'a CloudLod>,
}

impl<'a> PacketInCloud<'a> {
    fn nodes(&self) -> RetainedNodes<'a> {
        RetainedNodes { access: self.access, cloud: self.cloud }
    }

    /// The cloud as it is seen from afar, if it is.
    pub(super) fn from_afar(&self) -> Option<Seen<'a>> {
        let (cloud, lod, sight) = (self.cloud, self.lod?, self.sight?);
        Some(Seen { cloud, lod, sight })
    }

    /// A box of points as far as these reach by themselves for those who see them.
    pub(super) fn points_as_seen(&self, bounds: Aabb) -> Aabb {
        match self.from_afar() {
            Some(Seen { lod, sight, .. }) => bounds.inflated(lod.reach_of_points(&bounds, sight)),
            None => self.cloud.as_seen(bounds, (self.sight, None)),
        }
    }

    /// The pages that are needed to open a node. From afar, points of a leaf may not be.
    fn pages_to_open(&self, node: &Node) -> impl Iterator<Item = u32> + use<> {
        let is_needed = self.lod.is_none() || node.child_mask != 0;
        self.cloud.pages_to_open(node).filter(move |_| is_needed)
    }

    /// Bounds of influence of a node.
    pub(super) fn bounds(&self, node: &Node) -> Aabb {
        self.cloud.as_seen(node.bounds(self.cloud.root_cell), (self.sight, self.lod))
    }

    /// Bounds of influence of a run.
    pub(super) fn run_bounds(&self, points: &PointPage<'_>, run: usize) -> Aabb {
        self.points_as_seen(run_bounds(self.cloud, points, run))
    }
}

impl Frontier {
    /// Restarts at the root.
    pub(super) fn begin(&mut self, place: PacketInCloud<'_>) -> Result<(), Halt> {
        self.heap.clear();
        self.aside.clear();
        self.cut.clear();
        let mut none = Active::default();
        let Self { heap, aside, walk, cut } = self;
        let mut opening = Opening::new(place, (heap, aside, cut), (NOWHERE, 0), &mut none);
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
        active: &mut Active,
    ) -> Result<(), Halt> {
        let Self { heap, aside, walk, cut } = self;
        let mut opening = Opening::new(place, (heap, aside, cut), (slab, since), active);
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

/// Visits the pages of a node's own points, each with the range of runs that belong to the node.
pub(in crate::trace) fn each_own_page(
    access: Access<'_>,
    cloud: &CloudPlacement,
    node: &Node,
    mut visit: impl FnMut(u32, &PointPage<'_>, Range<usize>),
) -> Result<(), Halt> {
    let own = node.own;
    let (mut page, mut run, mut left) = (own.first_page, usize::from(own.first_run), own.runs as usize);
    while left > 0 {
        if page >= cloud.first_node_page {
            return Err(cloud.broken(page).into());
        }
        let guard = access.retain(cloud, page)?;
        let points = PointPage::trusted(&guard, cloud.header());
        let here = left.min(points.len().saturating_sub(run));
        if here == 0 {
            return Err(cloud.broken(page).into());
        }
        visit(page, &points, run..run + here);
        left -= here;
        (page, run) = (page + 1, 0);
    }
    Ok(())
}
