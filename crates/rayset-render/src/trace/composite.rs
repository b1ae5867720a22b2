//! Front-to-back compositing: from the optical depths of samples to the contribution of each sample
//! to its ray.

use fearless_simd::f32x8;
use fearless_simd::prelude::*;

use super::cloud::Remaining;
use super::node_samples::{NodeSamples, Rows, each_lane};
use crate::field::{BLOCK_SAMPLES, LANES, Packet, SLAB_SAMPLES, SampleRow, SimdLevel, Slab, dispatch};
use crate::math::{absorbed_of_eight, ln};

/// What a ray has accumulated so far.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct RayState {
    pub(super) color: [f32; 3],
    /// In double precision: a ray may pass millions of samples that absorb next to nothing each.
    pub(super) transmittance: f64,
}

impl RayState {
    pub(super) const START: Self = Self { color: [0.0; 3], transmittance: 1.0 };
}

/// The samples of a slab that contribute to their rays.
pub(super) struct Shares {
    /// For each lane, a bit for each such sample.
    pub(super) samples: [u32; LANES],
    /// Weight of each sample: the transmittance in front of it times its own opacity.
    pub(super) share: Vec<SampleRow>,
    /// Transmittance of the ray up to and including each sample.
    pub(super) behind: Vec<SampleRow>,
}

impl Shares {
    pub(super) fn new() -> Self {
        let rows = || vec![SampleRow([0.0; SLAB_SAMPLES]); LANES];
        Self { samples: [0; LANES], share: rows(), behind: rows() }
    }

    /// Number of contributing samples.
    pub(super) fn count(&self) -> u64 {
        self.samples.iter().map(|bits| u64::from(bits.count_ones())).sum()
    }

    /// Lanes with at least one of them.
    pub(super) fn lanes(&self) -> u64 {
        self.samples.iter().enumerate().fold(0, |lanes, (lane, &bits)| lanes | u64::from(bits != 0) << lane)
    }
}

/// How rays are attenuated.
#[derive(Clone, Copy, Debug)]
pub(super) struct Absorption {
    pub(super) unit_distance: f64,
    /// A ray ends at the first sample behind which its transmittance is less than this.
    pub(super) stop_transmittance: f64,
    pub(super) simd: SimdLevel,
}

/// Least transmittance at which rays end for which it is foreseen where: far more than what
/// absorption is rounded to.
const LEAST_FORESEEN: f64 = 1e-4;

impl Absorption {
    /// How much is left of rays; `None` if that cannot be said.
    pub(super) fn remaining(&self, packet: &Packet, states: &[RayState; LANES]) -> Option<Remaining> {
        if self.stop_transmittance < LEAST_FORESEEN {
            return None;
        }
        let mut depth = [0.0; LANES];
        for (depth, state) in depth.iter_mut().zip(states) {
            *depth = (state.transmittance / self.stop_transmittance) as f32;
        }
        dispatch!(self.simd.level(), _simd => logarithms(&mut depth));
        // More than all that is rounded on the way to the ray's end.
        let per_unit = (self.unit_distance / packet.step_world()) as f32 * 1.001;
        Some(Remaining { depth: depth.map(|depth| (depth + 1e-5) * per_unit) })
    }

    /// Advances the rays in `lanes` through a slab. Returns the lanes of rays that continue.
    pub(super) fn absorb(
        &self,
        packet: &Packet,
        slab: Slab,
        node: &NodeSamples,
        lanes: u64,
        states: &mut [RayState; LANES],
        shares: &mut Shares,
    ) -> u64 {
        let step_units = (packet.step_world() / self.unit_distance) as f32;
        let mut going = lanes;
        shares.samples.fill(0);
        let taking = lanes & node.touched;
        dispatch!(self.simd.level(), simd => taken(simd, taking, &node.opacity, step_units, shares));
        each_lane(taking, |lane| {
            let opaque = shares.samples[lane] & u32::MAX >> (SLAB_SAMPLES - slab.samples);
            let rows = (&mut shares.share[lane], &mut shares.behind[lane]);
            let (samples, ends) = self.through(opaque, &mut states[lane].transmittance, rows);
            shares.samples[lane] = samples;
            if ends {
                going &= !(1 << lane);
            }
        });
        going
    }

    /// Advances one ray through the opaque samples of a slab, front to back, whose shares are yet
    /// what each absorbs. Returns a bit for each contributing sample, and whether the ray ends.
    fn through(
        &self,
        mut opaque: u32,
        transmittance: &mut f64,
        (share, behind): (&mut SampleRow, &mut SampleRow),
    ) -> (u32, bool) {
        let mut samples = 0;
        while opaque != 0 {
            let j = opaque.trailing_zeros() as usize & (SLAB_SAMPLES - 1);
            opaque &= opaque - 1;
            samples |= 1 << j;
            let taken = share.0[j];
            share.0[j] = *transmittance as f32 * taken;
            *transmittance *= 1.0 - f64::from(taken);
            behind.0[j] = *transmittance as f32;
            if *transmittance < self.stop_transmittance {
                return (samples, true);
            }
        }
        (samples, false)
    }
}

#[inline(always)]
fn logarithms(values: &mut [f32; LANES]) {
    values.iter_mut().for_each(|v| *v = ln(*v));
}

/// Sets the share of each sample to the fraction of light that it absorbs over its step, and its
/// bit if that is any. Blocks without opacity are left as they are.
#[inline(always)]
fn taken<S: Simd>(simd: S, mut lanes: u64, optical_depth: &Rows, step_units: f32, shares: &mut Shares) {
    while lanes != 0 {
        let lane = lanes.trailing_zeros() as usize;
        lanes &= lanes - 1;
        let mut bits = 0;
        for block in 0..SLAB_SAMPLES / BLOCK_SAMPLES {
            let at = block * BLOCK_SAMPLES..(block + 1) * BLOCK_SAMPLES;
            let depth = f32x8::from_slice(simd, &optical_depth[lane].0[at.clone()]);
            if depth.simd_gt(0.0).to_bitmask() == 0 {
                continue;
            }
            let taken = absorbed_of_eight(simd, depth * step_units);
            taken.store_slice(&mut shares.share[lane].0[at.clone()]);
            bits |= (taken.simd_gt(0.0).to_bitmask() as u32) << at.start;
        }
        shares.samples[lane] = bits;
    }
}
