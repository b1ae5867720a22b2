//! The bytes of one attribute of an SPZ file, unpacked from front to back.
//!
//! Attributes lie one behind the other, so each that is needed has its own reader of the file, positioned at the attribute's
//! first byte. What is needed of the file at a time stays small this way, however large it is.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use flate2::bufread::GzDecoder;
use ruzstd::decoding::StreamingDecoder;

use super::spz_header::StreamPlace;
use crate::points::{Place, ReadError, quiet};
use crate::regular_file;

const BUFFER_BYTES: usize = 64 << 10;
/// Memory of a reader: its buffer, and tables of the decoder.
pub(super) const READER_BYTES: u64 = 512 << 10;
/// Largest window of a zstd stream, that of zstd's own decoder.
const WINDOW_LIMIT: u64 = 128 << 20;

/// A file that knows how many of its bytes were used.
struct Counted {
    input: BufReader<File>,
    at: u64,
}

impl Counted {
    fn open(path: &Path, at: u64) -> io::Result<Self> {
        let mut file = regular_file::open(path)?;
        file.seek(SeekFrom::Start(at))?;
        Ok(Self { input: BufReader::with_capacity(BUFFER_BYTES, file), at })
    }
}

impl Read for Counted {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let read = self.input.read(buffer)?;
        self.at += read as u64;
        Ok(read)
    }
}

impl BufRead for Counted {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        self.input.fill_buf()
    }

    fn consume(&mut self, bytes: usize) {
        self.at += bytes as u64;
        self.input.consume(bytes);
    }
}

enum Input {
    Plain(Counted),
    Gzip(GzDecoder<Counted>),
    Zstd(Box<StreamingDecoder<io::Take<Counted>, ruzstd::decoding::FrameDecoder>>),
}

/// The bytes that unpacking a zstd stream has to keep, from the header of its frame; `None` if it is no such header, or they
/// are more than are allowed.
pub(super) fn zstd_window(frame: &[u8]) -> Option<u64> {
    let rest = frame.strip_prefix(&[0x28, 0xb5, 0x2f, 0xfd])?;
    let (&descriptor, rest) = rest.split_first()?;
    let window = if descriptor & 0x20 == 0 {
        let window = *rest.first()?;
        let base = 1_u64 << (10 + (window >> 3));
        base + base / 8 * u64::from(window & 7)
    } else {
        // The whole content, whose size is behind the number of a dictionary.
        let rest = rest.get([0, 1, 2, 4][usize::from(descriptor & 3)]..)?;
        let size =
            rest.get(..1 << (descriptor >> 6))?.iter().rev().fold(0, |n, &byte| n << 8 | u64::from(byte));
        if descriptor >> 6 == 1 { size + 256 } else { size }
    };
    (window <= WINDOW_LIMIT).then_some(window)
}

/// How an SPZ file, or a stream of it, is packed.
#[derive(Clone, Copy, Debug)]
pub(super) enum Packing {
    Plain,
    Gzip,
    Zstd(StreamPlace),
}

/// Unpacked bytes of a file.
pub(super) struct Plane {
    path: PathBuf,
    input: Input,
    /// Whether what is packed ended before its own end.
    is_cut: bool,
}

impl Plane {
    /// Opens a file, `skip` bytes behind the beginning of what is packed.
    pub(super) fn open(path: &Path, packing: Packing, skip: u64) -> Result<Self, ReadError> {
        let io = |source| ReadError::Io { path: path.to_owned(), source };
        let input = match packing {
            Packing::Plain => Input::Plain(Counted::open(path, 0).map_err(io)?),
            Packing::Gzip => Input::Gzip(GzDecoder::new(Counted::open(path, 0).map_err(io)?)),
            Packing::Zstd(place) => {
                let file = Counted::open(path, place.offset).map_err(io)?.take(place.bytes);
                let decoder =
                    quiet::catch(|| StreamingDecoder::new_with_max_window_size(file, WINDOW_LIMIT).ok());
                let what = "not the beginning of a zstd stream";
                let fail = || ReadError::malformed(path, Place::Byte(place.offset), what);
                Input::Zstd(Box::new(decoder.flatten().ok_or_else(fail)?))
            }
        };
        let mut plane = Self { path: path.to_owned(), input, is_cut: false };
        plane.skip(skip)?;
        Ok(plane)
    }

