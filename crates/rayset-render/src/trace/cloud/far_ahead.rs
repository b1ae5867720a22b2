//! The cut through a cloud ahead of rays, as far as its records are in memory: which pages what is
//! seen from afar will need.

use std::ops::Range;

use super::cut::{Cut, NodeCut};
use super::leaf_cut::{LeafCuts, Left};
use super::lod::CloudLod;
use super::parts::{NodePart, Seen};
use super::placement::CloudPlacement;
use super::record_pages::RecordPages;
use super::volume::CloudVolume;
use crate::field::Sight;
use crate::lod::part_of_cell;
use crate::trace::access::Halt;
use rayset_base::geometry::Aabb;
use rayset_files::octree::layout::DEEPEST_LEVEL;
use rayset_files::octree::node::Node;
use rayset_store::working_set::PageClient;

/// The cut through a cloud, while nodes are opened ahead of rays.
pub(in crate::trace) struct FarAhead<'a> {
    cloud: &'a CloudPlacement,
    lod: &'a CloudLod,
    /// In the cloud's space.
    sight: Sight,
    records: RecordPages<'a>,
    cut: Cut,
    leaves: LeafCuts,
    /// Pages of records that are not in memory, each as often as it was asked for.
    pub(in crate::trace) absent: Vec<u32>,
}

/// What rays that come to a node need.
#[derive(Clone, Copy, Debug, Default)]
pub(in crate::trace) struct Opened {
    /// Its own points.
    pub(in crate::trace) points: bool,
    /// Its children.
    pub(in crate::trace) children: bool,
}

impl<'a> FarAhead<'a> {
    /// Of a cloud that is seen from afar; `sight` is of world space.
    pub(in crate::trace) fn new(
        client: &'a PageClient,
        volume: &'a CloudVolume,
        sight: Option<&Sight>,
    ) -> Option<Self> {
        let (cloud, lod) = (&volume.placement, volume.lod.as_deref()?);
        let sight = lod.sight(&cloud.local_sight(sight)?);
        let records = RecordPages::in_memory(client, cloud, lod);
        let (cut, leaves) = (Cut::default(), LeafCuts::default());
        Some(Self { cloud, lod, sight, records, cut, leaves, absent: Vec::new() })
    }

    /// The pages of all records that may be seen, were all of the cloud as far away as its middle:
    /// those of the largest cells come first.
    pub(in crate::trace) fn coarse_pages(&self) -> Range<u32> {
        let (header, aggregates) = (self.cloud.header(), &self.lod.aggregates);
        let pixel = self.sight.pixel_at(header.bounds.center());
        let seen = Seen { cloud: self.cloud, lod: self.lod, sight: &self.sight };
        let finest = (0..DEEPEST_LEVEL).find(|&level| part_of_cell(seen.edge(level), pixel) >= 1.0);
        let end = aggregates.first_of_level[usize::from(finest.unwrap_or(DEEPEST_LEVEL)) + 1];
        let first = self.cloud.first_record_page();
        first..first + end.div_ceil(aggregates.records_per_page(header.page_bytes).max(1))
    }

    /// The root is about to be met; false if nothing is known of it yet.
    pub(in crate::trace) fn begin(&mut self) -> bool {
        let seen = Seen { cloud: self.cloud, lod: self.lod, sight: &self.sight };
        let begun = self.cut.begin(seen, &mut self.records);
        self.known(begun).is_some()
    }

    /// The part of a node that is met; `None` if every point is seen.
    pub(in crate::trace) fn meet(&mut self, node: &Node) -> Option<NodePart> {
        let (part, _) = self.cut.meet()?;
        let seen = Seen { cloud: self.cloud, lod: self.lod, sight: &self.sight };
        match NodeCut::of(seen, node, part) {
            NodeCut::Whole => None,
            NodeCut::Part(part) => Some(part),
        }
    }

    /// Bounds of influence of a node.
    pub(in crate::trace) fn bounds(&self, node: &Node) -> Aabb {
        self.cloud.as_seen(node.bounds(self.cloud.root_cell), (Some(&self.sight), Some(self.lod)))
    }

    /// Opens a node of which a part is seen, or every point.
    pub(in crate::trace) fn open(&mut self, node: &Node, part: Option<NodePart>) -> Opened {
        let Some(part) = part else {
            self.cut.open_whole();
            return Opened { points: true, children: true };
        };
        let opened = self.open_part(node, part);
        self.known(opened).unwrap_or_default()
    }

    fn open_part(&mut self, node: &Node, part: NodePart) -> Result<Opened, Halt> {
        let seen = Seen { cloud: self.cloud, lod: self.lod, sight: &self.sight };
        let leaf =
            self.cut.cells(&mut self.leaves, (0, seen), &mut self.records, (node, part), |_, _| false)?;
        let some_left = match &leaf {
            _ if f64::from(node.radius_max) > seen.edge(node.level) => true,
            Some(leaf) => leaf.left.as_ref().is_none_or(|left| !Left::is_empty(left)),
            None => part.rest > 0.0,
        };
        let children = part.rest > 0.0 && node.child_mask != 0;
        if children {
            self.cut.open(seen, &mut self.records, (node, part))?;
        }
        Ok(Opened { points: node.own.runs > 0 && some_left, children })
    }

    /// The pages of records that were looked at since this was asked; some several times.
    pub(in crate::trace) fn take_touched(&mut self) -> Vec<u32> {
        self.records.take_touched()
    }

    /// What is known. If it is not for the lack of a page, that is noted; a file that contradicts
    /// itself is reported when rays reach it.
    fn known<T>(&mut self, found: Result<T, Halt>) -> Option<T> {
        match found {
            Ok(found) => Some(found),
            Err(Halt::Deferred(lacking)) => {
                self.absent.push(lacking.page);
                None
            }
            Err(Halt::Failed(_)) => None,
        }
    }
}
