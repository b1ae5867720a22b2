//! Clouds and grids that are open, in memory or on disk.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

use numpy::ndarray::{Array1, Array2};
use numpy::{IntoPyArray, PyArray1, PyArray2};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};
use rayset::file::FileKind;
use rayset::geometry::DVec3;
use rayset::{CancelToken, Cloud, Grid, OpenError};
use rayset_inputs::look::{self, Looks, Picture};
use rayset_inputs::{BuildChoices, Cache, Host, Input, Opened, OwnFolder, Resources};

use crate::errors::{self, Kind};
use crate::looks::{self, ChosenLook};
use crate::remote;
use crate::room;
use crate::wait::{self, Progress, lock};

/// A cloud.
#[pyclass(frozen, module = "rayset._native")]
pub(crate) struct CloudFile {
    pub(crate) cloud: Arc<Cloud>,
    in_memory: bool,
    /// What it looks like: a sample of its points, read when somebody asks.
    looks: Mutex<Option<Arc<Looks>>>,
    /// Keeps a file that goes with it.
    _opened: Option<Opened>,
}

/// A grid.
#[pyclass(frozen, module = "rayset._native")]
pub(crate) struct GridFile {
    pub(crate) grid: Arc<Grid>,
    in_memory: bool,
    _opened: Option<Opened>,
}

/// A name under which scenes refer to what is in memory.
fn memory_name() -> String {
    static LAST: AtomicU64 = AtomicU64::new(0);
    format!("memory:{}", LAST.fetch_add(1, Ordering::Relaxed) + 1)
}

impl CloudFile {
    pub(crate) fn on_disk(cloud: Arc<Cloud>) -> Self {
        Self { cloud, in_memory: false, looks: Mutex::default(), _opened: None }
    }

    /// The same cloud under a name of its own.
    pub(crate) fn in_memory(cloud: &Cloud) -> Result<Self, OpenError> {
        let cloud = match cloud.storage() {
            Some(storage) => Cloud::from_storage(&memory_name(), storage.clone())?,
            None => Cloud::open(cloud.path())?,
        };
        Ok(Self { in_memory: true, ..Self::on_disk(Arc::new(cloud)) })
    }

    fn looks(&self) -> anyhow::Result<Arc<Looks>> {
        let mut looks = lock(&self.looks);
        if let Some(looks) = &*looks {
            return Ok(looks.clone());
        }
        let read = Arc::new(Looks::of_cloud(self.cloud.clone())?);
        *looks = Some(read.clone());
        Ok(read)
    }
}

fn triple(v: DVec3) -> (f64, f64, f64) {
    (v.x, v.y, v.z)
}

#[pymethods]
impl CloudFile {
    /// The path, or the name of what is in memory.
    #[getter]
    fn path(&self) -> OsString {
        self.cloud.path().into()
    }

    /// What opens it again: the path, with the query of a signed address.
    #[getter]
    fn address(&self) -> OsString {
        self.cloud.address().into()
    }

    /// What tells an object from others at its address; `None` for files.
    #[getter]
    fn version(&self) -> Option<String> {
        remote::version(self.cloud.storage())
    }

    #[getter]
    fn is_in_memory(&self) -> bool {
        self.in_memory
    }

    /// What the header says.
    fn header<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let header = self.cloud.header();
        let all = PyDict::new(py);
        all.set_item("points", header.points)?;
        all.set_item("copies", header.copies)?;
        all.set_item("skipped", header.skipped)?;
        all.set_item("bounds", (triple(header.bounds.min), triple(header.bounds.max)))?;
        all.set_item("radius", (header.radius.min(), header.radius.max()))?;
        all.set_item("radius_mean", header.radius_mean)?;
        all.set_item("weight", (header.weight.min(), header.weight.max()))?;
        all.set_item("has_color", header.has_color)?;
        all.set_item("file_bytes", header.file_bytes)?;
        all.set_item("identity", header.identity.to_string())?;
        all.set_item("crs", &header.crs)?;
        all.set_item("sources", &header.sources)?;
        all.set_item("up", header.up.map(triple))?;
        let attributes = PyList::empty(py);
        for attribute in &header.attributes {
            let one = PyDict::new(py);
            one.set_item("name", &attribute.name)?;
            one.set_item("type", attribute.kind.name())?;
            one.set_item("unit", &attribute.unit)?;
            one.set_item("is_class", attribute.is_class)?;
            one.set_item("range", (attribute.min, attribute.max))?;
            attributes.append(one)?;
        }
        all.set_item("attributes", attributes)?;
        Ok(all)
    }

    /// About `most` points, evenly spread: their positions, and their columns by name.
    #[expect(clippy::type_complexity, reason = "positions, and columns by name")]
    fn sample<'py>(
        &self,
        py: Python<'py>,
        most: usize,
    ) -> PyResult<(Bound<'py, PyArray2<f64>>, Vec<(String, Bound<'py, PyArray1<f64>>)>)> {
        let read = py.detach(|| self.cloud.sample(most));
        let batch = read.map_err(|error| errors::error(py, Kind::Input, error.to_string()))?;
        let flat = batch.position.concat();
        let positions =
            Array2::from_shape_vec((batch.len(), 3), flat).map_err(|e| errors::value(e.to_string()))?;
        let columns =
            self.cloud.sample_schema().columns.into_iter().zip(&batch.columns).map(|(info, values)| {
                let values: Array1<f64> = (0..values.len()).map(|i| values.get(i)).collect();
                (info.name, values.into_pyarray(py))
            });
        Ok((positions.into_pyarray(py), columns.collect()))
    }

    /// The scene that it is rendered as if nobody says more than `arguments`, an object of JSON:
    /// the scene as JSON, what is said of it, the name of the look, and what is up; with `turns`
    /// also what the cameras of a turntable turn about, of which its camera is the first.
    #[pyo3(signature = (arguments, size, turns = false))]
    fn look(&self, py: Python<'_>, arguments: &str, size: (u32, u32), turns: bool) -> PyResult<ChosenLook> {
        looks::chosen(py, arguments, Picture { size, turns }, |style, picture| {
            self.looks()?.chosen(style, picture)
        })
    }

    /// Writes the cloud to a file, as it is.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let copied = py.detach(|| copy(self.cloud.path(), self.cloud.storage().map(AsRef::as_ref), &path));
        copied.map_err(|error| errors::os(format!("cannot write {}: {error}", path.display())))
    }
}

