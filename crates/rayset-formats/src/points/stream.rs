//! A file as a stream of bytes, looked through gzip and zstd if it is compressed.

use std::io::{self, BufRead, BufReader, Read};
use std::path::{Path, PathBuf};

use super::ReadError;
use super::packed::{Packing, Unpacked};
use rayset_base::regular_file::held;
use rayset_store::storage::input_file::InputFile;

/// Size of a read buffer in bytes.
const BUFFER_BYTES: usize = 256 << 10;

/// The bytes of a file in order.
///
/// What begins as gzip or zstd does is decompressed, whatever its name. Errors of the decompressor
/// say whether the file is cut off or damaged, and near which byte.
pub(super) struct Stream {
    path: PathBuf,
    /// Bytes that were looked at, and are still to be read.
    front: io::Cursor<Vec<u8>>,
    input: Input,
    packing: Option<Packing>,
    memory: u64,
}

enum Input {
    Plain(BufReader<InputFile>),
    Packed(Box<BufReader<Unpacked<BufReader<InputFile>>>>),
}

impl Stream {
    /// Opens a file, which may also be a pipe.
    pub(super) fn open(path: &Path) -> Result<Self, ReadError> {
        let mut file =
            BufReader::with_capacity(BUFFER_BYTES, InputFile::open_any(path).map_err(ReadError::io(path))?);
        held(&mut file).map_err(ReadError::io(path))?;
        let packing = Packing::of(file.buffer());
        let mut memory = BUFFER_BYTES as u64;
        let input = match packing {
            None => Input::Plain(file),
            Some(packing) => {
                let (unpacked, more) = Unpacked::new(file, packing).map_err(ReadError::io(path))?;
                memory = 2 * memory + more;
                Input::Packed(Box::new(BufReader::with_capacity(BUFFER_BYTES, unpacked)))
            }
        };
        Ok(Self { path: path.to_owned(), front: io::Cursor::default(), input, packing, memory })
    }

    /// The first `most` bytes, or all that there are, which are read again.
    pub(super) fn head(&mut self, most: u64) -> io::Result<Vec<u8>> {
        let mut head = Vec::new();
        self.take(most).read_to_end(&mut head)?;
        self.front = io::Cursor::new(head.clone());
        Ok(head)
    }

    /// Whether bytes that were looked at are still to be read.
    fn has_front(&self) -> bool {
        self.front.position() < self.front.get_ref().len() as u64
    }

    /// The file.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// How the file is compressed; `None` if it is not.
    pub(super) fn packing(&self) -> Option<Packing> {
        self.packing
    }

    /// Upper bound on the memory in bytes of buffers and decompressor.
    pub(super) fn memory_needed(&self) -> u64 {
        self.memory
    }

    /// Whether it is a file, which can be read again, and no pipe.
    pub(super) fn is_file(&self) -> bool {
        let file = match &self.input {
            Input::Plain(input) => input.get_ref(),
            Input::Packed(input) => input.get_ref().input().get_ref(),
        };
        file.is_file()
    }

    /// Whether bytes can be passed over without reading them.
    pub(super) fn can_seek(&self) -> bool {
        matches!(&self.input, Input::Plain(input) if input.get_ref().is_file())
    }

    /// Passes over bytes, of a file that can be so passed; if it ends before, what is read next
    /// finds the end.
    pub(super) fn seek_forward(&mut self, bytes: u64) -> io::Result<()> {
        match &mut self.input {
            Input::Plain(input) => input.seek_relative(bytes.min(i64::MAX as u64) as i64),
            Input::Packed(input) => io::copy(&mut input.take(bytes), &mut io::sink()).map(drop),
        }
    }

    /// Reads what is left of a compressed file, so that its checksum is found to be right; of
    /// others, nothing.
    pub(super) fn check_rest(&mut self) -> Result<(), ReadError> {
        if let Input::Packed(input) = &mut self.input {
            let rest = io::copy(input, &mut io::sink());
            rest.map_err(ReadError::io(&self.path))?;
        }
        Ok(())
    }
}

impl Read for Stream {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.has_front() {
            return self.front.read(buffer);
        }
        match &mut self.input {
            Input::Plain(input) => input.read(buffer),
            Input::Packed(input) => input.read(buffer),
        }
    }
}

impl BufRead for Stream {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        if self.has_front() {
            return self.front.fill_buf();
        }
        match &mut self.input {
            Input::Plain(input) => input.fill_buf(),
            Input::Packed(input) => input.fill_buf(),
        }
    }

    fn consume(&mut self, bytes: usize) {
        if self.has_front() {
            return self.front.consume(bytes);
        }
        match &mut self.input {
            Input::Plain(input) => input.consume(bytes),
            Input::Packed(input) => input.consume(bytes),
        }
    }
}

impl std::fmt::Debug for Stream {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Stream")
            .field("path", &self.path)
            .field("packing", &self.packing)
            .finish_non_exhaustive()
    }
}
