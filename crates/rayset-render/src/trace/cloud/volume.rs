//! A cloud as a volume object.

use std::sync::Arc;

use super::placement::CloudPlacement;
use super::shading::CloudShading;
use crate::scene::{CloudObject, Scene};
use crate::trace::node_samples::MATERIAL;
use crate::trace::unopened::Unopened;
use rayset_base::geometry::DAffine3;
use rayset_files::PagedFiles;
use rayset_store::working_set::Object;

/// A cloud in the world: its placement and its shading.
pub(in crate::trace) struct CloudVolume<P = Arc<Object>> {
    pub(in crate::trace) placement: CloudPlacement<P>,
    pub(in crate::trace) shading: CloudShading,
}

impl CloudVolume<Unopened> {
    pub(in crate::trace) fn new(
        object: &CloudObject,
        world_from_local: &DAffine3,
        scene: &Scene,
        material: [f32; MATERIAL],
    ) -> Self {
        let placement = CloudPlacement::new(object, world_from_local);
        let shading = CloudShading::new(object, placement.local_from_world(), scene, material);
        Self { placement, shading }
    }

    /// With its pages in a working set; `None` if they are in none.
    pub(in crate::trace) fn open(self, paged: &PagedFiles) -> Option<CloudVolume> {
        Some(CloudVolume { placement: self.placement.open(paged)?, shading: self.shading })
    }
}

impl<P> CloudVolume<P> {
    /// Bytes that it takes.
    pub(in crate::trace) fn bytes(&self) -> usize {
        size_of::<CloudVolume>() + self.shading.bytes()
    }
}
