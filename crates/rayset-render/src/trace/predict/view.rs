//! The part of a cloud's octree that is in memory.

use super::probe::{Expected, OctreeView, ProbeRays};
use crate::trace::cloud::CloudPlacement;
use rayset_base::geometry::Aabb;
use rayset_files::octree::node::{Node, NodePage};
use rayset_store::working_set::PageClient;

/// The part of a cloud's octree that is in memory, as probe rays go through it.
pub(super) struct View<'v, 'a> {
    pages_in_memory: &'a PageClient,
    cloud: &'a CloudPlacement,
    /// Called for each node that rays are expected to reach.
    want: &'v mut dyn FnMut(&Node),
    /// Node pages on the way that are not in memory.
    pub(super) absent_nodes: Vec<u32>,
    opened: u64,
}

impl<'v, 'a> View<'v, 'a> {
    pub(super) fn new(
        pages_in_memory: &'a PageClient,
        cloud: &'a CloudPlacement,
        want: &'v mut dyn FnMut(&Node),
    ) -> Self {
        Self { pages_in_memory, cloud, want, absent_nodes: Vec::new(), opened: 1 }
    }

    /// Lets rays go through the octree from its root, if that is in memory.
    pub(super) fn explore(&mut self, rays: &mut ProbeRays, expected: &Expected) {
        let root = self.cloud.header().root;
        match self.node_at(root.page, root.index) {
            Some(root) => rays.explore(root, expected, self),
            None => self.absent_nodes.push(self.cloud.first_node_page + root.page),
        }
    }

    /// A node record, if its page is in memory.
    fn node_at(&self, page: u32, index: u16) -> Option<Node> {
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
        (self.want)(node);
    }
}
