//! The memory that a render needs besides pages, so that a budget for the whole process can be
//! kept: the sum of what a scene takes as given, compiled, and in the threads that trace it.

use std::sync::Arc;

use super::interior::graph as caps;
use super::march::March;
use super::program::{Program, Purpose};
use super::ray_tree::tree_bytes;
use super::shadow::{DeepShadowMap, SHADOW_TILE_BYTES, Shadows};
use super::unopened::Unopened;
use crate::field::SimdLevel;
use crate::scene::{RenderSettings, Samples, Scene};
use rayset_files::grid::Grid;
use rayset_files::grid::format::PAGE_BYTES;
use rayset_files::octree::Cloud;
use rayset_store::working_set::{OVERHEAD_BYTES, WorkingSet};

/// Stack, bookkeeping and tiles of one thread, as measured: besides what marches and shadows take.
const THREAD_BYTES: u64 = 640 << 10;
/// What look-ahead stores per page of the files, though it never has most of them in view at a
/// time.
const LOOKAHEAD_BYTES: u64 = 24;
/// One part in this many of the pages' memory is set aside for gaps in the allocator's memory for
/// everything else.
const ALLOCATOR_PART: u64 = 32;
/// Memory for the reads in flight and the threads that serve them.
const READING_BYTES: u64 = 1 << 20;

/// What a scene needs in memory besides its pages.
#[derive(Clone, Debug)]
pub struct SceneNeeds {
    pub(super) clouds: Vec<Arc<Cloud>>,
    pub(super) grids: Vec<Arc<Grid>>,
    /// The graph as given and as compiled, and what remains allocated after loading it.
    scene_bytes: u64,
    /// What its caps may take, and how much of this they may not take.
    pub(super) caps_bytes: u64,
    spare_bytes: u64,
    thread_bytes: u64,
    /// Number of tiles of shadow tables.
    shadow_tiles: u64,
    /// What requests take at most, if any file is remote.
    request_bytes: u64,
    /// Whether tiles are made with layers, and whether the picture is written with them.
    pub(super) layers: bool,
    pub(super) writes_layers: bool,
    pub(super) ambient_occlusion: bool,
    /// Whether pixels are traced again where the picture varies.
    pub(super) traces_again: bool,
    /// Width and height of the picture in pixels.
    pub(super) size: (u32, u32),
    pub(super) threads: usize,
    /// What the process takes before the render starts.
    pub(super) process_bytes: u64,
}

impl SceneNeeds {
    /// The needs of a scene that has been checked.
    #[must_use]
    pub fn of(scene: &Scene, settings: &RenderSettings) -> Self {
        let seen = |scene| {
            let purpose = (settings.purpose(), settings.lod);
            Program::compile_seen(scene, purpose, SimdLevel::default())
        };
        let Some((capped, caps)) = caps::sized(scene, settings) else {
            return Self::of_program(scene, settings, &seen(scene));
        };
        let needs = Self::of_program(&capped, settings, &seen(&capped));
        // Caps are found before the picture's programs are there.
        let surface = Program::compile(scene, Purpose::Surface, SimdLevel::default());
        let counting = THREAD_BYTES + March::most_bytes(&surface) as u64;
        Self {
            caps_bytes: caps.most,
            spare_bytes: caps.most - caps.least,
            thread_bytes: needs.thread_bytes.max(counting),
            scene_bytes: needs.scene_bytes.max((scene.bytes() + surface.bytes()) as u64),
            ..needs
        }
    }

    /// The needs of a scene without caps, or of one in which something else takes their place.
    fn of_program(scene: &Scene, settings: &RenderSettings, program: &Program<Unopened>) -> Self {
        let (of_shadows, of_shadows_in_thread) = Shadows::most_bytes(scene, settings);
        let turns = program.turns().any() && settings.max_depth > 0;
        let tree = if turns { tree_bytes(settings.max_depth) } else { 0 };
        let clouds: Vec<Arc<Cloud>> = once(program.clouds_of().cloned());
        let grids: Vec<Arc<Grid>> = once(program.grids_of().cloned());
        Self {
            request_bytes: request_bytes(&clouds, &grids),
            clouds,
            grids,
            scene_bytes: (scene.bytes() + program.bytes() + of_shadows) as u64,
            caps_bytes: 0,
            spare_bytes: 0,
            thread_bytes: THREAD_BYTES + (March::most_bytes(program) + of_shadows_in_thread) as u64 + tree,
            shadow_tiles: DeepShadowMap::tiles_of(scene, settings.shadows),
            layers: settings.records_layers(),
            writes_layers: settings.layers,
            ambient_occlusion: settings.ambient_occlusion > 0.0,
            traces_again: matches!(settings.samples, Samples::Auto { .. }),
            size: (settings.width, settings.height),
            threads: 1,
            process_bytes: 0,
        }
    }

    /// Sets the number of threads that render; otherwise one.
    #[must_use]
    pub fn with_threads(self, threads: usize) -> Self {
        Self { threads, ..self }
    }

    /// Sets what the process takes before the render starts, for budgets of whole processes;
    /// otherwise nothing.
    #[must_use]
    pub fn with_process(self, process_bytes: u64) -> Self {
        Self { process_bytes, ..self }
    }

    /// Adds the memory that loading the scene took: little of it becomes available to pages,
    /// because what remains allocated lies scattered in it.
    #[must_use]
    pub fn with_loading(self, loading_bytes: u64) -> Self {
        Self { scene_bytes: self.scene_bytes + loading_bytes, ..self }
    }

