//! Pictures of any size as files: traced band by band, encoded as they come, and sent piece by
//! piece, so that none is ever whole in memory.

use std::io::{self, Write};

use rayset::image::{Band, LayerPixel, PngBands};
use rayset::{BandSink, CancelToken, RenderError, Session, SinkError};

use crate::compose::{self, Opened};
use crate::frames::{Outgoing, Send};
use crate::protocol::{FrameHead, FrameKind, Show, ToPage};

/// Longest edge of a picture that is saved, in pixels.
pub(crate) const MOST_SAVED_EDGE: u32 = 16_384;
/// Bytes of a piece.
const PIECE_BYTES: usize = 64 << 10;
/// Bytes of a pixel while it is in a band: its light, and its layers where they are needed.
const PIXEL_BYTES: u64 = size_of::<[f32; 4]>() as u64;
const LAYERS_BYTES: u64 = size_of::<LayerPixel>() as u64;
/// The part of the height within which shading looks around, on either side, with some room.
const SURROUNDINGS: u64 = 45;
/// The fewest rows of a band.
const LEAST_ROWS: u64 = 8;
/// The most.
const MOST_ROWS: u64 = 32;
/// Parts that progress is told in.
const PARTS: u32 = 100;

/// Renders what a page sees and sends it as a PNG file, within `bytes` of memory besides the
/// session's.
///
/// # Errors
/// Why it is not whole, for the person who wanted it.
pub(crate) fn save(
    session: &Session,
    opened: &Opened,
    show: &Show,
    bytes: u64,
    cancel: &CancelToken,
    send: &Send,
) -> Result<(), String> {
    show.check(MOST_SAVED_EDGE, u64::MAX)?;
    let [width, height] = show.size;
    let file = opened.parse(&opened.composed(show, true)?)?;
    let is_shaded_at_the_end = file.settings.ambient_occlusion > 0.0;
    // Rows are held until those within the surroundings of the last of them are known.
    let (layers, around) =
        if is_shaded_at_the_end { (LAYERS_BYTES, 2 * u64::from(height) / SURROUNDINGS) } else { (0, 0) };
    // Twice a band: the one that is made, and the one that is passed on.
    let rows = bytes.saturating_sub(2 * PIECE_BYTES as u64) / (u64::from(width) * (PIXEL_BYTES + layers));
    let band_rows = rows.saturating_sub(around) / 2;
    if band_rows < LEAST_ROWS {
        return Err(format!(
            "there is no memory for a picture of {width}x{height}; close other pages, or start with more --memory"
        ));
    }
    let said = |error: RenderError| match error {
        RenderError::Cancelled => "cancelled".to_owned(),
        other => other.to_string(),
    };
    let scene = session.prepare(&file.scene, &file.settings).map_err(said)?;
    let view = scene.view_of_size(&compose::camera(&show.camera), width, height).map_err(said)?;
    let pieces = Pieces { send, waiting: Vec::with_capacity(PIECE_BYTES) };
    // The encoder's output has to live by itself; what it writes is sent from here.
    let written = SharedBytes::default();
    let encoder = PngBands::new(written.clone(), width, height, file.display_transform);
    let encoder = encoder.map_err(|error| error.to_string())?;
    let mut sink = Sink { encoder, written: written.clone(), pieces, height, told: 0 };
    view.render_bands(&view.region(), band_rows.min(MOST_ROWS) as u32, cancel, &mut sink).map_err(said)?;
    let Sink { encoder, mut pieces, .. } = sink;
    encoder.finish().map_err(|error| error.to_string())?;
    pieces.add(&written.take()).and_then(|()| pieces.flush()).map_err(|error| error.to_string())
}

/// Bytes that an encoder has written and nobody has taken yet.
#[derive(Clone, Default)]
struct SharedBytes(std::sync::Arc<std::sync::Mutex<Vec<u8>>>);

impl SharedBytes {
    fn take(&self) -> Vec<u8> {
        std::mem::take(&mut *self.0.lock().unwrap_or_else(std::sync::PoisonError::into_inner))
    }
}

impl Write for SharedBytes {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.lock().unwrap_or_else(std::sync::PoisonError::into_inner).extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Collects bytes until there are enough for a message.
struct Pieces<'a> {
    send: &'a Send,
    waiting: Vec<u8>,
}

impl Pieces<'_> {
    fn add(&mut self, bytes: &[u8]) -> io::Result<()> {
        for part in bytes.chunks(PIECE_BYTES) {
            self.waiting.extend_from_slice(part);
            if self.waiting.len() >= PIECE_BYTES {
                self.flush()?;
            }
        }
        Ok(())
    }

    fn flush(&mut self) -> io::Result<()> {
        let head = FrameHead { kind: FrameKind::Piece, generation: 0, frame: 0, size: [0; 2], rectangles: 0 };
        let mut message = head.bytes().to_vec();
        message.append(&mut self.waiting);
        let has_gone = || io::Error::new(io::ErrorKind::BrokenPipe, "the page has gone");
        if (self.send)(Outgoing::Frame(message)) { Ok(()) } else { Err(has_gone()) }
    }
}

/// Encodes bands, sends what comes of them, and tells how far it is.
struct Sink<'a> {
    encoder: PngBands<SharedBytes>,
    written: SharedBytes,
    pieces: Pieces<'a>,
    height: u32,
    told: u32,
}

impl BandSink for Sink<'_> {
    fn band(&mut self, band: &Band) -> Result<(), SinkError> {
        self.encoder.write(band)?;
        self.pieces.add(&self.written.take())?;
        let part = (band.first_row + band.rows()) * PARTS / self.height;
        if part > self.told {
            self.told = part;
            (self.pieces.send)(Outgoing::Text(ToPage::Progress { part: f64::from(part) / f64::from(PARTS) }));
        }
        Ok(())
    }
}
