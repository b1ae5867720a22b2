//! One look at a prepared scene: its tiles, and the work of rendering them.

use std::ops::Range;
use std::sync::Arc;

use super::job::{Job, Next};
use super::prepared::Prepared;
use super::sink::{FinishedTile, TileSink};
use super::{RenderCounts, RenderError};
use crate::cancel::CancelToken;
use crate::field::LANES;
use crate::geometry::curve::hilbert_order;
use crate::scene::{RayMaker, RenderSettings};

/// Longest edge of a tile in pixels.
pub const MAX_TILE_PIXELS: u32 = 8;
/// Edge of the squares of pixels whose tiles follow each other: those that are looked ahead at together.
pub(super) const LOOKAHEAD_TILE_PIXELS: u32 = 32;

/// Pixels of a picture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Region {
    /// Columns.
    pub columns: Range<u32>,
    /// Rows.
    pub rows: Range<u32>,
}

impl Region {
    /// Number of pixels.
    #[must_use]
    pub fn pixels(&self) -> u64 {
        self.columns.len() as u64 * self.rows.len() as u64
    }

    /// The smallest that holds all tiles, of which there is at least one.
    pub(super) fn around(tiles: &[Tile]) -> Self {
        let least = |of: fn(&Tile) -> u32| tiles.iter().map(of).min().unwrap_or(0);
        let most = |of: fn(&Tile) -> u32| tiles.iter().map(of).max().unwrap_or(0);
        Self {
            columns: least(|t| t.x)..most(|t| t.x + t.width),
            rows: least(|t| t.y)..most(|t| t.y + t.height),
        }
    }
}

/// A rectangle of pixels that is traced together: its upper left pixel and its size, each edge 1 to
/// 8.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tile {
    /// Left column.
    pub x: u32,
    /// Top row.
    pub y: u32,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

impl Tile {
    /// Number of pixels.
    #[must_use]
    pub fn pixels(&self) -> usize {
        self.width as usize * self.height as usize
    }
}

const _: () = assert!(MAX_TILE_PIXELS as usize * MAX_TILE_PIXELS as usize == LANES);

/// What is to be rendered of a view, and in what order. The order changes no pixel.
#[derive(Clone, Debug)]
pub struct Work {
    pub(super) tiles: Vec<Tile>,
    pub(super) passes: Passes,
}

/// How the rays of a pixel are divided into passes over all tiles.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Passes {
    /// All in one.
    One,
    /// So many in each pass, and the rest in a last one.
    Of(Vec<u32>),
    /// One, then as many as there have been.
    Doubling,
}

impl Work {
    /// Tiles in the order in which they are to be rendered, each once with all of its rays.
    #[must_use]
    pub fn tiles(tiles: Vec<Tile>) -> Self {
        Self { tiles, passes: Passes::One }
    }

    /// The same in passes over all tiles: the first traces `rays[0]` rays of every pixel, the next `rays[1]`, and so on; the
    /// last traces what is left of the square of [`RenderSettings::samples`]. After each pass every tile is handed out with
    /// the mean of what its rays have seen so far; after the last this is, bit for bit, what it is in one pass.
    #[must_use]
    pub fn in_passes(self, rays: &[u32]) -> Self {
        Self { passes: Passes::Of(rays.to_vec()), ..self }
    }

    /// The same in passes that double the number of rays: 1, 1, 2, 4, …
    #[must_use]
    pub fn progressive(self) -> Self {
        Self { passes: Passes::Doubling, ..self }
    }
}

impl Passes {
    /// The rays of each pass, of `rays` in all.
    pub(super) fn ranges(&self, rays: u32) -> Vec<Range<u32>> {
        let mut ranges = Vec::new();
        let mut done = 0;
        let mut pass = 0;
        while done < rays {
            let count = match self {
                Self::One => rays,
                Self::Of(counts) => counts.get(pass).copied().unwrap_or(rays),
                Self::Doubling => done.max(1),
            };
            let end = done.saturating_add(count.max(1)).min(rays);
            ranges.push(done..end);
            (done, pass) = (end, pass + 1);
        }
        ranges
    }
}

