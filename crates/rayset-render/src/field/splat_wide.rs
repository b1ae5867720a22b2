//! Splats runs whose points are small compared with the extent of the run, in `f64`: runs of sparse
//! clouds, most of whose points no ray of a packet meets.

use super::columns::MAP_COLUMNS;
use super::counts::SplatCounts;
use super::gaussian_splat::Chord;
use super::packet::LANES;
use super::run::DecodedRun;
use super::samples::SplatJob;
use super::simd::{SimdLevel, dispatch};
use rayset_base::kernel::Kernel;

/// Adds such a run, point by point: each is tested against all rays together, and added to those
/// that pass it, one by one.
#[inline(never)]
pub(super) fn splat_wide<const GRADIENT: bool>(
    kernel: Kernel,
    simd: SimdLevel,
    run: &DecodedRun,
    job: &mut SplatJob<'_>,
) -> SplatCounts {
    let mut counts = SplatCounts::default();
    let Some(wide) = &run.wide else { return counts };
    let (packet, slab) = (job.packet, job.slab);
    let center = run.center.to_array();
    let origin: [[f64; LANES]; 3] =
        std::array::from_fn(|axis| packet.origin[axis].map(|origin| origin - center[axis]));
    counts.pairs_tested += u64::from(job.lanes.count_ones()) * run.len as u64;
    for i in 0..run.len {
        let position: [f64; 3] = std::array::from_fn(|axis| wide.position[axis][i]);
        let inverse = wide.inverse_radius[i] * wide.inverse_radius[i];
        let rays = (&origin, &packet.direction);
        let mut lanes = job.lanes & dispatch!(simd.level(), _simd => lanes_near(rays, position, inverse));
        while lanes != 0 {
            let lane = lanes.trailing_zeros() as usize;
            lanes &= lanes - 1;
            let d: [f64; 3] = std::array::from_fn(|axis| packet.direction[axis][lane]);
            let c: [f64; 3] = std::array::from_fn(|axis| position[axis] - origin[axis][lane]);
            let pair = match wide.map.get(i) {
                None => WidePair::of_ball(d, c, inverse),
                Some(map) => WidePair::of_ellipsoid(d, c, map),
            };
            let WidePair { nearest, half, .. } = pair;
            if half == 0.0 && !wide.map.is_empty() {
                continue;
            }
            // The samples in reach, with one to spare on either side. Casts to integers round
            // toward 0, and negative numbers become 0.
            let number = |t: f64| t / packet.step[lane] - packet.sample_offset[lane];
            let first = ((number(nearest - half) - 1.0) as u64).max(slab.first);
            let last = ((number(nearest + half) + 2.0) as u64).min(slab.end() - 1);
            if number(nearest + half) <= -2.0 || last < first {
                continue;
            }
            job.samples.begin::<GRADIENT>(lane);
            counts.pairs_added += 1;
            counts.kernel_evaluations += last + 1 - first;
            let to = (lane, first, last);
            add_samples::<GRADIENT>(kernel, (run, i), &pair, to, job);
        }
    }
    counts
}

/// Adds a point of a run to samples of a ray, from the first to the last.
fn add_samples<const GRADIENT: bool>(
    kernel: Kernel,
    (run, i): (&DecodedRun, usize),
    pair: &WidePair,
    (lane, first, last): (usize, u64, u64),
    job: &mut SplatJob<'_>,
) {
    let weight = f64::from(run.points.weight[i]);
    if kernel == Kernel::Splat {
        return add_intervals::<GRADIENT>((run, i), pair, (lane, first, last), job);
    }
    for sample in first..=last {
        let along = job.packet.sample_t(lane, sample) - pair.nearest;
        let s = (along * along + pair.distance_squared) * pair.per_square;
        let at = (sample - job.slab.first) as usize;
        let weighted = (kernel.value(s) * weight) as f32;
        job.samples.density[lane].0[at] += weighted;
        for (rows, column) in job.samples.attribute.iter_mut().zip(&run.attribute) {
            rows[lane].0[at] += weighted * column[i];
        }
        job.samples.label(lane, at, weighted, |label| run.label[label][i]);
        if GRADIENT {
            let slope = kernel.slope_over_x(s) * weight * pair.of_slope;
            for channel in 0..3 {
                let offset = along * pair.toward[channel] - pair.across[channel];
                job.samples.gradient[channel][lane].0[at] += (slope * offset) as f32;
            }
        }
    }
}

