//! Builds that are divided among processes: their steps, part by part, and the merge.

use std::path::PathBuf;

use numpy::PyUntypedArray;
use pyo3::prelude::*;
use rayset::CancelToken;
use rayset::build::{self, BuildControl, BuildError, BuildParts, BuildStep};

use crate::aggregates;
use crate::arrays::Named;
use crate::build::{Options, with_arrays};
use crate::errors;
use crate::points::Points;
use crate::wait::{self, Progress};

/// A build in parts: the folder through which they exchange their results, their number, and what
/// says that they are of one build.
#[derive(FromPyObject)]
pub(crate) struct Parts {
    #[pyo3(item)]
    folder: PathBuf,
    #[pyo3(item)]
    parts: u32,
    #[pyo3(item)]
    request: String,
}

impl Parts {
    fn of_library(&self) -> Result<BuildParts, BuildError> {
        Ok(BuildParts::new(&self.folder, self.parts)?.with_request(self.request.clone()))
    }
}

/// The name of the first step that has not been done, once all parts of those before have; `None`
/// if all have.
#[pyfunction]
pub(crate) fn next_step(py: Python<'_>, parts: Parts) -> PyResult<Option<&'static str>> {
    let step = py.detach(|| parts.of_library()?.next_step(1));
    step.map(|step| step.map(BuildStep::name)).map_err(|error| errors::of_build(py, error))
}

/// Reads the share of a part of some files. Returns what there is to say of these.
#[pyfunction]
pub(crate) fn read_part(
    py: Python<'_>,
    parts: Parts,
    part: u32,
    points: Points,
    options: Options,
    told: Option<&Bound<'_, PyAny>>,
) -> PyResult<Vec<String>> {
    let (cancel, progress) = (CancelToken::new(), Progress::default());
    let work = || {
        let open = points.open(options.of_library(), true, &progress, &cancel)?;
        let control = BuildControl::from(&progress as &dyn build::Progress).with_cancel(&cancel);
        parts.of_library()?.read(part, open.sources, &open.options, &control)?;
        Ok(open.remarks)
    };
    wait::run(py, &cancel, &progress, told, work)?.map_err(|error| errors::of_input(py, error))
}

/// Reads the points of a part that are in arrays, which no other part has.
#[pyfunction]
pub(crate) fn read_arrays_part(
    parts: Parts,
    part: u32,
    positions: &Bound<'_, PyUntypedArray>,
    columns: Vec<(Named, Bound<'_, PyUntypedArray>)>,
    options: Options,
    told: Option<&Bound<'_, PyAny>>,
) -> PyResult<()> {
    let py = positions.py();
    let (cancel, progress) = (CancelToken::new(), Progress::default());
    let of_library = options.of_library();
    with_arrays(positions, columns, |source| {
        let work = || {
            let control = BuildControl::from(&progress as &dyn build::Progress).with_cancel(&cancel);
            parts.of_library()?.read_own(part, vec![source], &of_library, &control)
        };
        wait::run(py, &cancel, &progress, told, work)?.map_err(|error| errors::of_build(py, error))
    })
}

/// Does any other step of a part.
#[pyfunction]
pub(crate) fn run_step(
    py: Python<'_>,
    parts: Parts,
    step: &str,
    part: u32,
    options: Options,
    told: Option<&Bound<'_, PyAny>>,
) -> PyResult<()> {
    let step: BuildStep =
        step.parse().map_err(|error: rayset::ParseError| errors::value(error.to_string()))?;
    let (cancel, progress) = (CancelToken::new(), Progress::default());
    let work = || {
        let control = BuildControl::from(&progress as &dyn build::Progress).with_cancel(&cancel);
        parts.of_library()?.run(step, part, &options.of_library(), &control)
    };
    wait::run(py, &cancel, &progress, told, work)?.map_err(|error| errors::of_build(py, error))
}

/// Merges all parts to a cloud file. Returns the numbers of records that were skipped, and what a
/// person should be warned of.
#[pyfunction]
pub(crate) fn merge_parts(
    py: Python<'_>,
    parts: Parts,
    path: PathBuf,
    options: Options,
    told: Option<&Bound<'_, PyAny>>,
) -> PyResult<([u64; 3], Vec<String>)> {
    let (cancel, progress) = (CancelToken::new(), Progress::default());
    let work = || {
        let control = BuildControl::from(&progress as &dyn build::Progress).with_cancel(&cancel);
        let report = parts.of_library()?.merge(&path, &options.of_library(), &control)?;
        Ok((report, aggregates::add(&path, &options, &progress, &cancel)?))
    };
    let outcome = wait::run(py, &cancel, &progress, told, work)?;
    let (report, warnings) = outcome.map_err(|error| errors::of_input(py, error))?;
    let skipped = report.skipped;
    Ok(([skipped.position, skipped.radius, skipped.weight], warnings))
}
