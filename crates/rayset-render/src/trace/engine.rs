//! What a session consists of: pages in memory, open files, threads, and the memory that scenes and
//! pages share.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use super::error::MOST_THREADS;
use super::memory::{self, SceneNeeds};
use super::predict::{self, Predictor};
use super::scheduler::Scheduler;
use super::work::MAX_TILE_PIXELS;
use super::{RenderError, SettingError};
use crate::field::{SLAB_SAMPLES, SimdLevel};
use crate::scene::{RenderSettings, Scene};
use rayset_files::PagedFiles;
use rayset_files::octree::Cloud;
use rayset_store::working_set::{Kind, Limits, PageGuard, WorkingSet};

/// How the work is done. Nothing here changes a pixel, except that vector instructions with and
/// without fused multiply–add differ in the last bits.
#[derive(Clone)]
pub struct ExecSettings {
    /// Number of threads that trace rays.
    pub threads: usize,
    /// Predicts the pages that will be needed, and prefetches them.
    pub predictor: Arc<dyn Predictor>,
    /// Vector instruction set. Pictures with and without fused multiply–add differ in the last
    /// bits.
    pub simd: SimdLevel,
    /// Edge of a tile in pixels, 1 to 8.
    pub tile_pixels: u32,
    /// Samples of a ray in a slab, 1 to 32.
    pub slab_samples: usize,
    /// How long a render lasts before it looks about for what the rest of it costs, if it does.
    pub estimates_after: Option<Duration>,
    /// Whether files are read with direct I/O, bypassing the system's page cache.
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
            estimates_after: None,
            direct: false,
        }
    }
}

/// The state behind a session and the scenes prepared in it.
pub(super) struct Engine {
    files: Mutex<PagedFiles>,
    pub(super) pages: WorkingSet,
    pub(super) exec: ExecSettings,
    /// `None` if the budget is for pages alone, and fixed.
    memory: Option<Mutex<Memory>>,
    /// Bytes for the caps of a scene, if the budget is for pages alone.
    caps_bytes: u64,
    pub(super) name_of_io: String,
    /// Of the latest render whose costs were looked about for, the share of its time that one ray a
    /// pixel takes: bits of an f64, not a number before.
    share_of_one_ray: AtomicU64,
    /// Pages that stay in memory, and the clouds that they are of.
    pinned: Mutex<Pinned>,
    // Declared, and so dropped, last: dropping it ends its threads.
    pub(super) scheduler: Scheduler,
}

/// Clouds, and what is kept of each.
type Pinned = Vec<(Arc<Cloud>, Vec<PageGuard>)>;

/// The memory of an engine as a whole, divided between prepared scenes and pages.
#[derive(Debug)]
struct Memory {
    total: u64,
    /// What each prepared scene needs besides pages.
    scenes: Vec<(u64, SceneNeeds)>,
    last: u64,
}

/// A prepared scene's part of the memory of its engine; released when dropped.
pub(super) struct Reservation {
    engine: Arc<Engine>,
    number: u64,
}

impl Drop for Reservation {
    fn drop(&mut self) {
        if let Some(memory) = &self.engine.memory {
            let mut memory = memory.lock().unwrap_or_else(PoisonError::into_inner);
            memory.scenes.retain(|(number, _)| *number != self.number);
            self.engine.divide(&memory);
        }
    }
}

/// The memory that a scene may take for its caps.
pub(super) struct CapMemory<'a> {
    pub(super) engine: &'a Engine,
    /// `None` if the budget is for pages alone.
    pub(super) reservation: Option<&'a Reservation>,
}

impl CapMemory<'_> {
    /// Takes memory for caps, so many bytes in all.
    ///
    /// # Errors
    /// [`RenderError::Memory`] if there is not so much.
    pub(super) fn take(&self, bytes: u64) -> Result<(), RenderError> {
        let (Some(memory), Some(reservation)) = (&self.engine.memory, self.reservation) else {
            let (given, needed) = (self.engine.caps_bytes, bytes);
            return if needed > given { Err(RenderError::Memory { given, needed }) } else { Ok(()) };
        };
        let mut memory = memory.lock().unwrap_or_else(PoisonError::into_inner);
        let scene = memory.scenes.iter_mut().find(|(number, _)| *number == reservation.number);
        let Some((_, needs)) = scene.filter(|(_, needs)| needs.caps_bytes < bytes) else { return Ok(()) };
        *needs = needs.clone().with_caps(bytes);
        self.engine.is_enough(&memory)?;
        self.engine.divide(&memory);
        Ok(())
    }
}

