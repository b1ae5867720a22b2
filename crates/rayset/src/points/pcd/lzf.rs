//! LZF (Marc Lehmann's LibLZF), as a stream in memory that does not depend on its size.
//!
//! Data are tokens: up to 32 bytes as they are, or up to 264 bytes that came at most 8 KiB before. Nothing else is remembered
//! from one token to the next, so a decoder can be copied where it stands, and go on from there later.

use std::fs::File;
use std::io::{self, BufReader, Read};
use std::sync::Arc;

use crate::points::stretch::Stretch;

/// Farthest that a token reaches back.
const WINDOW: usize = 8 << 10;
const BUFFER_BYTES: usize = 8 << 10;
/// Memory in bytes of a decoder.
pub(super) const DECODER_BYTES: usize = WINDOW + BUFFER_BYTES + 256;
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

pub(super) struct Lzf {
    file: Arc<File>,
    input: BufReader<Stretch>,
    /// Byte of the file that is next, and that where the data end.
    next: u64,
    end: u64,
    /// The last bytes that were decoded, in a ring; their number is `written`.
    window: Box<[u8; WINDOW]>,
    written: u64,
    token: Token,
}

impl Lzf {
    /// A decoder of the bytes of a file from `start` to `end`.
    pub(super) fn new(file: &Arc<File>, start: u64, end: u64) -> Self {
        Self {
            file: file.clone(),
            input: BufReader::with_capacity(BUFFER_BYTES, Stretch::new(file, start, end)),
            next: start,
            end,
            window: Box::new([0; WINDOW]),
            written: 0,
            token: Token::Plain(0),
        }
    }

    /// Another decoder, which goes on where this one stands.
    pub(super) fn fork(&self) -> Self {
        let stretch = Stretch::new(&self.file, self.next, self.end);
        Self {
            file: self.file.clone(),
            input: BufReader::with_capacity(BUFFER_BYTES, stretch),
            window: self.window.clone(),
            ..*self
        }
    }

    /// Byte of the file that is read next.
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
            let done = match self.token {
                Token::Plain(0) | Token::Copy { left: 0, .. } => {
                    self.next_token()?;
                    continue;
                }
                Token::Plain(left) => {
                    let count = left.min(out.len());
                    self.take(&mut out[..count])?;
                    for &byte in &out[..count] {
                        self.window[self.written as usize % WINDOW] = byte;
                        self.written += 1;
                    }
                    self.token = Token::Plain(left - count);
                    count
                }
                Token::Copy { distance, left } => {
                    let count = left.min(out.len());
                    for byte in &mut out[..count] {
                        *byte = self.window[(self.written - distance as u64) as usize % WINDOW];
                        self.window[self.written as usize % WINDOW] = *byte;
                        self.written += 1;
                    }
                    self.token = Token::Copy { distance, left: left - count };
                    count
                }
            };
            out = &mut out[done..];
        }
        if let Token::Copy { left: 0, .. } = self.token {
            self.token = Token::Plain(0);
        }
        Ok(())
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
