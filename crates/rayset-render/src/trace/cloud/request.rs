//! What is asked of a cloud in a slab.

use super::shading::CloudShading;
use crate::field::{LANES, RayEnds, SimdLevel, Slab};
use crate::trace::access::Access;
use crate::trace::node_samples::{Live, Measure, RequiredOutputs};

/// What is requested of a cloud in a slab.
#[derive(Clone, Copy)]
pub(in crate::trace) struct Request<'a> {
    pub(in crate::trace) access: Access<'a>,
    pub(in crate::trace) slab: Slab,
    pub(in crate::trace) live: &'a Live,
    /// Lanes whose rays have not ended.
    pub(in crate::trace) going: u64,
    /// Lanes whose rays have not ended either, but come to the slab with finer steps, and the first
    /// tick that these may still come to.
    pub(in crate::trace) waiting: (u64, u64),
    pub(in crate::trace) measure: Measure,
    pub(in crate::trace) required: RequiredOutputs,
    pub(in crate::trace) simd: SimdLevel,
    /// Where rays end if no samples but the cloud's absorb light, or `None` if that is of no use.
    pub(in crate::trace) ends: Option<&'a Remaining>,
}

impl<'a> Request<'a> {
    /// Where rays end in a cloud of this shading at the latest, by its densities.
    pub(super) fn ray_ends(&self, shading: &CloudShading) -> Option<RayEnds<'a>> {
        let absorption = shading.least_absorption?;
        self.ends.map(|ends| RayEnds { depth: &ends.depth, absorption })
    }
}

/// How much is left of each ray.
#[derive(Clone, Copy, Debug)]
pub(in crate::trace) struct Remaining {
    /// For each lane, the optical depth from the slab's beginning at which its ray ends, in steps
    /// at the optical depth of a unit distance. More than exact: a ray that comes to it has ended,
    /// whatever was rounded.
    pub(in crate::trace) depth: [f32; LANES],
}
