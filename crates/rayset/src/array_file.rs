//! Files of NumPy: the header of an array (`.npy`), and archives of arrays (`.npz`), which are ZIP files.
//!
//! The layout of the header is that of `numpy.lib.format`, versions 1 to 3; that of archives is PKWARE's APPNOTE, with
//! members that are stored or deflated, beyond 4 GiB, too.

use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use flate2::Crc;
use flate2::read::DeflateDecoder;

use crate::regular_file;

const MAGIC: &[u8; 6] = b"\x93NUMPY";
/// Longest header in bytes. NumPy itself refuses those of more than 10 000 unless it is told not to.
const MOST_HEADER_BYTES: u64 = 1 << 20;

/// What precedes the numbers of an array.
#[derive(Debug, PartialEq)]
pub(crate) struct ArrayHeader {
    /// Elements along each axis.
    pub(crate) shape: Vec<u64>,
    /// Whether the first index is the fastest; otherwise, the last is.
    pub(crate) fortran: bool,
    /// The type of an element, as in `<f4`, or the list of a record's fields, as it is written.
    pub(crate) descr: String,
    /// Length of the header: the offset of the first element.
    pub(crate) bytes: u64,
}

impl ArrayHeader {
    /// Reads a header from the beginning of an array. An error says what is wrong with it.
    pub(crate) fn read(data: &mut dyn Read) -> Result<Self, String> {
        let mut head = [0; 8];
        let short = |_| "the file ends within the header of the array".to_owned();
        data.read_exact(&mut head).map_err(short)?;
        if !head.starts_with(MAGIC) {
            return Err("this is not an array of NumPy: it begins with \\x93NUMPY".into());
        }
        let mut length = [0; 4];
        let length_bytes = match head[6] {
            1 => 2,
            2 | 3 => 4,
            other => return Err(format!("version {other} of the format; 1 to 3 are read")),
        };
        data.read_exact(&mut length[..length_bytes]).map_err(short)?;
        let length = u64::from(u32::from_le_bytes(length));
        if length > MOST_HEADER_BYTES {
            return Err(format!("a header of {length} bytes; at most {MOST_HEADER_BYTES} are read"));
        }
        let mut text = Vec::new();
        let read = data.take(length).read_to_end(&mut text).map_err(short)?;
        if (read as u64) < length {
            return Err("the file ends within the header of the array".into());
        }
        let text = String::from_utf8_lossy(&text);
        let bytes = 8 + length_bytes as u64 + length;
        Self::parse(&text, bytes).ok_or_else(|| {
            let text: String = text.trim().chars().take(80).collect();
            format!("expected {{'descr': ..., 'fortran_order': ..., 'shape': ...}}, and found `{text}`")
        })
    }

    fn parse(text: &str, bytes: u64) -> Option<Self> {
        let inside = text.trim().strip_prefix('{')?.strip_suffix('}')?;
        let (mut shape, mut fortran, mut descr) = (None, None, None);
        for item in items(inside) {
            let (key, value) = item.split_once(':')?;
            let value = value.trim();
            match unquoted(key.trim())? {
                "shape" => {
                    let numbers = value.strip_prefix('(')?.strip_suffix(')')?;
                    // Python 2 wrote long numbers as 7L.
                    let numbers = items(numbers).into_iter().map(|n| n.trim_end_matches('L').parse().ok());
                    shape = Some(numbers.collect::<Option<Vec<u64>>>()?);
                }
                "fortran_order" => fortran = Some(value == "True"),
                "descr" => descr = Some(unquoted(value).unwrap_or(value).to_owned()),
                _ => return None,
            }
        }
        Some(Self { shape: shape?, fortran: fortran?, descr: descr?, bytes })
    }
}

/// The parts between commas that are neither in quotes nor in brackets; empty ones are left out.
fn items(text: &str) -> Vec<&str> {
    let (mut depth, mut quote, mut start) = (0_i32, None, 0);
    let mut found = Vec::new();
    for (at, letter) in text.char_indices() {
        match letter {
            _ if quote == Some(letter) => quote = None,
            _ if quote.is_some() => {}
            '\'' | '"' => quote = Some(letter),
            '(' | '[' | '{' => depth += 1,
            ')' | ']' | '}' => depth -= 1,
            ',' if depth == 0 => {
                found.push(text[start..at].trim());
                start = at + 1;
            }
            _ => {}
        }
    }
    found.push(text[start..].trim());
    found.retain(|item| !item.is_empty());
    found
}

