//! A cloud as a volume object.

use super::placement::CloudPlacement;
use super::shading::CloudShading;
use crate::scene::CloudObject;
use crate::trace::node_samples::MATERIAL;
use rayset_base::geometry::DAffine3;
use rayset_files::PagedFiles;

/// A cloud in the world: its placement and its shading.
pub(in crate::trace) struct CloudVolume {
    pub(in crate::trace) placement: CloudPlacement,
    pub(in crate::trace) shading: CloudShading,
}

impl CloudVolume {
    /// `None` if the cloud's pages are not in a working set.
    pub(in crate::trace) fn new(
        object: &CloudObject,
        world_from_local: &DAffine3,
        unit_distance: f64,
        material: [f32; MATERIAL],
        paged: &PagedFiles,
    ) -> Option<Self> {
        let placement = CloudPlacement::new(&object.cloud, world_from_local, paged)?;
        let shading = CloudShading::new(object, placement.local_from_world(), unit_distance, material);
        Some(Self { placement, shading })
    }
}
