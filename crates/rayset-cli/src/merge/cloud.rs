//! Joins the parts of a cloud.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use rayset::build::{BuildControl, BuildOptions, BuildParts, Progress};
use rayset::output::Destination;

use crate::aggregates::{self, AggregateArgs, Means};
use crate::budget::{Budget, name_smallest_budget};
use crate::build;
use rayset_terminal::outputs::Outputs;
use rayset_terminal::progress::Meter;

/// What is asked for.
pub(super) struct Merge<'a> {
    pub(super) folder: &'a Path,
    pub(super) output: &'a Path,
    /// Of the whole process.
    pub(super) memory: u64,
    /// Whether the parts stay.
    pub(super) keep: bool,
    pub(super) aggregates: &'a AggregateArgs,
    pub(super) json: bool,
}

pub(super) fn run(job: &Merge<'_>) -> Result<()> {
    let output = Outputs::default().add(job.output, None)?;
    output.require_file()?;
    let parts = BuildParts::open(job.folder)?;
    refuse_within(&output, job.folder)?;
    let budget = Budget::of(job.memory, [job.folder, job.output]);
    // One thread lays out pages.
    let options = BuildOptions::default().with_memory_bytes(budget.left()).with_threads(1);
    let meter = Meter::new("points", job.json);
    let control = BuildControl::from(&meter as &dyn Progress);
    let merged = parts.merge(job.output, &options, &control);
    meter.finish();
    let mut merged = merged.map_err(|e| name_smallest_budget(e, budget))?;
    if !job.keep {
        parts.remove()?;
    }
    let means = Means { budget, threads: None, temp_dir: None, quiet: job.json };
    let aggregated = aggregates::add(job.output, &mut merged, job.aggregates, means);
    build::present(job.output, &merged, job.json)?;
    aggregated
}

/// Refuses an output among the parts: they are read for it, and the folder is removed once it is
/// whole.
fn refuse_within(output: &Destination, folder: &Path) -> Result<()> {
    let doing = || format!("cannot look at {}", folder.display());
    let within = folder.canonicalize().with_context(doing)?;
    let place = output.canonical().with_context(|| format!("cannot write {}", output.path().display()))?;
    ensure!(
        !place.is_some_and(|place| place.starts_with(within)),
        "{} lies in {}, the folder of the parts, which is removed once they are merged; name a file outside of it",
        output.path().display(),
        folder.display()
    );
    Ok(())
}
