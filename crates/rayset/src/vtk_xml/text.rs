//! Arrays as text in elements: base64, and ASCII numbers.

use std::io::{self, BufRead, Read};

/// Largest number of characters of a number.
const MOST_LETTERS: usize = 64;

fn invalid(what: String) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, what)
}

/// The text of an element, which ends at the next tag.
pub(super) struct UntilTag<R> {
    inner: R,
}

impl<R: BufRead> UntilTag<R> {
    pub(super) fn new(inner: R) -> Self {
        Self { inner }
    }

    /// The next character; white space is skipped unless `spaces`. `None` at the end of the text.
    fn letter(&mut self, spaces: bool) -> io::Result<Option<u8>> {
        loop {
            let Some(&byte) = self.inner.fill_buf()?.first() else {
                return Err(io::ErrorKind::UnexpectedEof.into());
            };
            if byte == b'<' {
                return Ok(None);
            }
            self.inner.consume(1);
            if spaces || !byte.is_ascii_whitespace() {
                return Ok(Some(byte));
            }
        }
    }
}

/// Decodes base64 in one or several pieces, each with its own padding.
pub(super) struct Base64<R> {
    text: UntilTag<R>,
    ready: [u8; 3],
    count: usize,
    at: usize,
}

impl<R: BufRead> Base64<R> {
    pub(super) fn new(text: UntilTag<R>) -> Self {
        Self { text, ready: [0; 3], count: 0, at: 0 }
    }

    /// Decodes the next four characters; false at the end.
    fn refill(&mut self) -> io::Result<bool> {
        let (mut bits, mut padding) = (0_u32, 0);
        for place in 0..4 {
            let Some(letter) = self.text.letter(false)? else {
                let whole = place == 0;
                return if whole {
                    Ok(false)
                } else {
                    Err(invalid("base64 that ends within four letters".into()))
                };
            };
            let value = match letter {
                b'=' if place >= 2 => {
                    padding += 1;
                    0
                }
                _ if padding > 0 => return Err(invalid("base64 with a letter behind `=`".into())),
                b'A'..=b'Z' => letter - b'A',
                b'a'..=b'z' => letter - b'a' + 26,
                b'0'..=b'9' => letter - b'0' + 52,
                b'+' => 62,
                b'/' => 63,
                _ => return Err(invalid(format!("`{}` is no letter of base64", letter.escape_ascii()))),
            };
            bits = bits << 6 | u32::from(value);
        }
        self.ready = [(bits >> 16) as u8, (bits >> 8) as u8, bits as u8];
        (self.count, self.at) = (3 - padding, 0);
        Ok(true)
    }
}

impl<R: BufRead> Read for Base64<R> {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        let mut written = 0;
        while written < out.len() {
            if self.at == self.count && !self.refill()? {
                break;
            }
            let now = (self.count - self.at).min(out.len() - written);
            out[written..written + now].copy_from_slice(&self.ready[self.at..self.at + now]);
            self.at += now;
            written += now;
        }
        Ok(written)
    }
}

/// The type of the numbers of an array.
pub(crate) trait Number {
    /// Parses a number and returns its little-endian bytes and their count. `None` if the text is not a number of this
    /// type, or is out of range.
    fn parse(&self, text: &str) -> Option<([u8; 8], usize)>;
    /// The name of the type, as in `u8`.
    fn name(&self) -> String;
}

/// Reads exactly `count` numbers separated by white space, as little-endian bytes.
pub(super) struct Ascii<R, N> {
    text: UntilTag<R>,
    number: N,
    count: u64,
    done: u64,
    ready: [u8; 8],
    /// The range of `ready` that has not been returned yet.
    at: usize,
    end: usize,
}

impl<R: BufRead, N: Number> Ascii<R, N> {
    pub(super) fn new(text: UntilTag<R>, number: N, count: u64) -> Self {
        Self { text, number, count, done: 0, ready: [0; 8], at: 0, end: 0 }
    }

    /// Reads the next number; false at the end.
    fn refill(&mut self) -> io::Result<bool> {
        let Some(first) = self.text.letter(false)? else {
            if self.done == self.count {
                return Ok(false);
            }
            return Err(invalid(format!("the array ends after {} numbers of {}", self.done, self.count)));
        };
        if self.done == self.count {
            return Err(invalid(format!("the array goes on behind its {} numbers", self.count)));
        }
        let mut word = vec![first];
        while let Some(letter) = self.text.letter(true)?.filter(|letter| !letter.is_ascii_whitespace()) {
            word.push(letter);
            if word.len() > MOST_LETTERS {
                break;
            }
        }
        let number = std::str::from_utf8(&word).ok().and_then(|word| self.number.parse(word));
        let (ready, end) = number.ok_or_else(|| {
            let kind = self.number.name();
            invalid(format!("number {}: `{}` is no {kind}", self.done + 1, word.escape_ascii()))
        })?;
        (self.ready, self.at, self.end) = (ready, 0, end);
        self.done += 1;
        Ok(true)
    }
}

impl<R: BufRead, N: Number> Read for Ascii<R, N> {
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
