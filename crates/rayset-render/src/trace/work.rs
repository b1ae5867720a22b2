//! What is to be rendered: tiles of a picture in a given order, and passes over them.

use std::ops::Range;

use crate::field::LANES;

/// Longest edge of a tile in pixels.
pub const MAX_TILE_PIXELS: u32 = 8;
/// Edge of look-ahead tiles in pixels: squares whose tiles follow each other in the order of
/// tracing and are predicted together.
pub(super) const LOOKAHEAD_TILE_PIXELS: u32 = 32;

/// A rectangle of pixels of a picture.
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

    /// The smallest region that contains all tiles, of which there is at least one.
    pub(super) fn around(tiles: &[Tile]) -> Self {
        let least = |of: fn(&Tile) -> u32| tiles.iter().map(of).min().unwrap_or(0);
        let most = |of: fn(&Tile) -> u32| tiles.iter().map(of).max().unwrap_or(0);
        Self {
            columns: least(|t| t.x)..most(|t| t.x + t.width),
            rows: least(|t| t.y)..most(|t| t.y + t.height),
        }
    }
}

/// A rectangle of pixels that are traced together: its upper left pixel and its size, each edge 1
/// to 8 pixels.
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

/// Some pixels of a tile, counted row after row: a bit for each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct PixelMask(pub(super) u64);

impl PixelMask {
    /// All pixels of a tile.
    pub(super) fn all_of(tile: &Tile) -> Self {
        Self(u64::MAX >> (LANES - tile.pixels().clamp(1, LANES)))
    }

    /// Their numbers, ascending.
    pub(super) fn pixels(self) -> impl Iterator<Item = usize> {
        (0..LANES).filter(move |pixel| self.0 >> pixel & 1 == 1)
    }

    /// How many they are.
    pub(super) fn len(self) -> u64 {
        u64::from(self.0.count_ones())
    }
}

/// What is to be rendered of a view, and in what order. The order changes no pixel.
#[derive(Clone, Debug)]
pub struct Work {
    pub(super) tiles: Vec<Tile>,
    /// The pixels of each tile that are traced, if they are not all.
    pub(super) traced: Option<Vec<PixelMask>>,
    /// Tiles of which it is known that they are rendered next, by other work: they are only looked
    /// ahead at.
    pub(super) upcoming: Vec<Tile>,
    pub(super) passes: Passes,
}

/// How the rays of a pixel are divided into passes over all tiles.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Passes {
    /// All in one.
    One,
    /// The given number of rays in each pass, and the rest in a last pass.
    Of(Vec<u32>),
    /// One ray, then in each pass as many as in all passes before it.
    Doubling,
}

impl Work {
    /// Tiles in the order in which they are to be rendered, each once with all of its rays.
    #[must_use]
    pub fn tiles(tiles: Vec<Tile>) -> Self {
        Self { tiles, traced: None, upcoming: Vec::new(), passes: Passes::One }
    }

    /// Some pixels of each tile alone.
    pub(super) fn pixels(tiles: Vec<Tile>, traced: Vec<PixelMask>) -> Self {
        Self { traced: Some(traced), ..Self::tiles(tiles) }
    }

    /// The same work, when it is known which tiles will be rendered next.
    pub(super) fn before(self, upcoming: Vec<Tile>) -> Self {
        Self { upcoming, ..self }
    }

    /// Divides the work into passes over all tiles: the first traces `rays[0]` rays of every pixel,
    /// the next `rays[1]`, and so on; the last traces what is left of the square of
    /// [`RenderSettings::samples`](crate::scene::RenderSettings::samples). After each pass every
    /// tile is handed out with the mean of what its rays have seen so far; after the last pass this
    /// is, bit for bit, the result of a single pass.
    #[must_use]
    pub fn in_passes(self, rays: &[u32]) -> Self {
        Self { passes: Passes::Of(rays.to_vec()), ..self }
    }

    /// Divides the work into passes that double the number of rays so far: 1, 1, 2, 4, …
    #[must_use]
    pub fn progressive(self) -> Self {
        Self { passes: Passes::Doubling, ..self }
    }
}

impl Passes {
    /// The range of rays in each pass, of `rays` in all.
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

/// Consecutive tiles in one pass, which are traced together.
#[derive(Clone, Copy, Debug)]
pub(super) struct TilePlace {
    /// Index of the first tile in the order of the work.
    pub(super) tile: usize,
    /// Number of tiles.
    pub(super) count: usize,
    pub(super) pass: usize,
}

impl TilePlace {
    /// Indices of the tiles.
    pub(super) fn tiles(self) -> Range<usize> {
        self.tile..self.tile + self.count
    }

    /// The tiles one by one.
    pub(super) fn singly(self) -> impl DoubleEndedIterator<Item = Self> {
        self.tiles().map(move |tile| Self { tile, count: 1, ..self })
    }
}