    /// Some bytes, as [`Read::read`].
    fn read_some(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        match &mut self.input {
            Input::Plain(file) => file.read(buffer),
            Input::Gzip(decoder) => decoder.read(buffer),
            // Damaged data may make the decoder panic.
            Input::Zstd(decoder) => quiet::catch(|| decoder.read(buffer))
                .unwrap_or_else(|| Err(io::ErrorKind::InvalidData.into())),
        }
    }

    /// An error at the byte of the file that was unpacked last.
    fn fail(&self, what: String) -> ReadError {
        let byte = match &self.input {
            Input::Plain(file) => file.at,
            Input::Gzip(decoder) => decoder.get_ref().at,
            Input::Zstd(decoder) => decoder.get_ref().get_ref().at,
        };
        ReadError::malformed(&self.path, Place::Byte(byte), what)
    }

    /// Reads up to as many bytes as the buffer has; fewer only at the end. Returns their number.
    pub(super) fn read(&mut self, buffer: &mut [u8]) -> Result<usize, ReadError> {
        let mut read = 0;
        while read < buffer.len() {
            match self.read_some(&mut buffer[read..]) {
                Ok(0) => break,
                Ok(bytes) => read += bytes,
                Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                Err(source) if source.raw_os_error().is_some() => {
                    return Err(ReadError::Io { path: self.path.clone(), source });
                }
                Err(e) if e.kind() == io::ErrorKind::UnexpectedEof || self.packed_has_ended() => {
                    self.is_cut = true;
                    break;
                }
                Err(e) if matches!(self.input, Input::Gzip(_)) => {
                    return Err(self.fail(format!("damaged: {e}")));
                }
                Err(_) => return Err(self.fail("damaged: no data of a zstd stream".into())),
            }
        }
        Ok(read)
    }

    /// Whether a zstd stream has no more packed bytes.
    fn packed_has_ended(&self) -> bool {
        matches!(&self.input, Input::Zstd(decoder) if decoder.get_ref().limit() == 0)
    }

    /// Whether the checksum of a zstd stream that has one differs from that of what was unpacked.
    fn is_wrong(&self) -> bool {
        let Input::Zstd(stream) = &self.input else { return false };
        let stated = stream.decoder.get_checksum_from_data();
        stated.is_some() && stated != stream.decoder.get_calculated_checksum()
    }

    /// Reads exactly as many bytes as the buffer has, of `what`, of which `done` of `count` are read.
    pub(super) fn read_exact(
        &mut self,
        buffer: &mut [u8],
        what: &str,
        done: u64,
        count: u64,
    ) -> Result<(), ReadError> {
        if self.read(buffer)? == buffer.len() {
            return Ok(());
        }
        Err(self.fail(format!(
            "the file ends early: {what} of fewer than {count} Gaussians, of which {done} are read"
        )))
    }

    fn skip(&mut self, bytes: u64) -> Result<(), ReadError> {
        let mut left = bytes;
        let mut buffer = [0; 16 << 10];
        while left > 0 {
            let part = buffer.len().min(usize::try_from(left).unwrap_or(usize::MAX));
            let read = self.read(&mut buffer[..part])?;
            if read < part {
                return Err(self.fail(format!(
                    "the file ends early: {} of {bytes} bytes unpacked",
                    bytes - left + read as u64
                )));
            }
            left -= part as u64;
        }
        Ok(())
    }

    /// Unpacks another `bytes` bytes, which have to be there, to the end of the stream, whose checksum then holds.
    pub(super) fn finish(&mut self, bytes: u64) -> Result<(), ReadError> {
        self.skip(bytes)?;
        // What is behind the attributes are extensions.
        let mut buffer = [0; 4096];
        while self.read(&mut buffer)? > 0 {}
        if self.is_cut {
            return Err(
                self.fail("the file ends early: its data are whole, but not what follows them".into())
            );
        }
        if self.is_wrong() {
            return Err(self.fail("damaged: the checksum of a zstd stream does not match its data".into()));
        }
        Ok(())
    }
}
