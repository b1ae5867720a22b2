//! Sessions hold what outlives scenes and pictures: pages in memory, open files, threads.

use std::ops::Range;
use std::sync::Arc;
use std::time::Duration;

use super::engine::{CapMemory, Engine, ExecSettings};
use super::error::FINEST_SHADOWS;
use super::interior;
use super::predict::Prediction;
use super::prepared::PreparedScene;
use super::sink::Picture;
use super::world::World;
use super::{RenderCounts, RenderError, SettingError};
use crate::field::SimdLevel;
use crate::scene::{Camera, Lod, Node, RenderSettings, Samples, Scene, Shadows, Shape};
use rayset_base::cancel::CancelToken;
use rayset_files::PagedFiles;
use rayset_files::octree::Cloud;
use rayset_store::working_set::read::{self, BackendKind, Delayed};
use rayset_store::working_set::{Limits, Statistics, WorkingSet};

/// Pages in memory within a budget, the files that they come from, and the threads that trace.
/// Cheap to clone.
///
/// Any number of scenes can be prepared and rendered at the same time, from any thread.
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
    caps_bytes: u64,
    io: BackendKind,
    read_delay: Duration,
    exec: ExecSettings,
}

impl Default for SessionBuilder {
    fn default() -> Self {
        Self {
            memory_bytes: 1 << 30,
            page_limits: None,
            caps_bytes: u64::MAX,
            io: BackendKind::Auto,
            read_delay: Duration::ZERO,
            exec: ExecSettings::default(),
        }
    }
}

impl SessionBuilder {
    /// Budget for all memory that the session allocates, in bytes: pages, compiled scenes, shadow
    /// tables, scratch memory of threads. Pictures belong to the caller and are not included. 1 GiB
    /// by default.
    pub fn memory(mut self, bytes: u64) -> Self {
        (self.memory_bytes, self.page_limits) = (bytes, None);
        self
    }

    /// A budget for pages alone, instead of one for everything.
    pub fn page_limits(mut self, limits: Limits) -> Self {
        self.page_limits = Some(limits);
        self
    }

    /// Bytes for the caps of a scene, where the budget is for pages alone; without limit by
    /// default.
    #[doc(hidden)]
    pub fn caps_bytes(mut self, bytes: u64) -> Self {
        self.caps_bytes = bytes;
        self
    }

    /// Number of threads that trace rays; the number of processors by default.
    pub fn threads(mut self, threads: usize) -> Self {
        self.exec.threads = threads.max(1);
        self
    }

    /// How pages are read. By default with io_uring if the system has it, otherwise with a pool of
    /// threads.
    pub fn io(mut self, kind: BackendKind) -> Self {
        self.io = kind;
        self
    }

    /// Whether files are read with direct I/O, bypassing the system's page cache; `false` by
    /// default.
    pub fn direct(mut self, direct: bool) -> Self {
        self.exec.direct = direct;
        self
    }

    /// Adds a delay to every read, to simulate slow storage.
    pub fn read_delay(mut self, delay: Duration) -> Self {
        self.read_delay = delay;
        self
    }

    /// How pages are predicted and prefetched before they are needed; [`Prediction::Packet`] by
    /// default.
    pub fn prediction(mut self, prediction: Prediction) -> Self {
        self.exec.predictor = prediction.predictor();
        self
    }

    /// Vector instruction set; the best that the processor has by default. Pictures with and
    /// without fused multiply–add differ in the last bits.
    pub fn simd(mut self, simd: SimdLevel) -> Self {
        self.exec.simd = simd;
        self
    }

    /// Edge of the tiles of [`View::tiles`](super::View::tiles) in pixels, 1 to 8; 8 by default.
    pub fn tile_pixels(mut self, edge: u32) -> Self {
        self.exec.tile_pixels = edge;
        self
    }

    /// Samples of a ray in a slab, which are evaluated together, 1 to 32; 32 by default.
    pub fn slab_samples(mut self, samples: usize) -> Self {
        self.exec.slab_samples = samples;
        self
    }

    /// A render that lasts longer than this traces a hundredth of its picture beforehand, so that
    /// the progress that it tells is that of its time; by default, none does. What is traced for
    /// that appears in the statistics of pages, and nowhere else.
    pub fn estimates_after(mut self, after: Duration) -> Self {
        self.exec.estimates_after = Some(after);
        self
    }

