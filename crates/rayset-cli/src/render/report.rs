//! The report of a render, in numbers.

use std::path::Path;
use std::time::Duration;

use rayset::RenderCounts;
use rayset::memory::MemoryPlan;

use super::work::Work;
use rayset_terminal::memory::peak_rss;
use rayset_terminal::report;
use rayset_terminal::statistics::{LodErrors, PageStatistics, WorkStatistics};

/// The report that `--stats` writes.
#[derive(serde::Serialize)]
pub(super) struct RenderReport {
    seconds: f64,
    threads: usize,
    simd: &'static str,
    predictor: &'static str,
    io: String,
    page_bytes: u64,
    pub(super) memory_bytes: u64,
    pages_budget_bytes: u64,
    peak_rss_bytes: Option<u64>,
    #[serde(flatten)]
    counts: WorkStatistics,
    #[serde(flatten)]
    pub(super) pages: PageStatistics,
}

impl RenderReport {
    pub(super) fn new(work: &Work, plan: &MemoryPlan, counts: RenderCounts, elapsed: Duration) -> Self {
        Self {
            seconds: elapsed.as_secs_f64(),
            threads: work.session.threads(),
            simd: work.session.simd().name(),
            predictor: work.prediction.name(),
            io: work.session.io().to_owned(),
            page_bytes: plan.largest_page_bytes,
            memory_bytes: work.memory,
            pages_budget_bytes: plan.page_bytes,
            peak_rss_bytes: peak_rss(),
            counts: counts.into(),
            pages: (&work.session.statistics()).into(),
        }
    }

    pub(super) fn describe(&self, output: &Path) {
        report::say(format_args!(
            "{}: {:.2} s, {} million kernel evaluations, {}{}",
            output.display(),
            self.seconds,
            self.counts.kernel_evaluations / 1_000_000,
            self.simd,
            self.peak_rss_bytes.map_or_else(String::new, |b| format!(", peak memory {}", report::bytes(b)))
        ));
        self.describe_errors();
        self.describe_working_set();
    }

    /// One line on how wrong the picture may be because of what is seen from afar, if anything is.
    fn describe_errors(&self) {
        let LodErrors { pixels: Some(pixels), mean: Some(mean) } = self.counts.lod_errors else { return };
        report::say(format_args!(
            "seen from afar: {:.0} % of the pixels, whose opacities are off by about {mean:.3} in the mean",
            100.0 * pixels
        ));
    }

    /// One line on what the working set did.
    fn describe_working_set(&self) {
        let set = &self.pages;
        report::say(format_args!(
            "working set: {} page requests, {} reads of {} ({:.2} a page), {} evictions, waited {:.3} s, at most {} of {}",
            report::count(set.working_set.hits + set.working_set.misses),
            report::count(set.working_set.reads),
            report::bytes(self.page_bytes),
            set.reads_per_page,
            report::count(set.working_set.evictions),
            set.stall_seconds,
            report::bytes(set.working_set_peak_bytes),
            report::bytes(self.pages_budget_bytes)
        ));
    }
}
