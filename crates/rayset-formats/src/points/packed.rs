//! Bytes that are compressed with gzip or zstd, as a stream of what was compressed.
//!
//! zstd is read by `ruzstd`, which needs no C compiler and no C on other people's bytes; its panics
//! on damaged data are caught. The memory that a file may ask for, its window, is limited before it
//! is given.

use std::error::Error;
use std::io::{self, BufRead, Read};

use flate2::bufread::MultiGzDecoder;
use ruzstd::decoding::{BlockDecodingStrategy, FrameDecoder};

use super::quiet;
use rayset_base::regular_file::held;
use rayset_store::storage::copy_of_reading;

const ZSTD_MAGIC: u32 = 0xfd2f_b528;
/// Largest window of zstd that is read, in bytes: that of its highest level.
pub(super) const WINDOW_LIMIT: u64 = 128 << 20;
/// The window that frames after the first may have, at least. Higher levels than 16 of zstd have
/// larger ones.
const LEAST_WINDOW: u64 = 2 << 20;
/// Memory in bytes of a decoder besides its window.
const DECODER_BYTES: u64 = 1 << 20;

/// How a file is compressed as a whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Packing {
    Gzip,
    Zstd,
}

impl Packing {
    /// The packing of a file that begins with these bytes; `None` if it has none that is known.
    pub(super) fn of(head: &[u8]) -> Option<Self> {
        if head.starts_with(b"\x1f\x8b\x08") {
            return Some(Self::Gzip);
        }
        (number(head) == Some(ZSTD_MAGIC)).then_some(Self::Zstd)
    }

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Gzip => "gzip",
            Self::Zstd => "zstd",
        }
    }

    /// The ending of the names of such files.
    pub(super) fn ending(self) -> &'static str {
        match self {
            Self::Gzip => ".gz",
            Self::Zstd => ".zst",
        }
    }
}

fn number(bytes: &[u8]) -> Option<u32> {
    let bytes = bytes.get(..4)?;
    Some(u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]))
}

/// A reader that counts what is taken from it.
#[derive(Debug)]
struct Counted<R> {
    input: R,
    bytes: u64,
}

impl<R: BufRead> Read for Counted<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let read = self.input.read(buffer)?;
        self.bytes += read as u64;
        Ok(read)
    }
}

impl<R: BufRead> BufRead for Counted<R> {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        self.input.fill_buf()
    }

    fn consume(&mut self, bytes: usize) {
        self.input.consume(bytes);
        self.bytes += bytes as u64;
    }
}

/// A decompressor.
pub(super) struct Unpacked<R>(Decoder<R>);

enum Decoder<R> {
    Gzip(MultiGzDecoder<Counted<R>>),
    Zstd(Box<Zstd<R>>),
}

impl<R: BufRead> Unpacked<R> {
    /// A decompressor of zstd, which keeps at most `window` bytes.
    pub(super) fn zstd(input: R, window: u64) -> Self {
        let mut decoder = FrameDecoder::new();
        decoder.set_max_window_size(window);
        let input = Counted { input, bytes: 0 };
        let zstd = Zstd { input, decoder, is_in_frame: false, is_broken: false, is_cut: false };
        Self(Decoder::Zstd(Box::new(zstd)))
    }

    /// What is decompressed.
    pub(super) fn input(&self) -> &R {
        match &self.0 {
            Decoder::Gzip(decoder) => &decoder.get_ref().input,
            Decoder::Zstd(zstd) => &zstd.input.input,
        }
    }

    /// Whether zstd data could not be decompressed because they end early.
    pub(super) fn is_cut(&self) -> bool {
        matches!(&self.0, Decoder::Zstd(zstd) if zstd.is_cut)
    }

    /// A decompressor, and the memory in bytes that it needs.
    ///
    /// # Errors
    /// If the input cannot be read, or needs too large a window.
    pub(super) fn new(mut input: R, packing: Packing) -> io::Result<(Self, u64)> {
        let window = zstd_window(held(&mut input)?).unwrap_or(0);
        Ok(match packing {
            Packing::Gzip => {
                let input = Counted { input, bytes: 0 };
                (Self(Decoder::Gzip(MultiGzDecoder::new(input))), DECODER_BYTES)
            }
            Packing::Zstd => {
                if window > WINDOW_LIMIT {
                    let what = format!(
                        "its zstd data need a window of {} MiB, and up to {} MiB are given; compress it without \
                         --long",
                        window >> 20,
                        WINDOW_LIMIT >> 20
                    );
                    return Err(invalid(what));
                }
                let window = window.max(LEAST_WINDOW);
                (Self::zstd(input, window), 2 * window + DECODER_BYTES)
            }
        })
    }
}

/// The window in bytes that a frame of zstd needs, which begins with these bytes; `None` if they
/// are no such beginning.
pub(super) fn zstd_window(frame: &[u8]) -> Option<u64> {
    if number(frame) != Some(ZSTD_MAGIC) {
        return None;
    }
    let (&flags, rest) = frame[4..].split_first()?;
    if flags & 32 == 0 {
        let window = u64::from(*rest.first()?);
        let base = 1_u64 << (10 + (window >> 3));
        return Some(base + base / 8 * (window & 7));
    }
    // A frame of a single segment has no window but its content, whose size is behind the number of
    // a dictionary.
    let start = [0, 1, 2, 4][usize::from(flags & 3)];
    let size = [1, 2, 4, 8][usize::from(flags >> 6)];
    let content = rest.get(start..start + size)?;
    let more = if size == 2 { 256 } else { 0 };
    Some(content.iter().rev().fold(0_u64, |value, &byte| value << 8 | u64::from(byte)).saturating_add(more))
}

