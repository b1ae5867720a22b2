//! The field at the samples of one slab of a packet, accumulated run by run.

use fearless_simd::f32x8;
use fearless_simd::prelude::*;

use super::packet::{LANES, Packet, SLAB_SAMPLES, Slab};
use super::pairs::BlockLimits;
#[cfg(test)]
use super::simd::{SimdLevel, dispatch};

/// The quantities accumulated besides the density.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct Channels {
    /// The gradient of the density.
    pub gradient: bool,
    /// Number of weighted attributes.
    pub attributes: usize,
    /// Number of attributes of class labels, which are not averaged.
    pub labels: usize,
}

/// One value for each sample of a slab.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub struct SampleRow(pub [f32; SLAB_SAMPLES]);

/// The field at the samples of one slab of a packet.
#[derive(Clone, Debug)]
pub struct FieldSamples {
    /// The density, Σ v·ω, for each lane.
    pub density: Vec<SampleRow>,
    /// Its gradient, Σ v·∇ω, by components; empty if not requested.
    pub gradient: [Vec<SampleRow>; 3],
    /// Σ v·ω·a for each attribute.
    pub attribute: Vec<Vec<SampleRow>>,
    /// For each attribute of class labels, the label of the point whose v·ω is largest, the first
    /// of equals, and that v·ω.
    pub label: Vec<[Vec<SampleRow>; 2]>,
    /// Lanes that have received contributions since [`clear`](Self::clear); the rows of all other
    /// lanes are stale.
    pub touched: u64,
}

impl FieldSamples {
    /// Allocates rows for the requested channels.
    #[must_use]
    pub fn new(channels: Channels) -> Self {
        let rows = |wanted: bool| vec![SampleRow([0.0; SLAB_SAMPLES]); if wanted { LANES } else { 0 }];
        Self {
            density: rows(true),
            gradient: std::array::from_fn(|_| rows(channels.gradient)),
            attribute: (0..channels.attributes).map(|_| rows(true)).collect(),
            label: (0..channels.labels).map(|_| [rows(true), rows(true)]).collect(),
            touched: 0,
        }
    }

    /// The channels for which rows are allocated.
    #[must_use]
    pub fn channels(&self) -> Channels {
        let (attributes, labels) = (self.attribute.len(), self.label.len());
        Channels { gradient: !self.gradient[0].is_empty(), attributes, labels }
    }

    /// Forgets all contributions.
    pub fn clear(&mut self) {
        self.touched = 0;
    }

    /// Zeroes the rows of a lane before its first contribution.
    #[inline(always)]
    pub(super) fn begin<const GRADIENT: bool>(&mut self, lane: usize) {
        if self.touched >> lane & 1 != 0 {
            return;
        }
        self.touched |= 1 << lane;
        self.density[lane].0.fill(0.0);
        for channel in 0..3 {
            if GRADIENT {
                self.gradient[channel][lane].0.fill(0.0);
            }
        }
        for rows in self.attribute.iter_mut().chain(self.label.iter_mut().flatten()) {
            rows[lane].0.fill(0.0);
        }
    }
}

impl FieldSamples {
    /// Gives a sample the labels of a point whose contribution is `weighted`, if no other
    /// contributed as much.
    pub(super) fn label(&mut self, lane: usize, sample: usize, weighted: f32, of: impl Fn(usize) -> f32) {
        for (number, [rows, most]) in self.label.iter_mut().enumerate() {
            if weighted > most[lane].0[sample] {
                (rows[lane].0[sample], most[lane].0[sample]) = (of(number), weighted);
            }
        }
    }
}

/// Where rays end, so that samples behind are left out.
#[derive(Clone, Copy, Debug)]
pub struct RayEnds<'a> {
    /// For each lane, the optical depth from the slab's beginning at which its ray has ended.
    pub depth: &'a [f32; LANES],
    /// The optical depth of each sample, in the same unit, or less.
    pub absorption: LeastAbsorption,
}

/// A lower bound of the optical depth of a sample by its density: 0, then a line, then a constant.
#[derive(Clone, Copy, Debug)]
pub struct LeastAbsorption {
    /// The density from which on the line rises.
    pub from: f32,
    /// By how much it rises for each unit of density.
    pub per_density: f32,
    /// The most that it may come to.
    pub most: f32,
    /// The density from which on the constant holds.
    pub full: f32,
    /// The constant.
    pub when_full: f32,
}

impl LeastAbsorption {
    /// The sum over samples of these densities.
    #[inline(always)]
    pub(super) fn sum<S: Simd>(&self, density: f32x8<S>) -> f32 {
        let most = f32x8::splat(density.simd, self.most);
        // A density that is NaN absorbs nothing.
        let line = ((density - self.from) * self.per_density).max(0.0).min(most);
        let constant = f32x8::splat(density.simd, self.when_full);
        density.simd_ge(self.full).select(constant, line).reduce_sum()
    }

    /// That of one sample.
    #[cfg(test)]
    pub(crate) fn of(&self, density: f32) -> f32 {
        let row: [f32; 8] = std::array::from_fn(|j| if j == 3 { density } else { 0.0 });
        dispatch!(SimdLevel::default().level(), simd => self.sum(f32x8::from_slice(simd, &row)))
    }
}

/// The operands of a splat.
pub(super) struct SplatJob<'a> {
    pub(super) packet: &'a Packet,
    pub(super) slab: Slab,
    pub(super) lanes: u64,
    pub(super) ends: Option<RayEnds<'a>>,
    pub(super) limits: &'a BlockLimits,
    pub(super) samples: &'a mut FieldSamples,
}
