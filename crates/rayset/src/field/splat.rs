//! The inner loop: a run of points is added to the samples of a packet of rays.
//!
//! Along a ray the squared distance to a point is d⊥² + (t − t_c)². The vector d⊥ is formed from coordinates about
//! the centre of the run, with the ray's origin moved (in `f64`) to its foot nearest that centre: |c|² − t_c² from
//! the eye would lose all digits. Points are tested sixteen at a time against one ray; those that reach it are added
//! to its 32 samples, sixteen at a time.
//!
//! Invariants on which bit-identical pictures rest:
//! - a contribution is a function of ray, run, point and sample number only;
//! - a sample receives contributions in the order of the points in the file;
//! - culling leaves out only pairs that would contribute exactly zero.

use fearless_simd::prelude::*;
use fearless_simd::{dispatch, f32x16};

use super::kernel::{self, Kernel, LaneKernel};
use super::packet::{LANES, Packet, SLAB_SAMPLES, Slab};
use super::run::{DecodedRun, WideRun};
use super::simd::SimdLevel;
use crate::octree::layout::RUN_POINTS;

/// Vectors of sixteen in a slab.
const BLOCKS: usize = SLAB_SAMPLES / 16;
/// Channels of a colour: so many sums are kept in registers.
const COLOR: usize = 3;
/// Any number of channels, whose sums are kept in memory.
const ANY: usize = usize::MAX;

/// What is accumulated besides the density.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct Channels {
    /// The gradient of the density.
    pub gradient: bool,
    /// How many weighted attributes.
    pub attributes: usize,
}

/// One value for each sample of a slab.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub struct SampleRow(pub [f32; SLAB_SAMPLES]);

/// The field at the samples of one slab of a packet.
#[derive(Clone, Debug)]
pub struct FieldSamples {
    /// Σ v·ω for each lane.
    pub density: Vec<SampleRow>,
    /// Σ v·∇ω, three components, where asked for.
    pub gradient: [Vec<SampleRow>; 3],
    /// Σ v·ω·a, one for each attribute.
    pub attribute: Vec<Vec<SampleRow>>,
    /// Lanes that received anything since [`clear`](Self::clear); the rows of all others are stale.
    pub touched: u64,
    /// Room to work in, kept from run to run: its contents need not be cleared.
    pairs: Option<Box<Pairs>>,
}

impl FieldSamples {
    /// Room for the channels asked for.
    #[must_use]
    pub fn new(channels: Channels) -> Self {
        let rows = |wanted: bool| vec![SampleRow([0.0; SLAB_SAMPLES]); if wanted { LANES } else { 0 }];
        Self {
            density: rows(true),
            gradient: std::array::from_fn(|_| rows(channels.gradient)),
            attribute: (0..channels.attributes).map(|_| rows(true)).collect(),
            touched: 0,
            pairs: None,
        }
    }

    /// What there is room for.
    #[must_use]
    pub fn channels(&self) -> Channels {
        Channels { gradient: !self.gradient[0].is_empty(), attributes: self.attribute.len() }
    }

    /// Forgets all contributions.
    pub fn clear(&mut self) {
        self.touched = 0;
    }

    /// Zeroes a lane's rows on its first contribution.
    #[inline(always)]
    fn begin<const GRADIENT: bool>(&mut self, lane: usize) {
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
        for rows in &mut self.attribute {
            rows[lane].0.fill(0.0);
        }
    }
}

/// How much work was done.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SplatCounts {
    /// Pairs of a ray and a point that were tested.
    pub pairs_tested: u64,
    /// Pairs that were added to samples.
    pub pairs_added: u64,
    /// Evaluations of a kernel: pairs added times samples worked on.
    pub kernel_evaluations: u64,
}

impl std::ops::AddAssign for SplatCounts {
    fn add_assign(&mut self, other: Self) {
        self.pairs_tested += other.pairs_tested;
        self.pairs_added += other.pairs_added;
        self.kernel_evaluations += other.kernel_evaluations;
    }
}

