//! Densities at places among the points of a cloud, summed over all points that reach them: the
//! same bits for any threads, budget and order of work.

use std::sync::Arc;

use super::error::AggregateError;
use super::near_points::NearPoints;
use super::places::PLACES;
use super::points::{Decoder, Points};
use crate::octree::file::Cloud;
use crate::octree::format::Header;
use crate::octree::node::Node;
use crate::octree::page::PointPage;
use crate::octree::walk::{NodePages, Visit, Visitor, Walk};
use rayset_base::geometry::{Aabb, DVec3};
use rayset_base::kernel::Kernel;
use rayset_store::working_set::{Object, PageClient, PageGuard};

/// Most points that are looked at together.
const MOST_TOGETHER: usize = 16_384;
/// Fewest places that are divided further if too many points reach them.
const FEWEST_PLACES: usize = 64;

/// The pages of a cloud.
#[derive(Clone, Copy)]
pub(super) struct CloudPages<'a> {
    pub(super) cloud: &'a Cloud,
    pub(super) client: &'a PageClient,
    pub(super) object: &'a Arc<Object>,
}

impl CloudPages<'_> {
    pub(super) fn retain(&self, page: u32) -> Result<PageGuard, AggregateError> {
        self.client.retain(self.object, page).map_err(AggregateError::from)
    }

    /// The error for a page that is intact but contradicts another page.
    pub(super) fn broken(&self, page: u32) -> AggregateError {
        let header = self.cloud.header();
        AggregateError::broken(self.cloud.path().to_owned(), page, header.page_offset(page))
    }

    /// Calls `visit` with each of a node's own runs.
    pub(super) fn each_own_run(
        &self,
        node: &Node,
        mut visit: impl FnMut(&PointPage<'_>, usize) -> Result<(), AggregateError>,
    ) -> Result<(), AggregateError> {
        let (own, header) = (node.own, self.cloud.header());
        let (mut page, mut run, mut left) = (own.first_page, usize::from(own.first_run), own.runs as usize);
        while left > 0 {
            if page >= header.point_pages {
                return Err(self.broken(page));
            }
            let guard = self.retain(page)?;
            let points = PointPage::trusted(&guard, header);
            let here = left.min(points.len().saturating_sub(run));
            if here == 0 {
                return Err(self.broken(page));
            }
            (run..run + here).try_for_each(|index| visit(&points, index))?;
            left -= here;
            (page, run) = (page + 1, 0);
        }
        Ok(())
    }
}

impl NodePages for CloudPages<'_> {
    type Page = PageGuard;
    type Error = AggregateError;

    fn header(&self) -> &Header {
        self.cloud.header()
    }

    fn page(&mut self, page: u32) -> Result<Option<PageGuard>, AggregateError> {
        self.retain(self.cloud.header().point_pages + page).map(Some)
    }

    fn no_tree(&mut self, page: u32) -> Result<(), AggregateError> {
        Err(self.broken(self.cloud.header().point_pages + page))
    }
}

/// The field of a cloud's points.
pub(super) struct Field<'a> {
    pub(super) pages: CloudPages<'a>,
    pub(super) decoder: &'a Decoder<'a>,
    pub(super) kernel: Kernel,
}

impl Field<'_> {
    /// The densities at places, which lie near each other in groups. If very many points reach a
    /// few dozen places, only the first of every `alike` has its own, and the others have that of
    /// the last before them.
    pub(super) fn densities(
        &self,
        places: &[DVec3],
        alike: usize,
        near: &mut NearPoints,
        out: &mut [f64],
    ) -> Result<(), AggregateError> {
        if places.is_empty() {
            return Ok(());
        }
        let bounds = places.iter().fold(Aabb::EMPTY, |bounds, &place| bounds.union(Aabb::new(place, place)));
        if self.find_points_near(&bounds, near)? {
            near.sum(self.kernel, places, out);
            return Ok(());
        }
        if places.len() > FEWEST_PLACES {
            // Places of a point stay together.
            let half = (places.len() / 2).next_multiple_of(PLACES);
            let (before, behind) = out.split_at_mut(half);
            self.densities(&places[..half], alike, near, before)?;
            return self.densities(&places[half..], alike, near, behind);
        }
        let mut last = 0.0;
        for (at, (place, density)) in places.iter().zip(out).enumerate() {
            if at.is_multiple_of(alike) {
                last = self.density_at(*place)?;
            }
            *density = last;
        }
        Ok(())
    }

    /// Finds the points that may reach a box; false if they are too many to be looked at together.
    fn find_points_near(&self, bounds: &Aabb, near: &mut NearPoints) -> Result<bool, AggregateError> {
        near.begin(bounds);
        self.each_run_near(bounds, &mut |points| {
            near.take(points);
            near.len() <= MOST_TOGETHER
        })?;
        Ok(near.len() <= MOST_TOGETHER)
    }

    /// The density at a place that any number of points reach.
    fn density_at(&self, place: DVec3) -> Result<f64, AggregateError> {
        let mut density = 0.0;
        self.each_run_near(&Aabb::new(place, place), &mut |points| {
            for index in 0..points.len() {
                let square = points.square(index, place);
                if square < 1.0 {
                    density += points.weight[index] * self.kernel.value(square);
                }
            }
            true
        })?;
        Ok(density)
    }

    /// Calls `visit` with the points of each run that may reach a box, in an order of the tree,
    /// until it returns false.
    fn each_run_near(
        &self,
        bounds: &Aabb,
        visit: &mut dyn FnMut(&Points) -> bool,
    ) -> Result<(), AggregateError> {
        let (waiting, scratch) = (Vec::new(), Points::default());
        let mut search = Search { field: self, bounds, waiting, scratch, visit };
        let (mut walk, mut pages) = (Walk::new(), self.pages);
        walk.begin(&mut pages, &mut search)?;
        walk.go_on(&mut pages, &mut search)
    }
}

/// Looks for the runs that reach a box.
struct Search<'t> {
    field: &'t Field<'t>,
    bounds: &'t Aabb,
    /// The last comes first.
    waiting: Vec<Node>,
    scratch: Points,
    visit: &'t mut dyn FnMut(&Points) -> bool,
}

impl<'a> Visitor<CloudPages<'a>> for Search<'_> {
    fn meet(&mut self, node: Node) {
        let root = self.field.pages.cloud.header().root_cell();
        if !node.bounds(root).intersection(*self.bounds).is_empty() {
            self.waiting.push(node);
        }
    }

    fn next(&mut self) -> Option<Node> {
        self.waiting.pop()
    }

    fn visit(
        &mut self,
        node: &Node,
        walk: &mut Walk,
        _: &mut CloudPages<'a>,
    ) -> Result<Visit, AggregateError> {
        let pages = self.field.pages;
        let header = pages.cloud.header();
        if !walk.may_look_at_runs_of(node, header) {
            return Err(pages.broken(node.own.first_page));
        }
        let Self { field, bounds, scratch, visit, .. } = self;
        let mut goes_on = true;
        pages.each_own_run(node, |page, index| {
            let head = page.head(index);
            let reach = f64::from(head.radius_max()) * (1.0 + 1e-5);
            let near = head.position_bounds(header.root_cell()).inflated(reach).intersection(**bounds);
            if goes_on && !near.is_empty() {
                scratch.clear();
                field.decoder.append_solid(&page.run(index), scratch);
                goes_on = visit(scratch);
            }
            Ok(())
        })?;
        Ok(if goes_on { Visit::Open } else { Visit::Stop })
    }
}
