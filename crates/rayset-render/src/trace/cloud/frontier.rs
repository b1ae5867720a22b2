//! The part of the octree that a packet has not passed yet, nearest first.
//!
//! A node is opened only when a slab reaches it and live rays may meet it, so nothing behind an opaque surface is ever
//! requested; and each node is opened once per packet, however many slabs there are.

use std::cmp::Ordering;
use std::collections::BinaryHeap;
use std::ops::Range;

use super::live_rays::LiveRays;
use super::placement::CloudPlacement;
use crate::field::{Packet, SLAB_SAMPLES};
use crate::trace::access::{Access, Halt};
use rayset_base::geometry::Aabb;
use rayset_files::octree::layout::{NodeRef, RUN_POINTS};
use rayset_files::octree::node::{Node, NodePage};
use rayset_files::octree::page::PointPage;

/// Nodes with more own runs than this add whole pages instead of single runs, so that a frontier stays small however
/// large the points are.
const MOST_SINGLE_RUNS: u32 = 512;

/// Runs that extend over more samples of a packet than this are examined point by point.
const MOST_SAMPLES_AT_ONCE: u64 = 64 * SLAB_SAMPLES as u64;
/// Most separate ranges of samples that are kept for a run.
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
    /// The heap yields its greatest entry first, so nearer is greater. The order of ties does not matter: runs are
    /// sorted before they are used.
    fn cmp(&self, other: &Self) -> Ordering {
        other.first.cmp(&self.first)
    }
}

/// Runs that some sample of the packet may need.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct ActiveRuns {
    pub(super) runs: Runs,
    /// First and last sample that they may reach.
    pub(super) first: u64,
    pub(super) last: u64,
}

/// Nodes and runs ahead of a packet.
#[derive(Default)]
pub(super) struct Frontier {
    heap: BinaryHeap<Entry>,
    /// Number of nodes opened.
    opened: u64,
    /// Number of own runs of these nodes.
    opened_runs: u64,
}

/// Bounds of influence of a run, enlarged by more than the rounding error.
pub(in crate::trace) fn run_bounds(cloud: &CloudPlacement, points: &PointPage<'_>, run: usize) -> Aabb {
    let head = points.head(run);
    head.position_bounds(cloud.root_cell).inflated(f64::from(head.radius_max()) * (1.0 + 1e-5))
}

/// What a frontier belongs to: one packet in one cloud.
#[derive(Clone, Copy)]
pub(super) struct Place<'a> {
    pub(super) access: Access<'a>,
    pub(super) cloud: &'a CloudPlacement,
    /// In the cloud's space.
    pub(super) packet: &'a Packet,
    pub(super) rays: &'a LiveRays,
}

impl Frontier {
    /// Restarts at the root.
    pub(super) fn begin(&mut self, place: Place<'_>) -> Result<(), Halt> {
        self.heap.clear();
        (self.opened, self.opened_runs) = (1, 0);
        if let Some(root) = place.access.root(place.cloud)? {
            self.push_node(place, root);
        }
        Ok(())
    }

    /// The first sample that anything ahead may reach.
    pub(super) fn next_sample(&self) -> Option<u64> {
        self.heap.peek().map(|e| e.first)
    }

    /// Opens everything that samples before `end` may need and moves its runs to `active`. Nodes that only samples
    /// without effect can reach are left for later.
    pub(super) fn advance(
        &mut self,
        place: Place<'_>,
        end: u64,
        active: &mut Vec<ActiveRuns>,
    ) -> Result<(), Halt> {
        let Place { cloud, packet, rays, .. } = place;
        while let Some(entry) = self.heap.peek().copied().filter(|e| e.first < end) {
            self.heap.pop();
            let node = match entry.item {
                Item::Runs(runs) => {
                    active.push(ActiveRuns { runs, first: entry.first, last: entry.last });
                    continue;
                }
                Item::Node(node) => node,
            };
            let bounds = node.bounds(cloud.root_cell);
            // Rays that met it may have ended since.
            let Some(range) = rays.samples_in(packet, &bounds) else { continue };
            if rays.misses_now(&bounds, range) {
                if entry.last >= end {
                    self.heap.push(Entry { first: end, ..entry });
                }
                continue;
            }
            let opened = self.open(place, &node);
            if matches!(opened, Err(Halt::Deferred(_))) {
                self.request_ahead(place, &node, end);
            }
            opened?;
        }
        Ok(())
    }

    /// Called when a page of a node is absent: requests, in one batch, all pages that this slab and the next
    /// `slabs_on_a_miss` slabs will open.
    fn request_ahead(&self, place: Place<'_>, node: &Node, end: u64) {
        let Place { access, cloud, packet, rays } = place;
        let until = end + access.slabs_on_a_miss * SLAB_SAMPLES as u64;
        let mut pages: Vec<u32> = cloud.pages_to_open(node).collect();
        for entry in self.heap.iter().filter(|entry| entry.first < until) {
            if let Item::Node(node) = &entry.item
                && rays.samples_in(packet, &node.bounds(cloud.root_cell)).is_some()
            {
                pages.extend(cloud.pages_to_open(node));
            }
        }
        access.pages.hint(&cloud.pages, &pages, u64::MAX);
    }

