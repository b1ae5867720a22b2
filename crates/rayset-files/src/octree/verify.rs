//! Verifying a whole file: every checksum and record, and every bound and total that rendering
//! relies on.

use super::aggregates::{self, AggregateError};
use super::file::Cloud;
use super::format::Header;
use super::layout::NodeRef;
use super::node::{Node, NodePage};
use super::page::{PointPage, Run};
use super::shape::StoredShape;
use crate::paged_file::{HasPages, PagedHeader};
use rayset_base::geometry::Aabb;
use rayset_store::container::ScanError;
use rayset_store::working_set::Kind;

/// How much to check.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Default)]
#[non_exhaustive]
pub enum Depth {
    /// Header, footer and length: what opening a file checks.
    Quick,
    /// Also every page: checksum, place, and that every record lies within its page.
    #[default]
    Pages,
    /// Also every bound and total against the points themselves.
    Deep,
}

/// How much was verified.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(not(feature = "internals"), non_exhaustive)]
pub struct VerifyReport {
    /// Number of pages checked.
    pub pages: u32,
    /// Number of runs checked.
    pub runs: u64,
    /// Number of points checked.
    pub points: u64,
    /// Number of nodes checked against their points.
    pub nodes: u64,
    /// Number of aggregates checked against their points.
    pub aggregates: u32,
}

/// What is wrong with a file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum VerifyError {
    /// A page cannot be read or is damaged.
    #[error(transparent)]
    Scan(#[from] ScanError),
    /// A bound or total does not hold.
    #[error("node {index} of node page {page}: {what}")]
    Node {
        /// Index of the node page.
        page: u32,
        /// Index of the record in the page.
        index: u16,
        /// What is wrong.
        what: &'static str,
    },
    /// Another value in the header does not hold.
    #[error("what the file says of all points: {what}")]
    Header {
        /// What is wrong.
        what: &'static str,
    },
    /// An aggregate is not what its points make, or they could not be made again to be compared.
    #[error(transparent)]
    Aggregates(#[from] AggregateError),
    /// The number of points does not hold.
    #[error("the header says {expected} points, the pages hold {found}")]
    Points {
        /// The number in the header.
        expected: u64,
        /// The number in the pages.
        found: u64,
    },
}

impl Cloud {
    /// Verifies the file to the given depth. Holds one page at a time, and with [`Depth::Deep`]
    /// also all nodes and a summary of each run, and what it takes to make the aggregates again.
    ///
    /// # Errors
    /// [`VerifyError`] for the first thing that is wrong.
    pub fn verify(&self, depth: Depth) -> Result<VerifyReport, VerifyError> {
        verify(self.as_stored(), depth)
    }
}

/// Verifies an open cloud. Holds one page at a time, and with [`Depth::Deep`] also all nodes and a
/// summary of each run.
///
/// # Errors
/// [`VerifyError`] for the first thing that is wrong.
fn verify(cloud: &Cloud, depth: Depth) -> Result<VerifyReport, VerifyError> {
    let mut report = VerifyReport::default();
    if depth == Depth::Quick {
        return Ok(report);
    }
    let header = cloud.header();
    let mut runs: Vec<RunFacts> = Vec::new();
    let mut first_run_of_page: Vec<usize> = Vec::new();
    let mut nodes: Vec<Vec<Node>> = Vec::new();
    cloud.stored_file().for_each_page(|page, bytes| {
        report.pages += 1;
        match header.kind_of_page(page) {
            Kind::Points => {}
            Kind::Octree if depth == Depth::Deep => {
                let records = NodePage::trusted(bytes);
                nodes.push((0..records.len()).filter_map(|i| records.get(i)).collect());
                return;
            }
            _ => return,
        }
        let points = PointPage::trusted(bytes, header);
        first_run_of_page.push(runs.len());
        for index in 0..points.len() {
            let run = points.run(index);
            report.runs += 1;
            report.points += run.head.len() as u64;
            if depth == Depth::Deep {
                runs.push(RunFacts::of(&run, cloud));
            }
        }
    })?;
    if report.points != header.points {
        return Err(VerifyError::Points { expected: header.points, found: report.points });
    }
    if depth == Depth::Deep && header.points > 0 {
        let seen = nodes.iter().map(|page| vec![false; page.len()]).collect();
        let taken = vec![false; runs.len()];
        let mut facts = Facts { cloud, runs, first_run_of_page, nodes, seen, taken };
        let root = facts.check(header.root, &mut report)?;
        if root.points != header.points {
            return Err(VerifyError::Points { expected: header.points, found: root.points });
        }
        check_header(header, &root, report.nodes).map_err(|what| VerifyError::Header { what })?;
        report.aggregates = aggregates::compare(cloud)?;
    }
    Ok(report)
}

/// Compares the header with the facts about all points.
fn check_header(header: &Header, root: &RunFacts, nodes: u64) -> Result<(), &'static str> {
    if nodes != header.nodes {
        return Err("its number of nodes is wrong");
    }
    if root.radius_min != header.radius.min() || root.radius_max != header.radius.max() {
        return Err("its smallest or largest radius is wrong");
    }
    if (root.detail_min, root.detail_max) != header.details() {
        return Err("its smallest or largest detail is wrong");
    }
    if root.weight_min != header.weight.min() || root.weight_max != header.weight.max() {
        return Err("its smallest or largest weight is wrong");
    }
    if !header.bounds.inflated(rounding(header)).encloses(&root.positions) {
        return Err("a point lies outside its bounds");
    }
    Ok(())
}

