//! The inner loop: adds runs of points to the samples of a packet of rays.
//!
//! Along a ray, the squared distance to a point is d⊥² + (t − t_c)². A ray takes the runs of a
//! batch together, block by block of eight samples, front to back. Where it first comes to a run,
//! the run's points are tested against all samples of the slab (`pairs`, in the coordinates of
//! `lane_ray`); those that reach the block are added to it (`sums`). If it is known where the ray
//! ends, blocks behind are left out.
//!
//! Bit-identical pictures depend on these invariants:
//! - a contribution is a function of ray, run, point and sample number only;
//! - a sample receives contributions in the order of the points in the file;
//! - culling only leaves out pairs whose contribution is exactly zero, and samples behind the end
//!   of their ray.

use fearless_simd::prelude::*;

use super::batch::{BatchedRun, MOST_RUNS, RunBatch};
use super::columns::CHUNK_POINTS;
use super::counts::SplatCounts;
use super::group::GroupLine;
use super::lane_kernels::{self, LaneKernel};
use super::lane_ray::LaneRay;
use super::packet::{BLOCK_SAMPLES, BLOCKS, BlockRange, GROUP, LANES, Packet, SLAB_SAMPLES, Slab};
use super::pairs::BlockLimits;
use super::samples::{Channels, FieldSamples, RayEnds, SplatJob};
use super::simd::{SimdLevel, dispatch};
use super::splat_wide::splat_wide;
use super::sums::{ANY, COLOR, SampleBlock, Sums};
use rayset_base::kernel::Kernel;

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
    /// Adds all runs of a batch to the samples of one slab, on the rays in `lanes`, for which they
    /// were appended, and empties it. `ends` may be given if no runs follow for this slab.
    pub fn splat(
        &self,
        batch: &mut RunBatch,
        packet: &Packet,
        slab: Slab,
        lanes: u64,
        ends: Option<RayEnds<'_>>,
        samples: &mut FieldSamples,
    ) -> SplatCounts {
        let mut counts = SplatCounts::default();
        let mut runs = batch.runs();
        let limits = &BlockLimits::new(self.kernel == Kernel::Splat);
        while !runs.is_empty() {
            // Runs that need double precision are added each by itself.
            let narrow = runs.iter().take_while(|item| item.run.wide.is_none()).count();
            let (now, later) = runs.split_at_mut(narrow.max(1));
            let ends = ends.filter(|_| later.is_empty());
            let job = SplatJob { packet, slab, lanes, ends, limits, samples };
            counts += match self.kernel {
                Kernel::Wyvill => self.with_kernel::<lane_kernels::Wyvill>(now, job),
                Kernel::Chen => self.with_kernel::<lane_kernels::Chen>(now, job),
                Kernel::Gaussian => self.with_kernel::<lane_kernels::Gaussian>(now, job),
                Kernel::CubicSpline => self.with_kernel::<lane_kernels::CubicSpline>(now, job),
                Kernel::WendlandC2 => self.with_kernel::<lane_kernels::WendlandC2>(now, job),
                Kernel::Epanechnikov => self.with_kernel::<lane_kernels::Epanechnikov>(now, job),
                Kernel::Triweight => self.with_kernel::<lane_kernels::Triweight>(now, job),
                Kernel::Splat => self.with_kernel::<lane_kernels::Splat>(now, job),
            };
            runs = later;
        }
        batch.clear();
        counts
    }

    fn with_kernel<K: LaneKernel>(&self, runs: &mut [Box<BatchedRun>], job: SplatJob<'_>) -> SplatCounts {
        // Labels are kept in memory, as attributes are where there are many.
        let attributes = if self.channels.labels > 0 { ANY } else { self.channels.attributes };
        // All runs are of one cloud. Ellipsoids have fewer loops of their own: one without
        // attributes is that of any number of them.
        let has_shapes = runs.iter().any(|item| !item.run.points.map.is_empty());
        match (self.channels.gradient, attributes) {
            (false, COLOR) if has_shapes => self.with_channels::<K, false, COLOR, true>(runs, job),
            (false, _) if has_shapes => self.with_channels::<K, false, ANY, true>(runs, job),
            (true, COLOR) if has_shapes => self.with_channels::<K, true, COLOR, true>(runs, job),
            (true, _) if has_shapes => self.with_channels::<K, true, ANY, true>(runs, job),
            (false, 0) => self.with_channels::<K, false, 0, false>(runs, job),
            (false, COLOR) => self.with_channels::<K, false, COLOR, false>(runs, job),
            (false, _) => self.with_channels::<K, false, ANY, false>(runs, job),
            (true, 0) => self.with_channels::<K, true, 0, false>(runs, job),
            (true, COLOR) => self.with_channels::<K, true, COLOR, false>(runs, job),
            (true, _) => self.with_channels::<K, true, ANY, false>(runs, job),
        }
    }

    #[inline(never)]
    fn with_channels<K: LaneKernel, const G: bool, const A: usize, const SHAPES: bool>(
        &self,
        runs: &mut [Box<BatchedRun>],
        mut job: SplatJob<'_>,
    ) -> SplatCounts {
        if let [item] = runs
            && item.run.wide.is_some()
        {
            return splat_wide::<G>(self.kernel, self.simd, &item.run, &mut job);
        }
        dispatch!(self.simd.level(), simd => splat_runs::<_, K, G, A, SHAPES>(simd, runs, &mut job))
    }
}

