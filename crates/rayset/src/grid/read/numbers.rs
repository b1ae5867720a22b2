//! Numbers in text, separated by white space.

use std::io::{self, BufRead, Read};

use super::stored::Stored;

/// Largest number of characters of a number.
const MOST_LETTERS: usize = 64;

fn invalid(what: String) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, what)
}

/// Reads exactly `count` numbers as little-endian bytes.
pub(super) struct Numbers<R> {
    text: R,
    stored: Stored,
    count: u64,
    /// Whether a tag must follow the last number, as in XML. Otherwise, what follows is not looked at.
    tag_follows: bool,
    done: u64,
    ready: [u8; 8],
    /// The range of `ready` that has not been returned yet.
    at: usize,
    end: usize,
}

impl<R: BufRead> Numbers<R> {
    pub(super) fn new(text: R, stored: Stored, count: u64, tag_follows: bool) -> Self {
        Self { text, stored, count, tag_follows, done: 0, ready: [0; 8], at: 0, end: 0 }
    }

    /// The next word, as its length in `letters`; 0 at the end of the text, or before a tag. A word ends with white space or
    /// a tag: at the end of the file, it may be cut off.
    fn word(&mut self, letters: &mut [u8; MOST_LETTERS]) -> io::Result<usize> {
        let mut length = 0;
        loop {
            let held = self.text.fill_buf()?;
            if held.is_empty() {
                let cut_off = self.tag_follows || length > 0;
                return if cut_off { Err(io::ErrorKind::UnexpectedEof.into()) } else { Ok(0) };
            }
            let mut used = 0;
            for &byte in held {
                if self.tag_follows && byte == b'<' {
                    self.text.consume(used);
                    return Ok(length);
                }
                used += 1;
                if !byte.is_ascii_whitespace() && length < MOST_LETTERS {
                    letters[length] = byte;
                    length += 1;
                } else if length > 0 {
                    self.text.consume(used);
                    return Ok(length);
                }
            }
            self.text.consume(used);
        }
    }

    /// Reads the next number; false at the end.
    fn refill(&mut self) -> io::Result<bool> {
        if self.done == self.count && !self.tag_follows {
            return Ok(false);
        }
        let mut letters = [0; MOST_LETTERS];
        let length = self.word(&mut letters)?;
        let word = &letters[..length];
        match (word.is_empty(), self.done == self.count) {
            (true, true) => return Ok(false),
            (true, false) => {
                return Err(invalid(format!("the array ends after {} numbers of {}", self.done, self.count)));
            }
            (false, true) => {
                return Err(invalid(format!("the array goes on behind its {} numbers", self.count)));
            }
            (false, false) => {}
        }
        let number = std::str::from_utf8(word).ok().and_then(|word| self.stored.parse(word));
        let (ready, end) = number.ok_or_else(|| {
            let kind = format!("{:?}", self.stored).to_lowercase();
            invalid(format!("number {}: `{}` is no {kind}", self.done + 1, word.escape_ascii()))
        })?;
        (self.ready, self.at, self.end) = (ready, 0, end);
        self.done += 1;
        Ok(true)
    }
}

impl<R: BufRead> Read for Numbers<R> {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        let mut written = 0;
        while written < out.len() {
            if self.at == self.end && !self.refill()? {
                break;
            }
            let now = (self.end - self.at).min(out.len() - written);
            out[written..written + now].copy_from_slice(&self.ready[self.at..self.at + now]);
            self.at += now;
            written += now;
        }
        Ok(written)
    }
}
