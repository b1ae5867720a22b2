//! Reads and counts the lines of a text file, in bounded memory.

use std::collections::VecDeque;
use std::io::{BufRead, Read};
use std::path::Path;

use super::stream::Stream;
use super::{Place, ReadError};
use crate::regular_file::held;

/// Longest record in bytes, so that a file without line ends or with an unclosed quote needs bounded memory.
pub(super) const RECORD_LIMIT: usize = 1 << 16;

#[derive(Debug)]
pub(super) struct Lines {
    input: Stream,
    /// Number of the line read last, starting at 1.
    number: u64,
    /// Lines that were looked at, and are still to be read.
    ahead: VecDeque<Vec<u8>>,
}

impl Lines {
    /// The file.
    pub(super) fn path(&self) -> &Path {
        self.input.path()
    }

    /// Upper bound on the memory in bytes that reading needs.
    pub(super) fn memory_needed(&self) -> u64 {
        self.input.memory_needed()
    }

    /// Opens a file, and skips a byte-order mark.
    pub(super) fn open(path: &Path) -> Result<Self, ReadError> {
        let mut lines = Self::after(Stream::open(path)?, 0);
        let io = |source| ReadError::Io { path: path.to_owned(), source };
        let start = held(&mut lines.input).map_err(io)?;
        if start.starts_with(b"\xef\xbb\xbf") {
            lines.input.consume(3);
        } else if start.starts_with(b"\xff\xfe") || start.starts_with(b"\xfe\xff") {
            lines.number = 1;
            return Err(lines.fail("the file is UTF-16, as its byte-order mark says; save it as UTF-8"));
        }
        Ok(lines)
    }

    /// The lines after the first `number`, which have been read.
    pub(super) fn after(input: Stream, number: u64) -> Self {
        Self { input, number, ahead: VecDeque::new() }
    }

    /// The next lines, up to `most` of up to `bytes` together, which are read again. Ends before a line that is too long.
    pub(super) fn look_ahead(&mut self, most: usize, bytes: usize) -> Result<Vec<&[u8]>, ReadError> {
        let mut left = bytes;
        while self.ahead.len() < most && left > 0 {
            let mut line = Vec::new();
            let read = (&mut self.input).take(left as u64).read_until(b'\n', &mut line);
            if read.map_err(|source| ReadError::Io { path: self.path().to_owned(), source })? == 0 {
                break;
            }
            left -= line.len();
            self.ahead.push_back(line);
        }
        let whole = self.ahead.iter().filter(|line| line.ends_with(b"\n"));
        Ok(whole.map(|line| line.trim_ascii_end()).collect())
    }

    /// Appends to `record` up to `room` bytes, to the end of a line. Returns their number.
    fn read_on(&mut self, room: usize, record: &mut Vec<u8>) -> std::io::Result<usize> {
        let mut read = 0;
        if let Some(line) = self.ahead.front_mut() {
            read = line.len().min(room);
            record.extend(line.drain(..read));
            if line.is_empty() {
                self.ahead.pop_front();
            }
            // The last that was looked at may have been cut off.
            if record.last() == Some(&b'\n') || read == room || !self.ahead.is_empty() {
                return Ok(read);
            }
        }
        Ok(read + (&mut self.input).take((room - read) as u64).read_until(b'\n', record)?)
    }

    /// Appends the next line to `record` without its line end. Returns false at the end of the file.
    pub(super) fn append(&mut self, record: &mut Vec<u8>) -> Result<bool, ReadError> {
        // Room for `\r\n`, which does not count.
        let room = RECORD_LIMIT + 2 - record.len().min(RECORD_LIMIT);
        let read = self
            .read_on(room, record)
            .map_err(|source| ReadError::Io { path: self.input.path().to_owned(), source })?;
        if read == 0 {
            return Ok(false);
        }
        self.number += 1;
        if record.last() == Some(&b'\n') {
            record.pop();
            if record.last() == Some(&b'\r') {
                record.pop();
            }
        }
        if record.len() > RECORD_LIMIT {
            return Err(self.fail(format!(
                "a line of more than {RECORD_LIMIT} bytes; is this text, and is every quote closed?"
            )));
        }
        Ok(true)
    }

    /// Checks what follows in a compressed file, so that its checksum is found to be right.
    pub(super) fn check_rest(&mut self) -> Result<(), ReadError> {
        self.input.check_rest()
    }

    pub(super) fn number(&self) -> u64 {
        self.number
    }

    /// An error on the line read last.
    pub(super) fn fail(&self, what: impl Into<String>) -> ReadError {
        self.fail_at(self.number, what)
    }

    pub(super) fn fail_at(&self, line: u64, what: impl Into<String>) -> ReadError {
        ReadError::malformed(self.input.path(), Place::Line(line), what)
    }
}