fn invalid(what: String) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, what)
}

/// What is said of data that cannot be decompressed because of `cause`, when `bytes` have been
/// read.
fn trouble(name: &str, bytes: u64, mut cause: Option<&(dyn Error + 'static)>) -> io::Error {
    while let Some(error) = cause {
        match error.downcast_ref::<io::Error>() {
            Some(error) if error.kind() == io::ErrorKind::UnexpectedEof => {
                return invalid(format!(
                    "its {name} data go on beyond byte {bytes}, where it ends; it is cut off"
                ));
            }
            Some(error) => match copy_of_reading(error) {
                Some(error) => return error,
                None => break,
            },
            None => cause = error.source(),
        }
    }
    invalid(format!("its {name} data are damaged, at or before byte {bytes}"))
}

impl<R: BufRead> Read for Unpacked<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        match &mut self.0 {
            Decoder::Gzip(decoder) => decoder.read(buffer).map_err(|error| match error.kind() {
                io::ErrorKind::Interrupted => error,
                _ => trouble("gzip", decoder.get_ref().bytes, Some(&error)),
            }),
            Decoder::Zstd(zstd) => zstd.read(buffer),
        }
    }
}

/// Frames of zstd, one after another.
struct Zstd<R> {
    input: Counted<R>,
    decoder: FrameDecoder,
    is_in_frame: bool,
    /// It has failed, and its state may be unusable.
    is_broken: bool,
    /// It has failed at the end of its data.
    is_cut: bool,
}

impl<R: BufRead> Zstd<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if buffer.is_empty() {
            return Ok(0);
        }
        if self.is_broken {
            return Err(trouble("zstd", self.input.bytes, None));
        }
        loop {
            if !self.is_in_frame && !self.next_frame()? {
                return Ok(0);
            }
            if self.decoder.can_collect() > 0 {
                return self.decoder.read(buffer);
            }
            if self.decoder.is_finished() {
                self.check_sum()?;
                self.is_in_frame = false;
                continue;
            }
            let block = BlockDecodingStrategy::UptoBlocks(1);
            let (decoder, input) = (&mut self.decoder, &mut self.input);
            match quiet::catch(|| decoder.decode_blocks(input, block)) {
                Some(Ok(_)) => {}
                Some(Err(error)) => return Err(self.fail(Some(&error))),
                None => return Err(self.fail(None)),
            }
        }
    }

    /// Begins the next frame. Returns false if there is none.
    fn next_frame(&mut self) -> io::Result<bool> {
        loop {
            if held(&mut self.input)?.is_empty() {
                return Ok(false);
            }
            let mut start = [0; 4];
            self.read_head(&mut start)?;
            // Frames to be skipped have one of sixteen numbers.
            if number(&start).is_some_and(|magic| magic & !15 == 0x184d_2a50) {
                let mut length = [0; 4];
                self.read_head(&mut length)?;
                let length = u64::from(u32::from_le_bytes(length));
                if io::copy(&mut (&mut self.input).take(length), &mut io::sink())? < length {
                    return Err(self.fail(Some(&io::Error::from(io::ErrorKind::UnexpectedEof))));
                }
                continue;
            }
            let (decoder, input) = (&mut self.decoder, &mut self.input);
            let begun = quiet::catch(|| decoder.reset((&start[..]).chain(input)));
            return match begun {
                Some(Ok(())) => {
                    self.is_in_frame = true;
                    Ok(true)
                }
                Some(Err(error)) => Err(self.fail(Some(&error))),
                None => Err(self.fail(None)),
            };
        }
    }

    /// Reads some of the first bytes of a frame.
    fn read_head(&mut self, bytes: &mut [u8]) -> io::Result<()> {
        self.input.read_exact(bytes).map_err(|error| {
            if error.kind() != io::ErrorKind::UnexpectedEof {
                return error;
            }
            self.is_cut = true;
            invalid("its zstd data end within a frame's first bytes; it is cut off".to_owned())
        })
    }

    /// Whatever comes after it, the decoder is not used again.
    fn fail(&mut self, cause: Option<&(dyn Error + 'static)>) -> io::Error {
        self.is_broken = true;
        self.is_cut = held(&mut self.input).is_ok_and(<[u8]>::is_empty);
        trouble("zstd", self.input.bytes, cause)
    }

    fn check_sum(&mut self) -> io::Result<()> {
        match (self.decoder.get_checksum_from_data(), self.decoder.get_calculated_checksum()) {
            (Some(stored), Some(found)) if stored != found => {
                let byte = self.input.bytes;
                Err(invalid(format!(
                    "the checksum of its zstd data that end at byte {byte} is wrong; it is damaged"
                )))
            }
            _ => Ok(()),
        }
    }
}
