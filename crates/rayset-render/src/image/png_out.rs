//! PNG, written band by band, so that the whole picture is never held in memory.

use std::io::{self, Write};

use super::display::Rgba8;
use super::{Band, DisplayTransform};
use rayset_store::output::OutputError;

/// Why a picture could not be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PngError {
    /// The encoder reported an error.
    #[error("{0}")]
    Encode(String),
    /// The system reported an error.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// The file cannot be written.
    #[error(transparent)]
    Output(#[from] OutputError),
}

fn encode_error(error: png::EncodingError) -> PngError {
    match error {
        png::EncodingError::IoError(error) => PngError::Io(error),
        other => PngError::Encode(other.to_string()),
    }
}

/// Writes an 8-bit sRGB picture with straight alpha, from bands in order from top to bottom.
pub struct PngBands<W: Write + 'static> {
    writer: png::StreamWriter<'static, W>,
    row: Vec<u8>,
    encoder: Rgba8,
}

impl<W: Write + 'static> PngBands<W> {
    /// Writes the header of a picture.
    ///
    /// # Errors
    /// [`PngError`] if the size is zero or the header cannot be written.
    pub fn new(
        output: W,
        width: u32,
        height: u32,
        display_transform: DisplayTransform,
    ) -> Result<Self, PngError> {
        let mut encoder = png::Encoder::new(output, width, height);
        encoder.set_color(png::ColorType::Rgba);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
        encoder.set_compression(png::Compression::Fast);
        let writer = encoder.write_header().map_err(encode_error)?;
        let writer = writer.into_stream_writer().map_err(encode_error)?;
        Ok(Self { writer, row: Vec::new(), encoder: Rgba8::new(display_transform) })
    }

    /// Appends a band.
    ///
    /// # Errors
    /// [`PngError`] if the pixels cannot be written.
    pub fn write(&mut self, band: &Band) -> Result<(), PngError> {
        self.write_with(band, |_, _| {})
    }

    /// Appends a band whose rows `retouch` may change once they are encoded: it is given the number
    /// of each row, counted from the top of the whole picture, and its pixels, 8-bit RGBA with
    /// straight alpha.
    ///
    /// # Errors
    /// [`PngError`] if the pixels cannot be written.
    pub fn write_with(
        &mut self,
        band: &Band,
        mut retouch: impl FnMut(u32, &mut [u8]),
    ) -> Result<(), PngError> {
        for (number, pixels) in (band.first_row..).zip(band.pixels.chunks(band.width.max(1) as usize)) {
            self.row.clear();
            self.row.extend(pixels.iter().flat_map(|&pixel| self.encoder.encode(pixel)));
            retouch(number, &mut self.row);
            self.writer.write_all(&self.row)?;
        }
        Ok(())
    }

    /// Completes the file.
    ///
    /// # Errors
    /// [`PngError`] if rows are missing or the file cannot be written.
    pub fn finish(self) -> Result<(), PngError> {
        self.writer.finish().map_err(encode_error)
    }
}
