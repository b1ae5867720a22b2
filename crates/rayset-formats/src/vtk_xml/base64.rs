//! Arrays as base64 in elements.

use std::io::{self, BufRead, Read};

use rayset_base::regular_file::held;

/// What is no letter of base64 in [`VALUES`].
const NO_LETTER: u8 = u8::MAX;
/// The six bits of each letter.
const VALUES: [u8; 256] = {
    let letters = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let (mut values, mut bits) = ([NO_LETTER; 256], 0);
    while bits < letters.len() {
        values[letters[bits] as usize] = bits as u8;
        bits += 1;
    }
    values
};

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

    /// Decodes letters that are held in memory, four at a time, up to the first of anything else
    /// and as far as `out` has room for three bytes. Returns the number of bytes.
    fn decode_held(&mut self, out: &mut [u8]) -> io::Result<usize> {
        let held = held(&mut self.text.inner)?;
        let mut groups = 0;
        for (letters, bytes) in held.chunks_exact(4).zip(out.chunks_exact_mut(3)) {
            let [a, b, c, d] = [0, 1, 2, 3].map(|place| VALUES[usize::from(letters[place])]);
            if a | b | c | d == NO_LETTER {
                break;
            }
            bytes.copy_from_slice(&[a << 2 | b >> 4, b << 4 | c >> 2, c << 6 | d]);
            groups += 1;
        }
        self.text.inner.consume(4 * groups);
        Ok(3 * groups)
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
                _ => VALUES[usize::from(letter)],
            };
            if value == NO_LETTER {
                return Err(invalid(format!("`{}` is no letter of base64", letter.escape_ascii())));
            }
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
            if self.at == self.count {
                written += self.decode_held(&mut out[written..])?;
                if written == out.len() || !self.refill()? {
                    break;
                }
            }
            let now = (self.count - self.at).min(out.len() - written);
            out[written..written + now].copy_from_slice(&self.ready[self.at..self.at + now]);
            self.at += now;
            written += now;
        }
        Ok(written)
    }
}

#[cfg(test)]
mod tests {
    use std::io::BufReader;

    use super::*;

    #[test]
    fn base64_is_the_same_bytes_however_it_is_held_and_wherever_there_is_white_space() {
        let text = "AAEC\nAw==\t/+79 /Ow=  6urq\n\n6urq6g==<";
        let expected = [0, 1, 2, 3, 0xff, 0xee, 0xfd, 0xfc, 0xec, 0xea, 0xea, 0xea, 0xea, 0xea, 0xea, 0xea];
        for held in 1..text.len() {
            for step in 1..=expected.len() {
                let mut decoder = Base64::new(UntilTag::new(BufReader::with_capacity(held, text.as_bytes())));
                let (mut found, mut part) = (Vec::new(), vec![0; step]);
                loop {
                    let count = decoder.read(&mut part).expect("base64");
                    found.extend_from_slice(&part[..count]);
                    if count < step {
                        break;
                    }
                }
                assert_eq!(found, expected, "{held} held, {step} at a time");
            }
        }
    }

    #[test]
    fn what_is_no_base64_is_an_error_wherever_it_stands() {
        for (text, part) in [
            ("AAECAwQF!AAA<", "`!` is no letter"),
            ("AAECAw==AA=A<", "behind `=`"),
            ("AAECAAE<", "within four letters"),
        ] {
            let mut decoder = Base64::new(UntilTag::new(text.as_bytes()));
            let said = decoder.read_to_end(&mut Vec::new()).expect_err(text).to_string();
            assert!(said.contains(part), "{said}");
        }
        assert!(Base64::new(UntilTag::new(&b"AAEC"[..])).read_to_end(&mut Vec::new()).is_err(), "no tag");
    }
}