impl std::ops::Sub for SplatCounts {
    type Output = Self;

    fn sub(self, other: Self) -> Self {
        Self {
            pairs_tested: self.pairs_tested - other.pairs_tested,
            pairs_added: self.pairs_added - other.pairs_added,
            kernel_evaluations: self.kernel_evaluations - other.kernel_evaluations,
        }
    }
}

/// Adds runs to samples with one kernel, on one set of instructions.
#[derive(Clone, Copy, Debug)]
pub struct Splatter {
    /// The kernel.
    pub kernel: Kernel,
    /// What is accumulated.
    pub channels: Channels,
    /// The instructions.
    pub simd: SimdLevel,
}

/// Everything that a splat works on.
struct Job<'a> {
    run: &'a DecodedRun,
    packet: &'a Packet,
    slab: Slab,
    lanes: u64,
    samples: &'a mut FieldSamples,
}

impl Splatter {
    /// Adds a run to the samples of the rays in `lanes`, in one slab.
    pub fn splat(
        &self,
        run: &DecodedRun,
        packet: &Packet,
        slab: Slab,
        lanes: u64,
        samples: &mut FieldSamples,
    ) -> SplatCounts {
        let job = Job { run, packet, slab, lanes, samples };
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

    fn with_kernel<K: LaneKernel>(&self, job: Job<'_>) -> SplatCounts {
        match (self.channels.gradient, self.channels.attributes) {
            (false, 0) => self.with_channels::<K, false, 0>(job),
            (false, COLOR) => self.with_channels::<K, false, COLOR>(job),
            (false, _) => self.with_channels::<K, false, ANY>(job),
            (true, 0) => self.with_channels::<K, true, 0>(job),
            (true, COLOR) => self.with_channels::<K, true, COLOR>(job),
            (true, _) => self.with_channels::<K, true, ANY>(job),
        }
    }

    #[inline(never)]
    fn with_channels<K: LaneKernel, const G: bool, const A: usize>(&self, mut job: Job<'_>) -> SplatCounts {
        let kernel = self.kernel;
        dispatch!(self.simd.level(), simd => splat_run::<_, K, G, A>(simd, kernel, &mut job))
    }
}

/// Where a ray is, seen from a run: its foot nearest the run's centre, and its samples counted from there.
struct Frames {
    foot: [[f32; LANES]; 3],
    /// Offset of the slab's first sample from the sample nearest the foot.
    first_sample: [f32; LANES],
    /// Distance along the ray from the foot to the sample nearest it.
    sample_zero: [f32; LANES],
}

impl Frames {
    #[inline(always)]
    fn new(run: &DecodedRun, packet: &Packet, slab: Slab) -> Self {
        let mut frames =
            Self { foot: [[0.0; LANES]; 3], first_sample: [0.0; LANES], sample_zero: [0.0; LANES] };
        let (o, d) = (&packet.origin, &packet.direction);
        let center = run.center.to_array();
        let first = slab.first as f64;
        // Plain multiplications and additions: `f64` has digits to spare, and a fused form is slow where there is
        // no instruction for it.
        for lane in 0..LANES {
            let (x, y, z) = (o[0][lane] - center[0], o[1][lane] - center[1], o[2][lane] - center[2]);
            let t_foot = -(x * d[0][lane] + y * d[1][lane] + z * d[2][lane]);
            frames.foot[0][lane] = (x + t_foot * d[0][lane]) as f32;
            frames.foot[1][lane] = (y + t_foot * d[1][lane]) as f32;
            frames.foot[2][lane] = (z + t_foot * d[2][lane]) as f32;
            let nearest = (t_foot * packet.per_step[lane]).floor();
            frames.first_sample[lane] = (first - nearest) as f32;
            frames.sample_zero[lane] =
                ((nearest + packet.sample_offset[lane]) * packet.step[lane] - t_foot) as f32;
        }
        frames
    }

