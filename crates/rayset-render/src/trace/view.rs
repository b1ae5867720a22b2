//! A view of a prepared scene: its tiles, and how they are rendered.

use std::sync::Arc;

use super::error::MOST_PIXELS;
use super::job::{Job, Next};
use super::prepared::{Prepared, PreparedScene};
use super::session::check_samples;
use super::sink::{FinishedTile, TileSink};
use super::steps::StepRule;
use super::work::{LOOKAHEAD_TILE_PIXELS, MAX_TILE_PIXELS, Region, Tile, Work};
use super::{RenderCounts, RenderError, SettingError};
use crate::scene::{Camera, Lod, RayMaker, RenderSettings, Samples};
use rayset_base::cancel::CancelToken;
use rayset_base::geometry::curve::hilbert_order;

/// A prepared scene seen by a camera, in a picture of a given size.
///
/// Cheap to make: nothing of the scene is compiled or copied for it.
#[derive(Clone)]
pub struct View {
    pub(super) prepared: Arc<Prepared>,
    pub(super) rays: RayMaker,
    /// Of rays from the eye.
    pub(super) steps: Arc<StepRule>,
    pub(super) settings: RenderSettings,
}

impl std::fmt::Debug for View {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "View({} x {})", self.settings.width, self.settings.height)
    }
}

impl PreparedScene {
    /// A view of the scene, in a picture of the size given in the settings.
    ///
    /// # Errors
    /// [`RenderError::Camera`] if the camera is invalid, [`RenderError::Setting`] if the size is
    /// out of range.
    pub fn view(&self, camera: &Camera) -> Result<View, RenderError> {
        self.view_of_size(camera, self.0.settings.width, self.0.settings.height)
    }

    /// A view of the scene, in a picture of `width` by `height` pixels, each 1 to 1 048 576.
    ///
    /// # Errors
    /// [`RenderError::Camera`] if the camera is invalid, [`RenderError::Setting`] if the size is
    /// out of range.
    pub fn view_of_size(&self, camera: &Camera, width: u32, height: u32) -> Result<View, RenderError> {
        let fits = |pixels: u32| (1..=MOST_PIXELS).contains(&pixels);
        if !(fits(width) && fits(height)) {
            return Err(SettingError::Size { width, height }.into());
        }
        let rays = camera.ray_maker(width, height)?;
        let settings = RenderSettings { width, height, ..self.0.settings };
        let world = &self.0.world;
        let steps = match settings.lod {
            Lod::Off => world.steps.clone(),
            Lod::Footprint(_) | Lod::Coarse(_) => {
                StepRule::new(&world.program, &settings, Some(&rays.sight()))?
            }
        };
        Ok(View { prepared: self.0.clone(), rays, steps: Arc::new(steps), settings })
    }
}

/// Cancels a render that nobody waits for any more.
struct CancelWhenDropped<'a>(&'a CancelToken);

impl Drop for CancelWhenDropped<'_> {
    fn drop(&mut self) {
        self.0.cancel();
    }
}

impl View {
    /// The same view with another number of rays: fewer for a preview.
    ///
    /// # Errors
    /// [`RenderError::Setting`] if the number is out of range.
    pub fn with_samples(mut self, samples: impl Into<Samples>) -> Result<Self, RenderError> {
        self.settings.samples = samples.into();
        check_samples(self.settings.samples)?;
        Ok(self)
    }

    /// The whole picture.
    #[must_use]
    pub fn region(&self) -> Region {
        Region { columns: 0..self.settings.width, rows: 0..self.settings.height }
    }

