//! Exceptions: the library's errors, with the same words, in a small hierarchy. Addresses in them
//! are without what grants access.

use pyo3::exceptions::{PyFileNotFoundError, PyOSError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyType;
use rayset::build::{AggregateError, BuildError, GridBuildError};
use rayset::parts::PartError;
use rayset::scene_file::SceneFileError;
use rayset::storage::redacted;
use rayset::{OpenError, RenderError};

/// The classes of exceptions, which the package defines in Python.
const MODULE: &str = "rayset._errors";

/// What went wrong, as far as a caller may want to tell apart.
#[derive(Clone, Copy)]
pub(crate) enum Kind {
    /// A file cannot be opened, read, or used for what it is.
    Input,
    /// A build failed.
    Build,
    /// A scene, a look or a camera is not valid.
    Scene,
    /// A render failed.
    Render,
    /// The memory that may be used is not enough.
    Memory,
    /// Something was stopped by `cancel`.
    Cancelled,
}

impl Kind {
    fn class(self) -> &'static str {
        match self {
            Self::Input => "InputError",
            Self::Build => "BuildError",
            Self::Scene => "SceneError",
            Self::Render => "RenderError",
            Self::Memory => "MemoryBudgetError",
            Self::Cancelled => "Cancelled",
        }
    }
}

/// Words as people may see them.
pub(crate) fn shown(words: impl Into<String>) -> String {
    redacted(&words.into()).into_owned()
}

/// An exception of the package.
pub(crate) fn error(py: Python<'_>, kind: Kind, words: impl Into<String>) -> PyErr {
    let class = py.import(MODULE).and_then(|module| module.getattr(kind.class()));
    match class.and_then(|class| Ok(class.cast_into::<PyType>()?)) {
        Ok(class) => PyErr::from_type(class, (shown(words),)),
        Err(other) => other,
    }
}

pub(crate) fn of_build(py: Python<'_>, error: BuildError) -> PyErr {
    let words = error.to_string();
    match error {
        BuildError::Cancelled => self::error(py, Kind::Cancelled, words),
        BuildError::Memory { given, needed } => {
            let (given, needed) = (bytes(given), needed);
            let words =
                format!("memory={given} is too small for this build; at least {needed} bytes will do");
            self::error(py, Kind::Memory, words)
        }
        BuildError::Read(_) => self::error(py, Kind::Input, words),
        _ => self::error(py, Kind::Build, words),
    }
}

pub(crate) fn of_grid_build(py: Python<'_>, error: GridBuildError) -> PyErr {
    let words = error.to_string();
    match error {
        GridBuildError::Cancelled => self::error(py, Kind::Cancelled, words),
        GridBuildError::Memory { needed, budget } => {
            let words = format!(
                "memory={} is too small for this grid; at least {needed} bytes will do",
                bytes(budget)
            );
            self::error(py, Kind::Memory, words)
        }
        GridBuildError::Read(_) => self::error(py, Kind::Input, words),
        _ => self::error(py, Kind::Build, words),
    }
}

pub(crate) fn of_open(py: Python<'_>, error: &OpenError) -> PyErr {
    self::error(py, Kind::Input, error.to_string())
}

pub(crate) fn of_render(py: Python<'_>, error: RenderError) -> PyErr {
    let words = error.to_string();
    let kind = match error {
        RenderError::Cancelled => Kind::Cancelled,
        RenderError::Scene(_) | RenderError::Camera(_) => Kind::Scene,
        RenderError::Memory { .. } => Kind::Memory,
        _ => Kind::Render,
    };
    self::error(py, kind, words)
}

pub(crate) fn of_part(py: Python<'_>, error: PartError) -> PyErr {
    match error {
        PartError::Render(error) => of_render(py, error),
        other => self::error(py, Kind::Render, other.to_string()),
    }
}

/// The key and what is wrong with it: the line in a text that nobody has written means nothing.
pub(crate) fn of_scene(py: Python<'_>, error: &SceneFileError) -> PyErr {
    let key = if error.key.is_empty() { String::new() } else { format!("{}: ", error.key) };
    self::error(py, Kind::Scene, format!("{key}{}", error.what))
}

fn of_aggregates(py: Python<'_>, error: &AggregateError, words: String) -> PyErr {
    match error {
        AggregateError::Cancelled => self::error(py, Kind::Cancelled, words),
        AggregateError::Memory { .. } => self::error(py, Kind::Memory, words),
        _ => self::error(py, Kind::Build, words),
    }
}

/// Errors of opening any input, which may be those of a build.
pub(crate) fn of_input(py: Python<'_>, error: anyhow::Error) -> PyErr {
    if let Some(cause) = error.downcast_ref::<AggregateError>() {
        return of_aggregates(py, cause, format!("{error:#}"));
    }
    match error.downcast::<BuildError>().map_err(anyhow::Error::downcast::<GridBuildError>) {
        Ok(error) => of_build(py, error),
        Err(Ok(error)) => of_grid_build(py, error),
        Err(Err(other)) => match other.downcast_ref::<std::io::Error>() {
            Some(io) if io.kind() == std::io::ErrorKind::NotFound => {
                PyFileNotFoundError::new_err(shown(format!("{other:#}")))
            }
            _ => self::error(py, Kind::Input, format!("{other:#}")),
        },
    }
}

pub(crate) fn value(words: impl Into<String>) -> PyErr {
    PyValueError::new_err(shown(words))
}

pub(crate) fn os(words: impl Into<String>) -> PyErr {
    PyOSError::new_err(shown(words))
}

/// The thread that did the work has panicked.
pub(crate) fn defect(py: Python<'_>) -> PyErr {
    self::error(py, Kind::Render, "an internal error; please report it with what was done")
}

/// A number of bytes as people write it.
pub(crate) fn bytes(n: u64) -> String {
    rayset_inputs::text::bytes(n)
}
