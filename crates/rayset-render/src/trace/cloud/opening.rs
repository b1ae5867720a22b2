//! Opening the nodes that samples of a slab need: their points, their children, and what stands for
//! them from afar.

use super::ahead::{
    Active, ActiveRecords, ActiveRuns, Ahead, Item, PacketInCloud, RunCut, Runs, each_own_page,
};
use super::cut::{Cut, NodeCut, PointsOfNode};
use super::leaf_cut::LeafCuts;
use super::nodes::RetainedNodes;
use super::parts::{NONE, NodePart};
use super::record_pages::RecordPages;
use crate::field::{SLAB_SAMPLES, Slab};
use crate::lod::LEAST_PART;
use crate::trace::access::Halt;
use rayset_base::geometry::Aabb;
use rayset_base::nearest_first::NearestFirst;
use rayset_files::octree::layout::RUN_POINTS;
use rayset_files::octree::node::Node;
use rayset_files::octree::page::PointPage;
use rayset_files::octree::walk::{Visit, Visitor, Walk};

/// Nodes with more own runs than this add whole pages instead of single runs, so that a frontier
/// stays small however large the points are.
const MOST_SINGLE_RUNS: u32 = 512;

/// Runs that extend over more samples of a packet than this are examined point by point.
const MOST_SAMPLES_AT_ONCE: u64 = 64 * SLAB_SAMPLES as u64;
/// Most separate ranges of ticks that are kept for a run.
const MOST_RANGES: usize = 32;

/// The nodes that samples of a slab need, while they are opened.
pub(super) struct Opening<'t> {
    place: PacketInCloud<'t>,
    heap: &'t mut NearestFirst<u64, Ahead>,
    aside: &'t mut Vec<(u64, Ahead)>,
    slab: Slab,
    since: u64,
    active: &'t mut Active,
    /// The entry that is visited, with the first tick that it may reach.
    pub(super) entry: Option<(u64, Ahead)>,
    cut: &'t mut Cut,
    leaves: &'t mut LeafCuts,
    records: Option<RecordPages<'t>>,
    /// The ticks that those of the children met so far may reach of which records are seen.
    span: Option<(u64, u64)>,
}

