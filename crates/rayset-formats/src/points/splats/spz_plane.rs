//! The bytes of one attribute of an SPZ file, unpacked from front to back.
//!
//! Attributes lie one behind the other, so each that is needed has its own reader of the file,
//! positioned at the attribute's first byte. What is needed of the file at a time stays small this
//! way, however large it is.

use std::io::{self, BufRead, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use flate2::bufread::GzDecoder;

use super::spz_header::StreamPlace;
use crate::points::packed::Unpacked;
use crate::points::{Place, ReadError};
use rayset_base::cancel::CancelToken;
use rayset_store::storage::input_file::InputFile;
use rayset_store::storage::is_of_reading;

const BUFFER_BYTES: usize = 64 << 10;
/// Memory of a reader: its buffer, and tables of the decoder.
pub(super) const READER_BYTES: u64 = 512 << 10;

/// A file that knows how many of its bytes were used.
struct Counted {
    input: BufReader<InputFile>,
    at: u64,
}

impl Counted {
    fn open(path: &Path, at: u64) -> io::Result<Self> {
        let mut file = InputFile::open(path)?;
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
    Zstd(Unpacked<io::Take<Counted>>),
}

/// How an SPZ file, or a stream of it, is packed.
#[derive(Clone, Copy, Debug)]
pub(super) enum Packing {
    Plain,
    Gzip,
    /// A stream, and its window in bytes.
    Zstd(StreamPlace, u64),
}

/// Unpacked bytes of a file.
pub(super) struct Plane {
    path: PathBuf,
    input: Input,
    /// Whether what is packed ended before its own end.
    is_cut: bool,
    /// Stops the passing over of bytes.
    cancel: CancelToken,
}

impl Plane {
    /// Opens a file, `skip` bytes behind the beginning of what is packed.
    pub(super) fn open(
        path: &Path,
        packing: Packing,
        skip: u64,
        cancel: &CancelToken,
    ) -> Result<Self, ReadError> {
        let open = |at| Counted::open(path, at).map_err(ReadError::io(path));
        let input = match packing {
            Packing::Plain => Input::Plain(open(0)?),
            Packing::Gzip => Input::Gzip(GzDecoder::new(open(0)?)),
            Packing::Zstd(place, window) => {
                Input::Zstd(Unpacked::zstd(open(place.offset)?.take(place.bytes), window))
            }
        };
        let mut plane = Self { path: path.to_owned(), input, is_cut: false, cancel: cancel.clone() };
        plane.skip(skip)?;
        Ok(plane)
    }

    /// Some bytes, as [`Read::read`].
    fn read_some(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        match &mut self.input {
            Input::Plain(file) => file.read(buffer),
            Input::Gzip(decoder) => decoder.read(buffer),
            Input::Zstd(stream) => stream.read(buffer),
        }
    }

    /// An error at the byte of the file that was unpacked last.
    fn fail(&self, what: String) -> ReadError {
        let byte = match &self.input {
            Input::Plain(file) => file.at,
            Input::Gzip(decoder) => decoder.get_ref().at,
            Input::Zstd(stream) => stream.input().get_ref().at,
        };
        ReadError::malformed(&self.path, Place::Byte(byte), what)
    }

    /// Reads up to as many bytes as the buffer has; fewer only at the end. Returns their number.
    pub(super) fn read(&mut self, buffer: &mut [u8]) -> Result<usize, ReadError> {
        let mut read = 0;
        while read < buffer.len() {
            if self.cancel.is_cancelled() {
                return Err(ReadError::Cancelled);
            }
            match self.read_some(&mut buffer[read..]) {
                Ok(0) => break,
                Ok(bytes) => read += bytes,
                Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                Err(source) if is_of_reading(&source) => return Err(ReadError::io(&self.path)(source)),
                Err(e) if e.kind() == io::ErrorKind::UnexpectedEof || self.stream_is_cut() => {
                    self.is_cut = true;
                    break;
                }
                Err(e) => return Err(self.fail(format!("damaged: {e}"))),
            }
        }
        Ok(read)
    }

    /// Whether a zstd stream ended before its own end.
    fn stream_is_cut(&self) -> bool {
        matches!(&self.input, Input::Zstd(stream) if stream.is_cut())
    }

    /// Reads exactly as many bytes as the buffer has, of `what`, of which `done` of `count` are
    /// read.
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

    /// Unpacks the stream to its end: its checksum then holds.
    pub(super) fn finish(&mut self) -> Result<(), ReadError> {
        // What is behind the attributes are extensions.
        let mut buffer = [0; 4096];
        while self.read(&mut buffer)? > 0 {}
        if self.is_cut {
            return Err(
                self.fail("the file ends early: its data are whole, but not what follows them".into())
            );
        }
        Ok(())
    }
}
