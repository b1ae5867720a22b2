//! Where a cloud is in the world and in memory: its spaces, the pages of its octree, and the bounds
//! of its nodes.

use std::ops::Range;
use std::sync::Arc;

use super::lod::CloudLod;
use crate::field::{Kernel, Packet, Sight, SplatFilter};
use crate::scene::{CloudObject, largest_stretch};
use crate::trace::RenderError;
use crate::trace::access::{Access, Halt};
use crate::trace::unopened::Unopened;
use rayset_base::geometry::{Aabb, DAffine3, DVec3, Ray};
use rayset_files::PagedFiles;
use rayset_files::octree::Cloud;
use rayset_files::octree::format::Header;
use rayset_files::octree::layout::{RUN_POINTS, RootCell};
use rayset_files::octree::node::Node;
use rayset_store::working_set::{Object, PageFault, PageGuard};

/// A cloud, placed in the world by the graph.
pub(in crate::trace) struct CloudPlacement<P = Arc<Object>> {
    cloud: Arc<Cloud>,
    pub(in crate::trace) pages: P,
    pub(in crate::trace) root_cell: RootCell,
    pub(in crate::trace) first_node_page: u32,
    /// `None` if local space and world space are the same.
    local_from_world: Option<DAffine3>,
    world_from_local: DAffine3,
    /// The smallest length in local space of a unit vector in world space.
    least_stretch: f64,
    /// Least and largest length, in local space, of which steps are a fraction.
    pub(in crate::trace) details: (f32, f32),
    pub(in crate::trace) are_splats: bool,
    filter: SplatFilter,
}

impl CloudPlacement<Unopened> {
    pub(in crate::trace) fn new(object: &CloudObject, world_from_local: &DAffine3) -> Self {
        let cloud = &object.cloud;
        let header = cloud.header();
        Self {
            pages: Unopened,
            root_cell: header.root_cell(),
            first_node_page: header.point_pages,
            local_from_world: (*world_from_local != DAffine3::IDENTITY).then(|| world_from_local.inverse()),
            world_from_local: *world_from_local,
            least_stretch: 1.0 / largest_stretch(world_from_local),
            details: object.details(),
            are_splats: object.kernel == Kernel::Splat,
            filter: object.splat_filter,
            cloud: cloud.clone(),
        }
    }

    /// With the pages of the cloud in a working set; `None` if they are in none.
    pub(super) fn open(self, paged: &PagedFiles) -> Option<CloudPlacement> {
        let Self { cloud, root_cell, first_node_page, local_from_world, details, are_splats, .. } = self;
        let (world_from_local, least_stretch, filter) =
            (self.world_from_local, self.least_stretch, self.filter);
        let pages = paged.find(&cloud)?.clone();
        Some(CloudPlacement {
            cloud,
            pages,
            root_cell,
            first_node_page,
            local_from_world,
            world_from_local,
            least_stretch,
            details,
            are_splats,
            filter,
        })
    }
}

impl<P> CloudPlacement<P> {
    /// Whether its points are splats that are wider for those who see them.
    pub(in crate::trace) fn is_filtered(&self) -> bool {
        self.filter != SplatFilter::None
    }

    pub(in crate::trace) fn cloud(&self) -> &Arc<Cloud> {
        &self.cloud
    }

    pub(in crate::trace) fn header(&self) -> &Header {
        self.cloud.header()
    }

    pub(in crate::trace) fn local_from_world(&self) -> Option<&DAffine3> {
        self.local_from_world.as_ref()
    }
}

impl CloudPlacement {
    /// A packet in the cloud's space.
    pub(in crate::trace) fn local(&self, packet: &Packet) -> Packet {
        self.local_from_world
            .as_ref()
            .map_or_else(|| packet.clone(), |map| packet.in_local_space(map, self.least_stretch))
    }

    /// A ray in the cloud's space, parametrised by distance in world space; its direction is not
    /// normalised.
    pub(in crate::trace) fn local_ray(&self, ray: &Ray) -> Ray {
        self.local_from_world.as_ref().map_or(*ray, |map| Ray {
            origin: map.transform_point3(ray.origin),
            direction: map.transform_vector3(ray.direction),
        })
    }

    /// How the cloud is seen, in local space; `None` of splats that are not shown.
    pub(in crate::trace) fn local_sight(&self, sight: Option<&Sight>) -> Option<Sight> {
        let sight = sight.filter(|sight| sight.is_shown || !self.are_splats);
        sight.map(|sight| self.local_from_world.as_ref().map_or(*sight, |map| sight.transformed(map)))
    }

