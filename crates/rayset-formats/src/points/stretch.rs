//! A part of a file as a stream: nothing beyond its end is ever read.

use std::io::{self, BufReader, Read, Seek, SeekFrom};

use rayset_store::storage::input_file::{self, Shared};

/// Size of the read buffer in bytes.
pub(super) const BUFFER_BYTES: usize = 64 << 10;

/// A range of the bytes of a file. Several stretches of one file have positions of their own.
#[derive(Clone)]
pub(super) struct Stretch {
    file: Shared,
    at: u64,
    end: u64,
}

/// A stretch that is read in large pieces.
pub(super) type Input = BufReader<Stretch>;

impl Stretch {
    pub(super) fn new(file: &Shared, at: u64, end: u64) -> Self {
        Self { file: file.clone(), at, end }
    }

    pub(super) fn buffered(self) -> Input {
        BufReader::with_capacity(BUFFER_BYTES, self)
    }

    /// Byte offset in the file of the end of the stretch.
    pub(super) fn end(&self) -> u64 {
        self.end
    }

    /// Moves to another part of the file. If the stretch is buffered, the buffer must be emptied as
    /// well.
    pub(super) fn set(&mut self, at: u64, end: u64) {
        (self.at, self.end) = (at, end);
    }
}

impl Read for Stretch {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let read = self.file.read(buffer, self.at, self.end)?;
        self.at += read as u64;
        Ok(read)
    }
}

impl Seek for Stretch {
    /// Positions are byte offsets in the file; `SeekFrom::End` counts from the end of the stretch.
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.at = input_file::place_of(to, self.at, self.end)?;
        Ok(self.at)
    }
}
