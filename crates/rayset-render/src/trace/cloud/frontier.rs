//! The part of the octree that a packet has not passed yet, nearest first.
//!
//! A node is opened only when a slab reaches it and live rays may meet it, so nothing behind an
//! opaque surface is ever requested; and each node is opened once per packet, however many slabs
//! there are.

use std::ops::Range;

use super::live_rays::LiveRays;
use super::nodes::{NodesInMemory, RetainedNodes};
use super::placement::CloudPlacement;
use crate::field::{Packet, SLAB_SAMPLES, Sight, Slab};
use crate::trace::access::{Access, Halt};
use rayset_base::geometry::{Aabb, Ray};
use rayset_base::nearest_first::NearestFirst;
use rayset_files::octree::layout::RUN_POINTS;
use rayset_files::octree::node::Node;
use rayset_files::octree::page::PointPage;
use rayset_files::octree::walk::{NodePages, Visit, Visitor, Walk};

/// Nodes with more own runs than this add whole pages instead of single runs, so that a frontier
/// stays small however large the points are.
const MOST_SINGLE_RUNS: u32 = 512;

/// Runs that extend over more samples of a packet than this are examined point by point.
const MOST_SAMPLES_AT_ONCE: u64 = 64 * SLAB_SAMPLES as u64;
/// Most separate ranges of ticks that are kept for a run.
const MOST_RANGES: usize = 32;

#[derive(Clone, Copy, Debug)]
enum Item {
    /// A node whose record has been read, but not its children and points.
    Node(Node),
    Runs(Runs),
}

/// One run of a page, or several runs that have not been examined individually.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Runs {
    pub(super) page: u32,
    pub(super) first: u16,
    pub(super) end: u16,
}

#[derive(Clone, Copy, Debug)]
struct Ahead {
    /// Last tick that it may reach.
    last: u64,
    item: Item,
}

/// Runs that some sample of the packet may need.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct ActiveRuns {
    pub(super) runs: Runs,
    /// First and last tick that they may reach.
    pub(super) first: u64,
    pub(super) last: u64,
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
}

impl<'a> PacketInCloud<'a> {
    fn nodes(&self) -> RetainedNodes<'a> {
        RetainedNodes { access: self.access, cloud: self.cloud }
    }

    /// Bounds of influence of a node.
    fn bounds(&self, node: &Node) -> Aabb {
        self.cloud.as_seen(node.bounds(self.cloud.root_cell), self.sight)
    }

    /// Bounds of influence of a run.
    pub(super) fn run_bounds(&self, points: &PointPage<'_>, run: usize) -> Aabb {
        self.cloud.as_seen(run_bounds(self.cloud, points, run), self.sight)
    }
}