/// A prepared scene seen by a camera, in a picture of some size.
///
/// Cheap to make: nothing of the scene is compiled or copied for it.
#[derive(Clone)]
pub struct View {
    pub(super) prepared: Arc<Prepared>,
    pub(super) rays: RayMaker,
    pub(super) settings: RenderSettings,
}

impl std::fmt::Debug for View {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "View({} x {})", self.settings.width, self.settings.height)
    }
}

/// Cancels what nobody waits for any more.
struct CancelWhenDropped<'a>(&'a CancelToken);

impl Drop for CancelWhenDropped<'_> {
    fn drop(&mut self) {
        self.0.cancel();
    }
}

impl View {
    /// The whole picture.
    #[must_use]
    pub fn region(&self) -> Region {
        Region { columns: 0..self.settings.width, rows: 0..self.settings.height }
    }

    /// The tiles of a part of the picture, in the order that is best for throughput: along a space-filling curve, so that
    /// what is traced at a time needs the same pages. Tiles lie on a lattice of the whole picture; those at the edges of
    /// the region are cut, and what lies outside the picture is left out.
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
        let edge = self.prepared.exec().tile_pixels;
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
        // NodeSamples by block along a curve of their own, so that each is come to once.
        let block = |tile: &Tile| (tile.x / LOOKAHEAD_TILE_PIXELS, tile.y / LOOKAHEAD_TILE_PIXELS);
        let first = (region.columns.start / LOOKAHEAD_TILE_PIXELS, region.rows.start / LOOKAHEAD_TILE_PIXELS);
        let columns = region.columns.end.div_ceil(LOOKAHEAD_TILE_PIXELS).saturating_sub(first.0);
        let rows = region.rows.end.div_ceil(LOOKAHEAD_TILE_PIXELS).saturating_sub(first.1);
        let mut place = vec![0; columns as usize * rows as usize];
        for (at, (i, j)) in hilbert_order(columns, rows).into_iter().enumerate() {
            place[(j * columns + i) as usize] = at;
        }
        tiles.sort_by_key(|tile| {
            let (i, j) = block(tile);
            place[((j - first.1) * columns + i - first.0) as usize]
        });
        tiles
    }

    /// Renders tiles and hands them to `sink`, on the calling thread, as they are finished; the session's threads trace
    /// them. Returns when all are handed out.
    ///
    /// Several calls may run at a time over one session, for one view or many; none changes a pixel of another.
    ///
    /// # Errors
    /// [`RenderError`] where a tile does not lie in the picture, a page cannot be had, the sink refuses a tile, or
    /// `cancel` is cancelled. All threads have then let go of this render.
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
        // The render stops where anything of it fails, and the caller's other work does not.
        let stop = CancelToken::new();
        let of_render = stop.clone();
        let _linked = cancel.register(Arc::new(move || of_render.cancel()));
        if cancel.is_cancelled() {
            return Err(RenderError::Cancelled);
        }
        let job = Arc::new(Job::new(self, work, &stop));
        let progress = job.progress();
        let _woken = stop.register(Arc::new(move || progress.wake()));
        // A sink that panics ends the render, too.
        let _ended = CancelWhenDropped(&stop);
        let scheduled = self.prepared.session().schedule(&job);
        loop {
            match job.next() {
                Next::Tile(tile) => {
                    // Threads may have left because too many tiles waited.
                    scheduled.call_threads();
                    let pixels = tile.tile.pixels();
                    let finished = FinishedTile {
                        tile: tile.tile,
                        pass: tile.pass,
                        passes: job.passes(),
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
        wrong.map_or(Ok(()), |tile| {
            let what = format!(
                "{}x{} pixels at ({}, {}); expected 1x1 to 8x8 pixels within a picture of {width}x{height}",
                tile.width, tile.height, tile.x, tile.y
            );
            Err(RenderError::Setting { setting: "tile", what })
        })
    }
}