    /// Lanes whose stretch of samples may meet the run's bounds of influence.
    #[inline(always)]
    fn lanes_that_meet<S: Simd>(&self, simd: S, run: &DecodedRun, packet: &Packet, samples: usize) -> u64 {
        let mut mask = 0;
        let last = (samples - 1) as f32;
        for chunk in 0..LANES / 16 {
            let step = lanes_of(simd, &packet.step_f32, chunk);
            let start =
                lanes_of(simd, &self.first_sample, chunk) * step + lanes_of(simd, &self.sample_zero, chunk);
            // Half a step of slack on either side covers the rounding of this test.
            let (mut enter, mut exit) = (start - step * 0.5, start + step * (last + 0.5));
            for axis in 0..3 {
                let foot = lanes_of(simd, &self.foot[axis], chunk);
                let inverse = lanes_of(simd, &packet.inverse_direction[axis], chunk);
                let reach = run.reach[axis];
                // A direction without extent along this axis neither enters nor leaves: the products are huge and
                // of opposite sign inside, of the same sign outside.
                let (a, b) = ((-reach - foot) * inverse, (reach - foot) * inverse);
                enter = enter.max(a.min(b));
                exit = exit.min(a.max(b));
            }
            let slack = (enter.abs() + exit.abs()) * 1e-5;
            mask |= (enter - slack).simd_le(exit + slack).to_bitmask() << (16 * chunk);
        }
        mask
    }
}

/// Sixteen lanes of a column. A closure would do, but closures are not always inlined where vectors must be.
#[inline(always)]
fn lanes_of<S: Simd>(simd: S, column: &[f32; LANES], chunk: usize) -> f32x16<S> {
    f32x16::from_slice(simd, &column[16 * chunk..16 * chunk + 16])
}

#[inline(always)]
fn splat_run<S: Simd, K: LaneKernel, const GRADIENT: bool, const ATTRIBUTES: usize>(
    simd: S,
    kernel: Kernel,
    job: &mut Job<'_>,
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
        let ray = LaneRay::new(simd, job, &frames, lane);
        let chunks = ray.chunks_in_reach(simd, job.run);
        counts.pairs_tested += 16 * u64::from(chunks.count_ones());
        if chunks != 0 && pairs.test::<S, GRADIENT>(simd, &ray, job.run, chunks) {
            job.samples.begin::<GRADIENT>(lane);
            let added = pairs.add::<S, K, GRADIENT, ATTRIBUTES>(simd, &ray, job.run, lane, job.samples);
            counts.pairs_added += added;
            counts.kernel_evaluations += added * 16;
        }
    }
    job.samples.pairs = Some(pairs);
    counts
}

/// One ray as a run sees it.
struct LaneRay<S: Simd> {
    foot: [f32; 3],
    direction: [f32; 3],
    /// Distances along the ray, from its foot, of the samples of the slab.
    t: [f32x16<S>; BLOCKS],
    /// The same for the first and the last sample of each block, with a little to spare, so that culling is never
    /// stricter than the evaluation.
    block_start: [f32; BLOCKS],
    block_end: [f32; BLOCKS],
}

impl<S: Simd> LaneRay<S> {
    #[inline(always)]
    fn new(simd: S, job: &Job<'_>, frames: &Frames, lane: usize) -> Self {
        let step = job.packet.step_f32[lane];
        let (first, zero) = (frames.first_sample[lane], frames.sample_zero[lane]);
        let count = f32x16::from_slice(simd, &COUNT);
        let mut ray = Self {
            foot: [frames.foot[0][lane], frames.foot[1][lane], frames.foot[2][lane]],
            direction: job.packet.direction_f32(lane),
            t: [f32x16::splat(simd, zero); BLOCKS],
            block_start: [0.0; BLOCKS],
            block_end: [0.0; BLOCKS],
        };
        for b in 0..BLOCKS {
            let block_first = first + (16 * b) as f32;
            ray.t[b] = (count + block_first).mul_add(step, ray.t[b]);
            ray.block_start[b] = (block_first - 0.01) * step + zero;
            ray.block_end[b] = (block_first + 15.01) * step + zero;
        }
        ray
    }

