//! Remote objects: `s3://`, `gs://`, `az://` and `https://`, wherever a file is named.

use std::ffi::{CString, OsString};
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use pyo3::exceptions::{PyFileNotFoundError, PyRuntimeWarning};
use pyo3::prelude::*;
use rayset::scene::{Node, Shape};
use rayset::storage::{self, InputFile, Named, Storage};
use rayset::{Cloud, Grid};
use rayset_inputs::values;
use rayset_remote::Settings;

use crate::errors;

/// The longest scene that is read from an address, in bytes.
const MOST_TEXT: u64 = 1 << 28;

/// Opens addresses in this process from now on, as the environment says it (`RAYSET_REMOTE_CACHE`);
/// without a cache, with a warning, if that cannot be used.
pub(crate) fn open_addresses(py: Python<'_>) -> PyResult<()> {
    let open =
        |settings: &Settings| rayset_remote::open_addresses(settings).map_err(|error| error.to_string());
    if let Err(what) = Settings::of_environment(values::size).and_then(|settings| open(&settings)) {
        let words =
            CString::new(format!("what is read of addresses is not kept: {what}").replace('\0', " "))?;
        PyErr::warn(py, &py.get_type::<PyRuntimeWarning>(), &words, 1)?;
        open(&Settings::default()).map_err(errors::os)?;
    }
    Ok(())
}

/// A path that stands in a file of a folder, either of which may be an address.
#[pyfunction]
pub(crate) fn beside(folder: PathBuf, path: PathBuf) -> OsString {
    storage::beside(&folder, &path).into()
}

/// The length of each file or object, and what tells an object from others at its address. Nothing
/// that was looked at a moment ago is looked at again.
#[pyfunction]
pub(crate) fn versions(py: Python<'_>, paths: Vec<PathBuf>) -> PyResult<Vec<(u64, Option<String>)>> {
    let look = |path: &Path| -> io::Result<(u64, Option<String>)> {
        if storage::address_of(path).is_some() {
            let object = storage::open(path, false)?;
            return Ok((object.length()?, object.version()));
        }
        match storage::look(path)? {
            Named::File(bytes) => Ok((bytes, None)),
            _ => Ok((0, None)),
        }
    };
    let all = py.detach(|| {
        paths
            .iter()
            .map(|path| {
                look(path).map_err(|error| (format!("cannot open {}: {error}", path.display()), error.kind()))
            })
            .collect::<Result<Vec<_>, _>>()
    });
    all.map_err(|(words, kind)| match kind {
        io::ErrorKind::NotFound => PyFileNotFoundError::new_err(words),
        _ => errors::os(words),
    })
}

/// What tells an object from others at its address; `None` for files, and where the server says
/// nothing.
pub(crate) fn version(storage: Option<&Arc<dyn Storage>>) -> Option<String> {
    storage.and_then(|storage| storage.version())
}

/// The clouds and grids of a scene that are remote.
#[derive(Clone, Default)]
pub(crate) struct RemoteFiles {
    clouds: Vec<Arc<Cloud>>,
    grids: Vec<Arc<Grid>>,
}

impl RemoteFiles {
    pub(crate) fn of(root: &Node) -> Self {
        let mut found = Self::default();
        root.for_each(&mut |node| match &node.shape {
            Shape::Cloud(object) if storage::address_of(object.cloud.address()).is_some() => {
                found.clouds.push(object.cloud.stored().clone());
            }
            Shape::Grid(object) if storage::address_of(object.grid.address()).is_some() => {
                found.grids.push(object.grid.clone());
            }
            _ => {}
        });
        found.clouds.sort_by_key(Arc::as_ptr);
        found.clouds.dedup_by(|a, b| Arc::ptr_eq(a, b));
        found.grids.sort_by_key(Arc::as_ptr);
        found.grids.dedup_by(|a, b| Arc::ptr_eq(a, b));
        found
    }

    /// Those that are still what is at their addresses, which need not be opened again.
    pub(crate) fn current(mut self) -> (Vec<Arc<Cloud>>, Vec<Arc<Grid>>) {
        let is_current = |path: &Path, own: Option<&Arc<dyn Storage>>| {
            let now = storage::open(path, false).ok();
            now.zip(own).is_some_and(|(now, own)| Arc::ptr_eq(&now, own))
        };
        self.clouds.retain(|cloud| is_current(cloud.address(), cloud.storage()));
        self.grids.retain(|grid| is_current(grid.address(), grid.storage()));
        (self.clouds, self.grids)
    }

    /// A text that differs when another object is at one of the addresses.
    pub(crate) fn text(&self) -> String {
        let clouds = self.clouds.iter().map(|cloud| (cloud.path(), cloud.storage()));
        let grids = self.grids.iter().map(|grid| (grid.path(), grid.storage()));
        let mut all: Vec<String> = clouds
            .chain(grids)
            .map(|(path, own)| {
                let length = own.and_then(|own| own.length().ok());
                format!("{} {length:?} {:?}", path.display(), version(own))
            })
            .collect();
        all.sort_unstable();
        all.join(" ")
    }
}

/// A path or an address as people may see it: without what grants access.
#[pyfunction]
pub(crate) fn shown(path: PathBuf) -> String {
    storage::shown(&path)
}

/// The text of an object.
#[pyfunction]
pub(crate) fn read_text(py: Python<'_>, path: PathBuf) -> PyResult<String> {
    let read = py.detach(|| {
        storage::look_again();
        let mut text = String::new();
        InputFile::open(&path)?.take(MOST_TEXT).read_to_string(&mut text)?;
        Ok(text)
    });
    read.map_err(|error: std::io::Error| errors::os(format!("cannot read {}: {error}", path.display())))
}