impl Engine {
    /// Starts over a working set and files that are already open. Divides `memory_bytes` between
    /// scenes and pages; `None` if the budget is for pages alone.
    ///
    /// # Errors
    /// [`RenderError::Setting`] if the size of tiles or slabs or the number of threads is out of
    /// range, [`RenderError::Threads`] if the system cannot start a thread.
    pub(super) fn start(
        files: PagedFiles,
        exec: ExecSettings,
        memory_bytes: Option<u64>,
        name_of_io: String,
    ) -> Result<Self, RenderError> {
        if !(1..=MAX_TILE_PIXELS).contains(&exec.tile_pixels)
            || !(1..=SLAB_SAMPLES).contains(&exec.slab_samples)
        {
            return Err(SettingError::TileOrSlab.into());
        }
        if exec.threads > MOST_THREADS {
            return Err(SettingError::Threads(exec.threads).into());
        }
        let caps_bytes = u64::MAX;
        let scheduler = Scheduler::start(exec.threads.max(1)).map_err(RenderError::Threads)?;
        let pages = files.pages.clone();
        let files = Mutex::new(files);
        let memory = memory_bytes.map(|total| Mutex::new(Memory { total, scenes: Vec::new(), last: 0 }));
        let pinned = Mutex::default();
        let share_of_one_ray = AtomicU64::new(f64::NAN.to_bits());
        Ok(Self { share_of_one_ray, files, pages, exec, memory, caps_bytes, name_of_io, pinned, scheduler })
    }

    /// The same with so many bytes for the caps of a scene, if its budget is for pages alone.
    pub(super) fn with_caps_bytes(self, caps_bytes: u64) -> Self {
        Self { caps_bytes, ..self }
    }

    pub(super) fn set_share_of_one_ray(&self, share: f64) {
        self.share_of_one_ray.store(share.to_bits(), Ordering::Relaxed);
    }

    pub(super) fn share_of_one_ray(&self) -> Option<f64> {
        let share = f64::from_bits(self.share_of_one_ray.load(Ordering::Relaxed));
        (!share.is_nan()).then_some(share)
    }

    /// The open files.
    pub(super) fn files(&self) -> MutexGuard<'_, PagedFiles> {
        self.files.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn pinned(&self) -> MutexGuard<'_, Pinned> {
        self.pinned.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Reserves memory for a scene, and gives the rest to pages.
    pub(super) fn reserve(
        self: &Arc<Self>,
        scene: &Scene,
        settings: &RenderSettings,
    ) -> Result<Option<Reservation>, RenderError> {
        let Some(memory) = &self.memory else { return Ok(None) };
        let mut memory = memory.lock().unwrap_or_else(PoisonError::into_inner);
        memory.last += 1;
        let number = memory.last;
        memory.scenes.push((number, SceneNeeds::of(scene, settings)));
        let mut enough = self.is_enough(&memory);
        if let (Err(_), Some((_, last))) = (&enough, memory.scenes.last_mut())
            && let Some(needs) = last.with_least_caps()
        {
            *last = needs;
            enough = self.is_enough(&memory);
        }
        if let Err(error) = enough {
            memory.scenes.pop();
            return Err(error);
        }
        self.divide(&memory);
        Ok(Some(Reservation { engine: self.clone(), number }))
    }

    fn is_enough(&self, memory: &Memory) -> Result<(), RenderError> {
        let needs: Vec<&SceneNeeds> = memory.scenes.iter().map(|(_, needs)| needs).collect();
        let divided = memory::divide(&needs, self.exec.threads, memory.total);
        divided.map(|_| ()).map_err(|needed| RenderError::Memory { given: memory.total, needed })
    }

    /// Gives pages the memory that the scenes leave.
    fn divide(&self, memory: &Memory) {
        let needs: Vec<&SceneNeeds> = memory.scenes.iter().map(|(_, needs)| needs).collect();
        if let Ok((page_bytes, shadow_bytes)) = memory::divide(&needs, self.exec.threads, memory.total) {
            self.pages.set_limits(Limits::total(page_bytes).with_kind(Kind::Shadows, shadow_bytes));
        }
    }
}
