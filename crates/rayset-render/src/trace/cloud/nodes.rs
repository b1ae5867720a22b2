//! Where walks through a cloud's octree have the records of its nodes from.

use std::convert::Infallible;

use super::placement::CloudPlacement;
use crate::trace::access::{Access, Halt};
use rayset_files::octree::format::Header;
use rayset_files::octree::walk::NodePages;
use rayset_store::working_set::{PageClient, PageGuard};

/// Pages that rays need: brought in, or a reason to put the tile off.
#[derive(Clone, Copy)]
pub(in crate::trace) struct RetainedNodes<'a> {
    pub(in crate::trace) access: Access<'a>,
    pub(in crate::trace) cloud: &'a CloudPlacement,
}

impl NodePages for RetainedNodes<'_> {
    type Page = PageGuard;
    type Error = Halt;

    fn header(&self) -> &Header {
        self.cloud.header()
    }

    fn page(&mut self, page: u32) -> Result<Option<PageGuard>, Halt> {
        self.access.retain(self.cloud, self.cloud.first_node_page + page).map(Some)
    }

    fn no_tree(&mut self, page: u32) -> Result<(), Halt> {
        Err(self.cloud.broken(self.cloud.first_node_page + page).into())
    }
}

/// Pages that are in memory anyway. Of others, it is noted that they were asked for.
pub(in crate::trace) struct NodesInMemory<'a> {
    client: &'a PageClient,
    cloud: &'a CloudPlacement,
    /// Pages that are not in memory, each as often as it was asked for.
    pub(in crate::trace) absent: Vec<u32>,
}

impl<'a> NodesInMemory<'a> {
    pub(in crate::trace) fn new(client: &'a PageClient, cloud: &'a CloudPlacement) -> Self {
        Self { client, cloud, absent: Vec::new() }
    }
}

impl NodePages for NodesInMemory<'_> {
    type Page = PageGuard;
    type Error = Infallible;

    fn header(&self) -> &Header {
        self.cloud.header()
    }

    fn page(&mut self, page: u32) -> Result<Option<PageGuard>, Infallible> {
        let page = self.cloud.first_node_page + page;
        let found = self.client.peek(&self.cloud.pages, page);
        if found.is_none() {
            self.absent.push(page);
        }
        Ok(found)
    }

    /// A file that is not a tree is reported when rays reach it.
    fn no_tree(&mut self, _: u32) -> Result<(), Infallible> {
        Ok(())
    }
}
