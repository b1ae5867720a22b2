//! Aggregates of what `build` and `merge` made.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, Result, anyhow};
use clap::Args;
use rayset::Cloud;
use rayset::build::{AggregateError, BuildReport, Stage};
use rayset_inputs::{Aggregating, Resources, aggregate};

use crate::budget::Budget;
use crate::input::Program;
use rayset_terminal::report;

/// Whether a cloud that is built gets aggregates.
#[derive(Args)]
pub(crate) struct AggregateArgs {
    /// Add to the cloud what stands for its points from afar, as `rayset lod` does. By default,
    /// clouds of 200 000 points and more that are shown as gas have it
    #[arg(long, conflicts_with = "no_lod")]
    lod: bool,
    /// Add nothing that stands for points from afar
    #[arg(long)]
    no_lod: bool,
}

impl AggregateArgs {
    /// The option that was given, if any.
    pub(crate) fn given(&self) -> Option<&'static str> {
        match self.wanted() {
            Aggregating::Gas => None,
            Aggregating::Always => Some("--lod"),
            Aggregating::Never => Some("--no-lod"),
        }
    }

    fn wanted(&self) -> Aggregating {
        match self {
            Self { lod: true, .. } => Aggregating::Always,
            Self { no_lod: true, .. } => Aggregating::Never,
            _ => Aggregating::Gas,
        }
    }
}

/// What aggregates are made with.
pub(crate) struct Means {
    pub(crate) budget: Budget,
    /// As many as there are processors if `None`.
    pub(crate) threads: Option<usize>,
    pub(crate) temp_dir: Option<PathBuf>,
    /// Whether progress is not shown.
    pub(crate) quiet: bool,
}

/// Adds aggregates to the cloud that was built at `output`, if it gets any, and to its report.
pub(crate) fn add(output: &Path, built: &mut BuildReport, args: &AggregateArgs, means: Means) -> Result<()> {
    let started = Instant::now();
    let program = Program::showing(means.quiet);
    let resources = Resources { memory: means.budget.left(), threads: means.threads, host: &program };
    let made = aggregate(output, args.wanted(), resources, means.temp_dir);
    program.finish();
    let built_without =
        || format!("{} is built, but has no aggregates, which `rayset lod` adds", output.display());
    if made.map_err(|error| named(error, means.budget)).with_context(built_without)?.is_some() {
        built.times.push((Stage::Aggregate, started.elapsed()));
        built.header = Cloud::open(output)?.header().clone();
    }
    Ok(())
}

/// The error, naming the memory of the whole process where that is too little.
fn named(error: anyhow::Error, budget: Budget) -> anyhow::Error {
    match error.downcast() {
        Ok(error) => name_smallest_budget(error, budget),
        Err(other) => other,
    }
}

/// As `budget::name_smallest_budget`, of aggregates.
pub(crate) fn name_smallest_budget(error: AggregateError, budget: Budget) -> anyhow::Error {
    match error {
        AggregateError::Memory { needed, .. } => {
            let needed = budget.leaving(needed);
            anyhow!(
                "--memory {} is too small; the smallest that would do is {needed} bytes ({})",
                budget.in_words(),
                report::bytes(needed)
            )
        }
        other => other.into(),
    }
}
