//! Reads and counts the lines of a text file, in bounded memory.

use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};

use super::{Place, ReadError};

/// Longest record in bytes, so that a file without line ends or with an unclosed quote needs bounded memory.
pub(super) const RECORD_LIMIT: usize = 1 << 16;

#[derive(Debug)]
pub(super) struct Lines {
    path: PathBuf,
    input: BufReader<File>,
    /// Number of the line read last, starting at 1.
    number: u64,
}

impl Lines {
    /// The file.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Opens a file, and skips a byte-order mark.
    pub(super) fn open(path: &Path) -> Result<Self, ReadError> {
        let path = path.to_owned();
        let file = File::open(&path).map_err(|source| ReadError::Io { path: path.clone(), source })?;
        let mut lines = Self { path, input: BufReader::with_capacity(256 << 10, file), number: 0 };
        let start =
            lines.input.fill_buf().map_err(|source| ReadError::Io { path: lines.path.clone(), source })?;
        if start.starts_with(b"\xef\xbb\xbf") {
            lines.input.consume(3);
        } else if start.starts_with(b"\xff\xfe") || start.starts_with(b"\xfe\xff") {
            lines.number = 1;
            return Err(lines.fail("the file is UTF-16, as its byte-order mark says; save it as UTF-8"));
        }
        Ok(lines)
    }

    /// Appends the next line to `record` without its line end. Returns false at the end of the file.
    pub(super) fn append(&mut self, record: &mut Vec<u8>) -> Result<bool, ReadError> {
        // Room for `\r\n`, which does not count.
        let room = RECORD_LIMIT + 2 - record.len().min(RECORD_LIMIT);
        let read = (&mut self.input)
            .take(room as u64)
            .read_until(b'\n', record)
            .map_err(|source| ReadError::Io { path: self.path.clone(), source })?;
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

    pub(super) fn number(&self) -> u64 {
        self.number
    }

    /// An error on the line read last.
    pub(super) fn fail(&self, what: impl Into<String>) -> ReadError {
        self.fail_at(self.number, what)
    }

    pub(super) fn fail_at(&self, line: u64, what: impl Into<String>) -> ReadError {
        ReadError::malformed(&self.path, Place::Line(line), what)
    }
}
