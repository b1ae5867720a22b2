//! A procedural field as the scene graph places it in the world, and its samples in a slab.

use std::any::Any;
use std::sync::Arc;

use crate::field::{BLOCK_SAMPLES, LANES, Packet, SLAB_SAMPLES, SampleRow, SimdLevel, Slab, dispatch};
use crate::math::ln;
use crate::scene::{MAX_OPACITY, Procedural, ProceduralSample, Solid, largest_stretch};
use crate::trace::node_samples::{
    Live, MATERIAL, MAX_OPTICAL_DEPTH, Measure, NodeSamples, RequiredOutputs, numbers,
};
use rayset_base::bytes::list_bytes;
use rayset_base::geometry::{Aabb, DAffine3, DMat3, DVec3, Ray};

/// The march of one packet through one field.
pub(in crate::trace) struct ProceduralMarch {
    /// For each ray, the first sample that may be in the field, and the one after the last.
    within: [(u64, u64); LANES],
}

impl ProceduralMarch {
    pub(in crate::trace) const BYTES: usize = size_of::<Self>();

    /// The samples of a ray that may be in the field, counted from the first of a slab: the first,
    /// and the one after the last.
    #[inline(always)]
    fn within(&self, lane: usize, slab: Slab) -> (usize, usize) {
        let (first, end) = self.within[lane];
        let (first, end) = (first.max(slab.first), end.min(slab.end()));
        if first < end { ((first - slab.first) as usize, (end - slab.first) as usize) } else { (0, 0) }
    }
}

/// What is requested of a field in a slab.
#[derive(Clone, Copy)]
pub(in crate::trace) struct ProceduralRequest<'a> {
    pub(in crate::trace) packet: &'a Packet,
    /// The packet in the field ([`ProceduralVolume::begin`]).
    pub(in crate::trace) march: &'a ProceduralMarch,
    pub(in crate::trace) slab: Slab,
    pub(in crate::trace) live: &'a Live,
    pub(in crate::trace) measure: Measure,
    pub(in crate::trace) required: RequiredOutputs,
    /// For each ray, the sum of the optical depths of samples with which it ends, if that is known.
    pub(in crate::trace) ends: Option<&'a [f32; LANES]>,
    pub(in crate::trace) simd: SimdLevel,
}

/// A field as the scene graph places it in the world.
pub(in crate::trace) struct ProceduralVolume {
    pub(super) field: Arc<dyn Procedural>,
    local_from_world: DAffine3,
    /// Transforms gradients from local space to world space.
    pub(super) world_gradient: DMat3,
    bounds_local: Aabb,
    /// How far outside the bounds the field is sampled if its boundary is required there; local
    /// space.
    reach_local: f64,
    pub(in crate::trace) material: [f32; MATERIAL],
    /// For each of the program's attributes, its index among those of the field, if the field has
    /// it.
    pub(super) named: Vec<Option<usize>>,
}

impl ProceduralVolume {
    /// Bytes that it takes; the field itself is the scene's.
    pub(in crate::trace) fn bytes(&self) -> usize {
        size_of::<Self>() + list_bytes(&self.named)
    }

