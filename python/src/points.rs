//! Files of points: which they are, what is kept of them, and the clouds that are built of them.

use std::ffi::OsString;
use std::path::PathBuf;
use std::sync::Mutex;

use anyhow::{Context, Result};
use pyo3::prelude::*;
use rayset::CancelToken;
use rayset::build::{self, BuildControl, BuildOptions};
use rayset::output::Destination;
use rayset::points::{PointSource, ReadOptions};
use rayset::storage::address_of;

use crate::build::Options;
use crate::errors;
use crate::files::{CloudFile, Package};
use crate::wait::{self, Progress, lock};

/// Files of points, and which of their columns are kept.
#[derive(FromPyObject)]
pub(crate) struct Points {
    /// Files, and no patterns or folders any more.
    #[pyo3(item)]
    files: Vec<PathBuf>,
    /// Names of the columns of text files and of arrays.
    #[pyo3(item)]
    columns: Option<Vec<String>>,
    /// Names of those that are kept; as `rayset build` chooses them if `None`.
    #[pyo3(item)]
    attributes: Option<Vec<String>>,
}

/// Points that are open, what is made of them, and what there is to say of them.
pub(crate) struct OpenPoints {
    pub(crate) sources: Vec<Box<dyn PointSource>>,
    pub(crate) options: BuildOptions,
    pub(crate) remarks: Vec<String>,
}

fn host<'a>(progress: &'a Progress, cancel: &'a CancelToken) -> Package<'a> {
    Package { remarks: Mutex::default(), progress, cancel, folder: None }
}

impl Points {
    /// Opens the files.
    pub(crate) fn open(
        &self,
        options: BuildOptions,
        progress: &Progress,
        cancel: &CancelToken,
    ) -> Result<OpenPoints> {
        let host = host(progress, cancel);
        let reading = ReadOptions::default().with_text_columns(self.columns.clone());
        let sources = rayset_inputs::open_points(&self.files, &reading, &host)?;
        let kept = match &self.attributes {
            Some(names) => names.clone(),
            None => rayset_inputs::customary_columns(&sources).kept,
        };
        let remarks = std::mem::take(&mut *lock(&host.remarks));
        Ok(OpenPoints { sources, options: options.with_attributes(kept), remarks })
    }
}

/// The files of points that paths, patterns and folders name. None of them may be that which is written.
#[pyfunction]
pub(crate) fn expand(
    py: Python<'_>,
    paths: Vec<PathBuf>,
    output: Option<PathBuf>,
) -> PyResult<Vec<OsString>> {
    let found = py.detach(|| {
        let (progress, cancel) = (Progress::default(), CancelToken::new());
        rayset::storage::look_again();
        let files = rayset_inputs::expand(&paths, &host(&progress, &cancel))?;
        for file in files.iter().filter(|file| address_of(file).is_none()) {
            std::fs::metadata(file).with_context(|| format!("cannot read {}", file.display()))?;
        }
        if rayset_inputs::has_volume(&files)? {
            anyhow::bail!("{}: a volume, which makes a grid; rs.open builds it", files[0].display());
        }
        if let Some(output) = &output {
            let destination = Destination::new(output)?;
            destination.require_file()?;
            destination.refuse_inputs(&files)?;
        }
        Ok(files.into_iter().map(PathBuf::into_os_string).collect())
    });
    found.map_err(|error| errors::of_input(py, error))
}

/// Builds a cloud of files. Returns it with the numbers of records that were skipped for their positions, radii and weights, and
/// with what there is to say of the files.
#[pyfunction]
pub(crate) fn build_files(
    py: Python<'_>,
    points: Points,
    options: Options,
    told: Option<&Bound<'_, PyAny>>,
) -> PyResult<(CloudFile, [u64; 3], Vec<String>)> {
    let (cancel, progress) = (CancelToken::new(), Progress::default());
    let work = || {
        let open = points.open(options.of_library(), &progress, &cancel)?;
        let control = BuildControl::from(&progress as &dyn build::Progress).with_cancel(&cancel);
        let (cloud, report) = match &options.path {
            Some(path) => (None, build::to_file(open.sources, path, &open.options, &control)?),
            None => {
                let (cloud, report) = build::in_memory(open.sources, &open.options, &control)?;
                (Some(cloud), report)
            }
        };
        let remarks = open.remarks.into_iter().chain(report.remarks.iter().cloned()).collect();
        Ok((cloud, report, remarks))
    };
    let outcome = wait::run(py, &cancel, &progress, told, work)?;
    let (cloud, report, remarks) = outcome.map_err(|error| errors::of_input(py, error))?;
    let (cloud, skipped) = crate::build::opened(py, cloud, &report, &options)?;
    Ok((cloud, skipped, remarks))
}