    /// The same with as little memory for caps as finding them takes; `None` if that is all they
    /// may take.
    pub(super) fn with_least_caps(&self) -> Option<Self> {
        (self.spare_bytes > 0).then(|| self.clone().with_caps(self.caps_bytes - self.spare_bytes))
    }

    /// The same with another amount of memory for caps, when it is known how much they take.
    #[doc(hidden)]
    #[must_use]
    pub fn with_caps(self, caps_bytes: u64) -> Self {
        Self { caps_bytes, spare_bytes: 0, ..self }
    }

    /// Every grid of the scene, each once.
    #[must_use]
    pub fn grids(&self) -> &[Arc<Grid>] {
        &self.grids
    }

    /// The number of pages of every file, and the bytes of each page.
    fn files(&self) -> impl Iterator<Item = (u64, u64)> {
        let clouds =
            self.clouds.iter().map(|c| (u64::from(c.header().pages()), u64::from(c.header().page_bytes)));
        clouds.chain(self.grids.iter().map(|grid| (grid.header().pages(), PAGE_BYTES as u64)))
    }

    /// Every cloud of the scene, each once.
    #[must_use]
    pub fn clouds(&self) -> &[Arc<Cloud>] {
        &self.clouds
    }
}

/// Files, each once.
fn once<T>(files: impl Iterator<Item = Arc<T>>) -> Vec<Arc<T>> {
    let mut known: Vec<Arc<T>> = Vec::new();
    for file in files {
        if !known.iter().any(|other| Arc::ptr_eq(other, &file)) {
            known.push(file);
        }
    }
    known
}

/// What requests to the files of a scene take at most; those of several files share it.
fn request_bytes(clouds: &[Arc<Cloud>], grids: &[Arc<Grid>]) -> u64 {
    let clouds = clouds.iter().filter_map(|cloud| cloud.storage());
    let storages = clouds.chain(grids.iter().filter_map(|grid| grid.storage()));
    let transports = storages.filter_map(|storage| storage.transport());
    transports.map(|transport| transport.memory_bytes()).max().unwrap_or(0)
}

/// Divides the memory of a session that has prepared these scenes. Returns the bytes for pages, and
/// how many of these shadow tables may take.
///
/// # Errors
/// The smallest sufficient memory in bytes.
pub(super) fn divide(scenes: &[&SceneNeeds], threads: usize, total: u64) -> Result<(u64, u64), u64> {
    let demand = Demand::of(scenes, threads);
    let least = demand.fixed + demand.least_page_bytes();
    if total < least { Err(least) } else { Ok(demand.divide(total - demand.fixed)) }
}

/// What the scenes of a session need besides pages, and how large their pages are.
pub(super) struct Demand {
    threads: usize,
    pub(super) fixed: u64,
    /// Bytes of the largest page of a file.
    pub(super) page: u64,
    /// Bytes of the largest and of the smallest page, including tiles of shadow tables.
    largest: u64,
    smallest: u64,
    /// Bytes of all pages of the files.
    file_bytes: u64,
}

impl Demand {
    pub(super) fn of(scenes: &[&SceneNeeds], threads: usize) -> Self {
        let tile = SHADOW_TILE_BYTES as u64;
        let files = || scenes.iter().flat_map(|needs| needs.files());
        let shadow_tiles: u64 = scenes.iter().map(|needs| needs.shadow_tiles).sum();
        let page = files().map(|(_, bytes)| bytes).max().unwrap_or(4096);
        let (largest, smallest) =
            if shadow_tiles > 0 { (page.max(tile), page.min(tile)) } else { (page, page) };
        let pages: u64 = files().map(|(pages, _)| pages).sum();
        let slots = u32::try_from(pages + shadow_tiles).unwrap_or(u32::MAX);
        let of_scenes: u64 = scenes.iter().map(|needs| needs.scene_bytes + needs.caps_bytes).sum();
        // Each thread works on one scene at a time.
        let of_thread = scenes.iter().map(|needs| needs.thread_bytes).max().unwrap_or(0);
        Self {
            threads,
            fixed: of_scenes
                + threads as u64 * of_thread
                + WorkingSet::overhead_bytes(slots)
                + pages * LOOKAHEAD_BYTES
                + READING_BYTES
                + scenes.iter().map(|needs| needs.request_bytes).max().unwrap_or(0),
            page,
            largest,
            smallest,
            file_bytes: files().map(|(pages, bytes)| pages * bytes).sum(),
        }
    }

    /// The least memory that pages need.
    pub(super) fn least_page_bytes(&self) -> u64 {
        least_pages(self.threads) * (self.largest + OVERHEAD_BYTES + self.largest / ALLOCATOR_PART)
    }

    /// Bytes of pages that fit in `room` bytes of memory, and how many of these shadow tables may
    /// take.
    pub(super) fn divide(&self, room: u64) -> (u64, u64) {
        // The overhead per page weighs most for small pages.
        let each = self.smallest + OVERHEAD_BYTES + self.smallest / ALLOCATOR_PART;
        let page_bytes = (room / each * self.smallest).max(least_pages(self.threads) * self.largest);
        let shadow_bytes = page_bytes
            .saturating_sub(self.file_bytes)
            .max(page_bytes / 2)
            .max(SHADOW_TILE_BYTES as u64 * (self.threads as u64 + 1))
            .min(page_bytes);
        (page_bytes, shadow_bytes)
    }
}

/// The smallest number of pages with which threads cannot wait for each other forever: each retains
/// one at a time while another is being loaded.
#[must_use]
pub fn least_pages(threads: usize) -> u64 {
    2 * threads as u64 + 2
}
