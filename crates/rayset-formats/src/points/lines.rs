//! Reads and counts the lines of a text file, in bounded memory.

use std::collections::VecDeque;
use std::io::{BufRead, Read};
use std::path::Path;

use super::stream::Stream;
use super::{Place, ReadError};
use rayset_base::regular_file::held;

/// Longest record in bytes, so that a file without line ends or with an unclosed quote needs
/// bounded memory.
pub(super) const RECORD_LIMIT: usize = 1 << 16;

/// Most bytes of 0 behind the last line. A device may have them without end.
const MOST_ZEROS: usize = 64 << 20;

#[derive(Debug)]
pub(super) struct Lines {
    input: Stream,
    /// Number of the line read last, starting at 1.
    number: u64,
    /// Lines that were looked at, and are still to be read.
    ahead: VecDeque<Vec<u8>>,
    /// The byte that ends a line: a carriage return in files that have these and no line feed
    /// behind them.
    end: u8,
}

/// The byte that ends the first line: a carriage return if no line feed follows it, as in old files
/// of a Macintosh.
pub(super) fn first_line_end(start: &[u8]) -> u8 {
    let first = start.iter().position(|byte| b"\r\n".contains(byte));
    let is_return =
        first.is_some_and(|at| start[at] == b'\r' && start.get(at + 1).is_some_and(|&b| b != b'\n'));
    if is_return { b'\r' } else { b'\n' }
}

/// The byte that ends the lines of a text, by all of its start.
fn line_end(start: &[u8]) -> u8 {
    // Files whose lines end with carriage returns have nothing else.
    if start.contains(&b'\n') { b'\n' } else { first_line_end(start) }
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
        Self::of(Stream::open(path)?)
    }

    /// The lines of a stream, which may begin with a byte-order mark.
    pub(super) fn of(input: Stream) -> Result<Self, ReadError> {
        let mut lines = Self::after(input, 0, b'\n');
        let path = lines.path().to_owned();
        let start = held(&mut lines.input).map_err(ReadError::io(&path))?;
        if start.starts_with(b"\xef\xbb\xbf") {
            lines.input.consume(3);
        } else if start.starts_with(b"\xff\xfe") || start.starts_with(b"\xfe\xff") {
            lines.number = 1;
            return Err(lines.fail("the file is UTF-16, as its byte-order mark says; save it as UTF-8"));
        }
        lines.end = line_end(held(&mut lines.input).map_err(ReadError::io(&path))?);
        Ok(lines)
    }

    /// The lines after the first `number`, which have been read; `end` is the byte that ends each.
    pub(super) fn after(input: Stream, number: u64, end: u8) -> Self {
        Self { input, number, ahead: VecDeque::new(), end }
    }

    /// The next lines, up to `most` of up to `bytes` together, which are read again. Ends before a
    /// line that is too long.
    pub(super) fn look_ahead(&mut self, most: usize, bytes: usize) -> Result<Vec<&[u8]>, ReadError> {
        let mut left = bytes;
        while self.ahead.len() < most && left > 0 {
            let mut line = Vec::new();
            let read = (&mut self.input).take(left as u64).read_until(self.end, &mut line);
            if read.map_err(ReadError::io(self.path()))? == 0 {
                break;
            }
            left -= line.len();
            self.ahead.push_back(line);
        }
        let whole = self.ahead.iter().filter(|line| line.last() == Some(&self.end));
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
            if record.last() == Some(&self.end) || read == room || !self.ahead.is_empty() {
                return Ok(read);
            }
        }
        Ok(read + (&mut self.input).take((room - read) as u64).read_until(self.end, record)?)
    }

    /// Appends the next line to `record` without its line end. Returns false at the end of the
    /// file.
    pub(super) fn append(&mut self, record: &mut Vec<u8>) -> Result<bool, ReadError> {
        // Room for `\r\n`, which does not count.
        let room = RECORD_LIMIT + 2 - record.len().min(RECORD_LIMIT);
        let read = self.read_on(room, record).map_err(ReadError::io(self.input.path()))?;
        if read == 0 {
            return Ok(false);
        }
        self.number += 1;
        if record.last() == Some(&self.end) {
            record.pop();
            if self.end == b'\n' && record.last() == Some(&b'\r') {
                record.pop();
            }
        } else if record.last() == Some(&0) && self.ends_with_zeros()? {
            // Room that was set aside for more, and never written.
            let used = record.iter().rposition(|&byte| byte != 0).map_or(0, |last| last + 1);
            record.truncate(used);
            return Ok(used > 0);
        }
        if record.len() > RECORD_LIMIT {
            return Err(self.fail(format!(
                "a line of more than {RECORD_LIMIT} bytes; is this text, and is every quote closed?"
            )));
        }
        Ok(true)
    }

    /// Whether nothing but bytes of 0 follows, which are passed over.
    fn ends_with_zeros(&mut self) -> Result<bool, ReadError> {
        let mut left = MOST_ZEROS;
        loop {
            let path = self.input.path().to_owned();
            let held = held(&mut self.input).map_err(|source| ReadError::Io { path, source })?;
            if left == 0 || held.iter().any(|&byte| byte != 0) {
                return Ok(false);
            }
            let zeros = held.len();
            if zeros == 0 {
                return Ok(true);
            }
            self.input.consume(zeros);
            left = left.saturating_sub(zeros);
        }
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
