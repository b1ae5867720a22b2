//! The ray tracer: packets of rays through slabs of samples, over a working set of pages.
//!
//! [`render`] is the table of contents. [`RenderSettings`] (with scene and camera) decide the picture;
//! [`ExecSettings`] never do.

mod access;
mod block;
mod bounce;
mod cloud_volume;
mod composite;
mod counts;
mod frontier;
mod grid_volume;
pub mod judge;
mod layers;
mod march;
mod math;
pub mod memory;
mod packet_tracer;
pub mod predict;
mod procedural_volume;
mod program;
mod secondary;
mod shade;
mod shadow;
mod steps;
mod tiles;
mod transfer;
mod world;

use std::cell::Cell;
use std::ops::Range;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, PoisonError};

use self::access::Halt;
pub use self::counts::RenderCounts;
use self::packet_tracer::PacketTracer;
use self::predict::{Lookahead, Predictor};
use self::tiles::{Agenda, Attempt, Tile, Tiles};
use self::world::World;
use crate::field::{LANES, SLAB_SAMPLES, SimdLevel};
use crate::image::{Band, LayerPixel};
use crate::scene::{Camera, CameraError, RenderSettings, Scene, SceneError};
use crate::working_set::{PageFault, PagedFiles};

/// How the work is done. Nothing here can change a pixel.
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
    /// Rows of the picture held at a time.
    pub band_rows: u32,
}

impl Default for ExecSettings {
    fn default() -> Self {
        Self {
            threads: std::thread::available_parallelism().map_or(1, usize::from),
            predictor: Arc::new(predict::PacketPredictor::default()),
            simd: SimdLevel::default(),
            tile_pixels: 8,
            slab_samples: SLAB_SAMPLES,
            band_rows: u32::MAX,
        }
    }
}

/// Why there is no picture.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RenderError {
    /// A page could not be had.
    #[error(transparent)]
    Page(#[from] PageFault),
    /// The camera makes no rays.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// The scene is none.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// A setting out of its range.
    #[error("{setting}: {what}")]
    Setting {
        /// The setting.
        setting: &'static str,
        /// What is wrong with it, and what is expected.
        what: String,
    },
    /// The receiver of the picture refused it.
    #[error("the picture could not be written: {0}")]
    Sink(String),
    /// The render was cancelled.
    #[error("cancelled")]
    Cancelled,
}

/// Takes a picture, band by band, and hears how it gets on.
pub trait Sink: Send {
    /// A finished band; bands come from the top.
    ///
    /// # Errors
    /// A sentence for the user; it ends the render.
    fn band(&mut self, band: &Band) -> Result<(), String>;

    /// `done` of `total` pixels are finished. Returning false cancels the render.
    fn progress(&mut self, _done: u64, _total: u64) -> bool {
        true
    }
}

/// Keeps the whole picture.
#[derive(Debug, Default)]
pub struct WholePicture {
    /// The bands joined.
    pub pixels: Vec<[f32; 4]>,
    /// Theirs, where they were asked for.
    pub layers: Vec<LayerPixel>,
}

impl Sink for WholePicture {
    fn band(&mut self, band: &Band) -> Result<(), String> {
        self.pixels.extend_from_slice(&band.pixels);
        self.layers.extend_from_slice(&band.layers);
        Ok(())
    }
}

/// Pixels of a picture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Region {
    /// Columns.
    pub columns: Range<u32>,
    /// Rows.
    pub rows: Range<u32>,
}

/// Renders a whole picture.
///
/// # Errors
/// [`RenderError`] where settings are out of range, a page cannot be had, or the sink refuses.
pub fn render(
    scene: &Scene,
    camera: &Camera,
    settings: &RenderSettings,
    exec: &ExecSettings,
    paged: &PagedFiles,
    sink: &mut dyn Sink,
) -> Result<RenderCounts, RenderError> {
    let whole = Region { columns: 0..settings.width, rows: 0..settings.height };
    render_region(scene, camera, settings, &whole, exec, paged, sink)
}

