//! The numbers of an array, wherever and however they are stored.

use std::io::{self, BufRead, BufReader, Read};
use std::path::Path;

use super::base64::{Base64, UntilTag};
use super::blocks::{Blocks, Words};
use super::document::{Document, Tag};
use super::fault::{Fault, data_at, what_of};
use rayset_base::text_numbers::{Behind, TextNumber, TextNumbers};

/// Upper bound on the compression ratio of Deflate, which needs at least 2 bits to encode at most
/// 258 bytes.
const MOST_DEFLATED: u64 = 1032;

/// Where binary data are, and how they are encoded.
enum Encoded {
    /// Base64 in the element itself, from this byte of the file on.
    Inline(u64),
    /// Raw bytes in the appended data, from this byte of the file on.
    Raw(u64),
    Base64(u64),
}

/// An array of a file, whose numbers are expected to have this many bytes.
pub(crate) struct DataArray<'a> {
    pub(crate) path: &'a Path,
    pub(crate) document: &'a Document,
    pub(crate) tag: &'a Tag,
    pub(crate) words: Words,
    /// How many numbers it has, and their bytes.
    pub(crate) count: u64,
    pub(crate) bytes: u64,
    pub(crate) file_bytes: u64,
}

/// The numbers of an array.
pub(crate) enum Opened {
    /// As they are, from this byte of the file on. The file has them all.
    Plain(u64),
    /// In a stream.
    Stream {
        data: Box<dyn Read + Send>,
        /// Number of bytes that must follow them: 0 if they come last. `None` if anything may
        /// follow.
        rest: Option<u64>,
        /// Whether they come from text, and so in little-endian order.
        is_text: bool,
    },
}

