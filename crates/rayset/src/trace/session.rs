//! What outlives scenes and pictures: pages in memory, open files, threads.

use std::sync::Arc;
use std::time::Duration;

use super::engine::{Engine, ExecSettings};
use super::predict::Prediction;
use super::prepared::PreparedScene;
use super::sink::Picture;
use super::world::World;
use super::{RenderCounts, RenderError};
use crate::cancel::CancelToken;
use crate::field::SimdLevel;
use crate::scene::{Camera, Node, RenderSettings, Scene, Shape};
use crate::working_set::read::{self, BackendKind, Delayed};
use crate::working_set::{Limits, PagedFiles, Statistics, WorkingSet};

/// Pages in memory within a budget, the files that they come from, and the threads that trace. Cheap to clone.
///
/// Any number of scenes can be prepared and rendered at a time, from any threads.
#[derive(Clone)]
pub struct Session(Arc<Engine>);

impl std::fmt::Debug for Session {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Session").field("threads", &self.0.exec.threads).finish_non_exhaustive()
    }
}

/// Makes a [`Session`].
#[derive(Clone)]
#[must_use]
pub struct SessionBuilder {
    memory_bytes: u64,
    page_limits: Option<Limits>,
    io: BackendKind,
    read_delay: Duration,
    exec: ExecSettings,
}

impl Default for SessionBuilder {
    fn default() -> Self {
        Self {
            memory_bytes: 1 << 30,
            page_limits: None,
            io: BackendKind::Auto,
            read_delay: Duration::ZERO,
            exec: ExecSettings::default(),
        }
    }
}

impl SessionBuilder {
    /// What the session may allocate for everything it does, in bytes: pages, compiled scenes, tables of shadows, scratch
    /// memory of threads. Pictures are the caller's. 1 GiB by default.
    pub fn memory(mut self, bytes: u64) -> Self {
        (self.memory_bytes, self.page_limits) = (bytes, None);
        self
    }

    /// A budget for pages alone, instead of one for everything.
    pub fn page_limits(mut self, limits: Limits) -> Self {
        self.page_limits = Some(limits);
        self
    }

    /// Threads that trace; as many as there are processors by default.
    pub fn threads(mut self, threads: usize) -> Self {
        self.exec.threads = threads.max(1);
        self
    }

    /// How pages are read: io_uring where the system has it, else a pool of threads, by default.
    pub fn io(mut self, kind: BackendKind) -> Self {
        self.io = kind;
        self
    }

    /// Whether files are read past the system's page cache; not by default.
    pub fn direct(mut self, direct: bool) -> Self {
        self.exec.direct = direct;
        self
    }

    /// Adds a time to every read, as a distant disk would.
    pub fn read_delay(mut self, delay: Duration) -> Self {
        self.read_delay = delay;
        self
    }

    /// What brings pages in before they are needed; [`Prediction::Packet`] by default.
    pub fn prediction(mut self, prediction: Prediction) -> Self {
        self.exec.predictor = prediction.predictor();
        self
    }

    /// Vector instructions; the best that the processor has by default. Those with and without fused multiply–add differ
    /// in last bits of a picture.
    pub fn simd(mut self, simd: SimdLevel) -> Self {
        self.exec.simd = simd;
        self
    }

    /// Edge of the tiles of [`View::tiles`](super::View::tiles) in pixels, 1 to 8; 8 by default.
    pub fn tile_pixels(mut self, edge: u32) -> Self {
        self.exec.tile_pixels = edge;
        self
    }

    /// Samples of a ray that are worked on at a time, 1 to 32; 32 by default.
    pub fn slab_samples(mut self, samples: usize) -> Self {
        self.exec.slab_samples = samples;
        self
    }

    /// Starts the threads.
    ///
    /// # Errors
    /// [`RenderError::Setting`] where tiles or slabs are out of range, [`RenderError::Io`] where there is no io_uring and
    /// it was asked for, [`RenderError::Threads`] where the system gives no thread.
    pub fn build(self) -> Result<Session, RenderError> {
        let mut backend = read::backend(self.io).map_err(RenderError::Io)?;
        if !self.read_delay.is_zero() {
            backend = Arc::new(Delayed::new(backend, self.read_delay).map_err(RenderError::Threads)?);
        }
        let name_of_io = format!("{}{}", backend.name(), if self.exec.direct { ", direct" } else { "" });
        let memory_bytes = self.page_limits.is_none().then_some(self.memory_bytes);
        let limits = self.page_limits.unwrap_or_else(|| Limits::total(self.memory_bytes));
        let files = PagedFiles::new(WorkingSet::new(limits, backend));
        Ok(Session(Arc::new(Engine::start(files, self.exec, memory_bytes, name_of_io)?)))
    }
}