#[inline(always)]
fn splat_runs<S: Simd, K: LaneKernel, const GRADIENT: bool, const ATTRIBUTES: usize, const SHAPES: bool>(
    simd: S,
    runs: &mut [Box<BatchedRun>],
    job: &mut SplatJob<'_>,
) -> SplatCounts {
    let mut counts = SplatCounts::default();
    let mut reaching = [Reaching::default(); LANES];
    let mut lanes = 0;
    for (number, item) in runs.iter().enumerate() {
        for block in 0..BLOCKS {
            let mut meets = item.frames.meets[block] & job.lanes;
            lanes |= meets;
            while meets != 0 {
                reaching[meets.trailing_zeros() as usize & (LANES - 1)].add(block, number);
                meets &= meets - 1;
            }
        }
    }
    for first in (0..LANES).step_by(GROUP) {
        let mut of_group = lanes & 0xffff << first;
        let mut group = Group { first, rays: of_group.count_ones(), asked: 0, bounded: 0, empty: 0 };
        while of_group != 0 {
            let lane = of_group.trailing_zeros() as usize & (LANES - 1);
            of_group &= of_group - 1;
            splat_lane::<S, K, GRADIENT, ATTRIBUTES, SHAPES>(
                simd,
                runs,
                (lane, reaching[lane]),
                &mut group,
                job,
                &mut counts,
            );
        }
    }
    counts.pairs_tested *= CHUNK_POINTS as u64;
    counts.kernel_evaluations = counts.pairs_added * BLOCK_SAMPLES as u64;
    counts
}

/// Neighbouring rays, for which points are looked up together.
struct Group {
    /// The first of its lanes.
    first: usize,
    /// Number of rays that some run may reach.
    rays: u32,
    /// A bit for each run that some ray of the group has come to.
    asked: u32,
    /// Those of them whose points near the group are known.
    bounded: u32,
    /// Those of them that have none.
    empty: u32,
}

/// Fewest rays for which points are looked up together.
const LEAST_RAYS: u32 = 3;

impl Group {
    /// Whether the points of a run that are tested are those selected for the group: of balls
    /// alone.
    #[inline(always)]
    fn selects<const SHAPES: bool>(&self, number: usize) -> bool {
        !SHAPES && self.bounded >> number & 1 == 1
    }

    /// The chunks of points of a run, or of those of its points near the group if these are balls,
    /// that are to be tested against a ray of the group.
    #[inline(always)]
    fn look_up<S: Simd, const SHAPES: bool>(
        &mut self,
        simd: S,
        number: usize,
        item: &mut BatchedRun,
        packet: &Packet,
        ray: &LaneRay,
    ) -> u64 {
        let bit = 1 << number;
        if self.asked & bit == 0 {
            self.asked |= bit;
            if self.rays >= LEAST_RAYS
                && let Some(near) = points_near(simd, item, packet, self.first)
            {
                self.bounded |= bit;
                if near == [0, 0] {
                    self.empty |= bit;
                }
            }
        }
        let is_bounded = self.bounded & bit != 0;
        if SHAPES {
            let near = if is_bounded { item.near_chunks } else { u64::MAX };
            return near & ray.chunks_in_reach::<S, true>(simd, &item.run);
        }
        if is_bounded { item.near_chunks } else { ray.chunks_in_reach::<S, false>(simd, &item.run) }
    }
}