impl DataArray<'_> {
    /// Opens the numbers. `number` says what they are.
    pub(crate) fn open(&self, number: impl TextNumber + Send + 'static) -> Result<Opened, Fault> {
        match self.tag.attribute("format") {
            Some("ascii") => self.ascii(number),
            Some("binary") => self.encoded(&Encoded::Inline(self.content()?)),
            Some("appended") => self.encoded(&self.appended()?),
            _ => Err(self.tag.wrong("format", "expected ascii, binary or appended")),
        }
    }

    /// The byte offset of the text of the element.
    fn content(&self) -> Result<u64, Fault> {
        self.tag.content.ok_or_else(|| self.tag.wrong("", "the element is empty"))
    }

    fn early(&self, what: &str) -> Fault {
        let what = format!("the file ends before all numbers are there: {what}");
        Fault::Header { place: self.tag.place(""), what }
    }

    fn ascii(&self, number: impl TextNumber + Send + 'static) -> Result<Opened, Fault> {
        let at = self.content()?;
        // At least one digit each, and one separator between two numbers.
        let least = self.count.saturating_mul(2).saturating_sub(1);
        if self.file_bytes - at.min(self.file_bytes) < least {
            return Err(self.early(&format!("{} numbers need at least {least} bytes", self.count)));
        }
        let data = Box::new(TextNumbers::new(data_at(self.path, at)?, number, self.count, Behind::Tag));
        Ok(Opened::Stream { data, rest: Some(0), is_text: true })
    }

    fn appended(&self) -> Result<Encoded, Fault> {
        let wrong = |what| Err(self.tag.wrong("offset", what));
        let Some(offset) = self.tag.attribute("offset").and_then(|text| text.trim().parse::<u64>().ok())
        else {
            return wrong("expected a number of bytes");
        };
        let Some((tag, start)) = &self.document.appended else { return wrong("there is no AppendedData") };
        let Some(at) = start.checked_add(offset).filter(|at| *at < self.file_bytes) else {
            return wrong("is beyond the end of the file");
        };
        match tag.attribute("encoding") {
            Some("raw") => Ok(Encoded::Raw(at)),
            Some("base64") => Ok(Encoded::Base64(at)),
            _ => Err(tag.wrong("encoding", "expected raw or base64")),
        }
    }

    /// Binary data, preceded by words that give their length.
    fn encoded(&self, encoded: &Encoded) -> Result<Opened, Fault> {
        let file = &self.document.file;
        match file.attribute("compressor").filter(|name| !name.is_empty()) {
            None => self.uncompressed(encoded),
            Some("vtkZLibDataCompressor") => self.compressed(encoded),
            Some(_) => {
                Err(file.wrong("compressor", "expected vtkZLibDataCompressor, or none; others are not read: ParaView's File, Save Data writes it so with \
                 Compressor Type ZLib"))
            }
        }
    }

    fn uncompressed(&self, encoded: &Encoded) -> Result<Opened, Fault> {
        let mut data = self.reader(encoded, 0)?;
        let said = self.words.read(&mut data).map_err(|error| unreadable(&error))?;
        self.check_length(said)?;
        let width = self.words.width();
        self.check_room(encoded, width.saturating_add(self.bytes))?;
        if let Encoded::Raw(at) = encoded {
            return Ok(Opened::Plain(at + width));
        }
        // Other arrays may follow in the appended data, but nothing may follow in an element.
        let rest = matches!(encoded, Encoded::Inline(_)).then_some(0);
        Ok(Opened::Stream { data: Box::new(data), rest, is_text: false })
    }

    fn compressed(&self, encoded: &Encoded) -> Result<Opened, Fault> {
        let mut head = self.reader(encoded, 0)?;
        let mut word = || self.words.read(&mut head).map_err(|error| unreadable(&error));
        let [blocks, block_bytes, partial_bytes] = [word()?, word()?, word()?];
        let last_bytes = if partial_bytes == 0 { block_bytes } else { partial_bytes };
        let whole = blocks.checked_sub(1).and_then(|whole| whole.checked_mul(block_bytes));
        let all = whole.and_then(|whole| whole.checked_add(last_bytes)).unwrap_or(0);
        self.check_length(all)?;
        if last_bytes > block_bytes {
            return Err(self.tag.wrong("", "its last compressed block is said to be longer than the others"));
        }
        // The sizes of the blocks are read twice instead of being stored, however many blocks there
        // are.
        let head_bytes = blocks.saturating_add(3).saturating_mul(self.words.width());
        self.check_room(encoded, head_bytes)?;
        let mut compressed_bytes = 0_u64;
        for _ in 0..blocks {
            compressed_bytes = compressed_bytes.saturating_add(word()?);
        }
        self.check_room(encoded, head_bytes.saturating_add(compressed_bytes))?;
        if self.bytes / MOST_DEFLATED > compressed_bytes {
            let what =
                format!("{compressed_bytes} compressed bytes cannot hold the {} of its numbers", self.bytes);
            return Err(self.early(&what));
        }
        let sizes = self.reader(encoded, 3 * self.words.width())?;
        let data = self.reader(encoded, head_bytes)?;
        let alone = matches!(encoded, Encoded::Inline(_));
        let blocks = Blocks::new(sizes, data, self.words, blocks, [block_bytes, last_bytes], alone);
        Ok(Opened::Stream { data: Box::new(blocks), rest: Some(0), is_text: false })
    }

    /// A reader of the decoded data after the first `skip` bytes.
    fn reader(&self, encoded: &Encoded, skip: u64) -> Result<Box<dyn BufRead + Send>, Fault> {
        let (Encoded::Inline(at) | Encoded::Raw(at) | Encoded::Base64(at)) = *encoded;
        if let Encoded::Raw(_) = encoded {
            return Ok(Box::new(data_at(self.path, at.saturating_add(skip))?));
        }
        let mut data = BufReader::with_capacity(1 << 16, Base64::new(UntilTag::new(data_at(self.path, at)?)));
        let skipped = io::copy(&mut Read::by_ref(&mut data).take(skip), &mut io::sink());
        skipped.map_err(|error| unreadable(&error))?;
        Ok(Box::new(data))
    }

    fn check_length(&self, said: u64) -> Result<(), Fault> {
        if said == self.bytes {
            return Ok(());
        }
        let what = format!("it is said to hold {said} bytes, and its element asks for {}", self.bytes);
        Err(self.tag.wrong("", &what))
    }

    /// Checks that the file is large enough for this number of decoded bytes.
    fn check_room(&self, encoded: &Encoded, bytes: u64) -> Result<(), Fault> {
        let (Encoded::Inline(at) | Encoded::Raw(at) | Encoded::Base64(at)) = *encoded;
        let left = self.file_bytes.saturating_sub(at);
        let room = if let Encoded::Raw(_) = encoded { left } else { left / 4 * 3 };
        if bytes <= room {
            return Ok(());
        }
        Err(self.early(&format!("{bytes} bytes of data are said to follow, and there is room for {room}")))
    }
}

fn unreadable(error: &io::Error) -> Fault {
    Fault::Data(what_of(error))
}