impl Session {
    /// Begins with default settings: a gibibyte of memory, all processors.
    pub fn builder() -> SessionBuilder {
        SessionBuilder::default()
    }

    /// Over a working set, and files that are open already.
    ///
    /// # Errors
    /// [`RenderError::Setting`] where tiles or slabs are out of range, [`RenderError::Threads`] where the system gives no
    /// thread.
    #[doc(hidden)]
    pub fn over(files: PagedFiles, exec: ExecSettings) -> Result<Self, RenderError> {
        Ok(Self(Arc::new(Engine::start(files, exec, None, String::new())?)))
    }

    /// Compiles a scene: checks it, opens what files of it are not open yet, and makes everything that does not depend
    /// on the camera. Of `settings`, the size is that of views for which none is given.
    ///
    /// # Errors
    /// [`RenderError`] where the scene or a setting is invalid, or a file does not open.
    pub fn prepare(&self, scene: &Scene, settings: &RenderSettings) -> Result<PreparedScene, RenderError> {
        check(scene, settings)?;
        let mut files = self.0.files();
        files.drop_unused();
        open_all(&scene.root, &mut files, self.0.exec.direct)?;
        let reservation = self.0.reserve(scene, settings)?;
        let world = World::compile(scene, settings, self.0.exec.simd, &files)?;
        Ok(PreparedScene::new(world, *settings, self.0.clone(), reservation))
    }

    /// How pages are read, in words.
    #[must_use]
    pub fn io(&self) -> &str {
        &self.0.name_of_io
    }

    /// What has been read, made and evicted since the session began, or since
    /// [`reset_statistics`](Self::reset_statistics).
    #[must_use]
    pub fn statistics(&self) -> Statistics {
        self.0.pages.statistics()
    }

    /// Counts from zero again; peaks start from what is in memory.
    pub fn reset_statistics(&self) {
        self.0.pages.reset_statistics();
    }

    /// Evicts every page that no render uses at this moment.
    pub fn evict_all(&self) {
        self.0.pages.clear();
    }

    /// Bytes that pages may take at present.
    #[must_use]
    pub fn page_budget_bytes(&self) -> u64 {
        self.0.pages.budget_bytes()
    }

    /// Threads that trace.
    #[must_use]
    pub fn threads(&self) -> usize {
        self.0.exec.threads
    }

    /// Vector instructions in use.
    #[must_use]
    pub fn simd(&self) -> SimdLevel {
        self.0.exec.simd
    }

    /// The pages in memory.
    #[doc(hidden)]
    #[must_use]
    pub fn pages(&self) -> &WorkingSet {
        &self.0.pages
    }

    /// How the work is done.
    #[doc(hidden)]
    #[must_use]
    pub fn exec(&self) -> &ExecSettings {
        &self.0.exec
    }
}

/// One picture, with a session of its own.
///
/// # Errors
/// As [`View::render`](super::View::render).
pub fn render_once(
    scene: &Scene,
    camera: &Camera,
    settings: &RenderSettings,
    exec: &ExecSettings,
    files: &PagedFiles,
) -> Result<(Picture, RenderCounts), RenderError> {
    let view = Session::over(files.clone(), exec.clone())?.prepare(scene, settings)?.view(camera)?;
    let mut picture = Picture::default();
    let counts = view.render_bands(&view.region(), u32::MAX, &CancelToken::new(), &mut picture)?;
    Ok((picture, counts))
}

fn check(scene: &Scene, settings: &RenderSettings) -> Result<(), RenderError> {
    scene.check()?;
    scene.check_step(settings.step)?;
    let wrong = |setting, what: String| Err(RenderError::Setting { setting, what });
    if !(settings.stop_transmittance >= 0.0 && settings.stop_transmittance < 1.0) {
        return wrong("stop transmittance", format!("{} is not in [0, 1)", settings.stop_transmittance));
    }
    if !(1..=64).contains(&settings.samples) {
        return wrong(
            "samples",
            format!("{} is not between 1 and 64 along a side of a pixel", settings.samples),
        );
    }
    Ok(())
}

/// Opens the files of a graph that are not open yet.
fn open_all(root: &Arc<Node>, files: &mut PagedFiles, direct: bool) -> Result<(), RenderError> {
    let mut outcome = Ok(());
    root.for_each(&mut |node| {
        let (opened, path) = match &node.shape {
            Shape::Cloud(object) => (files.open(&object.cloud, direct), object.cloud.path()),
            Shape::Grid(object) => (files.open_grid(&object.grid, direct), object.grid.path()),
            Shape::Procedural(_) | Shape::Operator(..) => return,
        };
        if let (Err(source), true) = (opened, outcome.is_ok()) {
            outcome = Err(RenderError::Open { path: path.to_owned(), source });
        }
    });
    outcome
}
