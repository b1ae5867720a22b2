//! Sessions, and the pictures that they render: whole, or coarse first and then finer.

use std::path::PathBuf;
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;

use pyo3::prelude::*;
use pyo3::types::PyDict;
use rayset::image::Band;
use rayset::memory::Kind as PageKind;
use rayset::parts::PartError;
use rayset::scene::{Camera, Samples};
use rayset::scene_file::{SceneFile, SceneFileError};
use rayset::storage;
use rayset::{
    BandSink, CancelToken, Cloud, Grid, ParseError, PreparedScene, Region, RenderError, SimdLevel, SinkError,
    View,
};
use rayset_inputs::Pixels;

use crate::errors::{self, Kind};
use crate::files::{CloudFile, GridFile};
use crate::image::{self, Picture};
use crate::remote::RemoteFiles;
use crate::room::TooLarge;
use crate::wait::{self, Closing, Mailbox, PATIENCE, Progress, Waited, lock};

/// Bytes of a band, about: what is held of a picture besides the picture itself.
const BAND_BYTES: u32 = 8 << 20;
/// Bytes of a pixel with its layers.
pub(crate) const PIXEL_BYTES: u64 = 64;

/// The pages, threads and tables of renders.
#[pyclass(frozen, module = "rayset._native")]
pub(crate) struct Session {
    open: Mutex<Option<Open>>,
    /// Threads do not survive a fork.
    process: u32,
}

struct Open {
    session: rayset::Session,
    last: Option<Last>,
}

/// The last scene.
#[derive(Clone)]
struct Last {
    /// What it was compiled of.
    key: String,
    prepared: PreparedScene,
    /// What it has open of objects that are remote.
    remote: RemoteFiles,
}

/// What is to be rendered: a scene as JSON, what distinguishes it but for its camera, the folder
/// that its paths are relative to, and the clouds and grids that it knows by their names.
#[derive(FromPyObject)]
pub(crate) struct Job {
    #[pyo3(item)]
    scene: String,
    #[pyo3(item)]
    key: String,
    #[pyo3(item)]
    folder: PathBuf,
    #[pyo3(item)]
    clouds: Vec<Py<CloudFile>>,
    #[pyo3(item)]
    grids: Vec<Py<GridFile>>,
    /// Left, top, width and height of a part.
    #[pyo3(item)]
    crop: Option<[u32; 4]>,
    #[pyo3(item)]
    layers: bool,
}

/// The same without Python.
pub(crate) struct Wanted {
    scene: String,
    key: String,
    folder: PathBuf,
    clouds: Vec<Arc<Cloud>>,
    grids: Vec<Arc<Grid>>,
    crop: Option<[u32; 4]>,
    layers: bool,
}

/// Why there is no picture.
pub(crate) enum Failure {
    Scene(Box<SceneFileError>),
    Render(RenderError),
    Part(PartError),
    Crop(String),
    TooLarge(TooLarge),
}

impl From<TooLarge> for Failure {
    fn from(error: TooLarge) -> Self {
        Self::TooLarge(error)
    }
}

impl From<RenderError> for Failure {
    fn from(error: RenderError) -> Self {
        Self::Render(error)
    }
}

impl From<PartError> for Failure {
    fn from(error: PartError) -> Self {
        Self::Part(error)
    }
}

pub(crate) fn raised(py: Python<'_>, failure: Failure) -> PyErr {
    match failure {
        Failure::Scene(error) => errors::of_scene(py, &error),
        Failure::Render(error) => errors::of_render(py, error),
        Failure::Part(error) => errors::of_part(py, error),
        Failure::Crop(words) => errors::value(words),
        Failure::TooLarge(error) => error.into(),
    }
}

impl Job {
    pub(crate) fn without_python(self) -> Wanted {
        Wanted {
            clouds: self.clouds.iter().map(|file| file.get().cloud.clone()).collect(),
            grids: self.grids.iter().map(|file| file.get().grid.clone()).collect(),
            scene: self.scene,
            key: self.key,
            folder: self.folder,
            crop: self.crop,
            layers: self.layers,
        }
    }
}

impl Wanted {
    /// Reads the scene, and opens the files that are not open.
    pub(crate) fn parsed(&self) -> Result<SceneFile, Failure> {
        self.parsed_using(RemoteFiles::default())
    }

