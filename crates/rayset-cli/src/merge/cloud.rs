//! Joins the parts of a cloud.

use std::path::Path;

use anyhow::Result;
use rayset::build::{BuildControl, BuildOptions, BuildParts, Progress};

use crate::budget::{Budget, name_smallest_budget};
use crate::build;
use crate::outputs::Outputs;
use crate::progress::Meter;

/// What is asked for.
pub(super) struct Merge<'a> {
    pub(super) folder: &'a Path,
    pub(super) output: &'a Path,
    /// Of the whole process.
    pub(super) memory: u64,
    /// Whether the parts stay.
    pub(super) keep: bool,
    pub(super) json: bool,
}

pub(super) fn run(job: &Merge<'_>) -> Result<()> {
    let nothing: [&Path; 0] = [];
    Outputs::beside(nothing).add(job.output, None)?.require_file()?;
    let parts = BuildParts::open(job.folder)?;
    let budget = Budget::of(job.memory, [job.folder, job.output]);
    // One thread lays out pages.
    let options = BuildOptions::default().with_memory_bytes(budget.left()).with_threads(1);
    let meter = Meter::new("points", job.json);
    let control = BuildControl::from(&meter as &dyn Progress);
    let merged = parts.merge(job.output, &options, &control);
    meter.finish();
    let merged = merged.map_err(|e| name_smallest_budget(e, budget))?;
    if !job.keep {
        parts.remove()?;
    }
    build::present(job.output, &merged, job.json)
}
