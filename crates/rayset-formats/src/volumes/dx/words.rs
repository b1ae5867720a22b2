//! The words of a header, between which numbers may stand.

use std::io::{BufRead, BufReader};
use std::path::Path;

use super::super::data::{data_at, io_error, regular_file_bytes};
use crate::words;
use rayset_base::regular_file::held;
use rayset_files::grid::VolumeError;
use rayset_store::storage::input_file::InputFile;

/// Longest header in bytes, without the numbers in it.
const MOST_HEADER_BYTES: u64 = 1 << 20;

/// A word, a number or a text in quotes.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Word {
    pub(super) text: String,
    quoted: bool,
}

impl Word {
    /// Whether it is a keyword.
    pub(super) fn is(&self, keyword: &str) -> bool {
        !self.quoted && self.text == keyword
    }
}

/// Reads words, and counts lines.
pub(super) struct Words<'a> {
    pub(super) path: &'a Path,
    file: BufReader<InputFile>,
    /// The line of the last word, and the offset behind it.
    line: u64,
    at: u64,
    room: u64,
    ahead: Option<Word>,
}

impl<'a> Words<'a> {
    pub(super) fn open(path: &'a Path) -> Result<Self, VolumeError> {
        let file = data_at(path, 0)?;
        Ok(Self { path, file, line: 1, at: 0, room: MOST_HEADER_BYTES, ahead: None })
    }

    pub(super) fn place(&self) -> String {
        format!("line {}", self.line)
    }

    pub(super) fn wrong(&self, what: &str) -> VolumeError {
        VolumeError::header(self.path, &self.place(), what)
    }

    fn byte(&mut self) -> Result<Option<u8>, VolumeError> {
        let held = held(&mut self.file).map_err(io_error(self.path))?;
        let Some(&byte) = held.first() else { return Ok(None) };
        if self.room == 0 {
            return Err(
                self.wrong(&format!("the header goes on beyond {MOST_HEADER_BYTES} bytes; is this OpenDX?"))
            );
        }
        Ok(Some(byte))
    }

    /// Goes on behind a byte that was looked at.
    fn consume(&mut self, byte: u8) {
        self.file.consume(1);
        (self.at, self.room) = (self.at + 1, self.room - 1);
        self.line += u64::from(byte == b'\n');
    }

    /// The next word without taking it. `None` at the end of the file.
    pub(super) fn peek(&mut self) -> Result<Option<&Word>, VolumeError> {
        if self.ahead.is_none() {
            self.ahead = self.read()?;
        }
        Ok(self.ahead.as_ref())
    }

    pub(super) fn next(&mut self) -> Result<Option<Word>, VolumeError> {
        match self.ahead.take() {
            Some(word) => Ok(Some(word)),
            None => self.read(),
        }
    }

    /// The next word, which must be there.
    pub(super) fn expect(&mut self, what: &str) -> Result<Word, VolumeError> {
        self.next()?.ok_or_else(|| self.wrong(&format!("the file ends where {what} was expected")))
    }

    /// A number that must follow.
    pub(super) fn count(&mut self, what: &str) -> Result<u64, VolumeError> {
        let word = self.expect(what)?;
        word.text
            .parse()
            .map_err(|_| self.wrong(&format!("expected {what}, and found `{}`", word.text.escape_debug())))
    }

    /// The numbers that follow.
    pub(super) fn numbers(&mut self) -> Result<Vec<f64>, VolumeError> {
        let mut all = Vec::new();
        while let Some(number) = self.peek()?.and_then(|word| word.text.parse().ok()) {
            all.push(number);
            self.ahead = None;
        }
        Ok(all)
    }

    fn read(&mut self) -> Result<Option<Word>, VolumeError> {
        loop {
            match self.byte()? {
                None => return Ok(None),
                Some(b'#') => self.end_line()?,
                Some(byte) if byte.is_ascii_whitespace() => self.consume(byte),
                Some(_) => break,
            }
        }
        let mut letters = Vec::new();
        let quoted = self.byte()? == Some(b'"');
        if quoted {
            self.consume(b'"');
        }
        while let Some(byte) = self.byte()? {
            if quoted && byte == b'"' {
                self.consume(byte);
                break;
            }
            // What ends a word stays, so that a line ends behind its last one.
            if !quoted && byte.is_ascii_whitespace() {
                break;
            }
            letters.push(byte);
            self.consume(byte);
        }
        Ok(Some(Word { text: String::from_utf8_lossy(&letters).into_owned(), quoted }))
    }

    /// Goes on behind the end of the line. Returns the offset.
    pub(super) fn end_line(&mut self) -> Result<(), VolumeError> {
        while let Some(byte) = self.byte()? {
            self.consume(byte);
            if byte == b'\n' {
                break;
            }
        }
        Ok(())
    }

    /// The offset of the next byte, of a word or not.
    pub(super) fn at(&self) -> u64 {
        self.at
    }

    /// Goes on behind bytes that are no words.
    pub(super) fn skip_bytes(&mut self, bytes: u64) -> Result<(), VolumeError> {
        let end = self.at.saturating_add(bytes);
        if end > regular_file_bytes(self.path)? {
            return Err(self.wrong("the file ends before all the numbers of an array are there"));
        }
        // What is in the buffer already is not read again, however many arrays there are.
        self.file.seek_relative((end - self.at) as i64).map_err(io_error(self.path))?;
        self.at = end;
        Ok(())
    }

    /// Goes on behind numbers in text.
    pub(super) fn skip_numbers(&mut self, count: u64) -> Result<(), VolumeError> {
        let passed = words::pass(&mut self.file, count).map_err(io_error(self.path))?;
        if passed.missing > 0 {
            let what = format!("the file ends before the last {} numbers of an array", passed.missing);
            return Err(self.wrong(&what));
        }
        self.line += passed.lines;
        self.at += passed.bytes;
        Ok(())
    }
}
