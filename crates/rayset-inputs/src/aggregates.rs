//! Aggregates of clouds that were just built: with them, pictures from afar look at few of the
//! points.

use std::path::{Path, PathBuf};

use anyhow::Result;
use rayset::Cloud;
use rayset::build::{self, AggregateError, AggregateHeader, AggregateOptions, Progress, Stage};

use crate::host::{Reported, Resources};
use crate::look;
use crate::style::{LookName, Style};

/// Which clouds get aggregates as they are built.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Aggregating {
    /// Those of [`look::MANY_POINTS`] and more that are shown as gas.
    #[default]
    Gas,
    /// All.
    Always,
    /// None.
    Never,
}

/// Adds aggregates to the cloud file at `output`, if clouds like it get them, for the kernel by
/// which it is shown. Temporary files go to `temp_dir`, or beside the output.
///
/// If all clouds get them, and this one can have none, it is a remark that says so.
///
/// # Errors
/// If there is too little memory, for a file must not depend on it; if the host does not want it
/// any more; if a file fails. The cloud is then as it was.
pub fn aggregate(
    output: &Path,
    wanted: Aggregating,
    resources: Resources<'_>,
    temp_dir: Option<PathBuf>,
) -> Result<Option<AggregateHeader>> {
    if wanted == Aggregating::Never {
        return Ok(None);
    }
    let cloud = std::sync::Arc::new(Cloud::open(output)?);
    if wanted == Aggregating::Gas && cloud.header().points < look::MANY_POINTS {
        return Ok(None);
    }
    let none_for = |why: &dyn std::fmt::Display| {
        if wanted == Aggregating::Always {
            resources.host.remark(&format!("{} has no aggregates: {why}", output.display()));
        }
        Ok(None)
    };
    let (kernel, normalised) = match look::of_cloud(&cloud, &Style::default(), (64, 64)) {
        Ok(chosen) if wanted == Aggregating::Gas && chosen.look != LookName::Gas.name() => return Ok(None),
        Ok(chosen) => chosen.kernel(),
        // Nothing is to be seen of it.
        Err(error) => return none_for(&error),
    };
    drop(cloud);
    let defaults = AggregateOptions::default();
    let threads = resources.threads.unwrap_or(defaults.threads);
    let options = defaults
        .with_kernel(kernel)
        .with_normalised(normalised)
        .with_memory_bytes(resources.memory)
        .with_threads(threads)
        .with_temp_dir(temp_dir);
    let reported = Reported { host: resources.host, unit: "points" };
    let progress = |done, total| reported.update(Stage::Aggregate, done, total);
    match build::add_aggregates(output, output, &options, &progress, &resources.host.cancel()) {
        Ok(made) => Ok(Some(made)),
        Err(AggregateError::Unsupported { what, .. }) => none_for(&what),
        Err(error) => Err(error.into()),
    }
}
