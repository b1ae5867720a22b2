//! Aggregates of clouds that were built to a file.

use std::path::Path;
use std::sync::Mutex;

use anyhow::{Context, Result};
use rayset::CancelToken;
use rayset_inputs::{Aggregating, Resources, aggregate};

use crate::build::Options;
use crate::files::Package;
use crate::wait::{Progress, lock};

/// Adds aggregates to a cloud that was built, if it gets any. Returns why it has none though all
/// were to have them.
pub(crate) fn add(
    path: &Path,
    options: &Options,
    progress: &Progress,
    cancel: &CancelToken,
) -> Result<Vec<String>> {
    let wanted = match options.lod {
        None => Aggregating::Gas,
        Some(true) => Aggregating::Always,
        Some(false) => Aggregating::Never,
    };
    let of_library = options.of_library();
    let host = Package { remarks: Mutex::default(), progress, cancel, folder: of_library.temp_dir.clone() };
    let resources =
        Resources { memory: of_library.memory_bytes, threads: Some(of_library.threads), host: &host };
    aggregate(path, wanted, resources, of_library.temp_dir).with_context(|| {
        format!("{} is built, but has no aggregates, which lod=False leaves out", path.display())
    })?;
    Ok(std::mem::take(&mut *lock(&host.remarks)))
}
