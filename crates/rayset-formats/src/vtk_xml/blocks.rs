//! Compressed data of VTK: a table of block sizes, followed by individually compressed blocks.

use std::io::{self, BufRead, Read};

use flate2::{Decompress, FlushDecompress, Status};

use super::document::Tag;
use super::fault::Fault;
use rayset_base::regular_file::held;

/// The format of the length words before data.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Words {
    wide: bool,
    pub(crate) big_endian: bool,
}

impl Words {
    /// As given by the attributes of the outermost element.
    pub(crate) fn of(file: &Tag) -> Result<Self, Fault> {
        let big_endian = match file.attribute("byte_order") {
            None | Some("LittleEndian") => false,
            Some("BigEndian") => true,
            Some(_) => return Err(file.wrong("byte_order", "expected LittleEndian or BigEndian")),
        };
        let wide = match file.attribute("header_type") {
            None | Some("UInt32") => false,
            Some("UInt64") => true,
            Some(_) => return Err(file.wrong("header_type", "expected UInt32 or UInt64")),
        };
        Ok(Self { wide, big_endian })
    }

    pub(super) fn width(self) -> u64 {
        if self.wide { 8 } else { 4 }
    }

    pub(super) fn read(self, data: &mut dyn Read) -> io::Result<u64> {
        let mut bytes = [0; 8];
        let used = self.width() as usize;
        data.read_exact(&mut bytes[..used])?;
        if self.big_endian {
            bytes[..used].reverse();
        }
        Ok(u64::from_le_bytes(bytes))
    }
}

/// The decompressed data of all blocks, as a stream: no whole block is held in memory. Every block
/// must have the compressed and decompressed lengths that were stated for it, and the right
/// checksum.
pub(super) struct Blocks {
    /// The sizes of blocks still to come.
    sizes: Box<dyn BufRead + Send>,
    data: Box<dyn BufRead + Send>,
    words: Words,
    /// The number of blocks after this one, and of all blocks.
    left: u64,
    count: u64,
    /// Decompressed bytes of each block but the last, and of the last.
    block_bytes: [u64; 2],
    /// Whether nothing may follow the last block.
    alone: bool,
    decompress: Decompress,
    /// Compressed bytes of this block still to be read, and decompressed bytes still to be
    /// returned.
    compressed: u64,
    decompressed: u64,
    ended: bool,
}

impl Blocks {
    pub(super) fn new(
        sizes: Box<dyn BufRead + Send>,
        data: Box<dyn BufRead + Send>,
        words: Words,
        count: u64,
        block_bytes: [u64; 2],
        alone: bool,
    ) -> Self {
        Self {
            sizes,
            data,
            words,
            left: count,
            count,
            block_bytes,
            alone,
            decompress: Decompress::new(true),
            compressed: 0,
            decompressed: 0,
            ended: true,
        }
    }

    fn wrong(&self, what: &str) -> io::Error {
        let text = format!("compressed block {} of {}: {what}", self.count - self.left, self.count);
        io::Error::new(io::ErrorKind::InvalidData, text)
    }

    /// Advances to the next block; false after the last.
    fn next_block(&mut self) -> io::Result<bool> {
        if self.left == 0 {
            if self.alone && !held(&mut self.data)?.is_empty() {
                return Err(self.wrong("more data follow it"));
            }
            return Ok(false);
        }
        self.left -= 1;
        self.compressed = self.words.read(&mut self.sizes)?;
        self.decompressed = self.block_bytes[usize::from(self.left == 0)];
        self.decompress.reset(true);
        self.ended = false;
        Ok(true)
    }
}

impl Read for Blocks {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        if out.is_empty() {
            return Ok(0);
        }
        loop {
            if self.ended && !self.next_block()? {
                return Ok(0);
            }
            let held = held(&mut self.data)?;
            if held.is_empty() && self.compressed > 0 {
                return Err(io::ErrorKind::UnexpectedEof.into());
            }
            let held = &held[..held.len().min(usize::try_from(self.compressed).unwrap_or(usize::MAX))];
            // The checksum follows the last byte; room for one more byte shows whether the block is
            // too long.
            let mut spare = [0];
            let whole = self.decompressed == 0;
            let room = out.len().min(usize::try_from(self.decompressed).unwrap_or(usize::MAX));
            let to = if whole { &mut spare[..] } else { &mut out[..room] };
            let before = (self.decompress.total_in(), self.decompress.total_out());
            let status = self.decompress.decompress(held, to, FlushDecompress::None);
            let used = self.decompress.total_in() - before.0;
            let made = self.decompress.total_out() - before.1;
            self.data.consume(used as usize);
            self.compressed -= used;
            let status = status.map_err(|error| self.wrong(&error.to_string()))?;
            if whole && made > 0 {
                return Err(self.wrong("it holds more than was said"));
            }
            self.decompressed -= made;
            match status {
                Status::StreamEnd if self.compressed > 0 => {
                    return Err(self.wrong("it ends before the bytes that were said to be its own"));
                }
                Status::StreamEnd if self.decompressed > 0 => {
                    return Err(self.wrong("it holds less than was said"));
                }
                Status::StreamEnd => self.ended = true,
                _ if used == 0 && made == 0 => {
                    return Err(self.wrong("it does not end within the bytes that were said to be its own"));
                }
                _ => {}
            }
            if made > 0 {
                return Ok(made as usize);
            }
        }
    }
}
