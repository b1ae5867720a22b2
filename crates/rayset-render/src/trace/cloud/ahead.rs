//! What may lie ahead of a packet in a cloud: nodes, runs of points, and from afar aggregates.

use std::ops::Range;

use super::cut::NodeCut;
use super::live_rays::LiveRays;
use super::lod::CloudLod;
use super::nodes::RetainedNodes;
use super::parts::{NONE, RecordRange, Seen};
use super::placement::CloudPlacement;
use crate::field::{Packet, Sight};
use crate::trace::access::{Access, Halt};
use rayset_base::geometry::Aabb;
use rayset_files::octree::node::Node;
use rayset_files::octree::page::PointPage;

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
    /// The cloud's number.
    pub(super) number: usize,
    /// In the cloud's space.
    pub(super) packet: &'a Packet,
    pub(super) rays: &'a LiveRays,
    /// In the cloud's space.
    pub(super) sight: Option<&'a Sight>,
    /// If the cloud is seen from afar.
    pub(super) lod: Option<&'a CloudLod>,
}

impl<'a> PacketInCloud<'a> {
    pub(super) fn nodes(&self) -> RetainedNodes<'a> {
        RetainedNodes { access: self.access, cloud: self.cloud }
    }

    /// The cloud as it is seen from afar, if it is.
    pub(super) fn seen_from_afar(&self) -> Option<Seen<'a>> {
        let (cloud, lod, sight) = (self.cloud, self.lod?, self.sight?);
        Some(Seen { cloud, lod, sight })
    }

    /// A box of points as far as these reach by themselves for those who see them.
    pub(super) fn points_as_seen(&self, bounds: Aabb) -> Aabb {
        match self.seen_from_afar() {
            Some(Seen { lod, sight, .. }) => bounds.inflated(lod.reach_of_points(&bounds, sight)),
            None => self.cloud.as_seen(bounds, (self.sight, None)),
        }
    }

    /// The pages that are needed to open a node. From afar, points of a leaf may not be.
    pub(super) fn pages_to_open(&self, node: &Node) -> impl Iterator<Item = u32> + use<> {
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
