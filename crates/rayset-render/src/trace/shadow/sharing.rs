//! Samples that share a shadow: where a ray passes through next to nothing, what reaches one of its
//! samples reaches the next ones too, and a shadow need not be computed for each.
//!
//! The samples of a ray are divided into runs of eight, by their numbers. Within a run, samples
//! take the shadow of the last one before them for which it was computed, as long as those that do
//! so are at most [`LARGEST_SHARE`] of their pixel. This is a function of the ray alone: neither
//! slabs nor packets change it.

use super::cached::LARGEST_DOUBT;
use crate::field::{LANES, SampleRow, Slab};
use crate::trace::composite::Shares;
use crate::trace::node_samples::each_lane;

/// Samples in a run: those of one slab, or of several.
const RUN_SAMPLES: u64 = 8;
/// The largest part of a pixel that takes the shadow of one of its samples.
const LARGEST_SHARE: f32 = LARGEST_DOUBT;
/// From which bit on the level stands in the number of a run.
const LEVEL_BIT: u32 = 56;
/// No run.
const NONE: u64 = u64::MAX;

/// What is known of the rays of a packet so far, and of the samples of a slab.
pub(super) struct SharedShadows {
    rays: [LastShadow; LANES],
    /// For each lane, a bit for each sample whose shadow has to be computed.
    pub(super) computed: [u32; LANES],
    /// Likewise for those that take the one before them.
    taken: [u32; LANES],
    /// For each light and lane: the shadow that was computed last.
    last: Vec<[f32; LANES]>,
}

/// The sample of a ray for which shadows were computed last.
#[derive(Clone, Copy)]
struct LastShadow {
    run: u64,
    /// The part of the pixel that may still take them.
    left: f32,
}

impl SharedShadows {
    pub(super) fn new(lights: usize) -> Self {
        Self {
            rays: [LastShadow { run: NONE, left: 0.0 }; LANES],
            computed: [0; LANES],
            taken: [0; LANES],
            last: vec![[1.0; LANES]; lights],
        }
    }

    /// Starts a packet.
    pub(super) fn begin(&mut self) {
        self.rays.fill(LastShadow { run: NONE, left: 0.0 });
    }

    /// Decides for each contributing sample of a slab, front to back, whether its shadow has to be
    /// computed; `weights` are the fractions of the light of rays that reach their pixels.
    pub(super) fn choose(&mut self, slab: Slab, weights: &[f32; LANES], shares: &Shares) {
        (self.computed, self.taken) = ([0; LANES], [0; LANES]);
        each_lane(shares.lanes(), |lane| {
            let ray = &mut self.rays[lane];
            let mut samples = shares.samples[lane];
            while samples != 0 {
                let j = samples.trailing_zeros() as usize;
                samples &= samples - 1;
                // The level is part of a run's number: samples of two are never of one run.
                let number = (slab.first + j as u64) / RUN_SAMPLES;
                let run = number | (u64::from(slab.level) << LEVEL_BIT);
                let share = weights[lane] * shares.share[lane].0[j];
                if ray.run == run && share <= ray.left {
                    ray.left -= share;
                    self.taken[lane] |= 1 << j;
                } else {
                    *ray = LastShadow { run, left: LARGEST_SHARE };
                    self.computed[lane] |= 1 << j;
                }
            }
        });
    }

    /// Gives the samples that take a light's shadow from one before them what was computed for that
    /// one.
    pub(super) fn spread(&mut self, light: usize, rows: &mut [SampleRow]) {
        let lanes = (0..LANES).filter(|&lane| self.computed[lane] | self.taken[lane] != 0);
        for lane in lanes {
            let mut last = self.last[light][lane];
            let mut samples = self.computed[lane] | self.taken[lane];
            while samples != 0 {
                let j = samples.trailing_zeros() as usize;
                samples &= samples - 1;
                if self.taken[lane] >> j & 1 == 1 {
                    rows[lane].0[j] = last;
                } else {
                    last = rows[lane].0[j];
                }
            }
            self.last[light][lane] = last;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn what_takes_the_shadow_of_another_sample_is_a_64th_of_a_pixel_and_the_same_however_slabs_are_cut(
            shares in prop::collection::vec(prop_oneof![Just(0.0_f32), 0.0_f32..0.03], 64),
            length in 1_usize..=32,
        ) {
            let decide = |length: usize| {
                let mut shared = SharedShadows::new(1);
                let mut computed = Vec::new();
                shared.begin();
                for (first, some) in (0..).step_by(length).zip(shares.chunks(length)) {
                    let mut slab = Shares::new();
                    for (j, &share) in some.iter().enumerate() {
                        slab.share[3].0[j] = share;
                        slab.samples[3] |= u32::from(share > 0.0) << j;
                    }
                    shared.choose(Slab { first, samples: some.len(), level: 0 }, &[1.0; LANES], &slab);
                    // A sample's shadow is its number.
                    let mut rows = vec![SampleRow([f32::NAN; 32]); LANES];
                    for j in (0..some.len()).filter(|j| shared.computed[3] >> j & 1 == 1) {
                        rows[3].0[j] = first as f32 + j as f32;
                    }
                    shared.spread(0, &mut rows);
                    computed.extend((0..some.len()).map(|j| rows[3].0[j]));
                }
                computed
            };
            let shadows = decide(32);
            prop_assert_eq!(&decide(length).iter().map(|v| v.to_bits()).collect::<Vec<_>>(),
                &shadows.iter().map(|v| v.to_bits()).collect::<Vec<_>>());
            for run in 0..8 {
                for from in run * 8..run * 8 + 8 {
                    let takers = (run * 8..run * 8 + 8).filter(|&j| j != from && shadows[j] == from as f32);
                    prop_assert!(takers.map(|j| shares[j]).sum::<f32>() <= LARGEST_SHARE * 1.0001);
                }
                for j in (run * 8..run * 8 + 8).filter(|&j| shares[j] > 0.0) {
                    prop_assert!(shadows[j] >= (run * 8) as f32 && shadows[j] <= j as f32);
                    let before = (run * 8..j).rev().find(|&k| shares[k] > 0.0);
                    if let Some(before) = before.filter(|_| shadows[j] == j as f32) {
                        let others = (run * 8..j).filter(|&k| k as f32 != shadows[before] && shadows[k] == shadows[before]);
                        let taken = others.map(|k| shares[k]).sum::<f32>() + shares[j];
                        prop_assert!(taken > LARGEST_SHARE * 0.9999, "{j} has a shadow of its own for nothing");
                    }
                }
            }
        }

        #[test]
        fn a_ray_that_is_half_of_its_pixel_shares_as_one_of_half_the_shares(
            shares in prop::collection::vec(0.0_f32..0.06, 32),
        ) {
            let decide = |weight: f32, factor: f32| {
                let mut slab = Shares::new();
                slab.samples[5] = u32::MAX;
                slab.share[5].0.iter_mut().zip(&shares).for_each(|(row, share)| *row = factor * share);
                let mut shared = SharedShadows::new(1);
                shared.begin();
                shared.choose(Slab { first: 0, samples: 32, level: 0 }, &[weight; LANES], &slab);
                shared.computed[5]
            };
            prop_assert_eq!(decide(0.5, 1.0), decide(1.0, 0.5));
        }
    }
}
