//! Looking a place up in a cloud's file: its nearest point, and where in space its pages lie. Pages are read one at a time, besides
//! those of any session.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::ops::Range;

use super::file::Cloud;
use super::layout::NodeRef;
use super::node::{Node, NodePage, RunRange};
use super::page::PointPage;
use crate::points::PointBatch;
use rayset_base::geometry::{Aabb, DVec3};
use rayset_store::container::{OpenFile, PageError, ScanError, SectionKind};

impl Cloud {
    /// The point whose centre is nearest to a place, with its columns as [`sample`](Self::sample) has them; an empty batch if none
    /// is within a distance. Of equally near ones, any.
    ///
    /// # Errors
    /// [`ScanError`] if a page cannot be read or is damaged.
    pub fn nearest(&self, place: DVec3, within: f64) -> Result<PointBatch, ScanError> {
        let mut found = self.empty_batch();
        if self.header().points == 0 {
            return Ok(found);
        }
        let mut lookup = Lookup { pages: Pages::new(self)?, place, nearest: within * within };
        // Nodes by their distance: non-negative numbers are in the order of their bits.
        let mut queue = BinaryHeap::new();
        let root = self.header().root;
        queue.push(Reverse((0_u64, root.page, root.index)));
        // Of a whole file, no node is met twice, and no run.
        let (mut nodes_left, mut runs_left) = (self.header().nodes, self.header().points);
        while let Some(Reverse((distance, page, index))) = queue.pop() {
            if f64::from_bits(distance) > lookup.nearest {
                break;
            }
            let of_node = page;
            let bytes = lookup.pages.read(SectionKind::NODES, page)?;
            let Some(node) = NodePage::scaled(&bytes, self.header()).get(usize::from(index)) else {
                continue;
            };
            runs_left = runs_left.checked_sub(u64::from(node.own.runs)).ok_or_else(|| self.broken(page))?;
            lookup.own_points(node.own, &mut found)?;
            if node.child_mask == 0 {
                continue;
            }
            let NodeRef { page, index: first } = node.first_child;
            // Children lie in one page, and most often in that of their parent.
            let bytes = if page == of_node { bytes } else { lookup.pages.read(SectionKind::NODES, page)? };
            let children = NodePage::scaled(&bytes, self.header());
            for index in first..first.saturating_add(node.child_mask.count_ones() as u16) {
                let child = children.get(usize::from(index)).filter(|child| child.is_child_of(&node));
                let child = child.ok_or_else(|| self.broken(page))?;
                nodes_left = nodes_left.checked_sub(1).ok_or_else(|| self.broken(page))?;
                let distance = lookup.distance_squared(&child);
                if distance <= lookup.nearest {
                    queue.push(Reverse((distance.to_bits(), page, index)));
                }
            }
        }
        Ok(found)
    }

    /// The error for a node page whose records do not make a tree.
    fn broken(&self, node_page: u32) -> ScanError {
        let page = self.header().point_pages + node_page;
        let (path, offset) = (self.path().to_owned(), self.header().page_offset(page));
        let source = PageError::Content { what: "nodes that are no tree" };
        ScanError::Damaged { path, page, offset, source }
    }

    /// The point pages in at most `most` groups of neighbours, each with the bounds of what its points influence. Reads all pages
    /// of nodes.
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
    /// Whether points of a node begin where the group does; else those of the last node before it go on here.
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
}

impl<'a> Pages<'a> {
    fn new(cloud: &'a Cloud) -> Result<Self, ScanError> {
        let file = cloud.reopened()?;
        if file.header().identity != cloud.header().identity {
            return Err(ScanError::Replaced { path: cloud.path().to_owned() });
        }
        Ok(Self { cloud, file })
    }

    fn read(&self, kind: SectionKind, index: u32) -> Result<Vec<u8>, ScanError> {
        let first = if kind == SectionKind::POINTS { 0 } else { self.cloud.header().point_pages };
        let (page, (offset, bytes)) = (first + index, self.file.page(kind, index)?);
        let damaged =
            |source| ScanError::Damaged { path: self.cloud.path().to_owned(), page, offset, source };
        self.cloud.check_page(page, &bytes).map_err(damaged)?;
        Ok(bytes)
    }
}

/// The search for the point that is nearest to a place.
struct Lookup<'a> {
    pages: Pages<'a>,
    place: DVec3,
    /// The square of the distance of the nearest point so far.
    nearest: f64,
}

impl Lookup<'_> {
    /// A least square of the distance of the points at and below a node.
    fn distance_squared(&self, node: &Node) -> f64 {
        let bounds = node.bounds(self.pages.cloud.header().root_cell());
        (self.place.clamp(bounds.min, bounds.max) - self.place).length_squared()
    }

    /// Keeps the nearest of a node's own points, if it is nearer than what is known.
    fn own_points(&mut self, own: RunRange, found: &mut PointBatch) -> Result<(), ScanError> {
        let header = self.pages.cloud.header();
        let (mut page, mut run, mut left) = (own.first_page, usize::from(own.first_run), own.runs);
        while left > 0 && page < header.point_pages {
            let bytes = self.pages.read(SectionKind::POINTS, page)?;
            let runs = PointPage::trusted(&bytes, header);
            while left > 0 && run < runs.len() {
                let points = runs.run(run);
                for (i, position) in points.positions(header.root_cell()).into_iter().enumerate() {
                    let square = (position - self.place).length_squared();
                    if square <= self.nearest {
                        self.nearest = square;
                        *found = self.pages.cloud.empty_batch();
                        self.pages.cloud.take(&points, &[i], found);
                    }
                }
                (run, left) = (run + 1, left - 1);
            }
            (page, run) = (page + 1, 0);
        }
        Ok(())
    }
}