    /// How much farther any of its points reaches for those who see it; world space.
    pub(in crate::trace) fn reach_world(&self, sight: Option<&Sight>, lod: Option<&CloudLod>) -> f64 {
        let Some(local) = self.local_sight(sight) else { return 0.0 };
        let bounds = &self.header().bounds;
        let reach = match lod {
            Some(lod) => lod.reach_in(bounds, &lod.sight(&local), self.header().radius.max().into()),
            None if self.filter != SplatFilter::None => self.filter.reach_in(bounds, &local),
            None => 0.0,
        };
        reach / self.least_stretch
    }

    /// A box in which points are, as far as they reach for those who see them; local space.
    pub(in crate::trace) fn as_seen(
        &self,
        bounds: Aabb,
        (sight, lod): (Option<&Sight>, Option<&CloudLod>),
    ) -> Aabb {
        match sight {
            Some(sight) if let Some(lod) = lod => {
                bounds.inflated(lod.reach_in(&bounds, sight, self.header().radius.max().into()))
            }
            Some(sight) if self.filter != SplatFilter::None => {
                bounds.inflated(self.filter.reach_in(&bounds, sight))
            }
            _ => bounds,
        }
    }

    /// Length in local space of a unit of world space along a direction.
    pub(in crate::trace) fn stretch_along(&self, direction_world: DVec3) -> f64 {
        self.local_from_world.as_ref().map_or(1.0, |map| map.transform_vector3(direction_world).length())
    }

    /// The least length in local space of a unit of world space.
    pub(in crate::trace) fn least_stretch(&self) -> f64 {
        self.least_stretch
    }

    /// The largest detail of any point along any direction, world space.
    pub(in crate::trace) fn largest_detail_world(&self) -> f64 {
        let stretch =
            if self.local_from_world.is_some() { largest_stretch(&self.world_from_local) } else { 1.0 };
        f64::from(self.details.1) * stretch
    }

    /// Bounds of influence of a node, world space.
    pub(in crate::trace) fn bounds_world_of(&self, node: &Node) -> Aabb {
        node.bounds(self.root_cell).transformed(&self.world_from_local)
    }

    /// The pages of a node's own points, estimated: for hints, where an error does no harm.
    pub(in crate::trace) fn own_pages(&self, node: &Node) -> Range<u32> {
        let own = node.own;
        if own.runs == 0 {
            return 0..0;
        }
        // Only a page itself knows its number of runs; the estimate uses the mean.
        let header = self.header();
        let runs = (header.points / RUN_POINTS as u64).max(1);
        let runs_per_page = (runs / u64::from(header.point_pages).max(1)).max(1);
        let last_run = u64::from(own.first_run) + u64::from(own.runs) - 1;
        let pages = u32::try_from(last_run / runs_per_page).unwrap_or(u32::MAX);
        own.first_page..own.first_page.saturating_add(pages).saturating_add(1).min(self.first_node_page)
    }

    /// The pages that may hold a node's own points: more than [`own_pages`](Self::own_pages) where
    /// pages of fewer runs than usual could make a difference.
    pub(in crate::trace) fn own_pages_at_most(&self, node: &Node) -> Range<u32> {
        /// Pages that hold so much less than the mean, in parts of it, are rare.
        const LESS: f64 = 0.25;
        let usual = self.own_pages(node);
        if usual.is_empty() {
            return usual;
        }
        let header = self.header();
        let runs_per_page = header.points as f64 / RUN_POINTS as f64 / f64::from(header.point_pages.max(1));
        let runs = f64::from(node.own.first_run) + node.own.runs as f64;
        let pages = (runs / (runs_per_page * (1.0 - LESS)).max(1.0)).ceil() as u32;
        let end = usual.start.saturating_add(pages).min(self.first_node_page);
        usual.start..end.max(usual.end)
    }

    /// The pages needed to open a node: those of its own points and of its children's records.
    pub(in crate::trace) fn pages_to_open(&self, node: &Node) -> impl Iterator<Item = u32> + use<> {
        let children = (node.child_mask != 0).then_some(self.first_node_page + node.first_child.page);
        self.own_pages(node).chain(children)
    }

    /// The first page of records of aggregates, or the last of all if there are none.
    pub(in crate::trace) fn first_record_page(&self) -> u32 {
        let header = self.header();
        (header.point_pages + header.node_pages).min(header.pages().saturating_sub(1))
    }

    /// The error for a page that is intact but contradicts another page.
    pub(in crate::trace) fn broken(&self, page: u32) -> RenderError {
        RenderError::Page(PageFault::Damaged {
            name: self.cloud.path().display().to_string(),
            page,
            offset: self.header().page_offset(page),
            what: "the octree refers to a record that is not there".into(),
        })
    }
}

impl Access<'_> {
    /// Retains a page of a cloud.
    pub(in crate::trace) fn retain(&self, cloud: &CloudPlacement, page: u32) -> Result<PageGuard, Halt> {
        self.retain_page(&cloud.pages, page)
    }
}
