//! Work counters of a render.

use crate::field::SplatCounts;
use crate::lod::MEAN_OF_BOUND;

/// How much work a render did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(not(feature = "internals"), non_exhaustive)]
pub struct RenderCounts {
    /// Rays from the eye.
    pub rays: u64,
    /// Work on pairs of a ray and a point.
    pub splats: SplatCounts,
    /// Samples of the slabs evaluated, for the rays still active.
    pub samples: u64,
    /// Samples that were not transparent.
    pub nonzero_samples: u64,
    /// Slabs evaluated, of all packets counted in `packets`.
    pub slabs: u64,
    /// Runs decoded; a run counts once for each slab of a packet.
    pub runs: u64,
    /// Packets traced, not counting those of shadow rays.
    pub packets: u64,
    /// Shadow rays traced.
    pub shadow_rays: u64,
    /// The part of `splats` done for shadow rays.
    pub shadow_splats: SplatCounts,
    /// Reflected and refracted rays traced.
    pub bounced_rays: u64,
    /// The part of `splats` done for these rays, not counting their shadow rays.
    pub bounced_splats: SplatCounts,
    /// How often a tile, or tiles that were traced together, was deferred because a page was
    /// absent. The work done on it until then is not counted.
    pub deferred: u64,
    /// How wrong opacities are because of what is seen from afar.
    pub lod_errors: LodErrors,
}

/// Errors of the opacities of pixels that are seen from afar, as they are estimated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LodErrors {
    /// Pixels that were traced. With as many rays as each needs, and with ambient occlusion, some
    /// count twice: those that vary, and those beside bands.
    pub pixels: u64,
    /// Those of them of which something is seen from afar.
    pub from_afar: u64,
    /// The sum of the bounds, in 2^−24, so that it is the same in any order.
    bounds: u64,
}

impl LodErrors {
    const ONE: f64 = (1_u64 << 24) as f64;

    /// Adds a pixel, given the bound of its error.
    pub(super) fn add(&mut self, bound: f32) {
        self.pixels += 1;
        self.from_afar += u64::from(bound > 0.0);
        self.bounds += (f64::from(bound) * Self::ONE) as u64;
    }

    /// By how much opacities are wrong in the mean, over the pixels of which something is seen from
    /// afar, 0 to 1: a fifth of the mean bound, as measured. `None` if nothing is.
    #[must_use]
    pub fn mean(&self) -> Option<f64> {
        let bounds = self.bounds as f64 / Self::ONE;
        (self.from_afar > 0).then(|| MEAN_OF_BOUND * bounds / self.from_afar as f64)
    }
}

impl std::ops::AddAssign for RenderCounts {
    fn add_assign(&mut self, other: Self) {
        self.rays += other.rays;
        self.splats += other.splats;
        self.samples += other.samples;
        self.nonzero_samples += other.nonzero_samples;
        self.slabs += other.slabs;
        self.runs += other.runs;
        self.packets += other.packets;
        self.shadow_rays += other.shadow_rays;
        self.shadow_splats += other.shadow_splats;
        self.bounced_rays += other.bounced_rays;
        self.bounced_splats += other.bounced_splats;
        self.deferred += other.deferred;
        self.lod_errors.pixels += other.lod_errors.pixels;
        self.lod_errors.from_afar += other.lod_errors.from_afar;
        self.lod_errors.bounds += other.lod_errors.bounds;
    }
}

#[cfg(test)]
mod tests {
    use crate::field::SplatCounts;

    #[test]
    fn what_is_counted_between_two_moments_is_their_difference() {
        let before = SplatCounts { pairs_tested: 7, pairs_added: 5, kernel_evaluations: 80 };
        let work = SplatCounts { pairs_tested: 3, pairs_added: 2, kernel_evaluations: 32 };
        let mut after = before;
        after += work;
        assert_eq!(after, SplatCounts { pairs_tested: 10, pairs_added: 7, kernel_evaluations: 112 });
        assert_eq!(after - before, work);
    }
}