fn unquoted(text: &str) -> Option<&str> {
    let quote = text.chars().next().filter(|letter| matches!(letter, '\'' | '"'))?;
    text.strip_prefix(quote)?.strip_suffix(quote)
}

/// Signatures of the parts of an archive.
const LOCAL: &[u8] = b"PK\x03\x04";
const CENTRAL: &[u8] = b"PK\x01\x02";
const END: &[u8] = b"PK\x05\x06";
const END_64: &[u8] = b"PK\x06\x06";
const LOCATOR_64: &[u8] = b"PK\x06\x07";

const LOCAL_BYTES: usize = 30;
const CENTRAL_BYTES: usize = 46;
const END_BYTES: usize = 22;
const LOCATOR_64_BYTES: u64 = 20;
/// The end of an archive may be followed by a comment of this length.
const MOST_COMMENT_BYTES: u64 = 0xffff;
/// An archive of more arrays than this is refused.
const MOST_MEMBERS: u64 = 1 << 16;
/// Upper bound on the compression ratio of Deflate.
const MOST_DEFLATED: u64 = 1032;

/// An array, or another file, in an archive.
#[derive(Debug)]
pub(crate) struct Member {
    pub(crate) name: String,
    /// Its length in bytes.
    pub(crate) bytes: u64,
    packed_bytes: u64,
    method: u16,
    encrypted: bool,
    crc: u32,
    /// The offset of its local header.
    at: u64,
}

fn invalid(what: impl Into<String>) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, what.into())
}

fn u16_at(bytes: &[u8], at: usize) -> u16 {
    u16::from_le_bytes([bytes[at], bytes[at + 1]])
}

fn u32_at(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
}

fn u64_at(bytes: &[u8], at: usize) -> u64 {
    u64::from(u32_at(bytes, at)) | u64::from(u32_at(bytes, at + 4)) << 32
}

/// Whether a file begins as archives do.
pub(crate) fn is_archive(head: &[u8]) -> bool {
    head.starts_with(LOCAL)
}

/// The members of an archive, in its own order.
pub(crate) fn members(path: &Path) -> io::Result<Vec<Member>> {
    let mut file = BufReader::new(regular_file::open(path)?);
    let length = file.get_ref().metadata()?.len();
    let (count, start) = directory(&mut file, length)?;
    if count > MOST_MEMBERS {
        return Err(invalid(format!("an archive of {count} files; at most {MOST_MEMBERS} are read")));
    }
    file.seek(SeekFrom::Start(start))?;
    (0..count).map(|_| Member::read(&mut file)).collect()
}

/// The number of members, and the offset of the list of them.
fn directory(file: &mut BufReader<File>, length: u64) -> io::Result<(u64, u64)> {
    let tail_bytes = length.min(END_BYTES as u64 + MOST_COMMENT_BYTES);
    file.seek(SeekFrom::Start(length - tail_bytes))?;
    let mut tail = Vec::new();
    file.by_ref().take(tail_bytes).read_to_end(&mut tail)?;
    let cut_off = || invalid("the archive has no list of its files at its end; it is cut off");
    let places = (0..tail.len().saturating_sub(END_BYTES - 1)).rev();
    let at = places.into_iter().find(|at| tail[*at..].starts_with(END)).ok_or_else(cut_off)?;
    let (count, start) = (u16_at(&tail, at + 10), u32_at(&tail, at + 16));
    if count != u16::MAX && start != u32::MAX {
        return Ok((u64::from(count), u64::from(start)));
    }
    // The numbers are too large for this place, and stand in another.
    let at = (length - tail_bytes + at as u64).checked_sub(LOCATOR_64_BYTES).ok_or_else(cut_off)?;
    let mut locator = [0; LOCATOR_64_BYTES as usize];
    file.seek(SeekFrom::Start(at))?;
    file.read_exact(&mut locator)?;
    if !locator.starts_with(LOCATOR_64) {
        return Ok((u64::from(count), u64::from(start)));
    }
    let mut end = [0; 56];
    file.seek(SeekFrom::Start(u64_at(&locator, 8)))?;
    file.read_exact(&mut end)?;
    if !end.starts_with(END_64) {
        return Err(invalid("the list of the archive's files is not where its end says"));
    }
    Ok((u64_at(&end, 32), u64_at(&end, 48)))
}