impl GridFile {
    pub(crate) fn new(grid: Arc<Grid>) -> Self {
        Self { grid, in_memory: false, _opened: None }
    }
}

#[pymethods]
impl GridFile {
    /// The path, or the name of what is in memory.
    #[getter]
    fn path(&self) -> OsString {
        self.grid.path().into()
    }

    /// What opens it again: the path, with the query of a signed address.
    #[getter]
    fn address(&self) -> OsString {
        self.grid.address().into()
    }

    /// What tells an object from others at its address; `None` for files.
    #[getter]
    fn version(&self) -> Option<String> {
        remote::version(self.grid.storage())
    }

    #[getter]
    fn is_in_memory(&self) -> bool {
        self.in_memory
    }

    /// What the header says.
    fn header<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let header = self.grid.header();
        let all = PyDict::new(py);
        let space = header.space_from_voxel;
        let ends = [DVec3::ZERO, header.last_voxel()].map(|p| triple(space.transform_point3(p)));
        all.set_item("size", header.size)?;
        all.set_item("type", header.kind.name())?;
        all.set_item("range", header.value_range())?;
        let [x, y, z] = [space.matrix3.x_axis, space.matrix3.y_axis, space.matrix3.z_axis];
        let t = space.translation;
        let row = |k: usize| [x[k], y[k], z[k], t[k]];
        all.set_item("matrix", [row(0), row(1), row(2)])?;
        all.set_item("ends", ends)?;
        all.set_item("file_bytes", header.file_bytes)?;
        all.set_item("identity", header.identity.to_string())?;
        all.set_item("sources", &header.sources)?;
        all.set_item("up", header.up.map(triple))?;
        Ok(all)
    }

    /// All voxels as they are stored, as an array of three axes, z first; `scale` and `offset` of
    /// the values besides.
    fn voxels<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyArray1<f32>>, f64, f64)> {
        let count = self.grid.header().size.iter().fold(1, |all: u64, &n| all.saturating_mul(n));
        room::check(count, 4, "the grid as an array", "render it, or build one of fewer voxels")?;
        let read = py.detach(|| self.grid.load());
        let voxels = read.map_err(|error| errors::error(py, Kind::Input, error.to_string()))?;
        let header = self.grid.header();
        Ok((voxels.into_pyarray(py), header.scale, header.offset))
    }

    /// As [`CloudFile::look`].
    #[pyo3(signature = (arguments, size, turns = false))]
    fn look(&self, py: Python<'_>, arguments: &str, size: (u32, u32), turns: bool) -> PyResult<ChosenLook> {
        looks::chosen(py, arguments, Picture { size, turns }, |style, picture| {
            look::of_grid(&self.grid, style, picture)
        })
    }

    /// Writes the grid to a file, as it is.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let copied = py.detach(|| copy(self.grid.path(), self.grid.storage().map(AsRef::as_ref), &path));
        copied.map_err(|error| errors::os(format!("cannot write {}: {error}", path.display())))
    }
}

/// Copies a file, or what is in memory, to a file that gets its name when it is complete.
fn copy(from: &Path, storage: Option<&dyn rayset::storage::Storage>, to: &Path) -> anyhow::Result<()> {
    use std::io::{Read, Write};
    const PIECE: usize = 1 << 20;
    let destination = rayset::output::Destination::new(to)?;
    destination.refuse_inputs([from])?;
    let file = rayset::output::OutputFile::create(&destination)?;
    let mut writer = file.writer();
    let mut piece = vec![0; PIECE];
    if let Some(storage) = storage {
        let (mut at, bytes) = (0_u64, storage.length()?);
        while at < bytes {
            let count = (bytes - at).min(PIECE as u64) as usize;
            storage.read_exact_at(&mut piece[..count], at)?;
            writer.write_all(&piece[..count])?;
            at += count as u64;
        }
    } else {
        let mut from = std::fs::File::open(from)?;
        loop {
            let count = from.read(&mut piece)?;
            if count == 0 {
                break;
            }
            writer.write_all(&piece[..count])?;
        }
    }
    drop(writer);
    Ok(file.publish()?)
}

