//! Aggregates of clouds that were just built: with them, pictures from afar look at few of the
//! points.

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use rayset::Cloud;
use rayset::build::{self, AggregateError, AggregateHeader, AggregateOptions, Progress, Stage};

use crate::host::Reported;
use crate::look;
use crate::open::Resources;
use crate::style::{LookName, Style};

/// Of so many points and more, gas is seen from afar: each ray goes through all of it, and most of
/// the time of its pictures would go into points that are small beside a pixel.
pub const MANY_POINTS: u64 = 200_000;

/// Which clouds get aggregates as they are built.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Aggregating {
    /// Those of [`MANY_POINTS`] and more that are shown as gas.
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
/// # Errors
/// If there is too little memory, whichever clouds get aggregates: a file must not depend on it. If
/// the cloud can have none, and all get them, or if the host does not want it any more, or a file
/// fails. The cloud is then as it was.
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
    if wanted == Aggregating::Gas && cloud.header().points < MANY_POINTS {
        return Ok(None);
    }
    let chosen = match look::of_cloud(&cloud, &Style::default(), (64, 64)) {
        Ok(chosen) => chosen,
        // Nothing is to be seen of it.
        Err(_) if wanted == Aggregating::Gas => return Ok(None),
        Err(error) => return Err(error),
    };
    if wanted == Aggregating::Gas && chosen.look != LookName::Gas.name() {
        return Ok(None);
    }
    drop(cloud);
    let (kernel, normalised) = chosen.kernel();
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
        Err(AggregateError::Unsupported { .. }) if wanted == Aggregating::Gas => Ok(None),
        Err(AggregateError::Unsupported { what, .. }) => bail!("{}: {what}", output.display()),
        Err(error) => Err(error.into()),
    }
}
