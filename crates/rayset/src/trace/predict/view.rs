//! The part of a cloud's octree that is in memory, as seen by one look-ahead tile.

use std::collections::HashSet;

use super::found::{Found, PageId};
use super::probe::OctreeView;
use crate::geometry::Aabb;
use crate::octree::node::{Node, NodePage};
use crate::trace::cloud::CloudPlacement;
use crate::working_set::PageClient;

/// The part of a cloud's octree that is in memory, as seen by one look-ahead tile.
pub(super) struct View<'v, 'a> {
    pages_in_memory: &'a PageClient,
    /// Whether its pages come from far away.
    far: bool,
    /// The last look-ahead tile whose rays may meet a box, in world space.
    last_visit: &'v dyn Fn(&Aabb) -> u32,
    cloud: &'a CloudPlacement,
    found: &'v mut Found,
    at: u32,
    pub(super) absent_nodes: Vec<u32>,
    /// The pages wanted.
    pub(super) pages: HashSet<u32>,
    opened: u64,
}

impl<'v, 'a> View<'v, 'a> {
    pub(super) fn new(
        pages_in_memory: &'a PageClient,
        far: bool,
        last_visit: &'v dyn Fn(&Aabb) -> u32,
        cloud: &'a CloudPlacement,
        found: &'v mut Found,
        at: u32,
    ) -> Self {
        Self {
            pages_in_memory,
            far,
            last_visit,
            cloud,
            found,
            at,
            absent_nodes: Vec::new(),
            pages: HashSet::new(),
            opened: 1,
        }
    }

    /// A node record, if its page is in memory.
    pub(super) fn node_at(&self, page: u32, index: u16) -> Option<Node> {
        let guard = self.pages_in_memory.peek(&self.cloud.pages, self.cloud.first_node_page + page)?;
        NodePage::scaled(&guard, self.cloud.header()).get(usize::from(index))
    }
}

impl OctreeView for View<'_, '_> {
    fn bounds(&self, node: &Node) -> Aabb {
        node.bounds(self.cloud.root_cell)
    }

    fn children(&mut self, node: &Node, found: &mut Vec<Node>) {
        let first = node.first_child;
        for k in 0..node.child_mask.count_ones() as u16 {
            match self.node_at(first.page, first.index + k) {
                // A file that is not a tree is reported when rays reach it.
                Some(child) if !child.is_child_of(node) || self.opened >= self.cloud.most_nodes() => return,
                Some(child) => {
                    self.opened += 1;
                    found.push(child);
                }
                None => return self.absent_nodes.push(self.cloud.first_node_page + first.page),
            }
        }
    }

    fn want(&mut self, node: &Node) {
        let pages = if self.far { self.cloud.own_pages_at_most(node) } else { self.cloud.own_pages(node) };
        if !pages.is_empty() {
            self.pages.extend(pages.clone());
            let use_by = (self.last_visit)(&self.cloud.bounds_world_of(node));
            let file = self.cloud.file;
            pages.for_each(|page| self.found.want(PageId { file, page }, self.at, use_by));
        }
    }
}
