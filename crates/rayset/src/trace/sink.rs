//! Where finished tiles go.

use std::io::BufWriter;
use std::path::Path;

use super::view::{Region, Tile};
use super::{RenderCounts, RenderError, View, Work};
use crate::cancel::CancelToken;
use crate::image::{Band, DisplayTransform, LayerPixel, PngBands, PngError};
use crate::output::{Destination, OutputFile};

/// Why a sink refuses a tile or a band; it ends the render.
pub type SinkError = Box<dyn std::error::Error + Send + Sync>;

/// A tile of a picture, after one of its passes.
#[derive(Clone, Copy, Debug)]
pub struct FinishedTile<'a> {
    /// Where it is.
    pub tile: Tile,
    /// The pass that has ended, from 0.
    pub pass: u32,
    /// How many there are: the tile is final after the last.
    pub passes: u32,
    /// Its pixels, row after row: red, green, blue (premultiplied, linear light) and opacity.
    pub pixels: &'a [[f32; 4]],
    /// What else is known of each pixel, where it was asked for; else empty.
    pub layers: &'a [LayerPixel],
}

impl FinishedTile<'_> {
    /// Whether no later pass will change it.
    #[must_use]
    pub fn is_final(&self) -> bool {
        self.pass + 1 == self.passes
    }
}

/// Takes tiles as they are finished, in any order, one at a time, on the thread that called for them. A closure does.
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

/// Takes a picture band by band from the top, as encoders of files want it, and hears how it gets on.
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
    /// What else is known of each pixel, where it was asked for; else empty.
    pub layers: Vec<LayerPixel>,
}

impl Picture {
    /// Writes the picture as a PNG of 8 bits, with the exposure and tone mapping of [`DisplayTransform::default`]. The file gets
    /// its name when it is whole.
    ///
    /// # Errors
    /// [`PngError`]; what stood under the name is then as it was.
    pub fn save_png(&self, path: &Path) -> Result<(), PngError> {
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

impl View {
    /// Renders the whole picture into memory.
    ///
    /// # Errors
    /// As [`View::render`].
    pub fn picture(&self) -> Result<Picture, RenderError> {
        let mut picture = Picture::default();
        self.render_bands(&self.region(), u32::MAX, &CancelToken::new(), &mut picture)?;
        Ok(picture)
    }

    /// Renders a part of the picture in bands of at most `band_rows` rows, of which one is held at a time; each of its
    /// pixels is the same, bit for bit, as in the whole.
    ///
    /// # Errors
    /// As [`View::render`], and where the region is empty or not within the picture.
    pub fn render_bands(
        &self,
        region: &Region,
        band_rows: u32,
        cancel: &CancelToken,
        sink: &mut (impl BandSink + ?Sized),
    ) -> Result<RenderCounts, RenderError> {
        let whole = self.region();
        let within = region.columns.end <= whole.columns.end && region.rows.end <= whole.rows.end;
        if region.columns.is_empty() || region.rows.is_empty() || !within {
            let what = "empty, or not within the picture".into();
            return Err(RenderError::Setting { setting: "region", what });
        }
        let (mut counts, mut done) = (RenderCounts::default(), 0);
        let mut row = region.rows.start;
        while row < region.rows.end {
            let rows = row..row + band_rows.clamp(1, region.rows.end - row);
            let of_band = Region { columns: region.columns.clone(), rows };
            let mut filling = Filling {
                band: Band::new(
                    row,
                    of_band.columns.len() as u32,
                    of_band.rows.len() as u32,
                    self.settings.layers,
                ),
                left: region.columns.start,
                done,
                total: region.pixels(),
                sink: &mut *sink,
            };
            counts += self.render(&Work::tiles(self.tiles(&of_band)), cancel, &mut filling)?;
            let band = filling.band;
            sink.band(&band).map_err(RenderError::Sink)?;
            (row, done) = (of_band.rows.end, done + of_band.pixels());
        }
        Ok(counts)
    }
}

/// A band whose tiles come in.
struct Filling<'s, S: BandSink + ?Sized> {
    band: Band,
    /// Leftmost column.
    left: u32,
    done: u64,
    total: u64,
    sink: &'s mut S,
}

impl<S: BandSink + ?Sized> TileSink for Filling<'_, S> {
    fn tile(&mut self, finished: &FinishedTile<'_>) -> Result<(), SinkError> {
        let Tile { x, y, width, height } = finished.tile;
        let length = width as usize;
        for row in 0..height {
            let from = row as usize * length;
            let to = (y + row - self.band.first_row) as usize * self.band.width as usize;
            let to = to + (x - self.left) as usize;
            self.band.pixels[to..to + length].copy_from_slice(&finished.pixels[from..from + length]);
            if !finished.layers.is_empty() {
                self.band.layers[to..to + length].copy_from_slice(&finished.layers[from..from + length]);
            }
        }
        self.done += finished.tile.pixels() as u64;
        self.sink.progress(self.done, self.total);
        Ok(())
    }
}