/// Renders a part of a picture; each of its pixels is the same, bit for bit, as in the whole.
///
/// # Errors
/// As [`render`].
pub fn render_region(
    scene: &Scene,
    camera: &Camera,
    settings: &RenderSettings,
    region: &Region,
    exec: &ExecSettings,
    paged: &PagedFiles,
    sink: &mut dyn Sink,
) -> Result<RenderCounts, RenderError> {
    check(scene, settings, region, exec)?;
    let rays = camera.ray_maker(settings.width, settings.height)?;
    let world = World::compile(scene, settings, exec, paged)?;
    let total = u64::from(region.columns.end - region.columns.start) * region.rows.len() as u64;
    let job = Job { world: &world, rays: &rays, settings, exec, total };
    let mut counts = RenderCounts::default();
    let mut done = 0;
    let mut row = region.rows.start;
    while row < region.rows.end {
        let rows = exec.band_rows.clamp(1, region.rows.end - row);
        let band = Region { columns: region.columns.clone(), rows: row..row + rows };
        counts += job.band(&band, &mut done, sink)?;
        row += rows;
    }
    Ok(counts)
}

fn check(
    scene: &Scene,
    settings: &RenderSettings,
    region: &Region,
    exec: &ExecSettings,
) -> Result<(), RenderError> {
    scene.check()?;
    scene.check_step(settings.step)?;
    let wrong = |setting, what: String| Err(RenderError::Setting { setting, what });
    let (width, height) = (settings.width, settings.height);
    if width == 0 || height == 0 || width > 1 << 20 || height > 1 << 20 {
        return wrong("size", format!("{width}x{height} is not between 1x1 and 1048576x1048576"));
    }
    if region.columns.is_empty()
        || region.rows.is_empty()
        || region.columns.end > width
        || region.rows.end > height
    {
        return wrong("region", "empty, or not within the picture".into());
    }
    if !(settings.stop_transmittance >= 0.0 && settings.stop_transmittance < 1.0) {
        return wrong("stop transmittance", format!("{} is not in [0, 1)", settings.stop_transmittance));
    }
    if !(1..=64).contains(&settings.samples) {
        return wrong(
            "samples",
            format!("{} is not between 1 and 64 along a side of a pixel", settings.samples),
        );
    }
    if !(1..=8).contains(&exec.tile_pixels) || !(1..=SLAB_SAMPLES).contains(&exec.slab_samples) {
        return wrong("tile or slab", "tiles have edges of 1 to 8 pixels, slabs 1 to 32 samples".into());
    }
    Ok(())
}

/// What all bands of one render share.
struct Job<'a> {
    world: &'a World,
    rays: &'a crate::scene::RayMaker,
    settings: &'a RenderSettings,
    exec: &'a ExecSettings,
    total: u64,
}

