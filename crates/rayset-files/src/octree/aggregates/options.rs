//! What can be chosen of aggregates.

use std::path::PathBuf;

use rayset_base::kernel::Kernel;
use rayset_base::setters;

/// Cells of at most so many points are not divided, by default.
const FEW_POINTS: u32 = 64;
/// What a thread takes: points that are looked at together, and places among them.
const THREAD_BYTES: u64 = 8 << 20;
/// What records take before they are stored, and pages that are used again and again.
const FIXED_BYTES: u64 = 8 << 20;

/// More threads are not started.
const MOST_THREADS: usize = 4096;

/// How aggregates are made. The bytes of a file follow from `kernel`, `normalised` and `few_points`
/// alone.
#[derive(Clone, Debug)]
#[cfg_attr(not(feature = "internals"), non_exhaustive)]
pub struct AggregateOptions {
    /// The kernel of densities; none of splats.
    pub kernel: Kernel,
    /// Whether weights are divided by what the kernels integrate to.
    pub normalised: bool,
    /// Cells of at most so many points are not divided.
    pub few_points: u32,
    /// Memory for all of it, in bytes.
    pub memory_bytes: u64,
    /// Threads.
    pub threads: usize,
    /// The folder of temporary files; that of the output if `None`.
    pub temp_dir: Option<PathBuf>,
}

impl Default for AggregateOptions {
    /// The kernel of scenes, weights as they are, 256 MiB, and a thread for each processor.
    fn default() -> Self {
        Self {
            kernel: Kernel::default(),
            normalised: false,
            few_points: FEW_POINTS,
            memory_bytes: 256 << 20,
            threads: std::thread::available_parallelism().map_or(1, std::num::NonZero::get),
            temp_dir: None,
        }
    }
}

setters!(AggregateOptions {
    with_kernel => kernel: Kernel,
    with_normalised => normalised: bool,
    with_few_points => few_points: u32,
    with_memory_bytes => memory_bytes: u64,
    with_threads => threads: usize,
    with_temp_dir => temp_dir: Option<PathBuf>,
});

/// How memory is divided.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shares {
    pub(super) threads: usize,
    pub(super) pages_bytes: u64,
}

impl AggregateOptions {
    /// The least memory that does, with pages of so many bytes.
    #[must_use]
    pub(super) fn least_bytes(page_bytes: u64) -> u64 {
        FIXED_BYTES + THREAD_BYTES + Self::least_pages(1, page_bytes)
    }

    /// A page of points and one of nodes for each thread, and a few more.
    fn least_pages(threads: u64, page_bytes: u64) -> u64 {
        (4 * threads + 8) * page_bytes
    }

    /// As many threads as there is memory for; the rest is for pages. `None` if there is too little
    /// for one.
    pub(super) fn shares(&self, page_bytes: u64, overhead: u64) -> Option<Shares> {
        let left = self.memory_bytes.checked_sub(FIXED_BYTES + overhead)?;
        (1..=self.threads.clamp(1, MOST_THREADS) as u64).rev().find_map(|threads| {
            let pages_bytes = left.checked_sub(threads * THREAD_BYTES)?;
            (pages_bytes >= Self::least_pages(threads, page_bytes))
                .then_some(Shares { threads: threads as usize, pages_bytes })
        })
    }
}