    /// Creates the session and starts its threads.
    ///
    /// # Errors
    /// [`RenderError::Setting`] if the size of tiles or slabs or the number of threads is out of
    /// range, [`RenderError::Io`] if io_uring is requested but not available,
    /// [`RenderError::Threads`] if the system cannot start a thread.
    pub fn build(self) -> Result<Session, RenderError> {
        let mut backend = read::backend(self.io).map_err(RenderError::Io)?;
        if !self.read_delay.is_zero() {
            backend = Arc::new(Delayed::new(backend, self.read_delay).map_err(RenderError::Threads)?);
        }
        let name_of_io = format!("{}{}", backend.name(), if self.exec.direct { ", direct" } else { "" });
        let memory_bytes = self.page_limits.is_none().then_some(self.memory_bytes);
        let limits = self.page_limits.unwrap_or_else(|| Limits::total(self.memory_bytes));
        let files = PagedFiles::new(WorkingSet::new(limits, backend));
        let engine = Engine::start(files, self.exec, memory_bytes, name_of_io)?;
        Ok(Session(Arc::new(engine.with_caps_bytes(self.caps_bytes))))
    }
}

impl Session {
    /// A builder with default settings: 1 GiB of memory and as many threads as processors.
    pub fn builder() -> SessionBuilder {
        SessionBuilder::default()
    }

    /// Creates a session over a working set and files that are already open.
    ///
    /// # Errors
    /// [`RenderError::Setting`] if the size of tiles or slabs or the number of threads is out of
    /// range, [`RenderError::Threads`] if the system cannot start a thread.
    #[doc(hidden)]
    pub fn over(files: PagedFiles, exec: ExecSettings) -> Result<Self, RenderError> {
        Ok(Self(Arc::new(Engine::start(files, exec, None, String::new())?)))
    }

    /// Compiles a scene: checks it, opens those of its files that are not open yet, and prepares
    /// everything that does not depend on the camera. The size in `settings` is the default for
    /// views. A scene with caps takes about as long as a picture; [`PreparedScene::remarks`] says
    /// which of them were left out.
    ///
    /// # Errors
    /// [`RenderError`] if the scene or a setting is invalid, a file cannot be opened, or the
    /// session's memory is too small.
    pub fn prepare(&self, scene: &Scene, settings: &RenderSettings) -> Result<PreparedScene, RenderError> {
        check(scene, settings)?;
        let files = {
            let mut files = self.0.files();
            files.drop_unused();
            open_all(&scene.root, &mut files, self.0.exec.direct)?;
            // Others may prepare their scenes meanwhile: caps take a while.
            files.clone()
        };
        let reservation = self.0.reserve(scene, settings)?;
        let memory = CapMemory { engine: &self.0, reservation: reservation.as_ref() };
        let (capped, remarks) = interior::with_caps(scene, settings, &files, &memory)?;
        let world = World::compile(&capped, settings, self.0.exec.simd, &files)?;
        let remarks = remarks.into_iter().chain(world.program.seen_whole()).collect();
        Ok(PreparedScene::new(scene.clone(), world, *settings, self.0.clone(), reservation, remarks))
    }

    /// How pages are read, as text.
    #[must_use]
    pub fn io(&self) -> &str {
        &self.0.name_of_io
    }

    /// Of the latest render that has lasted long enough to look about for what it costs (see
    /// [`SessionBuilder::estimates_after`]), the share of its time that one ray through the middle
    /// of each pixel takes, 0 to 1.
    #[must_use]
    pub fn share_of_one_ray(&self) -> Option<f64> {
        self.0.share_of_one_ray()
    }

    /// Statistics of the pages read, computed and evicted since the session was created, or since
    /// [`reset_statistics`](Self::reset_statistics).
    #[must_use]
    pub fn statistics(&self) -> Statistics {
        self.0.pages.statistics()
    }

    /// Resets the counts to zero; peaks start from what is now in memory.
    pub fn reset_statistics(&self) {
        self.0.pages.reset_statistics();
    }

    /// Evicts every page that is not retained by a render.
    pub fn evict_all(&self) {
        self.0.pages.clear();
    }

    /// The current budget for pages, in bytes.
    #[must_use]
    pub fn page_budget_bytes(&self) -> u64 {
        self.0.pages.budget_bytes()
    }

