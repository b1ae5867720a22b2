//! Densities at places among the points of a cloud, summed over all points that reach them: the
//! same bits for any threads, budget and order of work.

use std::sync::Arc;

use super::error::AggregateError;
use super::places::PLACES;
use super::points::{Decoder, Points};
use crate::octree::file::Cloud;
use crate::octree::format::Header;
use crate::octree::node::Node;
use crate::octree::page::PointPage;
use crate::octree::walk::{NodePages, Visit, Visitor, Walk};
use rayset_base::geometry::{Aabb, DMat3, DVec3};
use rayset_base::kernel::Kernel;
use rayset_store::working_set::{Object, PageClient, PageGuard};

/// Most points that are looked at together.
const MOST_TOGETHER: usize = 16_384;
/// Fewest places that are divided further if too many points reach them.
const FEWEST_PLACES: usize = 64;
/// Most entries of points in cells.
const MOST_ENTRIES: u32 = 1 << 18;
/// Most cells of a grid along an axis.
const MOST_CELLS: f64 = 24.0;

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
        out: &mut [f64],
    ) -> Result<(), AggregateError> {
        if places.is_empty() {
            return Ok(());
        }
        let bounds = places.iter().fold(Aabb::EMPTY, |bounds, &place| bounds.union(Aabb::new(place, place)));
        if let Some(near) = self.points_near(&bounds)? {
            match self.kernel {
                Kernel::Wyvill => near.sum(places, wyvill, out),
                kernel => near.sum(places, |s| kernel.value(s), out),
            }
            return Ok(());
        }
        if places.len() > FEWEST_PLACES {
            // Places of a point stay together.
            let half = (places.len() / 2).next_multiple_of(PLACES);
            let (before, behind) = out.split_at_mut(half);
            self.densities(&places[..half], alike, before)?;
            return self.densities(&places[half..], alike, behind);
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

    /// The points that may reach a box; `None` if they are too many to be looked at together.
    fn points_near(&self, bounds: &Aabb) -> Result<Option<Near>, AggregateError> {
        let mut near = Near::new(bounds);
        self.each_run_near(bounds, &mut |points| {
            near.take(points);
            near.points.len() <= MOST_TOGETHER
        })?;
        Ok((near.points.len() <= MOST_TOGETHER).then(|| near.in_grid()))
    }

    /// The density at a place that any number of points reach.
    fn density_at(&self, place: DVec3) -> Result<f64, AggregateError> {
        let mut density = 0.0;
        self.each_run_near(&Aabb::new(place, place), &mut |points| {
            for index in 0..points.len() {
                let square = NearPoint::new(points, index, DVec3::ZERO).square(place);
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

/// The points that may reach a box, and which of them may reach which cell of a grid over it.
struct Near {
    bounds: Aabb,
    points: Vec<NearPoint>,
    /// Cells along each axis, and cells in a unit of length.
    cells: [usize; 3],
    per_unit: DVec3,
    /// For each cell, where its entries begin; and where those of the last end. Each cell has a
    /// multiple of [`TOGETHER`].
    first: Vec<u32>,
    entries: Entries,
}

/// For cells of the grid, the points that may reach them, in their order.
#[derive(Default)]
struct Entries {
    /// Numbers of points; any for what fills up a cell.
    of: Vec<u32>,
    /// Relative to the corner of the box.
    position: [Vec<f32>; 3],
    /// The square of a radius, larger by more than what is rounded; negative for what fills up a
    /// cell.
    reach_squared: Vec<f32>,
}

/// A point, for its kernel.
#[derive(Clone, Copy)]
struct NearPoint {
    /// Relative to the corner of the box.
    position: DVec3,
    radius: f64,
    /// Half the edges of the smallest box around it.
    half: DVec3,
    weight: f64,
    /// The map to the unit ball, for points that are no balls; else its only number is 1/r.
    map: DMat3,
    is_ball: bool,
}

impl NearPoint {
    fn new(points: &Points, index: usize, corner: DVec3) -> Self {
        let radius = points.radius[index];
        let (map, half) = match points.shape.get(index) {
            Some(shape) => (shape.unit_from_local() * radius.recip(), shape.half_extent() * radius),
            None => (DMat3::from_diagonal(DVec3::splat(radius.recip())), DVec3::splat(radius)),
        };
        Self {
            position: points.position[index] - corner,
            radius,
            half,
            weight: points.weight[index],
            map,
            is_ball: points.shape.is_empty(),
        }
    }

    /// x² of a place relative to the same corner.
    #[inline(always)]
    fn square(&self, place: DVec3) -> f64 {
        let offset = place - self.position;
        if self.is_ball {
            let inverse = self.map.x_axis.x;
            offset.length_squared() * (inverse * inverse)
        } else {
            (self.map * offset).length_squared()
        }
    }
}

impl Near {
    fn new(bounds: &Aabb) -> Self {
        let entries = Entries::default();
        Self {
            bounds: *bounds,
            points: Vec::new(),
            cells: [1; 3],
            per_unit: DVec3::ZERO,
            first: Vec::new(),
            entries,
        }
    }

    /// Takes those points that may reach the box.
    fn take(&mut self, points: &Points) {
        let Aabb { min, max } = self.bounds;
        for index in 0..points.len() {
            let (position, radius) = (points.position[index], points.radius[index]);
            let distance_squared = (position.clamp(min, max) - position).length_squared();
            if distance_squared < radius * radius && points.weight[index] != 0.0 {
                self.points.push(NearPoint::new(points, index, min));
            }
        }
    }

    /// Finds which points may reach which cell.
    fn in_grid(mut self) -> Self {
        let size = self.bounds.size();
        let count = self.points.len().max(1) as f64;
        let mean = self.points.iter().map(|point| point.radius).sum::<f64>() / count;
        let mut edge = mean.max(size.max_element() / MOST_CELLS);
        self.divide(size, edge);
        while self.first[self.first.len() - 1] > MOST_ENTRIES && self.cells != [1; 3] {
            edge *= 2.0;
            self.divide(size, edge);
        }
        let count = self.first[self.first.len() - 1] as usize;
        let mut entries = Entries {
            of: vec![0; count],
            position: std::array::from_fn(|_| vec![0.0; count]),
            reach_squared: vec![-1.0; count],
        };
        // Coordinates are rounded to parts of the box, and to parts of their own.
        let rounding = 4.0 * f64::from(f32::EPSILON) * (size.max_element() + 4.0 * mean);
        let mut next = self.first.clone();
        for (at, point) in self.points.iter().enumerate() {
            let reach = point.radius * (1.0 + 1e-5) + rounding;
            let reach_squared = (reach * reach) as f32;
            let place = point.position.to_array().map(|v| v as f32);
            self.each_cell_of(point, |cell| {
                let to = next[cell] as usize;
                next[cell] += 1;
                entries.of[to] = at as u32;
                (0..3).for_each(|axis| entries.position[axis][to] = place[axis]);
                entries.reach_squared[to] = reach_squared;
            });
        }
        self.entries = entries;
        self
    }

    /// Divides the box into cells of about an edge, and counts the points that may reach each.
    fn divide(&mut self, size: DVec3, edge: f64) {
        self.cells = size
            .to_array()
            .map(|length| ((length / edge) as usize).saturating_add(1).min(MOST_CELLS as usize));
        self.per_unit = DVec3::from_array(std::array::from_fn(|axis| match size[axis] > 0.0 {
            true => self.cells[axis] as f64 / size[axis],
            false => 0.0,
        }));
        let mut first = vec![0_u32; self.cells.iter().product::<usize>() + 1];
        for point in &self.points {
            self.each_cell_of(point, |cell| first[cell + 1] += 1);
        }
        for cell in 1..first.len() {
            first[cell] = first[cell - 1] + first[cell].next_multiple_of(TOGETHER as u32);
        }
        self.first = first;
    }

    /// Calls `visit` for each cell that a point may reach.
    #[inline(always)]
    fn each_cell_of(&self, point: &NearPoint, mut visit: impl FnMut(usize)) {
        let NearPoint { position, half, .. } = *point;
        let [low, high] = [position - half, position + half].map(|place| self.cell_of(place));
        for z in low[2]..=high[2] {
            for y in low[1]..=high[1] {
                let row = (z * self.cells[1] + y) * self.cells[0];
                (row + low[0]..=row + high[0]).for_each(&mut visit);
            }
        }
    }

    /// The cell of a place relative to the corner of the box, or the nearest.
    #[inline(always)]
    fn cell_of(&self, place: DVec3) -> [usize; 3] {
        let in_cells = place * self.per_unit;
        std::array::from_fn(|axis| (in_cells[axis].max(0.0) as usize).min(self.cells[axis] - 1))
    }

    /// The sums over all points at places in the box, in the order of the points.
    fn sum(&self, places: &[DVec3], kernel: impl Fn(f64) -> f64, out: &mut [f64]) {
        for (place, density) in places.iter().zip(out) {
            let place = *place - self.bounds.min;
            let [x, y, z] = self.cell_of(place);
            let cell = (z * self.cells[1] + y) * self.cells[0] + x;
            let entries = self.first[cell] as usize..self.first[cell + 1] as usize;
            *density = 0.0;
            for first in entries.step_by(TOGETHER) {
                let mut near = self.entries.near(first, place.to_array().map(|v| v as f32));
                while near != 0 {
                    let at = first + near.trailing_zeros() as usize;
                    near &= near - 1;
                    let point = &self.points[self.entries.of[at] as usize];
                    let square = point.square(place);
                    if square < 1.0 {
                        *density += point.weight * kernel(square);
                    }
                }
            }
        }
    }
}

/// Entries that are looked at together.
const TOGETHER: usize = 8;

impl Entries {
    /// Which of the entries from one on may reach a place, a bit for each.
    #[inline(always)]
    fn near(&self, first: usize, place: [f32; 3]) -> u32 {
        let of = |column: &[f32]| -> [f32; TOGETHER] {
            std::array::from_fn(|at| column[first..first + TOGETHER][at])
        };
        let [x, y, z] = self.position.each_ref().map(|column| of(column));
        let reach_squared = of(&self.reach_squared);
        let mut near = 0;
        for at in 0..TOGETHER {
            let (x, y, z) = (x[at] - place[0], y[at] - place[1], z[at] - place[2]);
            near |= u32::from(x * x + y * y + z * z < reach_squared[at]) << at;
        }
        near
    }
}

/// [`Kernel::Wyvill`], where s < 1.
fn wyvill(s: f64) -> f64 {
    1.0 + s * (-22.0 / 9.0 + s * (17.0 / 9.0 - s * (4.0 / 9.0)))
}
