//! Which samples of a ray are inside an object, as bent rays need to know.

use super::node_samples::{Constants, NodeSamples, REFLECTANCE, REFRACTIVE_INDEX};
use crate::field::{Packet, SLAB_SAMPLES, Slab};
use rayset_base::geometry::DVec3;

/// A sample inside an object.
#[derive(Clone, Copy, Debug)]
pub(super) struct Inside {
    /// Distance along the ray; world space.
    pub(super) t: f64,
    pub(super) normal: DVec3,
    /// Distance to the boundary; world space.
    pub(super) depth: f64,
    /// The step there; world space.
    pub(super) step_world: f64,
    pub(super) reflectance: f32,
}

/// The samples of a ray in a slab.
pub(super) struct Samples<'a> {
    pub(super) packet: &'a Packet,
    pub(super) slab: Slab,
    pub(super) node: &'a NodeSamples,
    pub(super) constants: &'a Constants,
    pub(super) lane: usize,
}

impl Samples<'_> {
    /// A bit for each sample inside an object.
    pub(super) fn inside(&self) -> u32 {
        let (opacity, boundary) = (&self.node.opacity[self.lane].0, &self.node.boundary[self.lane].0);
        let mut bits = 0;
        for j in 0..SLAB_SAMPLES {
            bits |= u32::from((opacity[j] > 0.0) & (boundary[j] < 0.0)) << j;
        }
        bits
    }

    /// A bit for each sample inside an object whose refractive index is not `index`.
    pub(super) fn of_other_index(&self, inside: u32, index: f32) -> u32 {
        if inside == 0 {
            return 0;
        }
        match &self.constants.material {
            Some(material) if material[REFRACTIVE_INDEX] == index => 0,
            Some(_) => inside,
            None => {
                let row = &self.node.material[REFRACTIVE_INDEX][self.lane].0;
                let mut bits = 0;
                for (j, &other) in row.iter().enumerate() {
                    bits |= u32::from(other != index) << j;
                }
                bits & inside
            }
        }
    }

    /// The refractive index of a sample inside an object.
    pub(super) fn index(&self, j: usize) -> f32 {
        self.constants.material_at(self.node, REFRACTIVE_INDEX, self.lane, j)
    }

    /// A sample inside an object.
    pub(super) fn at(&self, j: usize) -> Inside {
        Inside {
            t: self.packet.sample_t_world(self.lane, self.slab.first + j as u64),
            normal: self.node.normal_at(self.lane, j),
            depth: -f64::from(self.node.boundary[self.lane].0[j]),
            step_world: self.packet.step_world(),
            reflectance: self.constants.material_at(self.node, REFLECTANCE, self.lane, j),
        }
    }
}