    /// The same, with remote files that are open, as far as they are still what is at their
    /// addresses.
    fn parsed_using(&self, remote: RemoteFiles) -> Result<SceneFile, Failure> {
        let path = self.folder.join("scene");
        let (mut clouds, mut grids) = remote.current();
        // The caller's own come before others of their names.
        clouds.extend_from_slice(&self.clouds);
        grids.extend_from_slice(&self.grids);
        let file = SceneFile::parse_using(&path, &self.scene, &clouds, &grids);
        file.map_err(|error| Failure::Scene(Box::new(error)))
    }
}

/// A scene that is compiled and seen from somewhere.
pub(crate) struct Shot {
    prepared: PreparedScene,
    camera: Camera,
    pub(crate) pixels: Pixels,
    size: (u32, u32),
    samples: Samples,
    pub(crate) region: Region,
    has_layers: bool,
}

impl Shot {
    pub(crate) fn view(&self) -> Result<View, RenderError> {
        self.prepared.view(&self.camera)
    }

    /// The same as a smaller picture of one ray a pixel, each of which stands for a square of
    /// pixels with this edge: its view and region.
    pub(crate) fn coarse(&self, edge: u32) -> Result<(View, Region), RenderError> {
        let (width, height) = self.size;
        let (small_width, small_height) = (width.div_ceil(edge), height.div_ceil(edge));
        let view = self.prepared.view_of_size(&self.camera, small_width, small_height)?.with_samples(1)?;
        let Region { columns, rows } = &self.region;
        let part = Region {
            columns: columns.start / edge..columns.end.div_ceil(edge),
            rows: rows.start / edge..rows.end.div_ceil(edge),
        };
        Ok((view, part))
    }

    fn picture(
        &self,
        view: &View,
        region: &Region,
        cancel: &CancelToken,
        progress: &Progress,
    ) -> Result<Picture, Failure> {
        let rows = (BAND_BYTES / PIXEL_BYTES as u32 / (region.columns.len() as u32).max(1)).max(32);
        let picture = image::empty(region.columns.len() as u32, region.rows.len() as u32, self.has_layers)?;
        let mut sink = Told { picture, progress };
        view.render_bands(region, rows, cancel, &mut sink)?;
        Ok(Picture {
            picture: sink.picture,
            pixels: self.pixels,
            corner: (region.columns.start, region.rows.start),
            whole: self.size,
        })
    }
}

/// A picture that says how far it is.
struct Told<'a> {
    picture: rayset::Picture,
    progress: &'a Progress,
}

impl BandSink for Told<'_> {
    fn band(&mut self, band: &Band) -> Result<(), SinkError> {
        self.picture.band(band)
    }

    fn progress(&mut self, done: u64, total: u64) {
        self.progress.set("tracing", done, total);
    }
}

impl Session {
    /// The engine, if it can be used: `None` after `close`.
    pub(crate) fn engine(&self, py: Python<'_>) -> PyResult<rayset::Session> {
        if self.process != std::process::id() {
            return Err(errors::error(
                py,
                Kind::Render,
                "this process was forked after the session was made, and has none of its threads; make another \
                 session in the child, or start processes by multiprocessing's \"spawn\"",
            ));
        }
        let open = lock(&self.open);
        open.as_ref().map(|open| open.session.clone()).ok_or_else(|| {
            errors::error(py, Kind::Render, "this session is closed; make another, or leave out session=")
        })
    }

    /// Compiles a scene, unless it is the last one seen from elsewhere.
    pub(crate) fn shot(&self, engine: &rayset::Session, wanted: &Wanted) -> Result<Shot, Failure> {
        let last = lock(&self.open).as_ref().and_then(|open| open.last.clone());
        // Of a scene that names no address nobody is asked.
        let names_some = wanted.scene.contains("://") || storage::address_of(&wanted.folder).is_some();
        let remote = last
            .as_ref()
            .filter(|_| names_some)
            .map_or_else(RemoteFiles::default, |last| last.remote.clone());
        let mut file = wanted.parsed_using(remote)?;
        file.settings.layers = wanted.layers;
        let remote = RemoteFiles::of(&file.scene.root);
        let key = format!("{} {} {}", wanted.key, wanted.layers, remote.text());
        let prepared = match last.filter(|last| last.key == key) {
            Some(last) => last.prepared,
            None => {
                let prepared = engine.prepare(&file.scene, &file.settings)?;
                if let Some(open) = &mut *lock(&self.open) {
                    open.last = Some(Last { key, prepared: prepared.clone(), remote });
                }
                prepared
            }
        };
        let size = (file.settings.width, file.settings.height);
        Ok(Shot {
            prepared,
            camera: file.camera,
            pixels: Pixels { display_transform: file.display_transform, compositing: file.scene.compositing },
            size,
            samples: file.settings.samples,
            region: region(wanted.crop, size)?,
            has_layers: wanted.layers,
        })
    }
}

