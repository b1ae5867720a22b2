//! From optical depth at samples to what each sample adds to its ray: absorption, front to back.

use fearless_simd::dispatch;

use super::math::absorbed;
use super::node_samples::{NodeSamples, each_lane};
use crate::field::{LANES, Packet, SLAB_SAMPLES, SampleRow, SimdLevel, Slab};

/// What a ray has gathered so far.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct RayState {
    pub(super) color: [f32; 3],
    /// In double precision: rays may pass millions of samples that take next to nothing each.
    pub(super) transmittance: f64,
}

impl RayState {
    pub(super) const START: Self = Self { color: [0.0; 3], transmittance: 1.0 };
}

/// The samples of a slab that add to their rays.
pub(super) struct Shares {
    /// For each lane, a bit for each such sample.
    pub(super) samples: [u32; LANES],
    /// What part of the light of a sample reaches the beginning of its ray.
    pub(super) share: Vec<SampleRow>,
    /// What of the light of the places behind a sample does.
    pub(super) behind: Vec<SampleRow>,
}

impl Shares {
    pub(super) fn new() -> Self {
        let rows = || vec![SampleRow([0.0; SLAB_SAMPLES]); LANES];
        Self { samples: [0; LANES], share: rows(), behind: rows() }
    }

    /// How many there are.
    pub(super) fn count(&self) -> u64 {
        self.samples.iter().map(|bits| u64::from(bits.count_ones())).sum()
    }

    /// Lanes with any.
    pub(super) fn lanes(&self) -> u64 {
        self.samples.iter().enumerate().fold(0, |lanes, (lane, &bits)| lanes | u64::from(bits != 0) << lane)
    }
}

/// How rays lose light.
#[derive(Clone, Copy, Debug)]
pub(super) struct Absorption {
    pub(super) unit_distance: f64,
    /// A ray ends at its first sample behind which less than this is seen.
    pub(super) stop_transmittance: f64,
    pub(super) simd: SimdLevel,
}

impl Absorption {
    /// Takes the rays in `lanes` through a slab. Returns the lanes that go on.
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

    /// One ray through the samples of a slab, front to back: those that are not transparent, and whether it ends.
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

/// The part of the light that each sample's step takes.
#[inline(always)]
fn taken(optical_depth: &SampleRow, step_units: f32) -> SampleRow {
    let mut taken = SampleRow([0.0; SLAB_SAMPLES]);
    for (a, &t) in taken.0.iter_mut().zip(&optical_depth.0) {
        *a = absorbed(t * step_units);
    }
    taken
}
