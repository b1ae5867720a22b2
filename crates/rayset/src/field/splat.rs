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
use crate::octree::page::RUN_POINTS;

/// Vectors of sixteen in a slab.
const BLOCKS: usize = SLAB_SAMPLES / 16;

/// What is accumulated besides the density.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct Channels {
    /// The gradient of the density.
    pub gradient: bool,
    /// Weighted attributes: a colour, or one scalar in the first channel.
    pub attributes: bool,
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
    /// Σ v·ω·a, where asked for.
    pub attribute: [Vec<SampleRow>; 3],
    /// Lanes that received anything since [`clear`](Self::clear); the rows of all others are stale.
    pub touched: u64,
}

impl FieldSamples {
    /// Room for the channels asked for.
    #[must_use]
    pub fn new(channels: Channels) -> Self {
        let rows = |wanted: bool| vec![SampleRow([0.0; SLAB_SAMPLES]); if wanted { LANES } else { 0 }];
        Self {
            density: rows(true),
            gradient: std::array::from_fn(|_| rows(channels.gradient)),
            attribute: std::array::from_fn(|_| rows(channels.attributes)),
            touched: 0,
        }
    }

    /// Forgets all contributions.
    pub fn clear(&mut self) {
        self.touched = 0;
    }

    /// Zeroes a lane's rows on its first contribution.
    #[inline(always)]
    fn begin<const GRADIENT: bool, const ATTRIBUTES: bool>(&mut self, lane: usize) {
        if self.touched >> lane & 1 != 0 {
            return;
        }
        self.touched |= 1 << lane;
        self.density[lane].0.fill(0.0);
        for channel in 0..3 {
            if GRADIENT {
                self.gradient[channel][lane].0.fill(0.0);
            }
            if ATTRIBUTES {
                self.attribute[channel][lane].0.fill(0.0);
            }
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
            (false, false) => self.with_channels::<K, false, false>(job),
            (false, true) => self.with_channels::<K, false, true>(job),
            (true, false) => self.with_channels::<K, true, false>(job),
            (true, true) => self.with_channels::<K, true, true>(job),
        }
    }

    #[inline(never)]
    fn with_channels<K: LaneKernel, const G: bool, const A: bool>(&self, mut job: Job<'_>) -> SplatCounts {
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
        let (step, per_step, first) = (packet.step(), 1.0 / packet.step(), slab.first as f64);
        // Plain multiplications and additions: `f64` has digits to spare, and a fused form is slow where there is
        // no instruction for it.
        for lane in 0..LANES {
            let (x, y, z) = (o[0][lane] - center[0], o[1][lane] - center[1], o[2][lane] - center[2]);
            let t_foot = -(x * d[0][lane] + y * d[1][lane] + z * d[2][lane]);
            frames.foot[0][lane] = (x + t_foot * d[0][lane]) as f32;
            frames.foot[1][lane] = (y + t_foot * d[1][lane]) as f32;
            frames.foot[2][lane] = (z + t_foot * d[2][lane]) as f32;
            let nearest = (t_foot * per_step).floor();
            frames.first_sample[lane] = (first - nearest) as f32;
            frames.sample_zero[lane] = ((nearest + packet.phase[lane]) * step - t_foot) as f32;
        }
        frames
    }

    /// Lanes whose stretch of samples may meet the run's bounds of influence.
    #[inline(always)]
    fn lanes_that_meet<S: Simd>(&self, simd: S, run: &DecodedRun, packet: &Packet, samples: usize) -> u64 {
        let mut mask = 0;
        let step = packet.step() as f32;
        let last = (samples - 1) as f32;
        for chunk in 0..LANES / 16 {
            let load = |column: &[f32; LANES]| f32x16::from_slice(simd, &column[16 * chunk..16 * chunk + 16]);
            let start = load(&self.first_sample) * step + load(&self.sample_zero);
            // Half a step of slack on either side covers the rounding of this test.
            let (mut enter, mut exit) = (start - 0.5 * step, start + (last + 0.5) * step);
            for axis in 0..3 {
                let (foot, direction) = (load(&self.foot[axis]), load(&packet.direction_f32[axis]));
                let reach = run.reach[axis];
                // A direction without extent along this axis neither enters nor leaves: the quotients are huge and
                // of opposite sign inside, of the same sign outside.
                let steep = direction.abs().max(1e-30).copysign(direction);
                let (a, b) = ((-reach - foot) / steep, (reach - foot) / steep);
                enter = enter.max(a.min(b));
                exit = exit.min(a.max(b));
            }
            let slack = (enter.abs() + exit.abs()) * 1e-5;
            mask |= (enter - slack).simd_le(exit + slack).to_bitmask() << (16 * chunk);
        }
        mask
    }
}

