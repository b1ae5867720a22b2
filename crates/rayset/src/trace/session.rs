//! What outlives scenes and pictures: pages in memory, open files, threads.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::job::Job;
use super::predict::{self, Predictor};
use super::prepared::PreparedScene;
use super::scheduler::{Scheduled, Scheduler};
use super::sink::Picture;
use super::view::MAX_TILE_PIXELS;
use super::world::World;
use super::{RenderCounts, RenderError};
use crate::cancel::CancelToken;
use crate::field::{SLAB_SAMPLES, SimdLevel};
use crate::scene::{Camera, Node, RenderSettings, Scene, Shape};
use crate::working_set::{PagedFiles, WorkingSet};

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
    // Last: its threads end when it goes.
    scheduler: Scheduler,
}

impl std::fmt::Debug for Session {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Session").field("threads", &self.0.exec.threads).finish_non_exhaustive()
    }
}

impl Session {
    /// Over a working set, and files that are open already.
    ///
    /// # Errors
    /// [`RenderError::Setting`] where tiles or slabs are out of range, [`RenderError::Threads`] where the system gives no
    /// thread.
    pub fn over(files: PagedFiles, exec: ExecSettings) -> Result<Self, RenderError> {
        if !(1..=MAX_TILE_PIXELS).contains(&exec.tile_pixels)
            || !(1..=SLAB_SAMPLES).contains(&exec.slab_samples)
        {
            let what = "tiles have edges of 1 to 8 pixels, slabs 1 to 32 samples".into();
            return Err(RenderError::Setting { setting: "tile or slab", what });
        }
        let scheduler = Scheduler::start(exec.threads.max(1)).map_err(RenderError::Threads)?;
        let pages = files.pages.clone();
        Ok(Self(Arc::new(Inner { files: Mutex::new(files), pages, exec, scheduler })))
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
        let world = World::compile(scene, settings, self.0.exec.simd, &files)?;
        Ok(PreparedScene::new(world, *settings, self.clone()))
    }

    /// The pages in memory.
    #[must_use]
    pub fn pages(&self) -> &WorkingSet {
        &self.0.pages
    }

    /// How the work is done.
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
