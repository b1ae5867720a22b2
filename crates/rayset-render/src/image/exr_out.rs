//! OpenEXR with layers, written band by band, so that the whole picture is never held in memory.
//!
//! A file has one part of 32-bit channels in scan lines, compressed by ZIP in blocks of 16 rows.
//! Layers are distinguished by the names of their channels, as is customary ("Technical
//! Introduction to OpenEXR", section on layers).

use std::io::{Seek, Write};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;

use exr::block::writer::ChunksWriter;
use exr::block::{BlockIndex, UncompressedBlock};
use exr::compression::Compression;
use exr::math::Vec2;
use exr::meta::BlockDescription;
use exr::meta::attribute::{ChannelDescription, IntegerBounds, LineOrder, SampleType, Text};
use exr::meta::header::{Header, ImageAttributes};

use super::{Band, ImageError, LayerPixel};

fn encode_error(error: exr::error::Error) -> ImageError {
    match error {
        exr::error::Error::Io(error) => ImageError::Io(error),
        other => ImageError::Encode(other.to_string()),
    }
}

/// Rows of a block compressed by ZIP.
const BLOCK_ROWS: usize = 16;

/// How the value of a channel is taken from a pixel.
enum Value {
    Float(fn(&[f32; 4], &LayerPixel) -> f32),
    Whole(fn(&[f32; 4], &LayerPixel) -> u32),
}

/// All channels: name and value.
const CHANNELS: [(&str, Value); 16] = [
    ("A", Value::Float(|c, _| c[3])),
    ("B", Value::Float(|c, _| c[2])),
    ("G", Value::Float(|c, _| c[1])),
    ("R", Value::Float(|c, _| c[0])),
    ("albedo.B", Value::Float(|_, l| l.albedo[2])),
    ("albedo.G", Value::Float(|_, l| l.albedo[1])),
    ("albedo.R", Value::Float(|_, l| l.albedo[0])),
    ("bytes.Y", Value::Float(|_, l| l.bytes)),
    ("depth.Z", Value::Float(|_, l| l.depth)),
    ("instanceId.Y", Value::Whole(|_, l| l.instance)),
    ("lodError.Y", Value::Float(|_, l| l.lod_error)),
    ("normal.X", Value::Float(|_, l| l.normal[0])),
    ("normal.Y", Value::Float(|_, l| l.normal[1])),
    ("normal.Z", Value::Float(|_, l| l.normal[2])),
    ("opacity.Y", Value::Float(|_, l| l.opacity)),
    ("samples.Y", Value::Whole(|_, l| l.samples)),
];

/// Writes a picture with all its layers, from bands in order from top to bottom.
pub struct ExrBands {
    blocks: Option<SyncSender<UncompressedBlock>>,
    writer: Option<JoinHandle<Result<(), exr::error::Error>>>,
    width: usize,
    height: usize,
    /// Row of the whole picture at which this one begins.
    top: usize,
    /// Rows that do not fill a block yet, as the encoder expects them; `first_row` is the number of
    /// the first of them.
    data: Vec<u8>,
    rows: usize,
    first_row: usize,
}

