//! PNG, written band by band, so that the whole picture is never held in memory.

use std::io::Write;

use super::display::Rgba8;
use super::{Band, DisplayTransform, ImageError};

fn encode_error(error: png::EncodingError) -> ImageError {
    match error {
        png::EncodingError::IoError(error) => ImageError::Io(error),
        other => ImageError::Encode(other.to_string()),
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
    /// [`ImageError`] if the size is zero or the header cannot be written.
    pub fn new(
        output: W,
        width: u32,
        height: u32,
        display_transform: DisplayTransform,
    ) -> Result<Self, ImageError> {
        Self::with_comment(output, width, height, display_transform, "")
    }

    /// The same with a comment, which is a text chunk of the keyword `Comment`; none if it is
    /// empty.
    ///
    /// # Errors
    /// As [`new`](Self::new), and if the comment has letters beyond Latin-1.
    pub fn with_comment(
        output: W,
        width: u32,
        height: u32,
        display_transform: DisplayTransform,
        comment: &str,
    ) -> Result<Self, ImageError> {
        let mut encoder = png::Encoder::new(output, width, height);
        if !comment.is_empty() {
            encoder.add_text_chunk("Comment".into(), comment.into()).map_err(encode_error)?;
        }
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
    /// [`ImageError`] if the pixels cannot be written.
    pub fn write(&mut self, band: &Band) -> Result<(), ImageError> {
        self.write_with(band, |_, _| {})
    }

    /// Appends a band whose rows `retouch` may change once they are encoded: it is given the number
    /// of each row, counted from the top of the whole picture, and its pixels, 8-bit RGBA with
    /// straight alpha.
    ///
    /// # Errors
    /// [`ImageError`] if the pixels cannot be written.
    pub fn write_with(
        &mut self,
        band: &Band,
        mut retouch: impl FnMut(u32, &mut [u8]),
    ) -> Result<(), ImageError> {
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
    /// [`ImageError`] if rows are missing or the file cannot be written.
    pub fn finish(self) -> Result<(), ImageError> {
        self.writer.finish().map_err(encode_error)
    }
}