/// Selects the points of a run near a group of rays: a bit for each. `None` if the group is too
/// wide for that. It is the same for all kernels, and compiled apart from them.
fn points_near<S: Simd>(simd: S, item: &mut BatchedRun, packet: &Packet, first: usize) -> Option<[u64; 2]> {
    simd.vectorize(
        #[inline(always)]
        || {
            let line = GroupLine::new(simd, &item.run, packet, &item.frames, first)?;
            let near = line.points_near(simd, &item.run);
            item.near_chunks = if item.run.points.map.is_empty() {
                item.near.select(&item.run.points, near)
            } else {
                // To copy their maps would take longer than to test their neighbours, too.
                chunks_of(near)
            };
            Some(near)
        },
    )
}

/// The chunks of points of which some have their bits set.
fn chunks_of(points: [u64; 2]) -> u64 {
    let of_word = |word: u64| {
        (0..8).fold(0, |chunks, chunk| chunks | u64::from(word >> (8 * chunk) & 0xff != 0) << chunk)
    };
    of_word(points[0]) | of_word(points[1]) << 8
}

/// The runs that may reach each block of a ray: a byte for each block, with a bit for each run.
#[derive(Clone, Copy, Default)]
struct Reaching(u32);

impl Reaching {
    #[inline(always)]
    fn add(&mut self, block: usize, number: usize) {
        self.0 |= 1 << (MOST_RUNS * block + number);
    }

    /// Those that may reach a block, a bit for each.
    #[inline(always)]
    fn block(self, block: usize) -> u32 {
        self.0 >> (MOST_RUNS * block) & 0xff
    }

    /// The blocks that a run may reach, one behind the other from a given one on, which is one of
    /// them.
    #[inline(always)]
    fn blocks_from(self, first: usize, number: usize) -> BlockRange {
        let others = !(self.0 >> (MOST_RUNS * first + number)) & 0x0101_0101;
        BlockRange { first, end: first + others.trailing_zeros() as usize / MOST_RUNS }
    }
}

/// Adds runs to the samples of one ray, block by block, as far as the ray goes.
#[inline(always)]
fn splat_lane<S: Simd, K: LaneKernel, const GRADIENT: bool, const ATTRIBUTES: usize, const SHAPES: bool>(
    simd: S,
    runs: &mut [Box<BatchedRun>],
    (lane, reaching): (usize, Reaching),
    group: &mut Group,
    job: &mut SplatJob<'_>,
    counts: &mut SplatCounts,
) {
    // A bit for each run whose points have been tested.
    let mut tested = 0_u32;
    let mut depth = 0.0;
    for block in 0..BLOCKS {
        let place = SampleBlock { lane, block };
        let (mut sums, mut begun) = (Sums::<S, GRADIENT, ATTRIBUTES>::zero(simd), false);
        let mut here = reaching.block(block) & !group.empty;
        while here != 0 {
            let number = here.trailing_zeros() as usize;
            here &= here - 1;
            let item = &mut *runs[number];
            let ray = LaneRay::new(job.packet, &item.frames, lane);
            if tested >> number & 1 == 0 {
                tested |= 1 << number;
                let blocks = reaching.blocks_from(block, number);
                let chunks = group.look_up::<S, SHAPES>(simd, number, item, job.packet, &ray);
                counts.pairs_tested += u64::from(chunks.count_ones());
                let BatchedRun { run, near, pairs, .. } = item;
                let points = if group.selects::<SHAPES>(number) { near } else { &run.points };
                pairs.test::<S, GRADIENT, SHAPES>(simd, &ray, points, chunks, blocks, job.limits);
            }
            let BatchedRun { run, near, pairs, .. } = item;
            let points = if group.selects::<SHAPES>(number) { &*near } else { &run.points };
            let hits = pairs.hits(block);
            if hits == [0, 0] {
                continue;
            }
            if !begun {
                begun = true;
                job.samples.begin::<GRADIENT>(lane);
                sums = Sums::load(simd, job.samples, place);
            }
            counts.pairs_added += u64::from(hits[0].count_ones() + hits[1].count_ones());
            sums.add::<K, SHAPES>(&ray, pairs, hits, (points, &*run), job.samples, place);
        }
        if begun {
            sums.store(job.samples, place);
        }
        if let Some(ends) = job.ends
            && job.samples.touched >> lane & 1 == 1
        {
            if !begun {
                sums = Sums::load(simd, job.samples, place);
            }
            depth += ends.absorption.sum(sums.density);
            if depth > ends.depth[lane] {
                return;
            }
        }
    }
}

const _: () = assert!(GROUP == 16 && BLOCKS * BLOCK_SAMPLES == SLAB_SAMPLES && MOST_RUNS == 8 && BLOCKS == 4);
