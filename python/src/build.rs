//! Clouds of arrays and of chunks, in memory or in a file.

use std::path::PathBuf;
use std::sync::Arc;

use numpy::{PyUntypedArray, PyUntypedArrayMethods};
use pyo3::prelude::*;
use rayset::build::{
    self, BuildControl, BuildOptions, BuildReport, InvalidPolicy, Precision, Rule, ShapeRule,
};
use rayset::points::PointSource;
use rayset::{CancelToken, Cloud};

use crate::aggregates;
use crate::arrays::{ArraySource, HeldColumn, HeldPositions, Named, Pinned};
use crate::chunks::{Chunk, ChunkSource, Raised};
use crate::errors::{self, Kind};
use crate::files::CloudFile;
use crate::room;
use crate::wait::{self, Progress, lock};

/// The options of a build, checked and named by the package.
#[derive(FromPyObject)]
pub(crate) struct Options {
    #[pyo3(item)]
    pub(crate) path: Option<PathBuf>,
    /// A number, `auto`, or `None` for a column of that name, or `auto` without one.
    #[pyo3(item)]
    radius: Option<RuleArgument>,
    /// A number, the name of a column, or `None` for the column of that name, or 1 without one.
    #[pyo3(item)]
    weight: Option<RuleArgument>,
    #[pyo3(item)]
    radius_scale: f64,
    /// `auto`, `fluid` or `round`.
    #[pyo3(item)]
    shape: String,
    #[pyo3(item)]
    length_scale: f64,
    #[pyo3(item)]
    attributes: Vec<String>,
    #[pyo3(item)]
    invalid: String,
    /// A fraction of the radius; `None` for exact.
    #[pyo3(item)]
    precision: Option<f64>,
    #[pyo3(item)]
    memory: Option<u64>,
    #[pyo3(item)]
    threads: Option<usize>,
    #[pyo3(item)]
    temp_dir: Option<PathBuf>,
    /// Whether a file gets aggregates; those of gas if `None`.
    #[pyo3(item)]
    pub(crate) lod: Option<bool>,
}

#[derive(FromPyObject)]
enum RuleArgument {
    Number(f64),
    Word(String),
}

impl RuleArgument {
    fn rule(&self) -> Rule {
        match self {
            Self::Number(number) => Rule::Number(*number),
            Self::Word(word) if word == "auto" => Rule::Auto,
            Self::Word(name) => Rule::Attribute(name.clone()),
        }
    }
}

impl Options {
    /// As the library has them.
    pub(crate) fn of_library(&self) -> BuildOptions {
        let defaults = BuildOptions::default();
        let (memory, threads) = (defaults.memory_bytes, defaults.threads);
        defaults
            .with_radius(self.radius.as_ref().map(RuleArgument::rule))
            .with_weight(self.weight.as_ref().map(RuleArgument::rule))
            .with_radius_scale(self.radius_scale)
            .with_shape(match self.shape.as_str() {
                "round" => ShapeRule::Round,
                "fluid" => ShapeRule::Fluid,
                _ => ShapeRule::Auto,
            })
            .with_length_scale(self.length_scale)
            .with_attributes(self.attributes.clone())
            .with_invalid(match self.invalid.as_str() {
                "skip-all" => InvalidPolicy::SkipAll,
                "raise" => InvalidPolicy::Reject,
                _ => InvalidPolicy::Skip,
            })
            .with_precision(self.precision.map_or(Precision::Exact, Precision::Relative))
            .with_memory_bytes(self.memory.unwrap_or(memory))
            .with_threads(self.threads.unwrap_or(threads))
            .with_temp_dir(self.temp_dir.clone())
    }
}

/// What a point of a cloud takes at least.
const LEAST_POINT_BYTES: u64 = 6;

/// A cloud; the numbers of records that were skipped for their positions, radii and weights; and
/// what a person should be warned of.
pub(crate) type Built = (CloudFile, [u64; 3], Vec<String>);

