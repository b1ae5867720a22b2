//! Splats runs whose points are small compared with the extent of the run, in `f64`: slow, but
//! rarely needed.

use super::counts::SplatCounts;
use super::kernel::Kernel;
use super::run::DecodedRun;
use super::samples::SplatJob;

/// Adds such a run, one pair of ray and point at a time.
#[inline(never)]
pub(super) fn splat_wide<const GRADIENT: bool>(
    kernel: Kernel,
    run: &DecodedRun,
    job: &mut SplatJob<'_>,
) -> SplatCounts {
    let mut counts = SplatCounts::default();
    let Some(wide) = &run.wide else { return counts };
    let (packet, slab) = (job.packet, job.slab);
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
            for sample in first..=last {
                counts.kernel_evaluations += 1;
                let along = packet.sample_t(lane, sample) - nearest;
                let s = (along * along + distance_squared) * inverse;
                let at = (sample - slab.first) as usize;
                let weighted = (kernel.value(s) * f64::from(run.points.weight[i])) as f32;
                job.samples.density[lane].0[at] += weighted;
                for (rows, column) in job.samples.attribute.iter_mut().zip(&run.attribute) {
                    rows[lane].0[at] += weighted * column[i];
                }
                job.samples.label(lane, at, weighted, |label| run.label[label][i]);
                if GRADIENT {
                    let slope = kernel.slope_over_x(s) * f64::from(run.points.weight[i]) * inverse;
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