#[inline(always)]
fn splat_run<S: Simd, K: LaneKernel, const GRADIENT: bool, const ATTRIBUTES: bool>(
    simd: S,
    kernel: Kernel,
    job: &mut Job<'_>,
) -> SplatCounts {
    let mut counts = SplatCounts::default();
    if let Some(wide) = &job.run.wide {
        return splat_wide::<GRADIENT, ATTRIBUTES>(kernel, wide, job);
    }
    let frames = Frames::new(job.run, job.packet, job.slab);
    let mut lanes = job.lanes & frames.lanes_that_meet(simd, job.run, job.packet, job.slab.samples);
    while lanes != 0 {
        let lane = lanes.trailing_zeros() as usize;
        lanes &= lanes - 1;
        let mut pairs = Pairs::default();
        pairs.test::<S, GRADIENT>(simd, job, &frames, lane);
        counts.pairs_tested += job.run.len as u64;
        if pairs.hits != [0; 2] {
            job.samples.begin::<GRADIENT, ATTRIBUTES>(lane);
            let added = pairs.add::<S, K, GRADIENT, ATTRIBUTES>(simd, job, &frames, lane);
            counts.pairs_added += added;
            counts.kernel_evaluations += added * SLAB_SAMPLES as u64;
        }
    }
    counts
}

/// One ray against all points of a run.
struct Pairs {
    /// Distance along the ray from the foot to the point nearest on the ray.
    nearest: [f32; RUN_POINTS],
    /// Squared distance of the point from the ray.
    distance_squared: [f32; RUN_POINTS],
    /// The vector from the ray to the point, where gradients are wanted.
    across: [[f32; RUN_POINTS]; 3],
    /// Points that reach the ray within the slab.
    hits: [u64; 2],
}

impl Default for Pairs {
    #[inline(always)]
    fn default() -> Self {
        Self {
            nearest: [0.0; RUN_POINTS],
            distance_squared: [0.0; RUN_POINTS],
            across: [[0.0; RUN_POINTS]; 3],
            hits: [0; 2],
        }
    }
}

impl Pairs {
    #[inline(always)]
    fn test<S: Simd, const GRADIENT: bool>(&mut self, simd: S, job: &Job<'_>, frames: &Frames, lane: usize) {
        let (run, step) = (job.run, job.packet.step() as f32);
        let splat = |v: f32| f32x16::splat(simd, v);
        let foot = frames.foot.each_ref().map(|f| splat(f[lane]));
        let direction = job.packet.direction_f32.each_ref().map(|d| splat(d[lane]));
        let start = frames.first_sample[lane] * step + frames.sample_zero[lane];
        // The slack keeps culling from ever being stricter than the evaluation.
        let slab_start = splat(start - 0.01 * step);
        let slab_end = splat(start + (job.slab.samples as f32 - 0.99) * step);
        for chunk in 0..run.len.div_ceil(16) {
            let range = 16 * chunk..16 * chunk + 16;
            let load = |column: &[f32; RUN_POINTS]| f32x16::from_slice(simd, &column[range.clone()]);
            let x = load(&run.position[0]) - foot[0];
            let y = load(&run.position[1]) - foot[1];
            let z = load(&run.position[2]) - foot[2];
            let nearest = z.mul_add(direction[2], y.mul_add(direction[1], x * direction[0]));
            let back = -nearest;
            let x = back.mul_add(direction[0], x);
            let y = back.mul_add(direction[1], y);
            let z = back.mul_add(direction[2], z);
            let distance_squared = z.mul_add(z, y.mul_add(y, x * x));
            let gap = (slab_start - nearest).max(nearest - slab_end).max(0.0);
            let reach = load(&run.radius_squared) - distance_squared;
            let hits = (gap * gap).simd_lt(reach).to_bitmask();
            self.hits[chunk / 4] |= hits << (16 * (chunk % 4));
            nearest.store_slice(&mut self.nearest[range.clone()]);
            distance_squared.store_slice(&mut self.distance_squared[range.clone()]);
            if GRADIENT {
                x.store_slice(&mut self.across[0][range.clone()]);
                y.store_slice(&mut self.across[1][range.clone()]);
                z.store_slice(&mut self.across[2][range.clone()]);
            }
        }
    }