    /// How many of some of a cloud's point pages are in memory. The cloud is one of a scene that
    /// has been prepared; of others, none are.
    #[must_use]
    pub fn resident_pages(&self, cloud: &Arc<Cloud>, pages: Range<u32>) -> u32 {
        let object = self.0.files().find(cloud).cloned();
        object.map_or(0, |object| pages.filter(|&page| object.is_resident(page)).count() as u32)
    }

    /// Keeps pages of a cloud's octree in memory for as long as the session lives, those nearest to
    /// the root first, up to `most_bytes` of them: however the camera jumps, what rays meet first
    /// need not be read again. The cloud is one of a scene that has been prepared. Returns the
    /// bytes that are kept; pages that were kept before stay.
    ///
    /// # Errors
    /// [`RenderError::Page`] if a page cannot be read, or there is no room for it.
    pub fn pin_nodes(&self, cloud: &Arc<Cloud>, most_bytes: u64) -> Result<u64, RenderError> {
        let Some(object) = self.0.files().find(cloud).cloned() else { return Ok(0) };
        let header = cloud.header();
        let wanted = (most_bytes / u64::from(header.page_bytes)).min(u64::from(header.node_pages)) as u32;
        let client = self.0.pages.client(&CancelToken::new());
        let mut pinned = self.0.pinned();
        if !pinned.iter().any(|(known, _)| Arc::ptr_eq(known, cloud.stored())) {
            // Children are written before their parents: the root is in the last page of nodes.
            let last = header.point_pages + header.node_pages;
            let guards = (last - wanted..last).rev().map(|page| client.retain(&object, page));
            pinned.push((cloud.stored().clone(), guards.collect::<Result<_, _>>()?));
        }
        let kept = pinned
            .iter()
            .find(|(known, _)| Arc::ptr_eq(known, cloud.stored()))
            .map_or(0, |(_, guards)| guards.len());
        Ok(kept as u64 * u64::from(header.page_bytes))
    }

    /// The configured number of threads that trace rays.
    #[must_use]
    pub fn threads(&self) -> usize {
        self.0.exec.threads
    }

    /// The vector instruction set in use.
    #[must_use]
    pub fn simd(&self) -> SimdLevel {
        self.0.exec.simd
    }

    /// What threads have done besides tracing since the session was created: how often they waited
    /// for a lock, joined a render, and were woken.
    #[cfg(feature = "internals")]
    #[doc(hidden)]
    #[must_use]
    pub fn serial_work(&self) -> [u64; 3] {
        let tally = self.0.scheduler.tally();
        let pages = self.0.pages.lock_waits();
        let [lock_waits, joined, woken] = [&tally.lock_waits, &tally.joined, &tally.woken]
            .map(|count| count.load(rayset_base::sync::atomic::Ordering::Relaxed));
        [lock_waits + pages, joined, woken]
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

/// Renders one picture in a session of its own.
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
    scene.check_compositing(settings)?;
    if !(settings.stop_transmittance >= 0.0 && settings.stop_transmittance < 1.0) {
        return Err(SettingError::StopTransmittance(settings.stop_transmittance).into());
    }
    check_samples(settings.samples)?;
    if let Shadows::Cached { resolution } = settings.shadows
        && !(1..=FINEST_SHADOWS).contains(&resolution)
    {
        return Err(SettingError::Shadows(resolution).into());
    }
    if !(8..=1024).contains(&settings.cap_resolution) {
        return Err(SettingError::CapResolution(settings.cap_resolution).into());
    }
    if let Lod::Footprint(factor) | Lod::Coarse(factor) = settings.lod
        && Lod::footprint(factor.into()).is_none()
    {
        return Err(SettingError::Lod(factor).into());
    }
    if !(0.0..=4.0).contains(&settings.ambient_occlusion) {
        return Err(SettingError::AmbientOcclusion(settings.ambient_occlusion).into());
    }
    Ok(())
}

/// Refuses numbers of rays along a side of a pixel that are out of range.
pub(super) fn check_samples(samples: Samples) -> Result<(), RenderError> {
    let side = samples.along_a_side();
    if (1..=64).contains(&side) { Ok(()) } else { Err(SettingError::Samples(side).into()) }
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
