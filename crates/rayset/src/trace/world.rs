//! A scene compiled for tracing: immutable, shared by all threads.

use std::sync::Arc;

use super::composite::Compositor;
use super::{ExecSettings, RenderError};
use crate::field::{Channels, RunDecoder, Splatter};
use crate::octree::format::Header;
use crate::octree::node::{Node, NodePage};
use crate::octree::page::RootCell;
use crate::scene::{RenderSettings, Scene, Shading};
use crate::working_set::{Object, PageFault, PageGuard, WorkingSet};

/// Everything that a thread needs to trace a packet.
pub(super) struct World<'a> {
    pub(super) header: &'a Header,
    pub(super) root_cell: RootCell,
    pub(super) first_node_page: u32,
    pub(super) pages: &'a WorkingSet,
    pub(super) object: Arc<Object>,
    pub(super) decoder: RunDecoder,
    pub(super) splatter: Splatter,
    pub(super) compositor: Compositor,
}

impl<'a> World<'a> {
    pub(super) fn compile(
        scene: &'a Scene,
        settings: &RenderSettings,
        exec: &ExecSettings,
        pages: &'a WorkingSet,
        object: &Arc<Object>,
    ) -> Self {
        let header = scene.cloud.header();
        let source = scene.attribute_source();
        let channels = Channels {
            gradient: scene.shading == Shading::Headlight,
            attributes: source != crate::field::AttributeSource::None,
        };
        Self {
            header,
            root_cell: header.root_cell(),
            first_node_page: header.point_pages,
            pages,
            object: object.clone(),
            decoder: RunDecoder::new(header, scene.kernel, scene.normalised, source),
            splatter: Splatter { kernel: scene.kernel, channels, simd: exec.simd },
            compositor: Compositor::new(scene, settings, exec.simd),
        }
    }

    pub(super) fn retain(&self, page: u32, priority: u8) -> Result<PageGuard, RenderError> {
        Ok(self.pages.retain(&self.object, page, priority)?)
    }

    /// The root node, or nothing where the cloud is empty.
    pub(super) fn root(&self) -> Result<Option<Node>, RenderError> {
        if self.header.points == 0 {
            return Ok(None);
        }
        let place = self.header.root;
        let guard = self.retain(self.first_node_page + place.page, super::frontier::NODE_PRIORITY)?;
        let node = NodePage::trusted(&guard).get(usize::from(place.index));
        node.map(Some).ok_or_else(|| self.broken(place.page))
    }

    /// A page that is whole but contradicts another.
    pub(super) fn broken(&self, page: u32) -> RenderError {
        RenderError::Page(PageFault::Damaged {
            name: "cloud".into(),
            page,
            offset: self.header.page_offset(page),
            what: "the octree refers to a record that is not there".into(),
        })
    }
}
