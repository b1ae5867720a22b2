//! A scene compiled for tracing: immutable, shared by all threads.

use std::ops::Range;
use std::sync::Arc;

use super::composite::Compositor;
use super::predict::Expected;
use super::{ExecSettings, RenderError};
use crate::field::{Channels, RunDecoder, Splatter};
use crate::octree::format::Header;
use crate::octree::node::Node;
use crate::octree::page::{RUN_POINTS, RootCell};
use crate::scene::{RenderSettings, Scene, Shading};
use crate::working_set::{Object, PageFault, WorkingSet};

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
    pub(super) expected: Expected,
    /// See [`Predictor::slabs_on_a_miss`](super::predict::Predictor::slabs_on_a_miss).
    pub(super) slabs_on_a_miss: u64,
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
            expected: Expected::new(scene, scene.kernel, settings),
            slabs_on_a_miss: exec.predictor.slabs_on_a_miss(),
        }
    }

    pub(super) fn is_resident(&self, page: u32) -> bool {
        self.pages.is_resident(&self.object, page)
    }

    /// The pages of a node's own points: at least those, and at most one more.
    pub(super) fn own_pages(&self, node: &Node) -> Range<u32> {
        let own = node.own;
        if own.runs == 0 {
            return 0..0;
        }
        // Most runs that a page can hold, so that a range is never taken for shorter than it is.
        let least_run = (RUN_POINTS * (6 + self.header.column_bytes())) as u64;
        let runs_per_page = (u64::from(self.header.page_bytes) / least_run).max(1);
        let last_run = u64::from(own.first_run) + u64::from(own.runs);
        let last = own.first_page + (last_run / runs_per_page) as u32;
        own.first_page..(last + 1).min(self.first_node_page)
    }

    /// The pages that are needed to open a node: of its own points and of its children's records.
    pub(super) fn pages_to_open(&self, node: &Node) -> impl Iterator<Item = u32> + use<> {
        let children = (node.child_mask != 0).then_some(self.first_node_page + node.first_child.page);
        self.own_pages(node).chain(children)
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