    /// The tiles of a region of the picture, in the order that is best for throughput: along a
    /// space-filling curve, so that tiles traced at the same time need the same pages. Tiles lie on
    /// a lattice over the whole picture; those at the edges of the region are clipped, and what
    /// lies outside the picture is left out.
    #[must_use]
    pub fn tiles(&self, region: &Region) -> Vec<Tile> {
        let whole = self.region();
        let region = &Region {
            columns: region.columns.start..region.columns.end.min(whole.columns.end),
            rows: region.rows.start..region.rows.end.min(whole.rows.end),
        };
        if region.columns.is_empty() || region.rows.is_empty() {
            return Vec::new();
        }
        let edge = self.prepared.engine.exec.tile_pixels;
        let (x0, y0) = (region.columns.start / edge, region.rows.start / edge);
        let (x1, y1) = (region.columns.end.div_ceil(edge), region.rows.end.div_ceil(edge));
        let mut tiles: Vec<Tile> = hilbert_order(x1.saturating_sub(x0), y1.saturating_sub(y0))
            .into_iter()
            .map(|(i, j)| {
                let x = ((x0 + i) * edge).max(region.columns.start);
                let y = ((y0 + j) * edge).max(region.rows.start);
                let (end_x, end_y) = ((x0 + i + 1) * edge, (y0 + j + 1) * edge);
                let (width, height) = (end_x.min(region.columns.end) - x, end_y.min(region.rows.end) - y);
                Tile { x, y, width, height }
            })
            .collect();
        // Look-ahead tiles follow a curve of their own, so that each is visited once.
        let lookahead_tile = |tile: &Tile| (tile.x / LOOKAHEAD_TILE_PIXELS, tile.y / LOOKAHEAD_TILE_PIXELS);
        let first = (region.columns.start / LOOKAHEAD_TILE_PIXELS, region.rows.start / LOOKAHEAD_TILE_PIXELS);
        let columns = region.columns.end.div_ceil(LOOKAHEAD_TILE_PIXELS).saturating_sub(first.0);
        let rows = region.rows.end.div_ceil(LOOKAHEAD_TILE_PIXELS).saturating_sub(first.1);
        let mut place = vec![0; columns as usize * rows as usize];
        for (at, (i, j)) in hilbert_order(columns, rows).into_iter().enumerate() {
            place[(j * columns + i) as usize] = at;
        }
        tiles.sort_by_key(|tile| {
            let (i, j) = lookahead_tile(tile);
            place[((j - first.1) * columns + i - first.0) as usize]
        });
        tiles
    }

    /// Renders tiles on the session's threads, and hands each to `sink` on the calling thread when
    /// it is finished. Returns when all tiles have been handed out.
    ///
    /// Several calls may run at the same time in one session, for one view or many; none changes a
    /// pixel of another.
    ///
    /// # Errors
    /// [`RenderError`] if a tile does not lie in the picture, a page cannot be obtained, the sink
    /// refuses a tile, or `cancel` is cancelled. All threads have then released this render.
    pub fn render(
        &self,
        work: &Work,
        cancel: &CancelToken,
        sink: &mut (impl TileSink + ?Sized),
    ) -> Result<RenderCounts, RenderError> {
        self.check_tiles(&work.tiles)?;
        if work.tiles.is_empty() {
            return Ok(RenderCounts::default());
        }
        // If any part of the render fails, the render stops; the caller's other work does not.
        let stop = CancelToken::new();
        let of_render = stop.clone();
        let _linked = cancel.register(Arc::new(move || of_render.cancel()));
        if cancel.is_cancelled() {
            return Err(RenderError::Cancelled);
        }
        let job = Arc::new(Job::new(
            self.prepared.clone(),
            (self.rays, self.steps.clone()),
            self.settings,
            work,
            &stop,
        ));
        let progress = job.progress();
        let _woken = stop.register(Arc::new(move || progress.wake()));
        // A sink that panics ends the render, too.
        let _ended = CancelWhenDropped(&stop);
        let scheduled = self.prepared.engine.scheduler.add(job.clone());
        loop {
            match job.next() {
                Next::Tile { output: tile, room } => {
                    if room > 0 {
                        scheduled.call_threads(room);
                    }
                    let pixels = tile.tile.pixels();
                    let finished = FinishedTile {
                        tile: tile.tile,
                        number: tile.number,
                        traced: tile.traced,
                        pass: tile.pass,
                        passes: job.passes(),
                        seconds: tile.seconds,
                        pixels: &tile.pixels[..pixels],
                        layers: tile.layers.as_ref().map_or(&[], |layers| &layers[..pixels]),
                    };
                    if let Err(refusal) = sink.tile(&finished) {
                        job.fail(RenderError::Sink(refusal));
                    }
                }
                Next::Finished(outcome) => return outcome,
            }
        }
    }

    fn check_tiles(&self, tiles: &[Tile]) -> Result<(), RenderError> {
        let (width, height) = (self.settings.width, self.settings.height);
        let fits = |start: u32, length: u32, end: u32| {
            (1..=MAX_TILE_PIXELS).contains(&length) && start < end && length <= end - start
        };
        let wrong = tiles.iter().find(|t| !(fits(t.x, t.width, width) && fits(t.y, t.height, height)));
        wrong.map_or(Ok(()), |&tile| Err(SettingError::Tile { tile, width, height }.into()))
    }
}
