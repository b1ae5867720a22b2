//! Numbers in text, separated by white space, as a stream of their little-endian bytes.

use std::io::{self, BufRead, Read};

use crate::regular_file::held;

/// Largest number of characters of a number.
const MOST_LETTERS: usize = 64;

/// The type of the numbers of an array.
pub trait TextNumber {
    /// Parses a number and returns its little-endian bytes and their count. `None` if the text is
    /// not a number of this type, or is out of range.
    fn parse(&self, text: &str) -> Option<([u8; 8], usize)>;
    /// The name of the type, as in `u8`.
    fn type_name(&self) -> String;
}

/// Implements [`TextNumber::parse`]'s conversion: the bytes of a number of type `$t` in `$text`.
#[macro_export]
macro_rules! bytes_of {
    ($text:expr, $t:ty) => {{
        let number = $text.parse::<$t>().ok()?.to_le_bytes();
        let mut bytes = [0; 8];
        bytes[..number.len()].copy_from_slice(&number);
        Some((bytes, number.len()))
    }};
}

/// What follows the last number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Behind {
    /// A tag, as in XML.
    Tag,
    /// White space: a number that ends with the file may be cut off.
    Space,
    /// White space, or nothing.
    Anything,
}

/// Reads exactly `count` numbers.
pub struct TextNumbers<R, N> {
    text: R,
    number: N,
    count: u64,
    behind: Behind,
    done: u64,
    ready: [u8; 8],
    /// The range of `ready` that has not been returned yet.
    at: usize,
    end: usize,
}

fn invalid(what: String) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, what)
}

impl<R: BufRead, N: TextNumber> TextNumbers<R, N> {
    /// Reads `count` numbers of the type `number` from `text`, and then what is to stand behind
    /// them.
    pub fn new(text: R, number: N, count: u64, behind: Behind) -> Self {
        Self { text, number, count, behind, done: 0, ready: [0; 8], at: 0, end: 0 }
    }

    /// The next word, as its length in `letters`; 0 at the end of the text, or before a tag.
    fn word(&mut self, letters: &mut [u8; MOST_LETTERS]) -> io::Result<usize> {
        let tag_follows = self.behind == Behind::Tag;
        let mut length = 0;
        loop {
            let held = held(&mut self.text)?;
            if held.is_empty() {
                let cut_off = tag_follows || self.behind == Behind::Space && length > 0;
                return if cut_off { Err(io::ErrorKind::UnexpectedEof.into()) } else { Ok(length) };
            }
            let mut used = 0;
            for &byte in held {
                if tag_follows && byte == b'<' {
                    self.text.consume(used);
                    return Ok(length);
                }
                used += 1;
                if !byte.is_ascii_whitespace() {
                    let Some(letter) = letters.get_mut(length) else {
                        let what = format!("number {} has more than {MOST_LETTERS} letters", self.done + 1);
                        return Err(invalid(what));
                    };
                    *letter = byte;
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
        if self.done == self.count && self.behind != Behind::Tag {
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
        let number = std::str::from_utf8(word).ok().and_then(|word| self.number.parse(word));
        let (ready, end) = number.ok_or_else(|| {
            let kind = self.number.type_name();
            invalid(format!("number {}: `{}` is no {kind}", self.done + 1, word.escape_ascii()))
        })?;
        (self.ready, self.at, self.end) = (ready, 0, end);
        self.done += 1;
        Ok(true)
    }
}

impl<R: BufRead, N: TextNumber> Read for TextNumbers<R, N> {
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

#[cfg(test)]
mod tests {
    use super::*;

    struct Single;

    impl TextNumber for Single {
        fn parse(&self, text: &str) -> Option<([u8; 8], usize)> {
            bytes_of!(text, f32)
        }

        fn type_name(&self) -> String {
            "f32".into()
        }
    }

    /// Text of which a signal interrupts every second read, and each read gives a single letter.
    struct Interrupted<'a>(&'a [u8], bool);

    impl Read for Interrupted<'_> {
        fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
            self.1 = !self.1;
            if self.1 { Err(io::ErrorKind::Interrupted.into()) } else { (&mut self.0).take(1).read(out) }
        }
    }

    fn read(text: &str, count: u64, behind: Behind) -> Result<Vec<f32>, String> {
        let text = io::BufReader::new(Interrupted(text.as_bytes(), false));
        let mut bytes = Vec::new();
        let read = TextNumbers::new(text, Single, count, behind).read_to_end(&mut bytes);
        read.map_err(|error| error.to_string())?;
        Ok(bytes.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect())
    }

    #[test]
    fn numbers_are_whole_however_often_a_signal_interrupts_reading_them() {
        assert_eq!(read(" 12.5\n-3 400 ", 3, Behind::Space), Ok(vec![12.5, -3.0, 400.0]));
        assert_eq!(read("12.5 -3<", 2, Behind::Tag), Ok(vec![12.5, -3.0]));
        assert_eq!(read("12.5 -3", 2, Behind::Anything), Ok(vec![12.5, -3.0]));
    }

    #[test]
    fn too_few_too_many_and_too_long_numbers_are_errors() {
        assert!(read("1 2", 2, Behind::Space).is_err(), "the last may be cut off");
        assert!(read("1 2 ", 2, Behind::Tag).is_err(), "no tag follows");
        let said = |text: &str, behind| read(text, 2, behind).expect_err("damaged");
        assert!(said("1 2 3<", Behind::Tag).contains("goes on behind its 2"));
        assert!(said("1<", Behind::Tag).contains("ends after 1 numbers of 2"));
        assert!(said("1 x ", Behind::Space).contains("number 2: `x` is no f32"));
        let long = format!("0.{} 2 ", "5".repeat(63));
        assert!(said(&long, Behind::Space).contains("number 1 has more than 64 letters"));
    }
}