impl<'t> Opening<'t> {
    pub(super) fn new(
        place: PacketInCloud<'t>,
        (heap, aside, cut): (&'t mut NearestFirst<u64, Ahead>, &'t mut Vec<(u64, Ahead)>, &'t mut Cut),
        leaves: &'t mut LeafCuts,
        (slab, since): (Slab, u64),
        active: &'t mut Active,
    ) -> Self {
        let records = place.seen_from_afar().map(|seen| RecordPages::new(place.access, seen.cloud, seen.lod));
        Self { place, heap, aside, slab, since, active, entry: None, cut, leaves, records, span: None }
    }

    /// The root is about to be met.
    pub(super) fn begin(&mut self) -> Result<(), Halt> {
        match (self.place.seen_from_afar(), &mut self.records) {
            (Some(seen), Some(records)) => self.cut.begin(seen, records),
            _ => Ok(()),
        }
    }

    /// Examines the bounds of a node's own runs. This needs their pages, which are soon needed
    /// again for the points. Returns the last tick that any of them may reach.
    fn open_own(&mut self, node: &Node, walk: &mut Walk, of_node: u32) -> Result<u64, Halt> {
        let PacketInCloud { access, cloud, packet, rays, .. } = self.place;
        if !walk.may_look_at_runs_of(node, cloud.header()) {
            return Err(cloud.broken(node.own.first_page).into());
        }
        let node_bounds = &self.place.bounds(node);
        let mut cut = RunCut { node: of_node, first_point: 0 };
        let of = self.cut.nodes.get(of_node as usize);
        let leaf = of.filter(|of| f64::from(node.radius_max) <= of.edge).and_then(|of| of.leaf.as_deref());
        let left = leaf.and_then(|leaf| leaf.left.as_ref());
        let mut last_of_all = 0;
        each_own_page(access, cloud, node, |page, points, range| {
            if node.own.runs > MOST_SINGLE_RUNS {
                let (first, last) = rays.ticks_in(packet, node_bounds).unwrap_or((0, 0));
                last_of_all = last_of_all.max(last);
                let runs = Runs { page, first: range.start as u16, end: range.end as u16 };
                self.heap.push(first, Ahead { last, item: Item::Runs(runs, cut) });
                if of_node != NONE {
                    cut.first_point += range.map(|index| points.head(index).len() as u32).sum::<u32>();
                }
                return;
            }
            for index in range {
                let of_run = cut;
                let len = points.head(index).len() as u32;
                cut.first_point += len;
                if left.is_some_and(|left| !left.has_some_of(of_run.first_point, len)) {
                    continue;
                }
                let bounds = self.place.run_bounds(points, index);
                let Some((first, last)) = rays.ticks_in(packet, &bounds) else { continue };
                last_of_all = last_of_all.max(last);
                let item = Item::Runs(Runs { page, first: index as u16, end: index as u16 + 1 }, of_run);
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
        })?;
        Ok(last_of_all)
    }

    /// Opens a node of which a part is seen from afar.
    fn open_part(&mut self, node: &Node, part: NodePart, walk: &mut Walk) -> Result<Visit, Halt> {
        let (Some(seen), Some(records)) = (self.place.seen_from_afar(), &mut self.records) else {
            return Ok(Visit::Skip);
        };
        let PacketInCloud { packet, rays, number, .. } = self.place;
        let heap = &mut *self.heap;
        let leaf = self.cut.cells(self.leaves, (number, seen), records, (node, part), |range, bounds| {
            let Some((first, last)) = rays.ticks_in(packet, bounds) else { return false };
            heap.push(first, Ahead { last, item: Item::Records(range) });
            true
        })?;
        let edge = seen.edge(node.level);
        // A node does not stand for points that are larger.
        let some_left = match &leaf {
            _ if f64::from(node.radius_max) > edge => true,
            Some(leaf) => leaf.left.as_ref().is_none_or(|left| !left.is_empty()),
            None => part.rest > 0.0,
        };
        // Its points reach less far than what stands for them.
        let near = self.place.points_as_seen(node.bounds(self.place.cloud.root_cell));
        if node.own.runs > 0 && some_left && rays.ticks_in(packet, &near).is_some() {
            let of_node = self.cut.nodes.len() as u32;
            self.cut.nodes.push(PointsOfNode { part, edge, leaf, last: u64::MAX });
            let last = self.open_own(node, walk, of_node)?;
            self.cut.nodes[of_node as usize].last = last;
        }
        if part.rest == 0.0 || node.child_mask == 0 {
            return Ok(Visit::Skip);
        }
        let Some(records) = &mut self.records else { return Ok(Visit::Skip) };
        self.cut.open(seen, records, (node, part))?;
        self.span = None;
        Ok(Visit::Open)
    }

    /// Meets a node of which a part may be seen from afar.
    fn meet_part(&mut self, node: Node, (part, is_last): (NodePart, bool), ticks: Option<(u64, u64)>) {
        if let Some((first, last)) = ticks {
            if f64::from(part.of_record()) > LEAST_PART {
                let (from, to) = self.span.unwrap_or((u64::MAX, 0));
                self.span = Some((from.min(first), to.max(last)));
            }
            let whole = || NodeCut::Whole;
            let cut = self.place.seen_from_afar().map_or_else(whole, |seen| NodeCut::of(seen, &node, part));
            let is_seen = part.rest > 0.0 || node.level == 0;
            if is_seen {
                self.heap.push(first, Ahead { last, item: Item::Node(node, cut) });
            }
        }
        if is_last
            && let Some((first, last)) = self.span.take()
            && let Some(records) = self.cut.records_of_children(node.level)
        {
            self.heap.push(first, Ahead { last, item: Item::Records(records) });
        }
    }
}

impl<'t> Visitor<RetainedNodes<'t>> for Opening<'t> {
    fn meet(&mut self, node: Node) {
        let PacketInCloud { packet, rays, .. } = self.place;
        let ticks = rays.ticks_in(packet, &self.place.bounds(&node));
        match self.cut.meet() {
            Some(child) => self.meet_part(node, child, ticks),
            None => {
                if let Some((first, last)) = ticks {
                    self.heap.push(first, Ahead { last, item: Item::Node(node, NodeCut::Whole) });
                }
            }
        }
    }

    fn next(&mut self) -> Option<Node> {
        while let Some((first, entry)) = self.heap.pop_before(self.slab.end_tick()) {
            match entry.item {
                Item::Runs(runs, cut) => {
                    self.active.runs.push(ActiveRuns { runs, first, last: entry.last, cut });
                }
                Item::Records(records) => {
                    self.active.records.push(ActiveRecords { records, first, last: entry.last });
                }
                // What waited for finer steps may lie behind all rays meanwhile.
                Item::Node(..) if entry.last < self.since => {}
                Item::Node(node, _) => {
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
        match self.entry {
            Some((_, Ahead { item: Item::Node(_, NodeCut::Part(part)), .. })) => {
                self.open_part(node, part, walk)
            }
            _ => {
                self.cut.open_whole();
                self.open_own(node, walk, NONE)?;
                Ok(Visit::Open)
            }
        }
    }
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
    let PacketInCloud { cloud, packet, rays, .. } = place;
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
            let bounds = place.points_as_seen(Aabb::new(position - reach, position + reach));
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