impl ExrBands {
    /// Writes the header of a picture of `width` × `height` pixels, whose upper left pixel is
    /// (`left`, `top`) in a picture of size `whole`.
    ///
    /// # Errors
    /// [`ImageError`] if the writer thread cannot be started.
    pub fn new<W: Write + Seek + Send + 'static>(
        output: W,
        (width, height): (u32, u32),
        (left, top): (u32, u32),
        whole: (u32, u32),
    ) -> Result<Self, ImageError> {
        Self::with_comment(output, (width, height), (left, top), whole, "")
    }

    /// The same with a comment, which is the attribute `comments`; none if it is empty.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn with_comment<W: Write + Seek + Send + 'static>(
        output: W,
        (width, height): (u32, u32),
        (left, top): (u32, u32),
        whole: (u32, u32),
        comment: &str,
    ) -> Result<Self, ImageError> {
        let channels = CHANNELS.iter().map(|(name, value)| {
            let of_type = match value {
                Value::Float(_) => SampleType::F32,
                Value::Whole(_) => SampleType::U32,
            };
            ChannelDescription::new(*name, of_type, true)
        });
        let size = Vec2(width as usize, height as usize);
        let mut header = Header::new("rayset".into(), size, channels.collect()).with_encoding(
            Compression::ZIP16,
            BlockDescription::ScanLines,
            LineOrder::Increasing,
        );
        header.own_attributes.comments = Some(comment).filter(|text| !text.is_empty()).map(Text::from);
        header.own_attributes.layer_position = Vec2(left as i32, top as i32);
        let window = IntegerBounds::from_dimensions(Vec2(whole.0 as usize, whole.1 as usize));
        header.shared_attributes = ImageAttributes::new(window);
        // The encoder requests blocks one by one; this channel delivers them.
        let (blocks, incoming): (_, Receiver<UncompressedBlock>) = sync_channel(1);
        let write = move || {
            exr::block::write(output, [header].into_iter().collect(), true, |meta, chunks| {
                for (number, block) in incoming.into_iter().enumerate() {
                    chunks.write_chunk(number, block.compress_to_chunk(&meta.headers)?)?;
                }
                Ok(())
            })
        };
        let writer = std::thread::Builder::new().spawn(write)?;
        let (width, height, top) = (size.0, size.1, top as usize);
        let (blocks, writer, data) = (Some(blocks), Some(writer), Vec::new());
        Ok(Self { blocks, writer, width, height, top, data, rows: 0, first_row: 0 })
    }

    /// Appends a band.
    ///
    /// # Errors
    /// [`ImageError`] if the file cannot be written, or if the band has no layers or is not the
    /// next from the top.
    pub fn write(&mut self, band: &Band) -> Result<(), ImageError> {
        let is_next = band.first_row as usize == self.top + self.first_row + self.rows;
        if band.width as usize != self.width || band.layers.len() != band.pixels.len() || !is_next {
            return Err(ImageError::Band);
        }
        for (pixels, layers) in band.pixels.chunks(self.width).zip(band.layers.chunks(self.width)) {
            let done = self.first_row + self.rows + 1;
            if done > self.height {
                return Err(ImageError::Band);
            }
            self.add_row(pixels, layers);
            if self.rows == BLOCK_ROWS || done == self.height {
                self.send_block()?;
            }
        }
        Ok(())
    }

    fn add_row(&mut self, pixels: &[[f32; 4]], layers: &[LayerPixel]) {
        let data = &mut self.data;
        if self.rows == 0 {
            let rows = BLOCK_ROWS.min(self.height - self.first_row);
            data.reserve_exact(rows * self.width * CHANNELS.len() * 4);
        }
        for (_, value) in &CHANNELS {
            for (pixel, layer) in pixels.iter().zip(layers) {
                // In native byte order, as the encoder expects.
                match value {
                    Value::Float(of) => data.extend_from_slice(bytemuck::bytes_of(&of(pixel, layer))),
                    Value::Whole(of) => data.extend_from_slice(bytemuck::bytes_of(&of(pixel, layer))),
                }
            }
        }
        self.rows += 1;
    }

    fn send_block(&mut self) -> Result<(), ImageError> {
        let (data, rows) = (std::mem::take(&mut self.data), std::mem::take(&mut self.rows));
        let index = BlockIndex {
            layer: 0,
            pixel_position: Vec2(0, self.first_row),
            pixel_size: Vec2(self.width, rows),
            level: Vec2(0, 0),
        };
        self.first_row += rows;
        let sent = self.blocks.as_ref().map(|blocks| blocks.send(UncompressedBlock { index, data }));
        // If the block was not accepted, the writer thread has ended with an error, which `end`
        // returns.
        if sent.is_some_and(|sent| sent.is_ok()) { Ok(()) } else { self.end() }
    }

    /// Completes the file.
    ///
    /// # Errors
    /// [`ImageError`] if rows are missing or the file cannot be written.
    pub fn finish(mut self) -> Result<(), ImageError> {
        self.end()
    }

    fn end(&mut self) -> Result<(), ImageError> {
        self.blocks = None;
        let Some(writer) = self.writer.take() else { return Ok(()) };
        match writer.join() {
            Ok(outcome) => outcome.map_err(encode_error),
            Err(_) => Err(ImageError::Encode("the encoder gave up".into())),
        }
    }
}

impl Drop for ExrBands {
    fn drop(&mut self) {
        let _ = self.end();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Cursor;

    #[test]
    fn bands_in_another_order_than_from_the_top_are_refused() {
        let mut picture =
            ExrBands::new(Cursor::new(Vec::new()), (4, 6), (2, 10), (9, 20)).expect("a picture begins");
        let refused = |outcome| matches!(outcome, Err(ImageError::Band));
        assert!(refused(picture.write(&Band::new(0, 4, 3, true))), "rows above the picture");
        assert!(refused(picture.write(&Band::new(13, 4, 3, true))), "rows left out");
        assert!(refused(picture.write(&Band::new(10, 5, 3, true))), "another width");
        assert!(refused(picture.write(&Band::new(10, 4, 3, false))), "no layers");
        picture.write(&Band::new(10, 4, 3, true)).expect("the first rows");
        assert!(refused(picture.write(&Band::new(10, 4, 3, true))), "the same rows again");
        picture.write(&Band::new(13, 4, 3, true)).expect("the last rows");
        picture.finish().expect("a whole picture");
    }
}
