//! How one attempt at a tile comes by its pages: it waits for those that are absent, or is put off until they are there.

use super::RenderError;
use super::world::World;
use crate::octree::node::{Node, NodePage};
use crate::working_set::PageGuard;

/// Priority of node pages: every packet needs the upper ones.
pub(super) const NODE_PRIORITY: u8 = 255;
/// Priority of point pages that samples wait for.
pub(super) const POINT_PRIORITY: u8 = 200;

/// Why an attempt ended early.
pub(super) enum Halt {
    /// A page is absent. It has been asked for; the tile is to be traced again, from its beginning, when it is there.
    PutOff {
        page: u32,
    },
    Failed(RenderError),
}

impl<E: Into<RenderError>> From<E> for Halt {
    fn from(error: E) -> Self {
        Self::Failed(error.into())
    }
}

/// The pages of a world, for one attempt.
#[derive(Clone, Copy)]
pub(super) struct Access<'a> {
    pub(super) world: &'a World<'a>,
    /// Whether it waits for pages that are absent.
    pub(super) waits: bool,
}

impl Access<'_> {
    pub(super) fn retain(&self, page: u32, priority: u8) -> Result<PageGuard, Halt> {
        let World { pages, object, .. } = self.world;
        if self.waits {
            return Ok(pages.retain(object, page, priority)?);
        }
        match pages.retain_resident(object, page, priority) {
            Some(outcome) => Ok(outcome?),
            None => {
                pages.hint(object, &[page], priority, u64::MAX);
                Err(Halt::PutOff { page })
            }
        }
    }

    /// The root node, or nothing where the cloud is empty.
    pub(super) fn root(&self) -> Result<Option<Node>, Halt> {
        if self.world.header.points == 0 {
            return Ok(None);
        }
        let place = self.world.header.root;
        let guard = self.retain(self.world.first_node_page + place.page, NODE_PRIORITY)?;
        match NodePage::trusted(&guard).get(usize::from(place.index)) {
            Some(root) => Ok(Some(root)),
            None => Err(self.world.broken(place.page).into()),
        }
    }
}