fn region(crop: Option<[u32; 4]>, (width, height): (u32, u32)) -> Result<Region, Failure> {
    let [x, y, w, h] = crop.unwrap_or([0, 0, width, height]);
    let (right, bottom) = (x.saturating_add(w), y.saturating_add(h));
    if w == 0 || h == 0 || right > width || bottom > height {
        let words =
            format!("crop=({x}, {y}, {w}, {h}) does not lie within the picture of {width} by {height}");
        return Err(Failure::Crop(words));
    }
    Ok(Region { columns: x..right, rows: y..bottom })
}

#[pymethods]
impl Session {
    /// `memory` bounds what it allocates, in bytes. `simd` is the class of vector instructions, by
    /// default the best.
    #[new]
    #[pyo3(signature = (memory, threads, simd = None))]
    fn new(
        py: Python<'_>,
        memory: Option<u64>,
        threads: Option<usize>,
        simd: Option<&str>,
    ) -> PyResult<Self> {
        let mut builder = rayset::Session::builder();
        if let Some(memory) = memory {
            builder = builder.memory(memory);
        }
        if let Some(threads) = threads {
            builder = builder.threads(threads);
        }
        if let Some(simd) = simd {
            let level: SimdLevel =
                simd.parse().map_err(|error: ParseError| errors::value(error.to_string()))?;
            builder = builder.simd(level);
        }
        let session = py.detach(|| builder.build()).map_err(|error| errors::of_render(py, error))?;
        Ok(Self { open: Mutex::new(Some(Open { session, last: None })), process: std::process::id() })
    }

    /// Renders a picture.
    fn render(&self, py: Python<'_>, job: Job, told: Option<&Bound<'_, PyAny>>) -> PyResult<Picture> {
        let engine = self.engine(py)?;
        let wanted = job.without_python();
        let (cancel, progress) = (CancelToken::new(), Progress::default());
        let work = || {
            storage::look_again();
            let shot = self.shot(&engine, &wanted)?;
            shot.picture(&shot.view()?, &shot.region, &cancel, &progress)
        };
        wait::run(py, &cancel, &progress, told, work)?.map_err(|failure| raised(py, failure))
    }

    /// Begins to render a picture, coarse first: each step is a picture of the whole size.
    fn begin(slf: &Bound<'_, Self>, job: Job) -> PyResult<Passes> {
        let py = slf.py();
        let engine = slf.get().engine(py)?;
        Passes::begin(slf.clone().unbind(), engine, job.without_python())
    }

    /// Remarks on the scene that was compiled last: caps that were left out.
    fn remarks(&self) -> Vec<String> {
        let open = lock(&self.open);
        let last = open.as_ref().and_then(|open| open.last.as_ref());
        last.map_or_else(Vec::new, |last| last.prepared.remarks().iter().map(ToString::to_string).collect())
    }

    /// What the working set has done since the session was made or this was asked with `reset`.
    fn statistics<'py>(&self, py: Python<'py>, reset: bool) -> PyResult<Bound<'py, PyDict>> {
        let engine = self.engine(py)?;
        let all = PyDict::new(py);
        let statistics = engine.statistics();
        all.set_item("budget_bytes", engine.page_budget_bytes())?;
        all.set_item("threads", engine.threads())?;
        for kind in PageKind::ALL {
            let of_kind = statistics.kind(*kind);
            let one = PyDict::new(py);
            one.set_item("hits", of_kind.hits)?;
            one.set_item("misses", of_kind.misses)?;
            one.set_item("bytes_read", of_kind.bytes_read)?;
            one.set_item("evictions", of_kind.evictions)?;
            one.set_item("resident_bytes", of_kind.resident_bytes)?;
            all.set_item(format!("{kind:?}").to_lowercase(), one)?;
        }
        if reset {
            engine.reset_statistics();
        }
        Ok(all)
    }

    /// Gives back all memory and threads, when what is being rendered has ended.
    fn close(&self, py: Python<'_>) {
        let open = lock(&self.open).take();
        if self.process == std::process::id() {
            py.detach(|| drop(open));
        } else {
            // Its threads are not here to be waited for.
            std::mem::forget(open);
        }
    }

    #[getter]
    fn closed(&self) -> bool {
        lock(&self.open).is_none()
    }
}

