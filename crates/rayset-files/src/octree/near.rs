//! Looking a place up in a cloud's file: its nearest point, and where in space its pages lie. Pages
//! are read one at a time, besides those of any session.

use std::ops::Range;
use std::sync::Arc;

use super::file::Cloud;
use super::format::Header;
use super::node::{Node, NodePage, RunRange};
use super::page::PointPage;
use super::walk::{NodePages, Visit, Visitor, Walk};
use crate::paged_file::HasPages;
use crate::points::PointBatch;
use rayset_base::geometry::{Aabb, DVec3};
use rayset_base::nearest_first::NearestFirst;
use rayset_store::container::{OpenFile, PageError, ScanError, SectionKind};

impl Cloud {
    /// The point whose centre is nearest to a place, with its columns as [`sample`](Self::sample)
    /// has them; an empty batch if none is within a distance. Of equally near ones, any.
    ///
    /// # Errors
    /// [`ScanError`] if a page cannot be read or is damaged.
    pub fn nearest(&self, place: DVec3, within: f64) -> Result<PointBatch, ScanError> {
        let mut found = self.empty_batch();
        if self.header().points == 0 {
            return Ok(found);
        }
        let mut pages = Pages::new(self)?;
        let waiting = NearestFirst::default();
        let mut lookup = Lookup { cloud: self, place, nearest: within * within, found: &mut found, waiting };
        let mut walk = Walk::new();
        walk.begin(&mut pages, &mut lookup)?;
        walk.go_on(&mut pages, &mut lookup)?;
        Ok(found)
    }

    /// The error for a page that belongs to nodes that make no tree.
    fn broken(&self, page: u32) -> ScanError {
        let (path, offset) = (self.path().to_owned(), self.header().page_offset(page));
        let source = PageError::Content { what: "nodes that are no tree" };
        ScanError::Damaged { path, page, offset, source }
    }

    /// The point pages in at most `most` groups of neighbours, each with the bounds of what its
    /// points influence. Reads all pages of nodes.
    ///
    /// # Errors
    /// [`ScanError`] if a page cannot be read or is damaged.
    pub fn page_regions(&self, most: usize) -> Result<Vec<(Range<u32>, Aabb)>, ScanError> {
        let header = self.header();
        let (pages, most) = (header.point_pages, most.clamp(1, u32::MAX as usize) as u32);
        let in_group = pages.div_ceil(most).max(1);
        let mut groups: Vec<Group> = (0..pages.div_ceil(in_group)).map(|_| Group::default()).collect();
        let reader = Pages::new(self)?;
        for page in 0..header.node_pages {
            let bytes = reader.read(SectionKind::NODES, page)?;
            let nodes = NodePage::scaled(&bytes, self.header());
            for node in (0..nodes.len()).filter_map(|index| nodes.get(index)).filter(|node| node.own.runs > 0)
            {
                let group = &mut groups[(node.own.first_page / in_group) as usize];
                group.add(&node, node.bounds(header.root_cell()), in_group);
            }
        }
        let mut regions: Vec<(Range<u32>, Aabb)> = Vec::with_capacity(groups.len());
        let mut last = Aabb::EMPTY;
        for (first, group) in (0..pages).step_by(in_group as usize).zip(groups) {
            let own = if group.of_leaves.is_empty() { group.of_others } else { group.of_leaves };
            let bounds = if group.has_a_beginning { own } else { own.union(last) };
            regions.push((first..(first + in_group).min(pages), bounds));
            last = group.last.map_or(last, |(_, bounds)| bounds);
        }
        Ok(regions)
    }
}

/// What is known of the nodes whose points begin in a group of pages.
struct Group {
    of_leaves: Aabb,
    /// Of nodes with children, which reach far beyond their own points.
    of_others: Aabb,
    /// Whether points of a node begin where the group does; else those of the last node before it
    /// go on here.
    has_a_beginning: bool,
    /// The page and run at which the last node's points begin, and its bounds.
    last: Option<((u32, u16), Aabb)>,
}

impl Default for Group {
    fn default() -> Self {
        Self { of_leaves: Aabb::EMPTY, of_others: Aabb::EMPTY, has_a_beginning: false, last: None }
    }
}

