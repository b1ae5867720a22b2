//! Counts of the work done by splatting.

/// Counts of the work done.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(not(feature = "internals"), non_exhaustive)]
pub struct SplatCounts {
    /// Pairs of a ray and a point that were tested.
    pub pairs_tested: u64,
    /// Pairs that were added to samples, counted once for each block of 8 samples (once per slab
    /// for runs evaluated in `f64`).
    pub pairs_added: u64,
    /// Kernel evaluations, including those at samples that the point does not reach.
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
