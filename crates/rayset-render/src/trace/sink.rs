//! Where finished tiles go.

use std::io::BufWriter;
use std::path::Path;

use super::work::{PixelMask, Tile};
use crate::image::{Band, DisplayTransform, ImageError, LayerPixel, PngBands};
use rayset_store::output::{Destination, OutputFile};

/// Why a sink refuses a tile or a band; it ends the render.
pub type SinkError = Box<dyn std::error::Error + Send + Sync>;

/// A tile of a picture, after one of its passes.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(not(feature = "internals"), non_exhaustive)]
pub struct FinishedTile<'a> {
    /// The tile's rectangle in the picture.
    pub tile: Tile,
    /// Its number among the tiles of the work.
    pub(super) number: usize,
    /// The pixels of it that were traced.
    pub(super) traced: PixelMask,
    /// The pass that has ended, counted from 0.
    pub pass: u32,
    /// Number of passes: the tile is final after the last.
    pub passes: u32,
    /// Seconds that a thread took for it in this pass.
    pub(super) seconds: f32,
    /// Its pixels, row after row: red, green, blue (premultiplied, linear light) and opacity.
    pub pixels: &'a [[f32; 4]],
    /// The layers of each pixel if they are requested, otherwise empty.
    pub layers: &'a [LayerPixel],
}

impl FinishedTile<'_> {
    /// Whether the tile is final: no later pass will change it.
    #[must_use]
    pub fn is_final(&self) -> bool {
        self.pass + 1 == self.passes
    }

    /// Copies the pixels that were traced to their places in a band that begins at column `left`,
    /// and has layers if the tile does.
    pub(super) fn paste(&self, band: &mut Band, left: u32) {
        let Tile { x, y, width, .. } = self.tile;
        for from in self.traced.pixels() {
            let (column, row) = (from as u32 % width, from as u32 / width);
            let to = (y + row - band.first_row) as usize * band.width as usize;
            let to = to + (x + column - left) as usize;
            band.pixels[to] = self.pixels[from];
            if !self.layers.is_empty() {
                band.layers[to] = self.layers[from];
            }
        }
    }
}

/// Receives tiles as they are finished, in any order, one at a time, on the thread that called
/// [`View::render`](super::View::render). Closures implement it.
pub trait TileSink {
    /// A tile after one of its passes.
    ///
    /// # Errors
    /// Any error; it ends the render, which returns it.
    fn tile(&mut self, tile: &FinishedTile<'_>) -> Result<(), SinkError>;
}

impl<F: FnMut(&FinishedTile<'_>) -> Result<(), SinkError>> TileSink for F {
    fn tile(&mut self, tile: &FinishedTile<'_>) -> Result<(), SinkError> {
        self(tile)
    }
}

/// Receives a picture band by band from the top, as file encoders need it, and reports of its
/// progress.
pub trait BandSink {
    /// A finished band.
    ///
    /// # Errors
    /// Any error; it ends the render, which returns it.
    fn band(&mut self, band: &Band) -> Result<(), SinkError>;

    /// `done` of `total` pixels are finished.
    fn progress(&mut self, _done: u64, _total: u64) {}
}

/// A picture in memory.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Picture {
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
    /// Pixels, row after row: red, green, blue (premultiplied, linear light) and opacity.
    pub pixels: Vec<[f32; 4]>,
    /// The layers of each pixel if they are requested, otherwise empty.
    pub layers: Vec<LayerPixel>,
}

impl Picture {
    /// Writes the picture as an 8-bit PNG, with the exposure and tone mapping of
    /// [`DisplayTransform::default`]. The file appears under its name only when it is complete.
    ///
    /// # Errors
    /// [`ImageError`]; a file that exists at `path` is then left unchanged.
    pub fn save_png(&self, path: impl AsRef<Path>) -> Result<(), ImageError> {
        let file = OutputFile::create(&Destination::new(path)?)?;
        let output = BufWriter::new(file.writer());
        let mut png = PngBands::new(output, self.width, self.height, DisplayTransform::default())?;
        let (width, pixels, layers) = (self.width, self.pixels.clone(), Vec::new());
        png.write(&Band { first_row: 0, width, pixels, layers })?;
        png.finish()?;
        Ok(file.publish()?)
    }
}

impl BandSink for Picture {
    fn band(&mut self, band: &Band) -> Result<(), SinkError> {
        self.width = band.width;
        self.height += band.rows();
        self.pixels.extend_from_slice(&band.pixels);
        self.layers.extend_from_slice(&band.layers);
        Ok(())
    }
}
