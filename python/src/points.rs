//! Files of points: which they are, what is kept of them, and the clouds that are built of them.

use std::ffi::OsString;
use std::path::PathBuf;
use std::sync::Mutex;

use anyhow::{Context, Result};
use pyo3::prelude::*;
use rayset::CancelToken;
use rayset::Cloud;
use rayset::build::{self, BuildControl, BuildOptions};
use rayset::output::Destination;
use rayset::points::{PointSource, ReadError, ReadOptions};
use rayset::storage::address_of;
use rayset_inputs::{Files, LeftOut};

use crate::aggregates;
use crate::build::{Built, Options};
use crate::errors;
use crate::files::Package;
use crate::wait::{self, Progress, lock};

/// Files of points, and which of their columns are kept.
#[derive(FromPyObject)]
pub(crate) struct Points {
    /// Files, and no patterns or folders any more.
    #[pyo3(item)]
    files: Vec<PathBuf>,
    /// Whether a person named each; one that a folder or a pattern named is left out if it is
    /// damaged.
    #[pyo3(item)]
    by_name: Vec<bool>,
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
    pub(crate) left_out: LeftOut,
    pub(crate) options: BuildOptions,
    pub(crate) remarks: Vec<String>,
}

fn host<'a>(progress: &'a Progress, cancel: &'a CancelToken) -> Package<'a> {
    Package { remarks: Mutex::default(), progress, cancel, folder: None }
}

impl Points {
    /// Opens the files. If `strict`, none is left out.
    pub(crate) fn open(
        &self,
        options: BuildOptions,
        strict: bool,
        progress: &Progress,
        cancel: &CancelToken,
    ) -> Result<OpenPoints> {
        let host = host(progress, cancel);
        let reading = ReadOptions::default().with_text_columns(self.columns.clone());
        let files = Files::of(self.files.clone(), self.by_name.clone());
        let points = rayset_inputs::open_points(&files, &reading, strict, &host)?;
        let (sources, left_out) = (points.sources, points.left_out);
        let kept = match &self.attributes {
            Some(names) => names.clone(),
            None => rayset_inputs::customary_columns(&sources).kept,
        };
        let remarks = std::mem::take(&mut *lock(&host.remarks));
        Ok(OpenPoints { sources, left_out, options: options.with_attributes(kept), remarks })
    }
}

/// The files of points that paths, patterns and folders name, and whether each was named by itself.
/// None of them may be that which is written.
#[pyfunction]
pub(crate) fn expand(
    py: Python<'_>,
    paths: Vec<PathBuf>,
    output: Option<PathBuf>,
) -> PyResult<(Vec<OsString>, Vec<bool>)> {
    let found = py.detach(|| {
        let (progress, cancel) = (Progress::default(), CancelToken::new());
        rayset::storage::look_again();
        let found = rayset_inputs::expand(&paths, &host(&progress, &cancel))?;
        let (named, files) = (found.are_named().to_vec(), found.paths);
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
        Ok((files.into_iter().map(PathBuf::into_os_string).collect(), named))
    });
    found.map_err(|error| errors::of_input(py, error))
}

/// Builds a cloud of files. Returns it with what there is to say of the files.
#[pyfunction]
pub(crate) fn build_files(
    py: Python<'_>,
    points: Points,
    options: Options,
    told: Option<&Bound<'_, PyAny>>,
) -> PyResult<(Built, Vec<String>)> {
    let (cancel, progress) = (CancelToken::new(), Progress::default());
    let work = || {
        let open = points.open(options.of_library(), false, &progress, &cancel)?;
        let leaves_out = |source: usize, error: &ReadError| open.left_out.takes(source, error);
        let control = BuildControl::from(&progress as &dyn build::Progress)
            .with_cancel(&cancel)
            .with_leaving_out(&leaves_out);
        let builder = Cloud::builder().sources(open.sources).options(open.options).control(control);
        let (cloud, report, warnings) = match &options.path {
            Some(path) => {
                let report = builder.write(path)?;
                (None, report, aggregates::add(path, &options, &progress, &cancel)?)
            }
            None => {
                let (cloud, report) = builder.build_reported()?;
                (Some(cloud), report, Vec::new())
            }
        };
        let said = report.remarks.iter().cloned().chain(open.left_out.remark());
        let remarks = open.remarks.into_iter().chain(said).collect();
        Ok((cloud, report, warnings, remarks))
    };
    let outcome = wait::run(py, &cancel, &progress, told, work)?;
    let (cloud, report, warnings, remarks) = outcome.map_err(|error| errors::of_input(py, error))?;
    let (cloud, skipped) = crate::build::opened(py, cloud, &report, &options)?;
    Ok(((cloud, skipped, warnings), remarks))
}
