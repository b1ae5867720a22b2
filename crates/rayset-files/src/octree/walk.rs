//! Walking an octree: the one loop over its nodes. Who walks says which nodes come in which order,
//! what is opened, and where the walk ends ([`Visitor`]), and from where records of nodes are read
//! ([`NodePages`]).
//!
//! A file whose checksums hold may still contradict itself. No walk meets more nodes than the file
//! has, nor looks at more runs if its visitor asks [`Walk::may_look_at_runs_of`]: so it ends,
//! whatever the records say.

use std::ops::Deref;

use super::format::Header;
use super::layout::{NodeRef, nodes_per_page};
use super::node::{Node, NodePage};

/// Pages of the records of an octree's nodes, wherever they are.
pub trait NodePages {
    /// A page, while it is used.
    type Page: Deref<Target = [u8]>;
    /// Why a page cannot be read, or a walk goes no further.
    type Error;

    /// What the file says.
    fn header(&self) -> &Header;

    /// A page, counted from the first of those with nodes, checked; `None` if the walk is to go on
    /// without the nodes in it.
    ///
    /// # Errors
    /// If it cannot be read.
    fn page(&mut self, page: u32) -> Result<Option<Self::Page>, Self::Error>;

    /// Called for a page whose records make no tree, or more nodes than the file has. If this is no
    /// error, the walk goes on without them.
    ///
    /// # Errors
    /// What is wrong with the file.
    fn no_tree(&mut self, page: u32) -> Result<(), Self::Error>;
}

/// What is done with a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Visit {
    /// Its children are met.
    Open,
    /// Nothing below it is of interest.
    Skip,
    /// Nor is anything else.
    Stop,
}

/// Who walks through an octree. Nodes that were met wait with it, in an order of its own.
pub trait Visitor<P: NodePages> {
    /// Takes a node whose parent was opened, or the root: to be visited later, or never.
    fn meet(&mut self, node: Node);

    /// The node that is visited next; `None` ends the walk for now.
    fn next(&mut self) -> Option<Node>;

    /// Visits a node.
    ///
    /// # Errors
    /// Whatever ends the walk.
    fn visit(&mut self, node: &Node, walk: &mut Walk, pages: &mut P) -> Result<Visit, P::Error>;
}

/// A walk through an octree. It may stop where its visitor has nothing to visit for now, and go on
/// later; after an error it has to begin again.
#[derive(Debug)]
pub struct Walk {
    /// Number of nodes met, the root among them.
    nodes: u64,
    /// Number of own runs of nodes that were looked at.
    runs: u64,
}

impl Default for Walk {
    fn default() -> Self {
        Self::new()
    }
}

impl Walk {
    /// A walk that has met the root, or is about to.
    #[must_use]
    pub fn new() -> Self {
        Self { nodes: 1, runs: 0 }
    }

    /// Meets the root. There is none if there are no points.
    ///
    /// # Errors
    /// Those of [`NodePages`].
    pub fn begin<P: NodePages>(
        &mut self,
        pages: &mut P,
        visitor: &mut impl Visitor<P>,
    ) -> Result<(), P::Error> {
        *self = Self::new();
        if pages.header().points == 0 {
            return Ok(());
        }
        let root = pages.header().root;
        let Some(bytes) = pages.page(root.page)? else { return Ok(()) };
        match NodePage::scaled(&bytes, pages.header()).get(usize::from(root.index)) {
            Some(root) => visitor.meet(root),
            None => pages.no_tree(root.page)?,
        }
        Ok(())
    }

    /// Visits node after node, until the visitor has none, or stops.
    ///
    /// # Errors
    /// Those of the visitor and of [`NodePages`].
    pub fn go_on<P: NodePages>(
        &mut self,
        pages: &mut P,
        visitor: &mut impl Visitor<P>,
    ) -> Result<(), P::Error> {
        while let Some(node) = visitor.next() {
            match visitor.visit(&node, self, pages)? {
                Visit::Open => self.open(&node, pages, visitor)?,
                Visit::Skip => {}
                Visit::Stop => break,
            }
        }
        Ok(())
    }

    /// Counts a node's own runs, which are about to be looked at; false if no file has so many, for
    /// each belongs to one node and has at least one point.
    #[must_use]
    pub fn may_look_at_runs_of(&mut self, node: &Node, header: &Header) -> bool {
        self.runs = self.runs.saturating_add(u64::from(node.own.runs));
        self.runs <= header.points
    }

    fn open<P: NodePages>(
        &mut self,
        node: &Node,
        pages: &mut P,
        visitor: &mut impl Visitor<P>,
    ) -> Result<(), P::Error> {
        if node.child_mask == 0 {
            return Ok(());
        }
        let NodeRef { page, index } = node.first_child;
        let Some(bytes) = pages.page(page)? else { return Ok(()) };
        let most = most_nodes(pages.header());
        for k in 0..node.child_mask.count_ones() as usize {
            let child = NodePage::scaled(&bytes, pages.header()).get(usize::from(index) + k);
            let child = child.filter(|child| child.is_child_of(node) && self.nodes < most);
            self.nodes += 1;
            match child {
                Some(child) => visitor.meet(child),
                None => return pages.no_tree(page),
            }
        }
        Ok(())
    }
}

/// Upper bound of the nodes that a walk can meet; if there are more, the file is not a tree.
fn most_nodes(header: &Header) -> u64 {
    header.nodes.min(u64::from(header.node_pages) * nodes_per_page(header.page_bytes as usize) as u64)
}
