//! Procedural fields, given in closed form, as volume objects in the world.

use std::sync::Arc;

use super::math::ln;
use super::node_samples::{
    Live, MATERIAL, MAX_OPTICAL_DEPTH, Measure, NodeSamples, RequiredOutputs, each_lane, numbers,
};
use crate::field::{LANES, Packet, SLAB_SAMPLES, Slab};
use crate::geometry::{Aabb, DAffine3, DMat3, DVec3, Ray};
use crate::scene::{MAX_OPACITY, Procedural, ProceduralSample, largest_stretch};

/// Samples of a ray that are evaluated together, front to back: a ray that ends in front of more needs none of them.
const MOST_AT_ONCE: usize = 8;

/// What is requested of a field in a slab.
#[derive(Clone, Copy)]
pub(super) struct ProceduralRequest<'a> {
    pub(super) packet: &'a Packet,
    pub(super) slab: Slab,
    pub(super) live: &'a Live,
    pub(super) measure: Measure,
    pub(super) required: RequiredOutputs,
    /// For each ray, the sum of the optical depths of samples with which it ends, if that is known.
    pub(super) ends: Option<&'a [f32; LANES]>,
}

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
    pub(super) fn sample(&self, asked: &ProceduralRequest<'_>, out: &mut NodeSamples) {
        out.touched = 0;
        let ProceduralRequest { packet, slab, required, .. } = *asked;
        let around = self.bounds_local.inflated(self.reach_local);
        each_lane(asked.live.lanes(), |lane| {
            let world = packet.ray(lane);
            let origin = self.local_from_world.transform_point3(world.origin);
            let direction = self.local_from_world.transform_vector3(world.direction);
            let ray = Ray { origin, direction };
            let span = if required.outside { around.clip(&ray) } else { self.field.span(&ray) };
            let Some((enter, exit)) = span else { return };
            let (step, first_t) = (packet.step_world(), packet.sample_t_world(lane, slab.first));
            let number = |t: f64| ((t - first_t) / step).clamp(-1.0, SLAB_SAMPLES as f64);
            let mut first = (number(enter).floor().max(0.0)) as usize;
            let end = ((number(exit).ceil() + 1.0).max(0.0) as usize).min(slab.samples);
            let mut left = asked.ends.map_or(f32::INFINITY, |ends| ends[lane]);
            while first < end && left >= 0.0 {
                let some = first..end.min(first + MOST_AT_ONCE);
                first = some.end;
                left -= self.fill(asked, lane, &ray, some, out);
            }
        });
    }

    /// Fills some samples of one ray. Returns the sum of their optical depths, or 0 if opacities are requested.
    fn fill(
        &self,
        asked: &ProceduralRequest<'_>,
        lane: usize,
        ray: &Ray,
        range: std::ops::Range<usize>,
        out: &mut NodeSamples,
    ) -> f32 {
        let ProceduralRequest { packet, slab, measure, required, .. } = *asked;
        let (mut places, mut samples) =
            ([DVec3::ZERO; MOST_AT_ONCE], [ProceduralSample::default(); MOST_AT_ONCE]);
        for (place, j) in places.iter_mut().zip(range.clone()) {
            *place = ray.origin + ray.direction * packet.sample_t_world(lane, slab.first + j as u64);
        }
        self.field.sample_all(&places[..range.len()], &mut samples[..range.len()]);
        if !required.outside && samples[..range.len()].iter().all(|s| s.opacity <= 0.0) {
            return 0.0;
        }
        if out.touched >> lane & 1 == 0 {
            out.clear_lane(lane, required);
            if required.material {
                for (rows, &v) in out.material.iter_mut().zip(&self.material) {
                    rows[lane].0.fill(v);
                }
            }
        }
        let mut sum = 0.0;
        // The logarithm of the last opacity: in most fields most samples have the same.
        let mut known = (0.0, 0.0);
        for ((sample, &place), j) in samples.iter().zip(&places).zip(range) {
            let opacity = sample.opacity.clamp(0.0, MAX_OPACITY) as f32;
            out.opacity[lane].0[j] = match measure {
                Measure::Opacity => opacity,
                Measure::OpticalDepth => {
                    if opacity != known.0 {
                        known = (opacity, (-ln(1.0 - opacity)).min(MAX_OPTICAL_DEPTH));
                    }
                    sum += known.1;
                    known.1
                }
            };
            self.shade(required, lane, j, (sample, place), out);
        }
        sum
    }

    /// Fills the outputs of one sample besides its opacity.
    fn shade(
        &self,
        required: RequiredOutputs,
        lane: usize,
        j: usize,
        (sample, place): (&ProceduralSample, DVec3),
        out: &mut NodeSamples,
    ) {
        if required.color {
            for (rows, v) in out.color.iter_mut().zip(sample.color) {
                rows[lane].0[j] = v as f32;
            }
        }
        for number in numbers(required.attributes) {
            let index = self.named.get(number).copied().flatten();
            out.attributes[number][lane].0[j] = index.map_or(0.0, |index| self.field.attribute(index, place));
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
}