    /// Starts at the nearest node ahead that the packet's middle ray meets and descends to where the ray first meets
    /// points, through nodes in memory only; requests the first page that is absent.
    pub(super) fn precache(&self, place: Place<'_>) {
        let Place { access, cloud, packet, .. } = place;
        let middle = packet.ray(packet.len() / 2);
        let enters = |node: &Node| node.bounds(cloud.root_cell).clip(&middle).map(|(enter, _)| enter);
        let nearest = |nodes: &mut dyn Iterator<Item = Node>| {
            let met = nodes.filter_map(|node| enters(&node).map(|enter| (enter, node)));
            met.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, node)| node)
        };
        let ask = |pages: &[u32]| access.pages.hint(&cloud.pages, pages, u64::MAX);
        let mut ahead = self.heap.iter().filter_map(|entry| match entry.item {
            Item::Node(node) => Some(node),
            Item::Runs(_) => None,
        });
        let mut next = nearest(&mut ahead);
        while let Some(node) = next.take() {
            if node.child_mask == 0 {
                let own: Vec<u32> = cloud.own_pages(&node).collect();
                ask(&own);
                return;
            }
            let page = cloud.first_node_page + node.first_child.page;
            let Some(guard) = access.pages.peek(&cloud.pages, page) else {
                ask(&[page]);
                return;
            };
            let nodes = NodePage::scaled(&guard, cloud.header());
            let first = usize::from(node.first_child.index);
            let children = (0..node.child_mask.count_ones() as usize).filter_map(|k| nodes.get(first + k));
            next = nearest(&mut children.filter(|child| child.is_child_of(&node)));
        }
    }

    fn push_node(&mut self, place: Place<'_>, node: Node) {
        let bounds = node.bounds(place.cloud.root_cell);
        if let Some((first, last)) = place.rays.samples_in(place.packet, &bounds) {
            self.heap.push(Entry { first, last, item: Item::Node(node) });
        }
    }

    fn open(&mut self, place: Place<'_>, node: &Node) -> Result<(), Halt> {
        self.open_own(place, node)?;
        self.open_children(place, node)
    }

    fn open_children(&mut self, place: Place<'_>, node: &Node) -> Result<(), Halt> {
        if node.child_mask == 0 {
            return Ok(());
        }
        let Place { access, cloud, .. } = place;
        let NodeRef { page, index } = node.first_child;
        let guard = access.retain(cloud, cloud.first_node_page + page)?;
        let nodes = NodePage::scaled(&guard, cloud.header());
        for k in 0..node.child_mask.count_ones() as usize {
            let child = nodes.get(usize::from(index) + k).filter(|child| child.is_child_of(node));
            let child = child.filter(|_| self.opened < cloud.most_nodes());
            self.opened += 1;
            self.push_node(place, child.ok_or_else(|| cloud.broken(page))?);
        }
        Ok(())
    }

    /// Examines the bounds of a node's own runs. This needs their pages, which are soon needed again for the points.
    fn open_own(&mut self, place: Place<'_>, node: &Node) -> Result<(), Halt> {
        let Place { access, cloud, packet, rays } = place;
        // Each run belongs to one node and has at least one point.
        self.opened_runs += u64::from(node.own.runs);
        if self.opened_runs > cloud.header().points {
            return Err(cloud.broken(node.own.first_page).into());
        }
        let node_bounds = &node.bounds(cloud.root_cell);
        each_own_page(access, cloud, node, |page, points, range| {
            if node.own.runs > MOST_SINGLE_RUNS {
                let (first, last) = rays.samples_in(packet, node_bounds).unwrap_or((0, 0));
                let runs = Runs { page, first: range.start as u16, end: range.end as u16 };
                self.heap.push(Entry { first, last, item: Item::Runs(runs) });
                return;
            }
            for index in range {
                let bounds = run_bounds(cloud, points, index);
                let Some((first, last)) = rays.samples_in(packet, &bounds) else { continue };
                let item = Item::Runs(Runs { page, first: index as u16, end: index as u16 + 1 });
                if last - first <= MOST_SAMPLES_AT_ONCE {
                    self.heap.push(Entry { first, last, item });
                    continue;
                }
                let ranges = ranges_of_points(place, points, index).unwrap_or_else(|| vec![(first, last)]);
                self.heap.extend(ranges.into_iter().map(|(first, last)| Entry { first, last, item }));
            }
        })
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

/// Ranges of samples that the points of a wide run may reach, or `None` if there are too many. They may be much smaller
/// than the range of its bounds, because rays miss most points of a wide run.
fn ranges_of_points(place: Place<'_>, points: &PointPage<'_>, run: usize) -> Option<Vec<(u64, u64)>> {
    let Place { cloud, packet, rays, .. } = place;
    let run = points.run(run);
    let mut radii = [cloud.header().radius.min(); RUN_POINTS];
    if let Some(stored) = run.radii(cloud.header()) {
        radii.iter_mut().zip(stored).for_each(|(radius, stored)| *radius = stored);
    }
    let positions = run.positions(cloud.root_cell);
    // Between the rays of a packet there may be any number of points that no ray meets.
    let going = rays.ray_by_ray(packet);
    let mut ranges: Vec<(u64, u64)> = (positions.iter().zip(&radii))
        .filter_map(|(&position, &radius)| {
            // Far larger than the rounding error when a point is added to samples.
            let reach = f64::from(radius) * (1.0 + 1e-4);
            going.samples_in(packet, &Aabb::new(position - reach, position + reach))
        })
        .collect();
    ranges.sort_unstable();
    ranges.dedup_by(|next, before| {
        let one = next.0 <= before.1 + SLAB_SAMPLES as u64;
        if one {
            before.1 = before.1.max(next.1);
        }
        one
    });
    (ranges.len() <= MOST_RANGES).then_some(ranges)
}