impl Group {
    fn add(&mut self, node: &Node, bounds: Aabb, in_group: u32) {
        let of_nodes = if node.child_mask == 0 { &mut self.of_leaves } else { &mut self.of_others };
        *of_nodes = of_nodes.union(bounds);
        let at = (node.own.first_page, node.own.first_run);
        self.has_a_beginning |= at.0.is_multiple_of(in_group) && at.1 == 0;
        if self.last.is_none_or(|(last, _)| at > last) {
            self.last = Some((at, bounds));
        }
    }
}

/// Pages of a cloud's file, checked.
struct Pages<'a> {
    cloud: &'a Cloud,
    file: OpenFile,
    /// The page of nodes that was read last: children most often lie in that of their parent.
    nodes: Option<(u32, Arc<[u8]>)>,
}

impl<'a> Pages<'a> {
    fn new(cloud: &'a Cloud) -> Result<Self, ScanError> {
        Ok(Self { cloud, file: cloud.stored_file().reopened()?, nodes: None })
    }

    fn read(&self, kind: SectionKind, index: u32) -> Result<Vec<u8>, ScanError> {
        let first = if kind == SectionKind::POINTS { 0 } else { self.cloud.header().point_pages };
        let (offset, bytes) = self.file.page(kind, index)?;
        self.cloud.stored_file().check(first + index, offset, &bytes)?;
        Ok(bytes)
    }
}

impl NodePages for Pages<'_> {
    type Page = Arc<[u8]>;
    type Error = ScanError;

    fn header(&self) -> &Header {
        self.cloud.header()
    }

    fn page(&mut self, page: u32) -> Result<Option<Arc<[u8]>>, ScanError> {
        if let Some((_, bytes)) = self.nodes.as_ref().filter(|(known, _)| *known == page) {
            return Ok(Some(bytes.clone()));
        }
        let bytes: Arc<[u8]> = self.read(SectionKind::NODES, page)?.into();
        self.nodes = Some((page, bytes.clone()));
        Ok(Some(bytes))
    }

    fn no_tree(&mut self, page: u32) -> Result<(), ScanError> {
        Err(self.cloud.broken(self.cloud.header().point_pages + page))
    }
}

/// The search for the point that is nearest to a place.
struct Lookup<'t> {
    cloud: &'t Cloud,
    place: DVec3,
    /// The square of the distance of the nearest point so far.
    nearest: f64,
    found: &'t mut PointBatch,
    /// By a least square of the distance of the points at and below a node.
    waiting: NearestFirst<f64, Node>,
}

impl<'t> Visitor<Pages<'t>> for Lookup<'_> {
    fn meet(&mut self, node: Node) {
        let bounds = node.bounds(self.cloud.header().root_cell());
        let distance_squared = (self.place.clamp(bounds.min, bounds.max) - self.place).length_squared();
        if distance_squared <= self.nearest {
            self.waiting.push(distance_squared, node);
        }
    }

    fn next(&mut self) -> Option<Node> {
        let (distance_squared, node) = self.waiting.pop()?;
        (distance_squared <= self.nearest).then_some(node)
    }

    fn visit(&mut self, node: &Node, walk: &mut Walk, pages: &mut Pages<'t>) -> Result<Visit, ScanError> {
        if !walk.may_look_at_runs_of(node, self.cloud.header()) {
            return Err(self.cloud.broken(node.own.first_page));
        }
        self.own_points(node.own, pages)?;
        Ok(Visit::Open)
    }
}

impl Lookup<'_> {
    /// Keeps the nearest of a node's own points, if it is nearer than what is known.
    fn own_points(&mut self, own: RunRange, pages: &Pages<'_>) -> Result<(), ScanError> {
        let header = self.cloud.header();
        let (mut page, mut run, mut left) = (own.first_page, usize::from(own.first_run), own.runs);
        while left > 0 && page < header.point_pages {
            let bytes = pages.read(SectionKind::POINTS, page)?;
            let runs = PointPage::trusted(&bytes, header);
            while left > 0 && run < runs.len() {
                let points = runs.run(run);
                for (i, position) in points.positions(header.root_cell()).into_iter().enumerate() {
                    let square = (position - self.place).length_squared();
                    if square <= self.nearest {
                        self.nearest = square;
                        *self.found = self.cloud.empty_batch();
                        self.cloud.take(&points, &[i], self.found);
                    }
                }
                (run, left) = (run + 1, left - 1);
            }
            (page, run) = (page + 1, 0);
        }
        Ok(())
    }
}
