//! A cloud as a volume object.

use std::sync::Arc;

use super::lod::{CloudLod, why_whole};
use super::placement::CloudPlacement;
use super::shading::CloudShading;
use crate::scene::{CloudObject, Lod, Scene};
use crate::trace::node_samples::{MATERIAL, RequiredOutputs};
use crate::trace::unopened::Unopened;
use rayset_base::geometry::DAffine3;
use rayset_files::PagedFiles;
use rayset_store::working_set::Object;

/// A cloud in the world: its placement and its shading.
pub(in crate::trace) struct CloudVolume<P = Arc<Object>> {
    pub(in crate::trace) placement: CloudPlacement<P>,
    pub(in crate::trace) shading: CloudShading,
    /// If it may be seen from afar.
    pub(in crate::trace) lod: Option<Box<CloudLod>>,
    /// Why it may not, if that was asked for.
    pub(in crate::trace) why_whole: Option<&'static str>,
}

impl CloudVolume<Unopened> {
    pub(in crate::trace) fn new(
        object: &CloudObject,
        world_from_local: &DAffine3,
        (scene, lod): (&Scene, Lod),
        material: [f32; MATERIAL],
    ) -> Self {
        let placement = CloudPlacement::new(object, world_from_local);
        let shading = CloudShading::new(object, placement.local_from_world(), scene, material);
        let is_asked = lod != Lod::Off;
        let why_whole = why_whole(object, world_from_local).filter(|_| is_asked);
        let lod = CloudLod::new(object, world_from_local, scene, lod).map(Box::new);
        Self { placement, shading, lod, why_whole }
    }

    /// Sets what fields carry, for the required outputs and the names of the program's attributes.
    pub(in crate::trace) fn carry(&mut self, required: RequiredOutputs, names: &[Arc<str>]) {
        let columns = self.shading.carry(self.placement.header(), required, names);
        if let Some(lod) = &mut self.lod {
            lod.carry(columns, &required);
        }
    }

    /// With its pages in a working set; `None` if they are in none.
    pub(in crate::trace) fn open(self, paged: &PagedFiles) -> Option<CloudVolume> {
        Some(CloudVolume {
            placement: self.placement.open(paged)?,
            shading: self.shading,
            lod: self.lod,
            why_whole: self.why_whole,
        })
    }
}

impl<P> CloudVolume<P> {
    /// Bytes that it takes.
    pub(in crate::trace) fn bytes(&self) -> usize {
        size_of::<CloudVolume>()
            + self.shading.bytes()
            + self.lod.as_ref().map_or(0, |lod| size_of::<CloudLod>() + lod.bytes())
    }
}