/// Bound on the rounding error of a position, which is the sum of a place in the root cell and an
/// offset, in world space.
fn rounding(header: &Header) -> f64 {
    4.0 * f64::EPSILON * (header.root_min.abs().max_element() + header.root_size)
}

/// Facts about a set of points.
#[derive(Clone, Copy)]
struct RunFacts {
    influence: Aabb,
    points: u64,
    positions: Aabb,
    weight_sum: f64,
    weight_size: f64,
    weight_min: f32,
    weight_max: f32,
    radius_min: f32,
    detail_min: f32,
    detail_max: f32,
    radius_max: f32,
    within_own_bounds: bool,
}

impl RunFacts {
    const NONE: Self = Self {
        influence: Aabb::EMPTY,
        points: 0,
        positions: Aabb::EMPTY,
        weight_sum: 0.0,
        weight_size: 0.0,
        weight_min: f32::INFINITY,
        weight_max: f32::NEG_INFINITY,
        radius_min: f32::INFINITY,
        detail_min: f32::INFINITY,
        detail_max: 0.0,
        radius_max: 0.0,
        within_own_bounds: true,
    };

    fn of(run: &Run<'_>, cloud: &Cloud) -> Self {
        let header = cloud.header();
        let root = header.root_cell();
        let n = run.head.len();
        let radii: Vec<f32> =
            run.radii(header).map_or_else(|| vec![header.radius.min(); n], Iterator::collect);
        let weights: Vec<f32> =
            run.weights(header).map_or_else(|| vec![header.weight.min(); n], Iterator::collect);
        let bounds = run.head.position_bounds(root).inflated(rounding(header));
        let mut facts = Self { points: n as u64, ..Self::NONE };
        let shapes: Vec<StoredShape> =
            run.shapes(header).map_or_else(|| vec![StoredShape::BALL; n], Iterator::collect);
        let positions = run.positions(root);
        for (((p, r), w), shape) in positions.into_iter().zip(radii).zip(weights).zip(shapes) {
            let (reach, detail) = (shape.half_extent(r), shape.detail(r));
            facts.influence = facts.influence.union(Aabb::new(p - reach, p + reach));
            facts.positions.include(p);
            facts.weight_min = facts.weight_min.min(w);
            facts.weight_max = facts.weight_max.max(w);
            facts.weight_sum += f64::from(w);
            facts.weight_size += f64::from(w).abs();
            facts.radius_min = facts.radius_min.min(r);
            facts.detail_min = facts.detail_min.min(detail);
            facts.detail_max = facts.detail_max.max(detail);
            facts.radius_max = facts.radius_max.max(r);
            facts.within_own_bounds &= bounds.contains(p) && r <= run.head.radius_max();
        }
        facts
    }