impl Drop for Session {
    fn drop(&mut self) {
        if self.process != std::process::id() {
            std::mem::forget(lock(&self.open).take());
        }
    }
}

/// A picture that is rendered coarse first, by a thread that goes on until this is dropped.
#[pyclass(frozen, module = "rayset._native")]
pub(crate) struct Passes {
    finished: Arc<Mailbox<Result<Picture, Failure>>>,
    thread: Mutex<Option<JoinHandle<()>>>,
    cancel: CancelToken,
}

/// Edges of pixels of the coarse pictures, and whether each pixel has one ray.
const STEPS: [(u32, bool); 4] = [(8, true), (3, true), (1, true), (1, false)];

impl Passes {
    fn begin(session: Py<Session>, engine: rayset::Session, wanted: Wanted) -> PyResult<Self> {
        let cancel = CancelToken::new();
        let finished = Arc::new(Mailbox::new());
        let (stop, done) = (cancel.clone(), finished.clone());
        let work = move || {
            let _closing = Closing(&done);
            storage::look_again();
            let shot = match session.get().shot(&engine, &wanted) {
                Ok(shot) => shot,
                Err(failure) => return done.put(Err(failure)),
            };
            for step in STEPS {
                match coarse(&shot, step, &stop) {
                    Ok(Some(picture)) => done.put(Ok(picture)),
                    Ok(None) => {}
                    Err(failure) => return done.put(Err(failure)),
                }
            }
        };
        let thread = std::thread::Builder::new().name("rayset-passes".into()).spawn(work);
        let thread = thread.map_err(|error| errors::os(format!("cannot start a thread: {error}")))?;
        Ok(Self { finished, thread: Mutex::new(Some(thread)), cancel })
    }

    /// Ends the thread, and waits for it.
    fn end(&self, py: Python<'_>) {
        self.cancel.cancel();
        let thread = lock(&self.thread).take();
        py.detach(|| thread.map(JoinHandle::join));
    }
}

/// A picture of one of the steps; `None` if it would be like the next.
fn coarse(
    shot: &Shot,
    (edge, one_ray): (u32, bool),
    cancel: &CancelToken,
) -> Result<Option<Picture>, Failure> {
    if edge == 1 && one_ray && shot.samples == Samples::Fixed(1) {
        return Ok(None);
    }
    let progress = Progress::default();
    if edge == 1 {
        let view = if one_ray { shot.view()?.with_samples(1)? } else { shot.view()? };
        return shot.picture(&view, &shot.region, cancel, &progress).map(Some);
    }
    let (view, part) = shot.coarse(edge)?;
    let picture = shot.picture(&view, &part, cancel, &progress)?;
    let Region { columns, rows } = &shot.region;
    let enlarged = picture.enlarged(columns.len() as u32, rows.len() as u32)?;
    Ok(Some(Picture { corner: (columns.start, rows.start), whole: shot.size, ..enlarged }))
}

#[pymethods]
impl Passes {
    fn __iter__(slf: PyRef<'_, Self>) -> PyRef<'_, Self> {
        slf
    }

    fn __next__(&self, py: Python<'_>) -> PyResult<Option<Picture>> {
        loop {
            if self.cancel.is_cancelled() {
                return Ok(None);
            }
            match py.detach(|| self.finished.wait(PATIENCE)) {
                Waited::Letter(Ok(picture)) => return Ok(Some(picture)),
                Waited::Letter(Err(failure)) => {
                    self.end(py);
                    return Err(raised(py, failure));
                }
                Waited::Closed => {
                    self.end(py);
                    return Ok(None);
                }
                Waited::NotYet => {
                    if let Err(error) = py.check_signals() {
                        self.end(py);
                        return Err(error);
                    }
                }
            }
        }
    }

    /// Stops what is left.
    fn close(&self, py: Python<'_>) {
        self.end(py);
    }
}

impl Drop for Passes {
    fn drop(&mut self) {
        self.cancel.cancel();
        let thread = lock(&self.thread).take();
        Python::attach(|py| py.detach(|| thread.map(JoinHandle::join)));
    }
}
