//! Front-to-back compositing: from the optical depths of samples to the contribution of each sample to its ray.

use fearless_simd::dispatch;

use super::math::absorbed;
use super::node_samples::{NodeSamples, each_lane};
use crate::field::{LANES, Packet, SLAB_SAMPLES, SampleRow, SimdLevel, Slab};

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

impl Absorption {
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
        each_lane(lanes & node.touched, |lane| {
            let optical_depth = &node.opacity[lane];
            let taken = dispatch!(self.simd.level(), _simd => taken(optical_depth, step_units));
            let rows = (&mut shares.share[lane], &mut shares.behind[lane]);
            let (samples, ends) = self.through(&taken, slab, &mut states[lane].transmittance, rows);
            shares.samples[lane] = samples;
            if ends {
                going &= !(1 << lane);
            }
        });
        going
    }

    /// Advances one ray through the samples of a slab, front to back. Returns a bit for each contributing sample, and
    /// whether the ray ends.
    fn through(
        &self,
        taken: &SampleRow,
        slab: Slab,
        transmittance: &mut f64,
        (share, behind): (&mut SampleRow, &mut SampleRow),
    ) -> (u32, bool) {
        let mut opaque = 0_u32;
        for (j, &a) in taken.0[..slab.samples].iter().enumerate() {
            opaque |= u32::from(a > 0.0) << j;
        }
        let mut samples = 0;
        while opaque != 0 {
            let j = opaque.trailing_zeros() as usize & (SLAB_SAMPLES - 1);
            opaque &= opaque - 1;
            samples |= 1 << j;
            share.0[j] = *transmittance as f32 * taken.0[j];
            *transmittance *= 1.0 - f64::from(taken.0[j]);
            behind.0[j] = *transmittance as f32;
            if *transmittance < self.stop_transmittance {
                return (samples, true);
            }
        }
        (samples, false)
    }
}

/// The fraction of light that each sample absorbs over its step.
#[inline(always)]
fn taken(optical_depth: &SampleRow, step_units: f32) -> SampleRow {
    let mut taken = SampleRow([0.0; SLAB_SAMPLES]);
    for (a, &t) in taken.0.iter_mut().zip(&optical_depth.0) {
        *a = absorbed(t * step_units);
    }
    taken
}