    fn merge(&mut self, other: &Self) {
        self.influence = self.influence.union(other.influence);
        self.points += other.points;
        self.positions = self.positions.union(other.positions);
        self.weight_min = self.weight_min.min(other.weight_min);
        self.weight_max = self.weight_max.max(other.weight_max);
        self.weight_sum += other.weight_sum;
        self.weight_size += other.weight_size;
        self.radius_min = self.radius_min.min(other.radius_min);
        self.detail_min = self.detail_min.min(other.detail_min);
        self.detail_max = self.detail_max.max(other.detail_max);
        self.radius_max = self.radius_max.max(other.radius_max);
        self.within_own_bounds &= other.within_own_bounds;
    }
}

struct Facts<'a> {
    cloud: &'a Cloud,
    runs: Vec<RunFacts>,
    first_run_of_page: Vec<usize>,
    nodes: Vec<Vec<Node>>,
    /// Which nodes have been visited, and which runs have already been owned by a node.
    seen: Vec<Vec<bool>>,
    taken: Vec<bool>,
}

impl Facts<'_> {
    /// Checks a node and everything below it; returns the facts about its points. Levels increase
    /// up to the deepest one, and no node is visited twice, so this takes at most as many steps as
    /// there are nodes.
    fn check(&mut self, place: NodeRef, report: &mut VerifyReport) -> Result<RunFacts, VerifyError> {
        let wrong = |what| VerifyError::Node { page: place.page, index: place.index, what };
        let node = self.nodes.get(place.page as usize).and_then(|p| p.get(usize::from(place.index)));
        let node = *node.ok_or_else(|| wrong("the record is not there"))?;
        if std::mem::replace(&mut self.seen[place.page as usize][usize::from(place.index)], true) {
            return Err(wrong("two nodes have it for a child"));
        }
        report.nodes += 1;
        let mut facts = RunFacts::NONE;
        let own = node.own;
        if own.runs > 0 {
            let page = self.first_run_of_page.get(own.first_page as usize);
            let first = page.ok_or_else(|| wrong("its points are in no page"))? + usize::from(own.first_run);
            let range = first..first + own.runs as usize;
            let taken = self.taken.get_mut(range.clone());
            let taken = taken.ok_or_else(|| wrong("its runs go beyond the last page"))?;
            if std::mem::replace(&mut taken[0], true) || taken[1..].iter().any(|&taken| taken) {
                return Err(wrong("its runs are another node's, too"));
            }
            taken.fill(true);
            self.runs[range].iter().for_each(|run| facts.merge(run));
        }
        for child in 0..node.child_mask.count_ones() as u16 {
            let index = node.first_child.index.saturating_add(child);
            let below = NodeRef { page: node.first_child.page, index };
            let child = self.nodes.get(below.page as usize).and_then(|p| p.get(usize::from(index)));
            if !child.is_some_and(|child| child.is_child_of(&node)) {
                return Err(wrong("a child is not one level further down"));
            }
            facts.merge(&self.check(below, report)?);
        }
        if !facts.within_own_bounds {
            return Err(wrong("a point lies outside the bounds of its run"));
        }
        let header = self.cloud.header();
        let bounds = node.bounds(header.root_cell()).inflated(rounding(header));
        if !bounds.encloses(&facts.influence) {
            return Err(wrong("a point reaches beyond its bounds"));
        }
        if facts.points != node.points {
            return Err(wrong("its number of points is wrong"));
        }
        if facts.radius_max != node.radius_max {
            return Err(wrong("its largest radius is wrong"));
        }
        let is_bound = facts.detail_max <= node.detail_max && node.detail_max <= 1.01 * facts.detail_max;
        if facts.detail_min != node.detail_min || !is_bound {
            return Err(wrong("its smallest or largest detail is wrong"));
        }
        if !((facts.weight_sum - node.weight_sum).abs() <= 1e-9 * facts.weight_size) {
            return Err(wrong("its sum of weights is wrong"));
        }
        Ok(facts)
    }
}
