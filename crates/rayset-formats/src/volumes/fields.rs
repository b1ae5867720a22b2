//! Text headers: lines, and the numbers in them.

use std::io::{BufRead, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use super::data::{data_at, io_error, regular_file_bytes};
use crate::words;
use rayset_files::grid::VolumeError;
use rayset_store::storage::input_file::InputFile;

/// Longest header in bytes. This bounds the memory for a file without line ends.
const MOST_HEADER_BYTES: u64 = 1 << 20;

/// Reads and counts the lines of a text header.
pub(super) struct Lines {
    file: BufReader<InputFile>,
    path: PathBuf,
    /// The number of the last line that was read; the first is 1.
    pub(super) number: u64,
    /// Bytes read so far, up to the end of the last line.
    pub(super) bytes: u64,
    /// Bytes that the lines still to come may have.
    room: u64,
}

impl Lines {
    pub(super) fn open(path: &Path) -> Result<Self, VolumeError> {
        Ok(Self {
            file: data_at(path, 0)?,
            path: path.to_owned(),
            number: 0,
            bytes: 0,
            room: MOST_HEADER_BYTES,
        })
    }

    /// The next line without its line end (`\n` or `\r\n`). `None` at the end of the file.
    pub(super) fn next(&mut self) -> Result<Option<String>, VolumeError> {
        self.number += 1;
        let room = self.room;
        let mut line = Vec::new();
        let read = Read::by_ref(&mut self.file).take(room).read_until(b'\n', &mut line);
        let read = read.map_err(io_error(&self.path))? as u64;
        self.bytes += read;
        self.room -= read;
        if read == room {
            let place = format!("line {}", self.number);
            let what = format!("the header goes on beyond {MOST_HEADER_BYTES} bytes; is this such a file?");
            return Err(VolumeError::Header { path: self.path.clone(), place, what });
        }
        // Comments and names may be in any encoding; keys and numbers are ASCII.
        let text = String::from_utf8_lossy(&line);
        Ok((read > 0).then(|| text.trim_end_matches('\n').trim_end_matches('\r').to_owned()))
    }

    /// Goes on behind this number of bytes, which are no lines. False if the file ends before.
    pub(super) fn skip_bytes(&mut self, bytes: u64) -> Result<bool, VolumeError> {
        let end = self.bytes.saturating_add(bytes);
        if end > regular_file_bytes(&self.path)? {
            return Ok(false);
        }
        self.file.seek(SeekFrom::Start(end)).map_err(io_error(&self.path))?;
        self.bytes = end;
        Ok(true)
    }

    /// Goes on behind this number of words between white space, which are no lines. False if the
    /// file ends before.
    pub(super) fn skip_words(&mut self, words: u64) -> Result<bool, VolumeError> {
        let passed = words::pass(&mut self.file, words).map_err(io_error(&self.path))?;
        self.bytes += passed.bytes;
        Ok(passed.missing == 0)
    }

    /// The current place for messages: "line 7", or "line 7, key".
    pub(super) fn place(&self, key: &str) -> String {
        if key.is_empty() { format!("line {}", self.number) } else { format!("line {}, {key}", self.number) }
    }
}

/// Parses exactly `N` whitespace-separated finite numbers.
pub(super) fn numbers<const N: usize>(text: &str) -> Option<[f64; N]> {
    parsed(text).filter(|all: &[f64; N]| all.iter().all(|v| v.is_finite()))
}

/// Parses three numbers of voxels.
pub(super) fn counts(text: &str) -> Option<[u64; 3]> {
    parsed(text)
}

/// Parses exactly `N` whitespace-separated values.
pub(super) fn parsed<T: std::str::FromStr, const N: usize>(text: &str) -> Option<[T; N]> {
    // One value more than expected shows that there are too many; further ones are not read.
    let all: Option<Vec<T>> =
        text.split_ascii_whitespace().take(N + 1).map(|word| word.parse().ok()).collect();
    all.and_then(|all| all.try_into().ok())
}
