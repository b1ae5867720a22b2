//! A part of a file as a stream: nothing beyond its end is ever read.

use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::sync::Arc;

/// Size of the read buffer in bytes.
pub(super) const BUFFER_BYTES: usize = 64 << 10;

/// A range of the bytes of a file. Several stretches of one file have positions of their own, but may only be used by one
/// thread at a time, because the file has a single cursor.
#[derive(Clone)]
pub(super) struct Stretch {
    file: Arc<File>,
    at: u64,
    end: u64,
}

/// A stretch that is read in large pieces.
pub(super) type Input = BufReader<Stretch>;

impl Stretch {
    pub(super) fn new(file: &Arc<File>, at: u64, end: u64) -> Self {
        Self { file: file.clone(), at, end }
    }

    pub(super) fn buffered(self) -> Input {
        BufReader::with_capacity(BUFFER_BYTES, self)
    }

    /// Byte offset in the file of the end of the stretch.
    pub(super) fn end(&self) -> u64 {
        self.end
    }

    /// Moves to another part of the file. If the stretch is buffered, the buffer must be emptied as well.
    pub(super) fn set(&mut self, at: u64, end: u64) {
        (self.at, self.end) = (at, end);
    }
}

impl Read for Stretch {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let left = usize::try_from(self.end.saturating_sub(self.at)).unwrap_or(usize::MAX);
        let room = buffer.len().min(left);
        if room == 0 {
            return Ok(0);
        }
        let mut file = &*self.file;
        file.seek(SeekFrom::Start(self.at))?;
        let read = file.read(&mut buffer[..room])?;
        self.at += read as u64;
        Ok(read)
    }
}

impl Seek for Stretch {
    /// Positions are byte offsets in the file; `SeekFrom::End` counts from the end of the stretch.
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let place = match to {
            SeekFrom::Start(place) => Some(place),
            SeekFrom::Current(distance) => self.at.checked_add_signed(distance),
            SeekFrom::End(distance) => self.end.checked_add_signed(distance),
        };
        self.at = place.ok_or(io::ErrorKind::InvalidInput)?;
        Ok(self.at)
    }
}