    /// Distance along the ray to where points are nearest, and the vectors from the ray to them.
    #[inline(always)]
    fn project(&self, simd: S, position: [f32x16<S>; 3]) -> (f32x16<S>, [f32x16<S>; 3]) {
        let (x, y, z) = (position[0] - self.foot[0], position[1] - self.foot[1], position[2] - self.foot[2]);
        let dx = f32x16::splat(simd, self.direction[0]);
        let dy = f32x16::splat(simd, self.direction[1]);
        let dz = f32x16::splat(simd, self.direction[2]);
        let nearest = z.mul_add(dz, y.mul_add(dy, x * dx));
        let back = -nearest;
        (nearest, [back.mul_add(dx, x), back.mul_add(dy, y), back.mul_add(dz, z)])
    }

    /// Chunks of sixteen points whose sphere of influence the ray meets within the slab.
    #[inline(always)]
    fn chunks_in_reach(&self, simd: S, run: &DecodedRun) -> u64 {
        let center = [
            f32x16::from_slice(simd, &run.chunk_center[0]),
            f32x16::from_slice(simd, &run.chunk_center[1]),
            f32x16::from_slice(simd, &run.chunk_center[2]),
        ];
        let (nearest, [x, y, z]) = self.project(simd, center);
        let distance_squared = z.mul_add(z, y.mul_add(y, x * x));
        let gap = (self.block_start[0] - nearest).max(nearest - self.block_end[BLOCKS - 1]).max(0.0);
        let within =
            gap.mul_add(gap, distance_squared).simd_le(f32x16::from_slice(simd, &run.chunk_reach_squared));
        within.to_bitmask() & ((1 << run.len.div_ceil(16)) - 1)
    }
}

/// One ray against points of a run, in units of their radii.
#[derive(Clone, Debug)]
struct Pairs {
    /// Distance along the ray from the foot to where the point is nearest, over the radius.
    nearest: [f32; RUN_POINTS],
    /// 1 − d⊥²/r².
    inside: [f32; RUN_POINTS],
    /// The vector from the ray to the point, world units, where gradients are wanted.
    across: [[f32; RUN_POINTS]; 3],
    /// For each block of samples, the points that reach it.
    hits: [[u64; 2]; BLOCKS],
}

impl Default for Pairs {
    fn default() -> Self {
        Self {
            nearest: [0.0; RUN_POINTS],
            inside: [0.0; RUN_POINTS],
            across: [[0.0; RUN_POINTS]; 3],
            hits: [[0; 2]; BLOCKS],
        }
    }
}

impl Pairs {
    /// Finds the points that reach samples of the slab; false where there are none.
    #[inline(always)]
    fn test<S: Simd, const GRADIENT: bool>(
        &mut self,
        simd: S,
        ray: &LaneRay<S>,
        run: &DecodedRun,
        mut chunks: u64,
    ) -> bool {
        let mut hits = [[0_u64; 2]; BLOCKS];
        while chunks != 0 {
            let chunk = chunks.trailing_zeros() as usize & 7;
            chunks &= chunks - 1;
            let range = 16 * chunk..16 * chunk + 16;
            let position = [
                f32x16::from_slice(simd, &run.position[0][range.clone()]),
                f32x16::from_slice(simd, &run.position[1][range.clone()]),
                f32x16::from_slice(simd, &run.position[2][range.clone()]),
            ];
            let (nearest, [x, y, z]) = ray.project(simd, position);
            let inverse = f32x16::from_slice(simd, &run.inverse_radius[range.clone()]);
            let distance_squared = z.mul_add(z, y.mul_add(y, x * x));
            let nearest = nearest * inverse;
            let inside = (-distance_squared).mul_add(inverse * inverse, f32x16::splat(simd, 1.0));
            // What rounding may take from a pair that just contributes is far below this.
            let reach = inside + 1e-5;
            for b in 0..BLOCKS {
                let before = inverse * ray.block_start[b] - nearest;
                let behind = nearest - inverse * ray.block_end[b];
                let gap = before.max(behind).max(0.0);
                hits[b][chunk / 4] |= (gap * gap).simd_lt(reach).to_bitmask() << (16 * (chunk % 4));
            }
            nearest.store_slice(&mut self.nearest[range.clone()]);
            inside.store_slice(&mut self.inside[range.clone()]);
            if GRADIENT {
                x.store_slice(&mut self.across[0][range.clone()]);
                y.store_slice(&mut self.across[1][range.clone()]);
                z.store_slice(&mut self.across[2][range.clone()]);
            }
        }
        let valid = [u64::MAX >> 64_usize.saturating_sub(run.len).min(63), high_mask(run.len)];
        let mut any = 0;
        for b in 0..BLOCKS {
            self.hits[b] = [hits[b][0] & valid[0], hits[b][1] & valid[1]];
            any |= self.hits[b][0] | self.hits[b][1];
        }
        any != 0
    }