impl Job<'_> {
    /// Renders a band of rows: threads take its tiles along a Hilbert curve, so that they work side by side on the
    /// same pages.
    fn band(
        &self,
        region: &Region,
        done: &mut u64,
        sink: &mut dyn Sink,
    ) -> Result<RenderCounts, RenderError> {
        let tiles = Tiles::new(region, self.exec.tile_pixels);
        let lookahead = Lookahead::new(self.world, self.rays, region, self.exec.threads);
        let failed = AtomicBool::new(false);
        let width = region.columns.len() as u32;
        let shared = Mutex::new(Shared {
            band: Band::new(region.rows.start, width, region.rows.len() as u32, self.world.layers),
            counts: RenderCounts::default(),
            done: *done,
            sink,
            error: None,
        });
        let work = || {
            let mut tracer = PacketTracer::new(self.world, self.exec.slab_samples);
            let asked_bytes = Cell::new(0);
            let mut agenda = Agenda::new(self.world, &tiles, &asked_bytes);
            while !failed.load(Ordering::Relaxed)
                && let Some(attempt) = agenda.next(lookahead.tiles_to_put_off())
            {
                let tile = attempt.tile;
                self.exec.predictor.ahead(&lookahead, tile.x, tile.y);
                let counts = tracer.counts();
                asked_bytes.set(0);
                let outcome = self.tile(attempt, &mut tracer);
                let count = (tile.width * tile.height) as usize;
                let layers = tracer.layers().map(|layers| layers.pixels(count, asked_bytes.get()));
                let mut shared = shared.lock().unwrap_or_else(PoisonError::into_inner);
                let go_on = match outcome {
                    Ok(pixels) => shared.store(region, tile, &pixels, layers.as_ref(), self.total),
                    Err(Halt::PutOff(lacking)) => {
                        tracer.put_off(counts);
                        agenda.put_off(attempt, lacking);
                        true
                    }
                    Err(Halt::Failed(error)) => {
                        shared.error.get_or_insert(error);
                        false
                    }
                };
                if !go_on {
                    failed.store(true, Ordering::Relaxed);
                }
            }
            shared.lock().unwrap_or_else(PoisonError::into_inner).counts += tracer.counts();
        };
        if self.exec.threads <= 1 {
            work();
        } else {
            std::thread::scope(|scope| (0..self.exec.threads).for_each(|_| drop(scope.spawn(work))));
        }
        // Pages hinted at that no ray came to must not take the room of the next band's, or the next picture's.
        self.world.pages.forget_hints();
        let shared = shared.into_inner().unwrap_or_else(PoisonError::into_inner);
        if let Some(error) = shared.error {
            return Err(error);
        }
        *done = shared.done;
        shared.sink.band(&shared.band).map_err(RenderError::Sink)?;
        Ok(shared.counts)
    }

    /// Traces the rays of a tile and returns its pixels.
    fn tile(&self, attempt: Attempt<'_>, tracer: &mut PacketTracer<'_>) -> Result<[[f32; 4]; LANES], Halt> {
        let Attempt { tile, access, .. } = attempt;
        if let Some(layers) = tracer.layers() {
            layers.begin();
        }
        let cells = self.settings.samples;
        let mut sums = [[0.0; 4]; LANES];
        for (i, j) in (0..cells).flat_map(|j| (0..cells).map(move |i| (i, j))) {
            let mut rays = Vec::with_capacity(LANES);
            for y in tile.y..tile.y + tile.height {
                for x in tile.x..tile.x + tile.width {
                    let (u, v) = self.settings.ray_place(x, y, i, j);
                    rays.push((self.rays.ray(u, v), self.settings.phase_of(x * cells + i, y * cells + j)));
                }
            }
            for (sum, seen) in sums.iter_mut().zip(tracer.trace(access, &rays)?) {
                (0..4).for_each(|channel| sum[channel] += seen[channel]);
            }
        }
        let share = 1.0 / (cells * cells) as f32;
        Ok(sums.map(|sum| sum.map(|v| v * share)))
    }
}

/// What threads of a band hand in.
struct Shared<'a> {
    band: Band,
    counts: RenderCounts,
    done: u64,
    sink: &'a mut dyn Sink,
    error: Option<RenderError>,
}

impl Shared<'_> {
    /// Stores the pixels of a tile; false where the render is cancelled.
    fn store(
        &mut self,
        region: &Region,
        tile: Tile,
        pixels: &[[f32; 4]; LANES],
        layers: Option<&[LayerPixel; LANES]>,
        total: u64,
    ) -> bool {
        let width = self.band.width as usize;
        for row in 0..tile.height as usize {
            let from = row * tile.width as usize;
            let to = (tile.y - region.rows.start) as usize + row;
            let to = to * width + (tile.x - region.columns.start) as usize;
            self.band.pixels[to..to + tile.width as usize]
                .copy_from_slice(&pixels[from..from + tile.width as usize]);
            if let Some(layers) = layers {
                self.band.layers[to..to + tile.width as usize]
                    .copy_from_slice(&layers[from..from + tile.width as usize]);
            }
        }
        self.done += u64::from(tile.width * tile.height);
        let go_on = self.sink.progress(self.done, total);
        if !go_on {
            self.error.get_or_insert(RenderError::Cancelled);
        }
        go_on
    }
}