impl Frontier {
    /// Restarts at the root.
    pub(super) fn begin(&mut self, place: PacketInCloud<'_>) -> Result<(), Halt> {
        self.heap.clear();
        self.aside.clear();
        let mut none = Vec::new();
        let mut opening = Opening {
            place,
            heap: &mut self.heap,
            aside: &mut self.aside,
            slab: NOWHERE,
            since: 0,
            active: &mut none,
            entry: None,
        };
        self.walk.begin(&mut place.nodes(), &mut opening)
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
        active: &mut Vec<ActiveRuns>,
    ) -> Result<(), Halt> {
        let Self { heap, aside, walk } = self;
        let mut opening = Opening { place, heap, aside, slab, since, active, entry: None };
        let outcome = walk.go_on(&mut place.nodes(), &mut opening);
        let opened_last = opening.entry;
        self.aside.drain(..).for_each(|(first, entry)| self.heap.push(first, entry));
        if let (Err(Halt::Deferred(_)), Some((_, Ahead { item: Item::Node(node), .. }))) =
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
        let mut pages: Vec<u32> = cloud.pages_to_open(node).collect();
        for (_, entry) in self.heap.iter().filter(|(first, _)| *first < until) {
            if let Item::Node(node) = &entry.item
                && rays.ticks_in(packet, &place.bounds(node)).is_some()
            {
                pages.extend(cloud.pages_to_open(node));
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
            if let Item::Node(node) = entry.item {
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

/// The nodes that samples of a slab need, while they are opened.
struct Opening<'t> {
    place: PacketInCloud<'t>,
    heap: &'t mut NearestFirst<u64, Ahead>,
    aside: &'t mut Vec<(u64, Ahead)>,
    slab: Slab,
    since: u64,
    active: &'t mut Vec<ActiveRuns>,
    /// The entry that is visited, with the first tick that it may reach.
    entry: Option<(u64, Ahead)>,
}

impl<'t> Opening<'t> {
    /// Examines the bounds of a node's own runs. This needs their pages, which are soon needed
    /// again for the points.
    fn open_own(&mut self, node: &Node, walk: &mut Walk) -> Result<(), Halt> {
        let PacketInCloud { access, cloud, packet, rays, .. } = self.place;
        if !walk.may_look_at_runs_of(node, cloud.header()) {
            return Err(cloud.broken(node.own.first_page).into());
        }
        let node_bounds = &self.place.bounds(node);
        each_own_page(access, cloud, node, |page, points, range| {
            if node.own.runs > MOST_SINGLE_RUNS {
                let (first, last) = rays.ticks_in(packet, node_bounds).unwrap_or((0, 0));
                let runs = Runs { page, first: range.start as u16, end: range.end as u16 };
                self.heap.push(first, Ahead { last, item: Item::Runs(runs) });
                return;
            }
            for index in range {
                let bounds = self.place.run_bounds(points, index);
                let Some((first, last)) = rays.ticks_in(packet, &bounds) else { continue };
                let item = Item::Runs(Runs { page, first: index as u16, end: index as u16 + 1 });
                if (last - first) >> self.slab.level <= MOST_SAMPLES_AT_ONCE {
                    self.heap.push(first, Ahead { last, item });
                    continue;
                }
                let ranges = ranges_of_points(self.place, points, index, self.slab.level)
                    .unwrap_or_else(|| vec![(first, last)]);
                for (first, last) in ranges {
                    self.heap.push(first, Ahead { last, item });
                }
            }
        })
    }
}

impl<'t> Visitor<RetainedNodes<'t>> for Opening<'t> {
    fn meet(&mut self, node: Node) {
        let PacketInCloud { packet, rays, .. } = self.place;
        if let Some((first, last)) = rays.ticks_in(packet, &self.place.bounds(&node)) {
            self.heap.push(first, Ahead { last, item: Item::Node(node) });
        }
    }

    fn next(&mut self) -> Option<Node> {
        while let Some((first, entry)) = self.heap.pop_before(self.slab.end_tick()) {
            match entry.item {
                Item::Runs(runs) => {
                    self.active.push(ActiveRuns { runs, first, last: entry.last });
                }
                // What waited for finer steps may lie behind all rays meanwhile.
                Item::Node(_) if entry.last < self.since => {}
                Item::Node(node) => {
                    self.entry = Some((first, entry));
                    return Some(node);
                }
            }
        }
        None
    }

    fn visit(&mut self, node: &Node, walk: &mut Walk, _: &mut RetainedNodes<'t>) -> Result<Visit, Halt> {
        let PacketInCloud { packet, rays, .. } = self.place;
        let bounds = self.place.bounds(node);
        // Rays that met it may have ended since.
        let Some(range) = rays.ticks_in(packet, &bounds) else { return Ok(Visit::Skip) };
        if rays.misses_now(packet, &bounds, range) {
            let end = self.slab.end_tick();
            match self.entry {
                Some((first, entry)) if rays.some_wait() => self.aside.push((first, entry)),
                Some((_, entry)) if entry.last >= end => self.heap.push(end, entry),
                _ => {}
            }
            return Ok(Visit::Skip);
        }
        self.open_own(node, walk)?;
        Ok(Visit::Open)
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

/// Ranges of ticks that the points of a wide run may reach, or `None` if there are too many that
/// are more than a slab of a level apart. They may be much smaller than the range of its bounds,
/// because rays miss most points of a wide run.
fn ranges_of_points(
    place: PacketInCloud<'_>,
    points: &PointPage<'_>,
    run: usize,
    level: u32,
) -> Option<Vec<(u64, u64)>> {
    let PacketInCloud { cloud, packet, rays, sight, .. } = place;
    let run = points.run(run);
    let mut radii = [cloud.header().radius.min(); RUN_POINTS];
    if let Some(stored) = run.radii(cloud.header()) {
        radii.iter_mut().zip(stored).for_each(|(radius, stored)| *radius = stored);
    }
    let positions = run.positions(cloud.root_cell);
    let mut ranges: Vec<(u64, u64)> = (positions.iter().zip(&radii))
        .filter_map(|(&position, &radius)| {
            // Far larger than the rounding error when a point is added to samples.
            let reach = f64::from(radius) * (1.0 + 1e-4);
            // Between the rays of a packet there may be any number of points that no ray meets.
            let bounds = cloud.as_seen(Aabb::new(position - reach, position + reach), sight);
            rays.ticks_of_each(packet, &bounds)
        })
        .collect();
    ranges.sort_unstable();
    ranges.dedup_by(|next, before| {
        let one = next.0 <= before.1 + ((SLAB_SAMPLES as u64) << level);
        if one {
            before.1 = before.1.max(next.1);
        }
        one
    });
    (ranges.len() <= MOST_RANGES).then_some(ranges)
}