    /// Adds all hits to the samples of the lane, in the order of the points; returns how many vectors of samples.
    #[inline(always)]
    fn add<S: Simd, K: LaneKernel, const GRADIENT: bool, const ATTRIBUTES: usize>(
        &self,
        simd: S,
        ray: &LaneRay<S>,
        run: &DecodedRun,
        lane: usize,
        samples: &mut FieldSamples,
    ) -> u64 {
        let zero = f32x16::splat(simd, 0.0);
        let columns = if ATTRIBUTES == COLOR { &run.attribute[..COLOR] } else { &run.attribute[..] };
        let mut added = 0;
        for b in 0..BLOCKS {
            let [low, high] = self.hits[b];
            if low | high == 0 {
                continue;
            }
            let at = 16 * b..16 * b + 16;
            let mut density = f32x16::from_slice(simd, &samples.density[lane].0[at.clone()]);
            let mut color = [zero; COLOR];
            if ATTRIBUTES == COLOR {
                for channel in 0..COLOR {
                    color[channel] =
                        f32x16::from_slice(simd, &samples.attribute[channel][lane].0[at.clone()]);
                }
            }
            // The gradient along the ray and against `across`, of this run alone.
            let mut along_sum = zero;
            let mut across_sum = [zero; 3];
            for half in 0..2 {
                let mut hits = self.hits[b][half];
                added += u64::from(hits.count_ones());
                while hits != 0 {
                    // Below RUN_POINTS by construction; the mask lets the compiler see it.
                    let i = (64 * half + hits.trailing_zeros() as usize) & (RUN_POINTS - 1);
                    hits &= hits - 1;
                    let (inverse, weight) = (run.inverse_radius[i], run.weight[i]);
                    let along = ray.t[b] * inverse - self.nearest[i];
                    let q = (-along).mul_add(along, f32x16::splat(simd, self.inside[i]));
                    let value = K::value(q);
                    if ATTRIBUTES == 0 {
                        density = value.mul_add(weight, density);
                    } else {
                        let weighted = value * weight;
                        density += weighted;
                        if ATTRIBUTES == COLOR {
                            for channel in 0..COLOR {
                                color[channel] = weighted.mul_add(columns[channel][i], color[channel]);
                            }
                        } else {
                            for (rows, column) in samples.attribute.iter_mut().zip(columns) {
                                let row = &mut rows[lane].0[at.clone()];
                                weighted.mul_add(column[i], f32x16::from_slice(simd, row)).store_slice(row);
                            }
                        }
                    }
                    if GRADIENT {
                        let slope = K::slope_over_x(q) * (weight * inverse);
                        along_sum = slope.mul_add(along, along_sum);
                        let slope = slope * inverse;
                        for channel in 0..3 {
                            across_sum[channel] = slope.mul_add(self.across[channel][i], across_sum[channel]);
                        }
                    }
                }
            }
            density.store_slice(&mut samples.density[lane].0[at.clone()]);
            for channel in 0..3 {
                if ATTRIBUTES == COLOR {
                    color[channel].store_slice(&mut samples.attribute[channel][lane].0[at.clone()]);
                }
                if GRADIENT {
                    let row = &mut samples.gradient[channel][lane].0[at.clone()];
                    let run_gradient = along_sum * ray.direction[channel] - across_sum[channel];
                    (f32x16::from_slice(simd, row) + run_gradient).store_slice(row);
                }
            }
        }
        added
    }
}