/// Builds a cloud of arrays.
#[pyfunction]
pub(crate) fn build_arrays(
    positions: &Bound<'_, PyUntypedArray>,
    columns: Vec<(Named, Bound<'_, PyUntypedArray>)>,
    options: Options,
    told: Option<&Bound<'_, PyAny>>,
) -> PyResult<Built> {
    let py = positions.py();
    if options.path.is_none() {
        let points = positions.shape().first().copied().unwrap_or(0) as u64;
        let advice = "name a file for it by path=, which may be larger than memory";
        room::check(points, LEAST_POINT_BYTES, &format!("a cloud of {points} points in memory"), advice)?;
    }
    with_arrays(positions, columns, |source| run(py, source, &options, told, &Raised::default()))
}

/// Hands arrays, which are read where they lie, to whoever reads their points.
pub(crate) fn with_arrays<T>(
    positions: &Bound<'_, PyUntypedArray>,
    columns: Vec<(Named, Bound<'_, PyUntypedArray>)>,
    read: impl FnOnce(Box<dyn PointSource + '_>) -> PyResult<T>,
) -> PyResult<T> {
    let pinned = Pinned::new(positions)?;
    let pinned_columns = columns
        .into_iter()
        .map(|(named, array)| Ok((Pinned::new(&array)?, named)))
        .collect::<PyResult<Vec<_>>>()?;
    let held = HeldPositions::new(pinned.array())?;
    let held_columns = pinned_columns
        .into_iter()
        .map(|(pinned, named)| Ok((HeldColumn::new(&named.name, pinned.array())?, named, pinned)))
        .collect::<PyResult<Vec<_>>>()?;
    let views = held_columns.iter().map(|(held, named, _)| (named.clone(), held.view())).collect();
    read(Box::new(ArraySource::new(held.view(), views)?))
}

/// Builds a cloud of an iterator of chunks, as [`build_arrays`].
#[pyfunction]
pub(crate) fn build_chunks(
    py: Python<'_>,
    first: Chunk,
    names: Vec<Named>,
    chunks: Py<PyAny>,
    options: Options,
    told: Option<&Bound<'_, PyAny>>,
) -> PyResult<Built> {
    let raised = Raised::default();
    let source = ChunkSource::new(py, &first, names, chunks, raised.clone())?;
    drop(first);
    run(py, Box::new(source), &options, told, &raised)
}

fn run(
    py: Python<'_>,
    source: Box<dyn PointSource + '_>,
    options: &Options,
    told: Option<&Bound<'_, PyAny>>,
    raised: &Raised,
) -> PyResult<Built> {
    let (cancel, progress) = (CancelToken::new(), Progress::default());
    let of_library = options.of_library();
    let work = || {
        let control = BuildControl::from(&progress as &dyn build::Progress).with_cancel(&cancel);
        let builder = Cloud::builder().sources([source]).options(of_library).control(control);
        match &options.path {
            Some(path) => {
                let report = builder.write(path)?;
                Ok((None, report, aggregates::add(path, options, &progress, &cancel)?))
            }
            None => {
                let (cloud, report) = builder.build_reported()?;
                Ok((Some(cloud), report, Vec::new()))
            }
        }
    };
    let outcome = wait::run(py, &cancel, &progress, told, work);
    if let Some(error) = lock(raised).take() {
        return Err(error);
    }
    let (cloud, report, warnings) = outcome?.map_err(|error| errors::of_input(py, error))?;
    let (cloud, skipped) = opened(py, cloud, &report, options)?;
    Ok((cloud, skipped, warnings))
}

/// Opens what was built. Returns it with the numbers of records that were skipped.
pub(crate) fn opened(
    py: Python<'_>,
    cloud: Option<Cloud>,
    report: &BuildReport,
    options: &Options,
) -> PyResult<(CloudFile, [u64; 3])> {
    let cloud = match (cloud, &options.path) {
        (Some(cloud), _) => CloudFile::in_memory(&cloud).map_err(|error| errors::of_open(py, &error))?,
        (None, Some(path)) => CloudFile::on_disk(Arc::new(
            py.detach(|| Cloud::open(path)).map_err(|error| errors::of_open(py, &error))?,
        )),
        (None, None) => return Err(errors::error(py, Kind::Build, "nothing was built")),
    };
    let skipped = report.skipped;
    Ok((cloud, [skipped.position, skipped.radius, skipped.weight]))
}