    /// Adds all hits to the samples of the lane, in the order of the points; returns their number.
    #[inline(always)]
    fn add<S: Simd, K: LaneKernel, const GRADIENT: bool, const ATTRIBUTES: bool>(
        &self,
        simd: S,
        job: &mut Job<'_>,
        frames: &Frames,
        lane: usize,
    ) -> u64 {
        let run = job.run;
        let step = job.packet.step() as f32;
        let direction = job.packet.direction_f32.each_ref().map(|d| d[lane]);
        let zero = f32x16::splat(simd, 0.0);
        let count = f32x16::from_slice(simd, &COUNT);
        let sample_zero = f32x16::splat(simd, frames.sample_zero[lane]);
        let mut t = [zero; BLOCKS];
        for (block, t) in t.iter_mut().enumerate() {
            let number = count + (frames.first_sample[lane] + (16 * block) as f32);
            *t = number.mul_add(step, sample_zero);
        }
        let load = |row: &SampleRow, b: usize| f32x16::from_slice(simd, &row.0[16 * b..16 * b + 16]);
        let mut density = [zero; BLOCKS];
        let mut gradient = [[zero; BLOCKS]; 3];
        let mut attribute = [[zero; BLOCKS]; 3];
        for b in 0..BLOCKS {
            density[b] = load(&job.samples.density[lane], b);
            for channel in 0..3 {
                if GRADIENT {
                    gradient[channel][b] = load(&job.samples.gradient[channel][lane], b);
                }
                if ATTRIBUTES {
                    attribute[channel][b] = load(&job.samples.attribute[channel][lane], b);
                }
            }
        }
        let mut added = 0;
        for (half, mut hits) in self.hits.into_iter().enumerate() {
            added += u64::from(hits.count_ones());
            while hits != 0 {
                let i = 64 * half + hits.trailing_zeros() as usize;
                hits &= hits - 1;
                // `i` is below RUN_POINTS by construction; the mask lets the compiler see it.
                let i = i & (RUN_POINTS - 1);
                let nearest = self.nearest[i];
                let distance_squared = f32x16::splat(simd, self.distance_squared[i]);
                let inverse = run.inverse_radius_squared[i];
                let weight = run.weight[i];
                for b in 0..BLOCKS {
                    let along = t[b] - nearest;
                    let s = along.mul_add(along, distance_squared) * inverse;
                    let value = K::value(s);
                    if ATTRIBUTES {
                        let weighted = value * weight;
                        density[b] += weighted;
                        for channel in 0..3 {
                            let a = run.attribute[channel][i];
                            attribute[channel][b] = weighted.mul_add(a, attribute[channel][b]);
                        }
                    } else {
                        density[b] = value.mul_add(weight, density[b]);
                    }
                    if GRADIENT {
                        let slope = K::slope_over_x(s) * (weight * inverse);
                        for channel in 0..3 {
                            let offset = along * direction[channel] - self.across[channel][i];
                            gradient[channel][b] = slope.mul_add(offset, gradient[channel][b]);
                        }
                    }
                }
            }
        }
        for b in 0..BLOCKS {
            let range = 16 * b..16 * b + 16;
            density[b].store_slice(&mut job.samples.density[lane].0[range.clone()]);
            for channel in 0..3 {
                if GRADIENT {
                    gradient[channel][b].store_slice(&mut job.samples.gradient[channel][lane].0[range.clone()]);
                }
                if ATTRIBUTES {
                    attribute[channel][b].store_slice(&mut job.samples.attribute[channel][lane].0[range.clone()]);
                }
            }
        }
        added
    }
}

const COUNT: [f32; 16] = [0., 1., 2., 3., 4., 5., 6., 7., 8., 9., 10., 11., 12., 13., 14., 15.];

/// A run whose points are small for its extent, in `f64`. Slow, and rare: each pair is worked out by itself.
#[inline(never)]
fn splat_wide<const GRADIENT: bool, const ATTRIBUTES: bool>(
    kernel: Kernel,
    wide: &WideRun,
    job: &mut Job<'_>,
) -> SplatCounts {
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
            let inverse = wide.inverse_radius_squared[i];
            let half = (1.0 / inverse - distance_squared).max(0.0).sqrt();
            let number = |t: f64| t / packet.step() - packet.phase[lane];
            // Samples in reach, one to spare on either side.
            let first = (number(nearest - half).floor() - 1.0).max(slab.first as f64) as u64;
            let last = (number(nearest + half).ceil() + 1.0).min(slab.end() as f64 - 1.0);
            if distance_squared * inverse >= 1.0 || last < first as f64 {
                continue;
            }
            job.samples.begin::<GRADIENT, ATTRIBUTES>(lane);
            counts.pairs_added += 1;
            for sample in first..=last as u64 {
                counts.kernel_evaluations += 1;
                let along = packet.sample_t(lane, sample) - nearest;
                let s = (along * along + distance_squared) * inverse;
                let at = (sample - slab.first) as usize;
                let weighted = (kernel.value(s) * f64::from(run.weight[i])) as f32;
                job.samples.density[lane].0[at] += weighted;
                if ATTRIBUTES {
                    for channel in 0..3 {
                        job.samples.attribute[channel][lane].0[at] += weighted * run.attribute[channel][i];
                    }
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