/// The bits of points 64 to 127 of a run of `len` points.
#[inline(always)]
fn high_mask(len: usize) -> u64 {
    match len.saturating_sub(64) {
        0 => 0,
        more => u64::MAX >> (64 - more),
    }
}

const COUNT: [f32; 16] = [0., 1., 2., 3., 4., 5., 6., 7., 8., 9., 10., 11., 12., 13., 14., 15.];

/// A run whose points are small for its extent, in `f64`. Slow, and rare: each pair is worked out by itself.
#[inline(never)]
fn splat_wide<const GRADIENT: bool>(kernel: Kernel, wide: &WideRun, job: &mut Job<'_>) -> SplatCounts {
    let mut counts = SplatCounts::default();
    let (run, packet, slab) = (job.run, job.packet, job.slab);
    let center = run.center.to_array();
    let mut lanes = job.lanes;
    while lanes != 0 {
        let lane = lanes.trailing_zeros() as usize;
        lanes &= lanes - 1;
        let d: [f64; 3] = std::array::from_fn(|axis| packet.direction[axis][lane]);
        let o: [f64; 3] = std::array::from_fn(|axis| packet.origin[axis][lane] - center[axis]);
        counts.pairs_tested += run.len as u64;
        for i in 0..run.len {
            let c: [f64; 3] = std::array::from_fn(|axis| wide.position[axis][i] - o[axis]);
            let nearest = c[0] * d[0] + c[1] * d[1] + c[2] * d[2];
            let across: [f64; 3] = std::array::from_fn(|axis| c[axis] - nearest * d[axis]);
            let distance_squared = across[0] * across[0] + across[1] * across[1] + across[2] * across[2];
            let inverse = wide.inverse_radius[i] * wide.inverse_radius[i];
            if distance_squared * inverse >= 1.0 {
                continue;
            }
            let half = (1.0 / inverse - distance_squared).max(0.0).sqrt();
            // Samples in reach, one to spare on either side. Conversions round towards 0, and numbers below it become 0.
            let number = |t: f64| t / packet.step[lane] - packet.sample_offset[lane];
            let first = ((number(nearest - half) - 1.0) as u64).max(slab.first);
            let last = ((number(nearest + half) + 2.0) as u64).min(slab.end() - 1);
            if number(nearest + half) <= -2.0 || last < first {
                continue;
            }
            job.samples.begin::<GRADIENT>(lane);
            counts.pairs_added += 1;
            for sample in first..=last {
                counts.kernel_evaluations += 1;
                let along = packet.sample_t(lane, sample) - nearest;
                let s = (along * along + distance_squared) * inverse;
                let at = (sample - slab.first) as usize;
                let weighted = (kernel.value(s) * f64::from(run.weight[i])) as f32;
                job.samples.density[lane].0[at] += weighted;
                for (rows, column) in job.samples.attribute.iter_mut().zip(&run.attribute) {
                    rows[lane].0[at] += weighted * column[i];
                }
                if GRADIENT {
                    let slope = kernel.slope_over_x(s) * f64::from(run.weight[i]) * inverse;
                    for channel in 0..3 {
                        let offset = along * d[channel] - across[channel];
                        job.samples.gradient[channel][lane].0[at] += (slope * offset) as f32;
                    }
                }
            }
        }
    }
    counts
}
