//! What outlives scenes and pictures: pages in memory, open files, threads.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use super::job::Job;
use super::memory::{self, SceneNeeds};
use super::predict::{self, Prediction, Predictor};
use super::prepared::PreparedScene;
use super::scheduler::{Scheduled, Scheduler};
use super::sink::Picture;
use super::view::MAX_TILE_PIXELS;
use super::world::World;
use super::{RenderCounts, RenderError};
use crate::cancel::CancelToken;
use crate::field::{SLAB_SAMPLES, SimdLevel};
use crate::scene::{Camera, Node, RenderSettings, Scene, Shape};
use crate::working_set::read::{self, BackendKind, Delayed};
use crate::working_set::{Kind, Limits, PagedFiles, Statistics, WorkingSet};

/// More threads than any machine has processors.
const MOST_THREADS: usize = 4096;

/// How the work is done. Nothing here can change a pixel, but for vector instructions with and without fused
/// multiply–add.
#[derive(Clone)]
pub struct ExecSettings {
    /// Threads that trace.
    pub threads: usize,
    /// What brings pages in before they are needed.
    pub predictor: Arc<dyn Predictor>,
    /// Vector instructions. Those with and without fused multiply–add differ in last bits.
    pub simd: SimdLevel,
    /// Edge of a tile in pixels, 1 to 8.
    pub tile_pixels: u32,
    /// Samples worked on at a time, 1 to 32.
    pub slab_samples: usize,
    /// Whether files are read past the system's page cache.
    pub direct: bool,
}

impl Default for ExecSettings {
    fn default() -> Self {
        Self {
            threads: std::thread::available_parallelism().map_or(1, usize::from),
            predictor: Arc::new(predict::PacketPredictor::default()),
            simd: SimdLevel::default(),
            tile_pixels: MAX_TILE_PIXELS,
            slab_samples: SLAB_SAMPLES,
            direct: false,
        }
    }
}

/// Pages in memory within a budget, the files that they come from, and the threads that trace. Cheap to clone.
///
/// Any number of scenes can be prepared and rendered at a time, from any threads.
#[derive(Clone)]
pub struct Session(Arc<Inner>);

struct Inner {
    files: Mutex<PagedFiles>,
    pages: WorkingSet,
    exec: ExecSettings,
    /// `None` where the budget is for pages alone, and fixed.
    memory: Option<Mutex<Memory>>,
    name_of_io: String,
    // Last: its threads end when it goes.
    scheduler: Scheduler,
}

impl std::fmt::Debug for Session {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Session").field("threads", &self.0.exec.threads).finish_non_exhaustive()
    }
}

/// Memory of a session as a whole, divided between prepared scenes and pages.
#[derive(Debug)]
struct Memory {
    total: u64,
    /// What each prepared scene needs besides pages.
    scenes: Vec<(u64, SceneNeeds)>,
    last: u64,
}

/// A prepared scene's part of the memory of its session; given back when it is dropped.
pub(super) struct Reservation {
    session: Session,
    number: u64,
}

impl Drop for Reservation {
    fn drop(&mut self) {
        if let Some(memory) = &self.session.0.memory {
            let mut memory = memory.lock().unwrap_or_else(PoisonError::into_inner);
            memory.scenes.retain(|(number, _)| *number != self.number);
            self.session.divide(&memory);
        }
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
        let memory = match self.page_limits {
            Some(_) => None,
            None => Some(Mutex::new(Memory { total: self.memory_bytes, scenes: Vec::new(), last: 0 })),
        };
        let limits = self.page_limits.unwrap_or_else(|| Limits::total(self.memory_bytes));
        let files = PagedFiles::new(WorkingSet::new(limits, backend));
        Session::with(files, self.exec, memory, name_of_io)
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
        Self::with(files, exec, None, String::new())
    }

    fn with(
        files: PagedFiles,
        exec: ExecSettings,
        memory: Option<Mutex<Memory>>,
        name_of_io: String,
    ) -> Result<Self, RenderError> {
        if !(1..=MAX_TILE_PIXELS).contains(&exec.tile_pixels)
            || !(1..=SLAB_SAMPLES).contains(&exec.slab_samples)
        {
            let what = "tiles have edges of 1 to 8 pixels, slabs 1 to 32 samples".into();
            return Err(RenderError::Setting { setting: "tile or slab", what });
        }
        if exec.threads > MOST_THREADS {
            let what = format!("{} are more than {MOST_THREADS}", exec.threads);
            return Err(RenderError::Setting { setting: "threads", what });
        }
        let scheduler = Scheduler::start(exec.threads.max(1)).map_err(RenderError::Threads)?;
        let pages = files.pages.clone();
        let files = Mutex::new(files);
        Ok(Self(Arc::new(Inner { files, pages, exec, memory, name_of_io, scheduler })))
    }

    /// Compiles a scene: checks it, opens what files of it are not open yet, and makes everything that does not depend
    /// on the camera. Of `settings`, the size is that of views for which none is given.
    ///
    /// # Errors
    /// [`RenderError`] where the scene or a setting is invalid, or a file does not open.
    pub fn prepare(&self, scene: &Scene, settings: &RenderSettings) -> Result<PreparedScene, RenderError> {
        check(scene, settings)?;
        let mut files = self.files();
        files.drop_unused();
        open_all(&scene.root, &mut files, self.0.exec.direct)?;
        let reservation = self.reserve(scene, settings)?;
        let world = World::compile(scene, settings, self.0.exec.simd, &files)?;
        Ok(PreparedScene::new(world, *settings, self.clone(), reservation))
    }

    /// Sets memory aside for a scene, and divides the rest among pages anew.
    fn reserve(&self, scene: &Scene, settings: &RenderSettings) -> Result<Option<Reservation>, RenderError> {
        let Some(memory) = &self.0.memory else { return Ok(None) };
        let mut memory = memory.lock().unwrap_or_else(PoisonError::into_inner);
        memory.last += 1;
        let number = memory.last;
        memory.scenes.push((number, SceneNeeds::of(scene, settings)));
        let needs: Vec<&SceneNeeds> = memory.scenes.iter().map(|(_, needs)| needs).collect();
        if let Err(needed) = memory::divide(&needs, self.0.exec.threads, memory.total) {
            memory.scenes.pop();
            return Err(RenderError::Memory { given: memory.total, needed });
        }
        self.divide(&memory);
        Ok(Some(Reservation { session: self.clone(), number }))
    }

    /// Gives pages what scenes leave.
    fn divide(&self, memory: &Memory) {
        let needs: Vec<&SceneNeeds> = memory.scenes.iter().map(|(_, needs)| needs).collect();
        if let Ok((page_bytes, shadow_bytes)) = memory::divide(&needs, self.0.exec.threads, memory.total) {
            self.0.pages.set_limits(Limits::total(page_bytes).with_kind(Kind::Shadows, shadow_bytes));
        }
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

    fn files(&self) -> MutexGuard<'_, PagedFiles> {
        self.0.files.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Has the threads work on a render until what this returns is dropped.
    pub(super) fn schedule(&self, job: &Arc<Job>) -> Scheduled<'_> {
        self.0.scheduler.add(job)
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
