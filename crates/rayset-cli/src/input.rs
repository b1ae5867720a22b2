//! What commands take as their input, opened within the memory of the process, with the program's
//! ways of telling and cleaning up.

use std::path::{Path, PathBuf};

use anyhow::Result;
use rayset::build::{BuildError, GridBuildError};
use rayset_inputs::{Cache, Host, Opened};

use crate::budget::{self, Budget};
use rayset_terminal::interrupts::TemporaryFolder;
use rayset_terminal::outputs::Outputs;
use rayset_terminal::progress::{Meter, ProgressCallback};
use rayset_terminal::report;

/// The resources that building may use.
#[derive(Clone, Copy)]
pub(crate) struct Resources<'a> {
    /// Of the whole process.
    pub(crate) memory: u64,
    pub(crate) threads: Option<usize>,
    /// Is told how far building is.
    pub(crate) told: ProgressCallback<'a>,
}

/// Opens inputs: one scene, one cloud or grid file, one volume, or any number of files of points,
/// folders and patterns.
pub(crate) fn open(inputs: &[PathBuf], cache: &Cache, resources: Resources<'_>) -> Result<Opened> {
    open_hearing(inputs, cache, resources, None)
}

/// The same; `heard` is told what is remarked, too.
pub(crate) fn open_hearing(
    inputs: &[PathBuf],
    cache: &Cache,
    resources: Resources<'_>,
    heard: Option<&(dyn Fn(&str) + Sync)>,
) -> Result<Opened> {
    let Resources { memory, threads, told } = resources;
    let program = Program { meter: Meter::new("", false).telling(told), heard };
    let budget = Budget::of(memory, inputs);
    let resources = rayset_inputs::Resources { memory: budget.left(), threads, host: &program };
    let opened = rayset_inputs::open(inputs, cache, resources);
    program.meter.finish();
    opened.map_err(|error| name_smallest_budget(error, budget))
}

/// Errors of a build whose budget is too small name the budget of the process.
fn name_smallest_budget(error: anyhow::Error, budget: Budget) -> anyhow::Error {
    match error.downcast::<BuildError>().map_err(|error| error.downcast::<GridBuildError>()) {
        Ok(error) => budget::name_smallest_budget(error, budget),
        Err(Ok(error)) => budget::name_smallest_grid_budget(error, budget),
        Err(Err(other)) => other,
    }
}

/// The program as the host of inputs.
pub(crate) struct Program<'a> {
    meter: Meter<'a>,
    heard: Option<&'a (dyn Fn(&str) + Sync)>,
}

impl Program<'_> {
    /// One that shows no progress.
    pub(crate) fn quiet() -> Self {
        Self::showing(true)
    }

    /// One that shows progress, unless it is `hidden`.
    pub(crate) fn showing(hidden: bool) -> Self {
        Self { meter: Meter::new("", hidden), heard: None }
    }

    /// Clears what is shown of progress.
    pub(crate) fn finish(&self) {
        self.meter.finish();
    }
}

impl Host for Program<'_> {
    fn remark(&self, text: &str) {
        report::remark(text);
        if let Some(heard) = self.heard {
            heard(text);
        }
    }

    fn note(&self, text: &str) {
        report::remark(text);
    }

    fn progress(&self, unit: &'static str, doing: &'static str, done: u64, total: u64) {
        self.meter.show_in(unit, doing, done, total);
    }

    fn temporary_folder(&self) -> Result<Box<dyn rayset_inputs::TemporaryFolder>> {
        Ok(Box::new(TemporaryFolder::new("input")?))
    }

    fn writes(&self, output: &Path, inputs: &[PathBuf]) -> Result<()> {
        Outputs::beside(inputs).add(output, None).map(drop)
    }
}
