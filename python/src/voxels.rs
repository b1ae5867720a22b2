//! Grids of an iterator of slabs of voxels.

use std::io::{self, Read};
use std::path::PathBuf;
use std::sync::Arc;

use pyo3::prelude::*;
use pyo3::types::PyBytes;
use rayset::build::{self, BuildControl, GridBuildOptions};
use rayset::file::VoxelKind;
use rayset::geometry::{DAffine3, DMat3, DVec3};
use rayset::volumes::VolumeSource;
use rayset::{CancelToken, Grid};

use crate::chunks::Raised;
use crate::errors;
use crate::files::GridFile;
use crate::wait::{self, Progress, lock};

/// The bytes of slabs, one after another.
struct Slabs {
    slabs: Py<PyAny>,
    now: Option<(Py<PyBytes>, usize)>,
    raised: Raised,
}

impl Slabs {
    fn take(&mut self, py: Python<'_>, to: &mut [u8]) -> PyResult<usize> {
        loop {
            if let Some((bytes, at)) = &mut self.now {
                let left = &bytes.bind(py).as_bytes()[*at..];
                if !left.is_empty() {
                    let count = left.len().min(to.len());
                    to[..count].copy_from_slice(&left[..count]);
                    *at += count;
                    return Ok(count);
                }
            }
            let Some(slab) = self.slabs.bind(py).try_iter()?.next() else { return Ok(0) };
            self.now = Some((slab?.extract()?, 0));
        }
    }
}

impl Read for Slabs {
    fn read(&mut self, to: &mut [u8]) -> io::Result<usize> {
        Python::attach(|py| self.take(py, to)).map_err(|error| {
            *lock(&self.raised) = Some(error);
            io::Error::other("the iterator raised")
        })
    }
}

/// Builds a grid file at `path` of slabs of bytes, x fastest: `size` voxels along x, y and z, of
/// `kind` `u8`, `i16`, `u16` or `f32`, whose centres `matrix`, three rows of four, places.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "what voxels are, where they go, and by what means")]
pub(crate) fn build_grid(
    py: Python<'_>,
    slabs: Py<PyAny>,
    size: [u64; 3],
    kind: &str,
    matrix: [[f64; 4]; 3],
    path: PathBuf,
    memory: Option<u64>,
    told: Option<&Bound<'_, PyAny>>,
) -> PyResult<GridFile> {
    let kind = VoxelKind::ALL.iter().find(|known| known.name() == kind);
    let kind = *kind.ok_or_else(|| errors::value("voxels are of u8, i16, u16 or f32"))?;
    let column = |k: usize| DVec3::new(matrix[0][k], matrix[1][k], matrix[2][k]);
    let space =
        DAffine3 { matrix3: DMat3::from_cols(column(0), column(1), column(2)), translation: column(3) };
    let raised = Raised::default();
    let reader = Slabs { slabs, now: None, raised: raised.clone() };
    let source = VolumeSource::from_reader("the array", size, kind, space, Box::new(reader));
    let source = source.map_err(|error| errors::value(error.to_string()))?;
    let mut options = GridBuildOptions::default();
    if let Some(memory) = memory {
        options = options.with_memory_bytes(memory);
    }
    let (cancel, progress) = (CancelToken::new(), Progress::default());
    let work = || {
        let control = BuildControl::from(&progress as &dyn build::Progress).with_cancel(&cancel);
        build::grid_to_file(source, &path, &options, &control)
    };
    let outcome = wait::run(py, &cancel, &progress, told, work);
    if let Some(error) = lock(&raised).take() {
        return Err(error);
    }
    outcome?.map_err(|error| errors::of_grid_build(py, error))?;
    let grid = py.detach(|| Grid::open(&path)).map_err(|error| errors::of_open(py, &error))?;
    Ok(GridFile::new(Arc::new(grid)))
}
