//! The inner loop: adds a run of points to the samples of a packet of rays.
//!
//! Along a ray, the squared distance to a point is d⊥² + (t − t_c)². Points are tested against one ray, sixteen at a
//! time (`pairs`, in the coordinates of `lane_ray`); those that reach it are added to its 32 samples, sixteen at a
//! time.
//!
//! Bit-identical pictures depend on these invariants:
//! - a contribution is a function of ray, run, point and sample number only;
//! - a sample receives contributions in the order of the points in the file;
//! - culling only leaves out pairs whose contribution is exactly zero.

use std::ops::Range;

use fearless_simd::prelude::*;
use fearless_simd::{dispatch, f32x16};

use super::counts::SplatCounts;
use super::kernel::{self, Kernel, LaneKernel};
use super::lane_ray::{Frames, LaneRay};
use super::packet::{Packet, Slab};
use super::pairs::Pairs;
use super::run::DecodedRun;
use super::samples::{Channels, FieldSamples, SplatJob};
use super::simd::SimdLevel;
use super::splat_wide::splat_wide;
use crate::octree::layout::RUN_POINTS;

/// Channels of a colour, whose sums are kept in registers.
const COLOR: usize = 3;
/// Any other number of channels; their sums are kept in memory.
const ANY: usize = usize::MAX;

/// Adds runs to samples with a given kernel and instruction set.
#[derive(Clone, Copy, Debug)]
pub struct Splatter {
    /// The kernel.
    pub kernel: Kernel,
    /// The quantities accumulated.
    pub channels: Channels,
    /// The instruction set.
    pub simd: SimdLevel,
}

impl Splatter {
    /// Adds a run to the samples of one slab, on the rays in `lanes`.
    pub fn splat(
        &self,
        run: &DecodedRun,
        packet: &Packet,
        slab: Slab,
        lanes: u64,
        samples: &mut FieldSamples,
    ) -> SplatCounts {
        let job = SplatJob { run, packet, slab, lanes, samples };
        match self.kernel {
            Kernel::Wyvill => self.with_kernel::<kernel::Wyvill>(job),
            Kernel::Chen => self.with_kernel::<kernel::Chen>(job),
            Kernel::Gaussian => self.with_kernel::<kernel::Gaussian>(job),
            Kernel::CubicSpline => self.with_kernel::<kernel::CubicSpline>(job),
            Kernel::WendlandC2 => self.with_kernel::<kernel::WendlandC2>(job),
            Kernel::Epanechnikov => self.with_kernel::<kernel::Epanechnikov>(job),
            Kernel::Triweight => self.with_kernel::<kernel::Triweight>(job),
        }
    }

    fn with_kernel<K: LaneKernel>(&self, job: SplatJob<'_>) -> SplatCounts {
        // Labels are kept in memory, as attributes are where there are many.
        let attributes = if self.channels.labels > 0 { ANY } else { self.channels.attributes };
        match (self.channels.gradient, attributes) {
            (false, 0) => self.with_channels::<K, false, 0>(job),
            (false, COLOR) => self.with_channels::<K, false, COLOR>(job),
            (false, _) => self.with_channels::<K, false, ANY>(job),
            (true, 0) => self.with_channels::<K, true, 0>(job),
            (true, COLOR) => self.with_channels::<K, true, COLOR>(job),
            (true, _) => self.with_channels::<K, true, ANY>(job),
        }
    }

    #[inline(never)]
    fn with_channels<K: LaneKernel, const G: bool, const A: usize>(
        &self,
        mut job: SplatJob<'_>,
    ) -> SplatCounts {
        let kernel = self.kernel;
        dispatch!(self.simd.level(), simd => splat_run::<_, K, G, A>(simd, kernel, &mut job))
    }
}

#[inline(always)]
fn splat_run<S: Simd, K: LaneKernel, const GRADIENT: bool, const ATTRIBUTES: usize>(
    simd: S,
    kernel: Kernel,
    job: &mut SplatJob<'_>,
) -> SplatCounts {
    let mut counts = SplatCounts::default();
    if let Some(wide) = &job.run.wide {
        return splat_wide::<GRADIENT>(kernel, wide, job);
    }
    let frames = Frames::new(job.run, job.packet, job.slab);
    let mut lanes = job.lanes & frames.lanes_that_meet(simd, job.run, job.packet, job.slab.samples);
    let mut pairs = job.samples.pairs.take().unwrap_or_default();
    while lanes != 0 {
        let lane = lanes.trailing_zeros() as usize;
        lanes &= lanes - 1;
        let ray = LaneRay::new(simd, job.packet, &frames, lane);
        let chunks = ray.chunks_in_reach(simd, job.run);
        counts.pairs_tested += 16 * u64::from(chunks.count_ones());
        if chunks != 0 && pairs.test::<S, GRADIENT>(simd, &ray, job.run, chunks) {
            job.samples.begin::<GRADIENT>(lane);
            let added = add::<S, K, GRADIENT, ATTRIBUTES>(simd, &pairs, &ray, job.run, lane, job.samples);
            counts.pairs_added += added;
            counts.kernel_evaluations += added * 16;
        }
    }
    job.samples.pairs = Some(pairs);
    counts
}

