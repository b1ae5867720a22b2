//! Procedural fields, given in closed form, as volume objects in the world.

use std::sync::Arc;

use super::math::ln;
use super::node_samples::{
    Live, MATERIAL, MAX_OPTICAL_DEPTH, Measure, NodeSamples, RequiredOutputs, each_lane, numbers,
};
use crate::field::{Packet, SLAB_SAMPLES, Slab};
use crate::geometry::{Aabb, DAffine3, DMat3, DVec3, Ray};
use crate::scene::{MAX_OPACITY, Procedural, ProceduralSample, largest_stretch};

/// A field as the scene graph places it in the world.
pub(super) struct ProceduralVolume {
    field: Arc<dyn Procedural>,
    local_from_world: DAffine3,
    /// Transforms gradients from local space to world space.
    world_gradient: DMat3,
    bounds_local: Aabb,
    /// How far outside the bounds the field is sampled if its boundary is required there; local space.
    reach_local: f64,
    pub(super) material: [f32; MATERIAL],
    /// For each of the program's attributes, its index among those of the field, if the field has it.
    named: Vec<Option<usize>>,
}

impl ProceduralVolume {
    pub(super) fn new(
        field: Arc<dyn Procedural>,
        world_from_local: &DAffine3,
        reach_world: f64,
        material: [f32; MATERIAL],
    ) -> Self {
        let local_from_world = world_from_local.inverse();
        Self {
            bounds_local: field.bounds(),
            field,
            local_from_world,
            world_gradient: local_from_world.matrix3.transpose(),
            reach_local: reach_world * largest_stretch(&local_from_world),
            material,
            named: Vec::new(),
        }
    }

    /// Sets the names of the program's attributes.
    pub(super) fn carry(&mut self, names: &[Arc<str>]) {
        let own = self.field.attributes();
        self.named = names.iter().map(|name| own.iter().position(|own| *own == &**name)).collect();
    }

    /// The length over which the field changes along a ray; world space.
    pub(super) fn detail_world(&self, ray: &Ray) -> f64 {
        self.field.detail() / self.local_from_world.transform_vector3(ray.direction).length()
    }

    /// The largest such length along any ray.
    pub(super) fn largest_detail_world(&self) -> f64 {
        self.field.detail() * largest_stretch(&self.local_from_world.inverse())
    }

    /// Fills the lanes that meet the field.
    pub(super) fn sample(
        &self,
        packet: &Packet,
        slab: Slab,
        live: &Live,
        measure: Measure,
        required: RequiredOutputs,
        out: &mut NodeSamples,
    ) {
        out.touched = 0;
        let bounds =
            if required.outside { self.bounds_local.inflated(self.reach_local) } else { self.bounds_local };
        each_lane(live.lanes(), |lane| {
            let world = packet.ray(lane);
            let origin = self.local_from_world.transform_point3(world.origin);
            let direction = self.local_from_world.transform_vector3(world.direction);
            let Some((enter, exit)) = bounds.clip(&Ray { origin, direction }) else { return };
            let (step, first_t) = (packet.step_world(), packet.sample_t_world(lane, slab.first));
            let number = |t: f64| ((t - first_t) / step).clamp(-1.0, SLAB_SAMPLES as f64);
            let first = (number(enter).floor().max(0.0)) as usize;
            let end = ((number(exit).ceil() + 1.0).max(0.0) as usize).min(slab.samples);
            if first < end {
                self.fill_lane(packet, slab, lane, (origin, direction), first..end, measure, required, out);
            }
        });
    }

    #[expect(clippy::too_many_arguments, reason = "one ray through a slab, spelled out")]
    fn fill_lane(
        &self,
        packet: &Packet,
        slab: Slab,
        lane: usize,
        (origin, direction): (DVec3, DVec3),
        range: std::ops::Range<usize>,
        measure: Measure,
        required: RequiredOutputs,
        out: &mut NodeSamples,
    ) {
        let mut places = [DVec3::ZERO; SLAB_SAMPLES];
        let mut samples = [ProceduralSample::default(); SLAB_SAMPLES];
        for j in range.clone() {
            places[j] = origin + direction * packet.sample_t_world(lane, slab.first + j as u64);
        }
        self.field.sample_all(&places[range.clone()], &mut samples[range.clone()]);
        if !required.outside && samples[range.clone()].iter().all(|s| s.opacity <= 0.0) {
            return;
        }
        out.clear_lane(lane, required);
        for j in range {
            let sample = &samples[j];
            let opacity = sample.opacity.clamp(0.0, MAX_OPACITY) as f32;
            out.opacity[lane].0[j] = match measure {
                Measure::Opacity => opacity,
                Measure::OpticalDepth => (-ln(1.0 - opacity)).min(MAX_OPTICAL_DEPTH),
            };
            if required.color {
                for (rows, v) in out.color.iter_mut().zip(sample.color) {
                    rows[lane].0[j] = v as f32;
                }
            }
            for number in numbers(required.attributes) {
                let index = self.named.get(number).copied().flatten();
                out.attributes[number][lane].0[j] =
                    index.map_or(0.0, |index| self.field.attribute(index, places[j]));
            }
            if required.normal || required.boundary {
                let gradient = self.world_gradient * sample.gradient;
                let length = gradient.length();
                let normal = if length > 0.0 && length.is_finite() { gradient / length } else { DVec3::ZERO };
                if required.normal {
                    for (rows, v) in out.normal.iter_mut().zip(normal.to_array()) {
                        rows[lane].0[j] = v as f32;
                    }
                }
                if required.boundary {
                    // A first-order estimate, exact if the implicit function is a distance.
                    out.boundary[lane].0[j] = (sample.implicit / length) as f32;
                }
            }
        }
        if required.material {
            for (rows, &v) in out.material.iter_mut().zip(&self.material) {
                rows[lane].0.fill(v);
            }
        }
    }
}