/// Adds a splat of a run to samples of a ray, from the first to the last.
fn add_intervals<const GRADIENT: bool>(
    (run, i): (&DecodedRun, usize),
    pair: &WidePair,
    (lane, first, last): (usize, u64, u64),
    job: &mut SplatJob<'_>,
) {
    let inside = 1.0 - pair.distance_squared * pair.per_square;
    let chord = Chord::new(run.points.weight[i], inside as f32);
    let (scale, packet) = (pair.per_square.sqrt(), job.packet);
    let per_step = 1.0 / packet.step_world();
    for sample in first..=last {
        let from = sample as f64 * packet.step[lane] - pair.nearest;
        let to = from + packet.step[lane];
        let depth = chord.depth_of_one((from * scale) as f32, (to * scale) as f32);
        let weighted = (f64::from(depth) * per_step) as f32;
        let at = (sample - job.slab.first) as usize;
        job.samples.density[lane].0[at] += weighted;
        for (rows, column) in job.samples.attribute.iter_mut().zip(&run.attribute) {
            rows[lane].0[at] += weighted * column[i];
        }
        job.samples.label(lane, at, weighted, |label| run.label[label][i]);
        if GRADIENT {
            let slope = -f64::from(weighted) * pair.of_slope;
            let front = from.max(-pair.half);
            for channel in 0..3 {
                let offset = front * pair.toward[channel] - pair.across[channel];
                job.samples.gradient[channel][lane].0[at] += (slope * offset) as f32;
            }
        }
    }
}

/// A ray and a point. With q the squared distance in units of the radius, in the space in which the
/// point is a ball: q = (s² + `distance_squared`)·`per_square` at the distance s from the place
/// nearest to the point, and half of its gradient is `of_slope`·(s·`toward` − `across`).
struct WidePair {
    /// Where along the ray that is.
    nearest: f64,
    /// How far from there the point reaches.
    half: f64,
    distance_squared: f64,
    per_square: f64,
    of_slope: f64,
    toward: [f64; 3],
    across: [f64; 3],
}

impl WidePair {
    /// `d` is the direction, and `c` the vector from the ray's origin to the point.
    fn of_ball(d: [f64; 3], c: [f64; 3], per_square: f64) -> Self {
        let nearest = dot(c, d);
        let across: [f64; 3] = std::array::from_fn(|axis| c[axis] - nearest * d[axis]);
        let distance_squared = dot(across, across);
        let half = (1.0 / per_square - distance_squared).max(0.0).sqrt();
        Self { nearest, half, distance_squared, per_square, of_slope: per_square, toward: d, across }
    }

    /// The same of an ellipsoid that a map takes to the unit ball.
    fn of_ellipsoid(d: [f64; 3], c: [f64; 3], map: &[f64; MAP_COLUMNS]) -> Self {
        let [of_direction, of_point] =
            [d, c].map(|v| [0, 3, 6].map(|row| dot([map[row], map[row + 1], map[row + 2]], v)));
        let per_square = dot(of_direction, of_direction);
        let nearest = dot(of_point, of_direction) / per_square;
        let across: [f64; 3] = std::array::from_fn(|row| of_point[row] - nearest * of_direction[row]);
        let distance_squared = dot(across, across) / per_square;
        let half = (1.0 / per_square - distance_squared).max(0.0).sqrt();
        let back = |v: [f64; 3]| [0, 1, 2].map(|axis| dot([map[axis], map[axis + 3], map[axis + 6]], v));
        let (toward, across) = (back(of_direction), back(across));
        Self { nearest, half, distance_squared, per_square, of_slope: 1.0, toward, across }
    }
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// The lanes of the rays that pass a point within its radius.
// Loops: the compiler makes vectors of them, with the same bits at every level of instructions.
#[inline(always)]
fn lanes_near(
    (origin, direction): (&[[f64; LANES]; 3], &[[f64; LANES]; 3]),
    position: [f64; 3],
    inverse_squared: f64,
) -> u64 {
    let mut near = 0;
    for lane in 0..LANES {
        let [dx, dy, dz] = [direction[0][lane], direction[1][lane], direction[2][lane]];
        let (x, y, z) =
            (position[0] - origin[0][lane], position[1] - origin[1][lane], position[2] - origin[2][lane]);
        let nearest = x * dx + y * dy + z * dz;
        let (x, y, z) = (x - nearest * dx, y - nearest * dy, z - nearest * dz);
        let is_far = (x * x + y * y + z * z) * inverse_squared >= 1.0;
        near |= u64::from(!is_far) << lane;
    }
    near
}