/// Adds all hits to the samples of a lane, in the order of the points; returns the number of pairs of a point and a
/// block of sixteen samples.
#[inline(always)]
fn add<S: Simd, K: LaneKernel, const GRADIENT: bool, const ATTRIBUTES: usize>(
    simd: S,
    pairs: &Pairs,
    ray: &LaneRay<S>,
    run: &DecodedRun,
    lane: usize,
    samples: &mut FieldSamples,
) -> u64 {
    let mut added = 0;
    for (block, hits) in pairs.hits.iter().enumerate() {
        if hits[0] | hits[1] == 0 {
            continue;
        }
        let mut sums = Sums::<S, GRADIENT, ATTRIBUTES>::load(simd, samples, lane, block);
        for (half, &hits) in hits.iter().enumerate() {
            let mut hits = hits;
            added += u64::from(hits.count_ones());
            while hits != 0 {
                // Below RUN_POINTS by construction; the mask makes this visible to the compiler.
                let i = (64 * half + hits.trailing_zeros() as usize) & (RUN_POINTS - 1);
                hits &= hits - 1;
                let along = ray.t[block] * run.inverse_radius[i] - pairs.nearest[i];
                let q = (-along).mul_add(along, f32x16::splat(simd, pairs.inside[i]));
                let weighted = sums.add_value(K::value(q), run, i);
                if ATTRIBUTES == ANY {
                    add_attributes(weighted, run, i, samples, lane, block);
                }
                if GRADIENT {
                    sums.add_slope(K::slope_over_x(q), along, pairs, run, i);
                }
            }
        }
        sums.store(ray, samples, lane, block);
    }
    added
}

/// The range of samples of a block.
#[inline(always)]
fn places(block: usize) -> Range<usize> {
    16 * block..16 * block + 16
}

/// Adds one point to the attributes, whose sums are in memory, and to the labels.
#[inline(always)]
fn add_attributes<S: Simd>(
    weighted: f32x16<S>,
    run: &DecodedRun,
    point: usize,
    samples: &mut FieldSamples,
    lane: usize,
    block: usize,
) {
    for (rows, column) in samples.attribute.iter_mut().zip(&run.attribute) {
        let row = &mut rows[lane].0[places(block)];
        weighted.mul_add(column[point], f32x16::from_slice(weighted.simd, row)).store_slice(row);
    }
    for ([rows, most], column) in samples.label.iter_mut().zip(&run.label) {
        let row = &mut rows[lane].0[places(block)];
        let most = &mut most[lane].0[places(block)];
        let before = f32x16::from_slice(weighted.simd, most);
        let wins = weighted.simd_gt(before);
        let label = f32x16::splat(weighted.simd, column[point]);
        wins.select(label, f32x16::from_slice(weighted.simd, row)).store_slice(row);
        wins.select(weighted, before).store_slice(most);
    }
}

/// Sums over the points of one run at sixteen samples, kept in registers.
struct Sums<S: Simd, const GRADIENT: bool, const ATTRIBUTES: usize> {
    density: f32x16<S>,
    color: [f32x16<S>; COLOR],
    /// Component of the gradient along the ray, of this run only.
    along: f32x16<S>,
    /// Component of the gradient across the ray, with reversed sign, of this run only.
    across: [f32x16<S>; 3],
}

impl<S: Simd, const GRADIENT: bool, const ATTRIBUTES: usize> Sums<S, GRADIENT, ATTRIBUTES> {
    #[inline(always)]
    fn load(simd: S, samples: &FieldSamples, lane: usize, block: usize) -> Self {
        let zero = f32x16::splat(simd, 0.0);
        let density = f32x16::from_slice(simd, &samples.density[lane].0[places(block)]);
        let mut sums = Self { density, color: [zero; COLOR], along: zero, across: [zero; 3] };
        if ATTRIBUTES == COLOR {
            for channel in 0..COLOR {
                sums.color[channel] =
                    f32x16::from_slice(simd, &samples.attribute[channel][lane].0[places(block)]);
            }
        }
        sums
    }

    /// Adds the value of one point to density and colour; returns it, weighted if attributes follow.
    #[inline(always)]
    fn add_value(&mut self, value: f32x16<S>, run: &DecodedRun, point: usize) -> f32x16<S> {
        let weight = run.weight[point];
        if ATTRIBUTES == 0 {
            self.density = value.mul_add(weight, self.density);
            return value;
        }
        let weighted = value * weight;
        self.density += weighted;
        if ATTRIBUTES == COLOR {
            let columns = &run.attribute[..COLOR];
            for channel in 0..COLOR {
                self.color[channel] = weighted.mul_add(columns[channel][point], self.color[channel]);
            }
        }
        weighted
    }

    /// Adds the slope of one point to the gradient.
    #[inline(always)]
    fn add_slope(
        &mut self,
        slope: f32x16<S>,
        along: f32x16<S>,
        pairs: &Pairs,
        run: &DecodedRun,
        point: usize,
    ) {
        let (inverse, weight) = (run.inverse_radius[point], run.weight[point]);
        let slope = slope * (weight * inverse);
        self.along = slope.mul_add(along, self.along);
        let slope = slope * inverse;
        for channel in 0..3 {
            self.across[channel] = slope.mul_add(pairs.across[channel][point], self.across[channel]);
        }
    }

    #[inline(always)]
    fn store(&self, ray: &LaneRay<S>, samples: &mut FieldSamples, lane: usize, block: usize) {
        let at = places(block);
        self.density.store_slice(&mut samples.density[lane].0[at.clone()]);
        for channel in 0..3 {
            if ATTRIBUTES == COLOR {
                self.color[channel].store_slice(&mut samples.attribute[channel][lane].0[at.clone()]);
            }
            if GRADIENT {
                let row = &mut samples.gradient[channel][lane].0[at.clone()];
                let gradient = self.along * ray.direction[channel] - self.across[channel];
                (f32x16::from_slice(self.density.simd, row) + gradient).store_slice(row);
            }
        }
    }
}