/// What was opened.
#[derive(IntoPyObject)]
pub(crate) enum AnyFile {
    Cloud(Py<CloudFile>),
    Grid(Py<GridFile>),
    Scene(OsString),
}

/// The package as the host of inputs.
pub(crate) struct Package<'a> {
    pub(crate) remarks: Mutex<Vec<String>>,
    pub(crate) progress: &'a Progress,
    pub(crate) cancel: &'a CancelToken,
    /// Of temporary files.
    pub(crate) folder: Option<PathBuf>,
}

impl Host for Package<'_> {
    fn remark(&self, text: &str) {
        lock(&self.remarks).push(errors::shown(text));
    }

    fn progress(&self, _unit: &'static str, doing: &'static str, done: u64, total: u64) {
        self.progress.set(doing, done, total);
    }

    fn cancel(&self) -> CancelToken {
        self.cancel.clone()
    }

    fn temporary_folder(&self) -> anyhow::Result<Box<dyn rayset_inputs::TemporaryFolder>> {
        let folder = self.folder.clone().unwrap_or_else(std::env::temp_dir);
        Ok(Box::new(OwnFolder::create(&folder, "python")?))
    }

    fn writes(&self, output: &Path, inputs: &[PathBuf]) -> anyhow::Result<()> {
        Ok(rayset::output::Destination::new(output)?.refuse_inputs(inputs)?)
    }
}

/// Opens a scene, a cloud, a grid, or files of points or voxels, which are built into the cache in
/// `cache`, the user's if `None`, or into a temporary file if `keep` is false. Returns what there
/// is to say besides.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "what is opened, where what is built goes, and by what means")]
pub(crate) fn open_files(
    py: Python<'_>,
    paths: Vec<PathBuf>,
    cache: Option<PathBuf>,
    keep: bool,
    columns: Option<Vec<String>>,
    volume_index: Option<u64>,
    temp_dir: Option<PathBuf>,
    memory: u64,
    threads: Option<usize>,
    told: Option<&Bound<'_, PyAny>>,
) -> PyResult<(AnyFile, Vec<String>)> {
    let (cancel, progress) = (CancelToken::new(), Progress::default());
    let cache = if keep { Cache::in_folder(cache) } else { Cache::none() };
    let choices = BuildChoices { columns, volume_index, ..BuildChoices::default() };
    let cache = Cache { choices, ..cache };
    let host = Package { remarks: Mutex::default(), progress: &progress, cancel: &cancel, folder: temp_dir };
    rayset::storage::look_again();
    let work = || rayset_inputs::open(&paths, &cache, Resources { memory, threads, host: &host });
    let opened =
        wait::run(py, &cancel, &progress, told, work)?.map_err(|error| errors::of_input(py, error))?;
    let file = match &opened.input {
        Input::Scene(path) => AnyFile::Scene(path.clone().into()),
        Input::Cloud(cloud) => {
            let file = CloudFile::on_disk(cloud.clone());
            AnyFile::Cloud(Py::new(py, CloudFile { _opened: Some(opened), ..file })?)
        }
        Input::Grid(grid) => {
            let again = py.detach(|| Grid::open(grid.address()));
            let grid = Arc::new(again.map_err(|error| errors::of_open(py, &error))?);
            AnyFile::Grid(Py::new(py, GridFile { _opened: Some(opened), ..GridFile::new(grid) })?)
        }
    };
    let remarks = std::mem::take(&mut *lock(&host.remarks));
    Ok((file, remarks))
}

/// Opens a cloud or a grid whose file is in memory; `None` if the bytes are neither.
#[pyfunction]
pub(crate) fn open_bytes(py: Python<'_>, bytes: &[u8]) -> PyResult<Option<AnyFile>> {
    let is = |kind: FileKind| bytes.starts_with(&kind.magic());
    let wrong = |error: OpenError| errors::of_open(py, &error);
    if is(FileKind::Cloud) {
        let cloud = CloudFile::in_memory(&Cloud::from_bytes(bytes).map_err(wrong)?).map_err(wrong)?;
        return Ok(Some(AnyFile::Cloud(Py::new(py, cloud)?)));
    }
    if is(FileKind::Grid) {
        let grid = Grid::from_bytes(bytes).map_err(wrong)?;
        let grid = match grid.storage() {
            Some(storage) => Grid::from_storage(&memory_name(), storage.clone()).map_err(wrong)?,
            None => grid,
        };
        let file = GridFile { in_memory: true, ..GridFile::new(Arc::new(grid)) };
        return Ok(Some(AnyFile::Grid(Py::new(py, file)?)));
    }
    Ok(None)
}
