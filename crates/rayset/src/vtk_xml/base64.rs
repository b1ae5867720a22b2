//! Arrays as base64 in elements.

use std::io::{self, BufRead, Read};

use crate::regular_file::held;

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

    /// The next character that is no white space. `None` at the end of the text.
    fn letter(&mut self) -> io::Result<Option<u8>> {
        loop {
            let Some(&byte) = held(&mut self.inner)?.first() else {
                return Err(io::ErrorKind::UnexpectedEof.into());
            };
            if byte == b'<' {
                return Ok(None);
            }
            self.inner.consume(1);
            if !byte.is_ascii_whitespace() {
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
            let Some(letter) = self.text.letter()? else {
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
