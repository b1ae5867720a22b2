//! LZF (Marc Lehmann's LibLZF), the compression of PCD and of h5py's filter `lzf`, as a stream in
//! memory that does not depend on its size.
//!
//! Data are tokens: up to 32 bytes as they are, or up to 264 bytes that came at most 8 KiB before.
//! Nothing else is remembered from one token to the next, so a decoder can be copied where it
//! stands, and go on from there later.

use std::io::{self, Read};

/// Farthest that a token reaches back.
const WINDOW: usize = 8 << 10;
/// Most bytes of a token.
#[cfg(feature = "hdf5")]
const MOST_OF_A_TOKEN: usize = 264;
/// Memory in bytes of a decoder, without that of its input.
pub(super) const DECODER_BYTES: usize = WINDOW + 256;
/// Most bytes that come of a byte: 264 of three.
pub(super) const MOST_FOR_A_BYTE: u64 = 88;

/// Why data cannot be decoded.
#[derive(Debug)]
pub(super) enum Damage {
    Io(io::Error),
    /// They end before they should.
    Ends,
    /// They refer to what comes before their beginning.
    BeforeBeginning,
}

/// What is left of a token.
#[derive(Clone, Copy)]
enum Token {
    Plain(usize),
    Copy { distance: usize, left: usize },
}

pub(super) struct Lzf<R> {
    input: R,
    /// Byte that is next in what `input` reads, and that where the data end.
    next: u64,
    end: u64,
    /// The last bytes that were decoded, in a ring; their number is `written`.
    window: Box<[u8; WINDOW]>,
    written: u64,
    token: Token,
}

impl<R: Read> Lzf<R> {
    /// A decoder of the bytes from `start` to `end`, which `input` reads.
    pub(super) fn new(input: R, start: u64, end: u64) -> Self {
        Self { input, next: start, end, window: Box::new([0; WINDOW]), written: 0, token: Token::Plain(0) }
    }

    /// Another decoder, which goes on where this one stands. `input` begins at
    /// [`byte`](Self::byte).
    pub(super) fn fork(&self, input: R) -> Self {
        Self { input, window: self.window.clone(), ..*self }
    }

    /// The byte that is read next.
    pub(super) fn byte(&self) -> u64 {
        self.next
    }

    /// Whether all data have been decoded.
    pub(super) fn is_at_end(&self) -> bool {
        self.next == self.end && matches!(self.token, Token::Plain(0))
    }

    /// Decodes `count` bytes and forgets them.
    pub(super) fn skip(&mut self, mut count: u64) -> Result<(), Damage> {
        let mut part = [0; 4096];
        while count > 0 {
            let now = count.min(4096) as usize;
            self.read(&mut part[..now])?;
            count -= now as u64;
        }
        Ok(())
    }

    /// Decodes as many bytes as `out` has.
    pub(super) fn read(&mut self, mut out: &mut [u8]) -> Result<(), Damage> {
        while !out.is_empty() {
            let done = self.read_token(out)?;
            out = &mut out[done..];
        }
        Ok(())
    }

    /// Decodes what is left of a token, or of the next one, as far as `out` has room. Returns the
    /// number of bytes, which is not 0 unless `out` is empty.
    fn read_token(&mut self, out: &mut [u8]) -> Result<usize, Damage> {
        if let Token::Plain(0) = self.token {
            self.next_token()?;
        }
        match self.token {
            Token::Plain(left) => {
                let count = left.min(out.len());
                self.take(&mut out[..count])?;
                for &byte in &out[..count] {
                    self.window[self.written as usize % WINDOW] = byte;
                    self.written += 1;
                }
                self.token = Token::Plain(left - count);
                Ok(count)
            }
            Token::Copy { distance, left } => {
                let count = left.min(out.len());
                for byte in &mut out[..count] {
                    *byte = self.window[(self.written - distance as u64) as usize % WINDOW];
                    self.window[self.written as usize % WINDOW] = *byte;
                    self.written += 1;
                }
                let left = left - count;
                self.token = if left == 0 { Token::Plain(0) } else { Token::Copy { distance, left } };
                Ok(count)
            }
        }
    }

    fn next_token(&mut self) -> Result<(), Damage> {
        let first = usize::from(self.take_byte()?);
        if first < 32 {
            self.token = Token::Plain(first + 1);
            return Ok(());
        }
        let mut left = (first >> 5) + 2;
        if left == 9 {
            left += usize::from(self.take_byte()?);
        }
        let distance = ((first & 31) << 8 | usize::from(self.take_byte()?)) + 1;
        if distance as u64 > self.written {
            return Err(Damage::BeforeBeginning);
        }
        self.token = Token::Copy { distance, left };
        Ok(())
    }

    fn take_byte(&mut self) -> Result<u8, Damage> {
        let mut byte = [0];
        self.take(&mut byte)?;
        Ok(byte[0])
    }

    fn take(&mut self, out: &mut [u8]) -> Result<(), Damage> {
        self.input.read_exact(out).map_err(|error| match error.kind() {
            io::ErrorKind::UnexpectedEof => Damage::Ends,
            _ => Damage::Io(error),
        })?;
        self.next += out.len() as u64;
        Ok(())
    }
}

/// Decodes data in memory into at most `limit` bytes. `None` if they are damaged, or longer when
/// they are decoded.
#[cfg(feature = "hdf5")]
pub(super) fn decompress(data: &[u8], limit: usize) -> Option<Vec<u8>> {
    let mut decoder = Lzf::new(data, 0, data.len() as u64);
    let mut out = Vec::with_capacity(limit.min(data.len().saturating_mul(4)));
    let mut part = [0; MOST_OF_A_TOKEN];
    while !decoder.is_at_end() {
        let count = decoder.read_token(&mut part).ok()?;
        out.extend_from_slice(&part[..count]);
        if out.len() > limit {
            return None;
        }
    }
    Some(out)
}

#[cfg(all(test, feature = "hdf5"))]
mod tests {
    use super::{Lzf, decompress};

    /// "ab", then 3 + 2 bytes from 2 back; then a long reference of 7 + 1 + 2 bytes from 1 back.
    const DATA: [u8; 8] = [1, b'a', b'b', 3 << 5, 1, 7 << 5, 1, 0];
    const DECODED: &[u8] = b"abababaaaaaaaaaaa";

    #[test]
    fn literals_and_references_are_read_and_damage_is_none() {
        assert_eq!(decompress(&DATA, 64).as_deref(), Some(DECODED));
        assert_eq!(decompress(&DATA, 10), None, "longer than the limit");
        assert_eq!(decompress(&DATA[..7], 64), None, "cut off");
        assert_eq!(decompress(&[1 << 5, 0], 64), None, "before the beginning");
    }

    #[test]
    fn a_decoder_goes_on_wherever_another_stands() {
        for place in 0..DECODED.len() {
            let mut first = Lzf::new(&DATA[..], 0, 8);
            first.skip(place as u64).expect("whole data");
            let mut second = first.fork(&DATA[first.byte() as usize..]);
            let mut rest = vec![0; DECODED.len() - place];
            second.read(&mut rest).expect("whole data");
            assert_eq!(rest, DECODED[place..]);
            assert!(second.is_at_end() && !first.is_at_end());
        }
    }
}