    pub(in crate::trace) fn new(
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
    pub(in crate::trace) fn carry(&mut self, names: &[Arc<str>]) {
        let own = self.field.attributes();
        self.named = names.iter().map(|name| own.iter().position(|own| *own == &**name)).collect();
    }

    /// The length over which the field changes along a ray; world space.
    pub(in crate::trace) fn detail_world(&self, ray: &Ray) -> f64 {
        self.field.detail() / self.local_from_world.transform_vector3(ray.direction).length()
    }

    /// The smallest such length along any ray.
    pub(in crate::trace) fn least_detail_world(&self) -> f64 {
        self.field.detail() / largest_stretch(&self.local_from_world)
    }

    /// The largest such length along any ray.
    pub(in crate::trace) fn largest_detail_world(&self) -> f64 {
        self.field.detail() * largest_stretch(&self.local_from_world.inverse())
    }

    /// Starts a packet. `outside`: the boundary is required around the field as well.
    pub(in crate::trace) fn begin(&self, packet: &Packet, outside: bool) -> ProceduralMarch {
        let mut within = [(0, 0); LANES];
        let around = self.bounds_local.inflated(self.reach_local);
        for (lane, within) in within.iter_mut().enumerate().take(packet.len()) {
            let ray = self.local_ray(packet, lane);
            let span = if outside { around.clip(&ray) } else { self.field.span(&ray) };
            let Some((enter, exit)) = span else { continue };
            let number =
                |t: f64| (t / packet.step_world() - packet.sample_offset(lane)).clamp(0.0, MOST_SAMPLES);
            *within = (number(enter).floor() as u64, number(exit).ceil() as u64 + 1);
        }
        ProceduralMarch { within }
    }

    /// A ray of a packet in the field's space; distances along it are those in the world.
    fn local_ray(&self, packet: &Packet, lane: usize) -> Ray {
        let world = packet.ray(lane);
        let origin = self.local_from_world.transform_point3(world.origin);
        Ray { origin, direction: self.local_from_world.transform_vector3(world.direction) }
    }

    /// Fills the lanes that meet the field.
    // Not inlined: its rows would be part of the stack of every instruction of every slab.
    #[inline(never)]
    pub(in crate::trace) fn sample(&self, asked: &ProceduralRequest<'_>, out: &mut NodeSamples) {
        out.touched = 0;
        let field: &dyn Any = &*self.field;
        let solid = field.downcast_ref::<Solid>();
        let mut lanes = asked.live.lanes();
        while lanes != 0 {
            let lane = lanes.trailing_zeros() as usize;
            lanes &= lanes - 1;
            let (first, end) = asked.march.within(lane, asked.slab);
            if first == end {
                continue;
            }
            let ray = self.local_ray(asked.packet, lane);
            let mut left = asked.ends.map_or(f32::INFINITY, |ends| ends[lane]);
            for block in first / BLOCK_SAMPLES..end.div_ceil(BLOCK_SAMPLES) {
                let live = asked.live.0[lane].to_le_bytes()[block];
                let samples = bits(first, end, block) & live;
                if samples == 0 {
                    continue;
                }
                let eight = Eight { lane, block, samples, ray: &ray };
                left -= match solid {
                    Some(solid) => dispatch!(asked.simd.level(), simd =>
                        self.fill_solid(simd, asked, solid, &eight, out)),
                    None => self.fill(asked, &eight, out),
                };
                if !(left >= 0.0) {
                    break;
                }
            }
        }
    }

    /// Makes a lane valid, if it is not yet.
    pub(super) fn begin_lane(&self, lane: usize, required: RequiredOutputs, out: &mut NodeSamples) {
        if out.touched >> lane & 1 == 1 {
            return;
        }
        out.clear_lane(lane, required);
        if required.material {
            for (rows, &v) in out.material.iter_mut().zip(&self.material) {
                rows[lane].0.fill(v);
            }
        }
    }

    /// Fills some samples of one ray. Returns the sum of their optical depths, or 0 if opacities
    /// are requested.
    fn fill(&self, asked: &ProceduralRequest<'_>, eight: &Eight<'_>, out: &mut NodeSamples) -> f32 {
        let ProceduralRequest { packet, slab, measure, required, .. } = *asked;
        let Eight { lane, block, samples: bits, ray } = *eight;
        let (mut places, mut samples) =
            ([DVec3::ZERO; BLOCK_SAMPLES], [ProceduralSample::default(); BLOCK_SAMPLES]);
        // The samples from the first to the last that is wanted, those in between included.
        let first = bits.trailing_zeros() as usize;
        let count = BLOCK_SAMPLES - bits.leading_zeros() as usize - first;
        let range = block * BLOCK_SAMPLES + first..block * BLOCK_SAMPLES + first + count;
        for (place, j) in places.iter_mut().zip(range.clone()) {
            *place = ray.origin + ray.direction * packet.sample_t_world(lane, slab.first + j as u64);
        }
        self.field.sample_all(&places[..count], &mut samples[..count]);
        if !required.outside && samples[..count].iter().all(|s| s.opacity <= 0.0) {
            return 0.0;
        }
        self.begin_lane(lane, required, out);
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

/// Upper bound of sample numbers.
const MOST_SAMPLES: f64 = (1_u64 << 52) as f64;

/// Eight samples of one ray that follow each other.
#[derive(Clone, Copy)]
pub(super) struct Eight<'a> {
    pub(super) lane: usize,
    /// Their place among those of the slab.
    pub(super) block: usize,
    /// A bit for each that is wanted.
    pub(super) samples: u8,
    /// Local space.
    pub(super) ray: &'a Ray,
}

/// The samples from `first` to `end` − 1 of a slab that are in one of its blocks.
#[inline(always)]
fn bits(first: usize, end: usize, block: usize) -> u8 {
    let below = |n: usize| if n >= SLAB_SAMPLES { u32::MAX } else { (1 << n) - 1 };
    (below(end) & !below(first)).to_le_bytes()[block]
}

/// Replaces the numbers of a block whose bits are set.
#[inline(always)]
pub(super) fn replace(row: &mut SampleRow, block: usize, with: &[f32; BLOCK_SAMPLES], bits: u8) {
    let row = &mut row.0.as_chunks_mut::<BLOCK_SAMPLES>().0[block];
    for i in 0..BLOCK_SAMPLES {
        row[i] = if bits >> i & 1 == 1 { with[i] } else { row[i] };
    }
}