impl Member {
    /// Reads an entry of the list.
    fn read(file: &mut BufReader<File>) -> io::Result<Self> {
        let mut head = [0; CENTRAL_BYTES];
        file.read_exact(&mut head)?;
        if !head.starts_with(CENTRAL) {
            return Err(invalid("the list of the archive's files is damaged"));
        }
        let mut text = vec![0; usize::from(u16_at(&head, 28))];
        let mut extra = vec![0; usize::from(u16_at(&head, 30))];
        file.read_exact(&mut text)?;
        file.read_exact(&mut extra)?;
        file.seek_relative(i64::from(u16_at(&head, 32)))?;
        let mut wide = wide_numbers(&extra);
        // Of those that are too large for their places, the extra numbers follow in this order.
        let mut number = |at: usize| {
            let short = u32_at(&head, at);
            if short == u32::MAX { wide.next().unwrap_or(u64::from(short)) } else { u64::from(short) }
        };
        Ok(Self {
            bytes: number(24),
            packed_bytes: number(20),
            at: number(42),
            name: String::from_utf8_lossy(&text).into_owned(),
            method: u16_at(&head, 10),
            encrypted: u16_at(&head, 8) & 1 != 0,
            crc: u32_at(&head, 16),
        })
    }

    /// Opens the contents. At their end, their length and checksum are verified.
    pub(crate) fn open(&self, path: &Path) -> io::Result<Box<dyn Read + Send>> {
        let mut file = BufReader::with_capacity(1 << 16, regular_file::open(path)?);
        let length = file.get_ref().metadata()?.len();
        file.seek(SeekFrom::Start(self.at))?;
        let mut head = [0; LOCAL_BYTES];
        file.read_exact(&mut head)?;
        if !head.starts_with(LOCAL) || self.encrypted {
            let what = if self.encrypted { "is encrypted" } else { "is not where the archive says" };
            return Err(invalid(format!("`{}` {what}", self.name)));
        }
        file.seek_relative(i64::from(u16_at(&head, 26)) + i64::from(u16_at(&head, 28)))?;
        let most = self.packed_bytes.saturating_mul(MOST_DEFLATED);
        if self.packed_bytes > length || self.bytes > most {
            let what = format!("`{}` has {} bytes, and the archive {length}", self.name, self.bytes);
            return Err(invalid(what));
        }
        let packed = file.take(self.packed_bytes);
        let inner: Box<dyn Read + Send> = match self.method {
            0 => Box::new(packed),
            8 => Box::new(DeflateDecoder::new(packed)),
            other => {
                let what = format!(
                    "`{}` is compressed by method {other}; stored and deflated files are read, as \
                     numpy.savez and savez_compressed write them",
                    self.name
                );
                return Err(invalid(what));
            }
        };
        Ok(Box::new(Checked { inner, crc: Crc::new(), bytes: self.bytes, expected: self.crc, read: 0 }))
    }
}

/// The numbers of 64 bits in the extra field of a member.
fn wide_numbers(mut extra: &[u8]) -> impl Iterator<Item = u64> {
    let mut found = Vec::new();
    while extra.len() >= 4 {
        let (kind, length) = (u16_at(extra, 0), usize::from(u16_at(extra, 2)));
        let Some(content) = extra.get(4..4 + length) else { break };
        if kind == 1 {
            found = content.chunks_exact(8).map(|bytes| u64_at(bytes, 0)).collect();
        }
        extra = &extra[4 + length..];
    }
    found.into_iter()
}

/// Verifies a checksum at the end of data.
struct Checked {
    inner: Box<dyn Read + Send>,
    crc: Crc,
    bytes: u64,
    expected: u32,
    read: u64,
}

impl Read for Checked {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        let found = self.inner.read(out)?;
        self.crc.update(&out[..found]);
        self.read += found as u64;
        let ended = found == 0 && !out.is_empty();
        if self.read > self.bytes || ended && self.read < self.bytes {
            let what = format!("the archive says that there are {} bytes, and there are not", self.bytes);
            return Err(invalid(what));
        }
        if ended && self.crc.sum() != self.expected {
            return Err(invalid("the checksum is wrong: the archive is damaged"));
        }
        Ok(found)
    }
}
