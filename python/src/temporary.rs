//! Temporary folders, which the next run removes if this one is killed.

use std::ffi::OsString;
use std::sync::Mutex;

use pyo3::prelude::*;
use rayset_inputs::OwnFolder;

use crate::errors;
use crate::wait::lock;

/// A folder that is removed by `close`, or when nobody has it any more.
#[pyclass(frozen, module = "rayset._native")]
pub(crate) struct TemporaryFolder {
    path: OsString,
    folder: Mutex<Option<OwnFolder>>,
}

#[pymethods]
impl TemporaryFolder {
    #[new]
    fn new() -> PyResult<Self> {
        let within = std::env::temp_dir();
        let folder = OwnFolder::create(&within, "python").map_err(|error| {
            errors::os(format!("cannot create a temporary folder in {}: {error}", within.display()))
        })?;
        Ok(Self { path: folder.path().into(), folder: Mutex::new(Some(folder)) })
    }

    #[getter]
    fn path(&self) -> OsString {
        self.path.clone()
    }

    /// Removes it, with all that is in it.
    fn close(&self) {
        drop(lock(&self.folder).take());
    }
}
