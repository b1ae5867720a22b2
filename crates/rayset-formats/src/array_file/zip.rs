//! The members of a ZIP archive (PKWARE's APPNOTE), such as the arrays of a NPZ file: stored as
//! they are, or deflated, with the extensions for large files.
//!
//! Only the directory at the end is trusted for where members are; the checksum of each is verified
//! when it is read to its end.

use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use flate2::bufread::DeflateDecoder;

use super::fault::Fault;
use rayset_store::storage::input_file::InputFile;

/// Upper bound on the compression ratio of Deflate.
const MOST_DEFLATED: u64 = 1032;
/// Largest directory in bytes.
const MOST_DIRECTORY_BYTES: u64 = 4 << 20;
/// Bytes at the end among which the end of the directory is sought: 22, and the longest comment.
const END_BYTES: u64 = 22 + 65535;

/// A member of an archive, or a file that is one array.
#[derive(Clone, Debug)]
pub(crate) struct Member {
    /// Empty if it is the whole file.
    pub(crate) name: String,
    pub(crate) start: u64,
    /// Bytes in the file, and when it is unpacked.
    stored: u64,
    pub(crate) bytes: u64,
    is_deflated: bool,
    checksum: Option<u32>,
}

impl Member {
    /// A file that is one array.
    pub(crate) fn whole(bytes: u64) -> Self {
        Self { name: String::new(), start: 0, stored: bytes, bytes, is_deflated: false, checksum: None }
    }

    /// Whether what is skipped need not be read.
    pub(crate) fn can_seek(&self) -> bool {
        self.checksum.is_none()
    }

    /// A stream of the bytes from `skip` on.
    pub(crate) fn open(&self, path: &Path, skip: u64) -> io::Result<Box<dyn Read + Send>> {
        let mut file = InputFile::open(path)?;
        let Some(checksum) = self.checksum else {
            file.seek(SeekFrom::Start(self.start.saturating_add(skip)))?;
            return Ok(Box::new(BufReader::with_capacity(1 << 14, file)));
        };
        file.seek(SeekFrom::Start(self.start))?;
        let stored = BufReader::with_capacity(1 << 14, file.take(self.stored));
        let data: Box<dyn Read + Send> =
            if self.is_deflated { Box::new(DeflateDecoder::new(stored)) } else { Box::new(stored) };
        let mut checked =
            Checked { data, left: self.bytes, sum: flate2::Crc::new(), checksum, name: self.name.clone() };
        let skipped = io::copy(&mut Read::by_ref(&mut checked).take(skip), &mut io::sink())?;
        if skipped < skip { Err(io::ErrorKind::UnexpectedEof.into()) } else { Ok(Box::new(checked)) }
    }
}

/// A member whose checksum is verified at its end.
struct Checked {
    data: Box<dyn Read + Send>,
    left: u64,
    sum: flate2::Crc,
    checksum: u32,
    name: String,
}

impl Read for Checked {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        let room = out.len().min(usize::try_from(self.left).unwrap_or(usize::MAX));
        let read = self.data.read(&mut out[..room])?;
        self.sum.update(&out[..read]);
        self.left -= read as u64;
        if read > 0 && self.left == 0 && self.sum.sum() != self.checksum {
            let what = format!("{} does not have its checksum; the file is damaged", self.name);
            return Err(io::Error::new(io::ErrorKind::InvalidData, what));
        }
        Ok(read)
    }
}

/// Whether a file begins as ZIP archives do.
pub(crate) fn is_archive(head: &[u8]) -> bool {
    head.starts_with(b"PK\x03\x04")
}

/// Whether a file begins as a ZIP archive does whose first member is an array.
pub(crate) fn begins_with_array(head: &[u8]) -> bool {
    let name_bytes = match head.get(26..28) {
        Some(length) => usize::from(u16::from_le_bytes([length[0], length[1]])),
        None => return false,
    };
    is_archive(head) && head.get(30..30 + name_bytes).is_some_and(|name| name.ends_with(b".npy"))
}

fn number(bytes: &[u8], at: usize, length: usize) -> Option<u64> {
    Some(bytes.get(at..at + length)?.iter().rev().fold(0, |n, &byte| n << 8 | u64::from(byte)))
}

/// Reads bytes that must be in the file.
fn bytes_at(file: &mut InputFile, at: u64, length: u64) -> io::Result<Vec<u8>> {
    let mut bytes = vec![0; length as usize];
    file.seek(SeekFrom::Start(at))?;
    file.read_exact(&mut bytes)?;
    Ok(bytes)
}

/// The arrays of an archive, by their names without `.npy`.
pub(crate) fn arrays(path: &Path) -> Result<Vec<Member>, Fault> {
    let of_array = |member: Member| {
        let name = member.name.strip_suffix(".npy")?.to_owned();
        Some(Member { name, ..member })
    };
    Ok(members(path)?.into_iter().filter_map(of_array).collect())
}

/// All members of an archive that can be read.
pub(crate) fn members(path: &Path) -> Result<Vec<Member>, Fault> {
    let mut file = InputFile::open(path)?;
    let length = file.length()?;
    let fail = |at: u64, what: &str| Fault::Wrong { at, what: what.to_owned() };
    let (at, entries, bytes) = directory(&mut file, length)?.ok_or_else(|| {
        fail(
            length,
            "the directory at the end of this ZIP archive is missing or damaged; the file may be cut off",
        )
    })?;
    if bytes > MOST_DIRECTORY_BYTES {
        return Err(fail(at, "the directory of this ZIP archive is too long"));
    }
    let directory = bytes_at(&mut file, at, bytes)?;
    let (mut members, mut place) = (Vec::new(), 0_usize);
    for _ in 0..entries {
        let damaged = || fail(at + place as u64, "the directory of this ZIP archive is damaged");
        let entry =
            directory.get(place..).filter(|entry| entry.starts_with(b"PK\x01\x02")).ok_or_else(damaged)?;
        let (member, offset, used) = entry_of(entry).ok_or_else(damaged)?;
        place += used;
        let Some(mut member) = member else { continue };
        let at = offset;
        let local = at
            .checked_add(30)
            .filter(|end| *end <= length)
            .ok_or_else(|| fail(at, "a member beyond the end of the file"))?;
        let head = bytes_at(&mut file, at, 30)?;
        let names = number(&head, 26, 2).unwrap_or(0) + number(&head, 28, 2).unwrap_or(0);
        member.start = local + names;
        let end = member.start.checked_add(member.stored);
        if !head.starts_with(b"PK\x03\x04") || end.is_none_or(|end| end > length) {
            return Err(fail(
                at,
                "a member of this ZIP archive is damaged or goes beyond the end of the file",
            ));
        }
        let fits = if member.is_deflated {
            member.bytes / MOST_DEFLATED <= member.stored
        } else {
            member.bytes == member.stored
        };
        if !fits {
            return Err(fail(
                at,
                &format!(
                    "{} bytes cannot hold the {} that are said to be in them",
                    member.stored, member.bytes
                ),
            ));
        }
        members.push(member);
    }
    Ok(members)
}

/// Where the directory is: its byte, the number of its entries, its length. `None` if there is none
/// that fits the file.
fn directory(file: &mut InputFile, length: u64) -> io::Result<Option<(u64, u64, u64)>> {
    let tail_at = length.saturating_sub(END_BYTES);
    let tail = bytes_at(file, tail_at, length - tail_at)?;
    let Some(end) = tail.windows(4).rposition(|window| window == b"PK\x05\x06") else { return Ok(None) };
    let record = &tail[end..];
    let field = |at, length| number(record, at, length);
    let numbers = (field(10, 2), field(12, 4), field(16, 4), field(20, 2));
    let (Some(mut entries), Some(mut bytes), Some(mut at), Some(_)) = numbers else { return Ok(None) };
    if entries == 0xffff || bytes == 0xffff_ffff || at == 0xffff_ffff {
        // The record for large files is found by its locator, which stands before this one.
        let Some(locator) = end.checked_sub(20).map(|start| &tail[start..end]) else { return Ok(None) };
        let place =
            number(locator, 8, 8).filter(|place| place.checked_add(56).is_some_and(|end| end <= length));
        let Some(place) = place.filter(|_| locator.starts_with(b"PK\x06\x07")) else { return Ok(None) };
        let large = bytes_at(file, place, 56)?;
        if !large.starts_with(b"PK\x06\x06") {
            return Ok(None);
        }
        entries = number(&large, 32, 8).unwrap_or(0);
        (bytes, at) = (number(&large, 40, 8).unwrap_or(0), number(&large, 48, 8).unwrap_or(0));
    }
    let inside = at.checked_add(bytes).is_some_and(|end| end <= length);
    // An entry has at least 46 bytes.
    Ok((inside && entries <= bytes / 46).then_some((at, entries, bytes)))
}

/// A member by its entry in the directory, where its own head is, and the length of the entry. The
/// member is `None` if it is compressed in another way, or encrypted.
fn entry_of(entry: &[u8]) -> Option<(Option<Member>, u64, usize)> {
    let field = |at, length| number(entry, at, length);
    let (flags, method, checksum) = (field(8, 2)?, field(10, 2)?, field(16, 4)? as u32);
    let (mut stored, mut bytes, mut offset) = (field(20, 4)?, field(24, 4)?, field(42, 4)?);
    let [name_bytes, extra_bytes, comment_bytes] = [28, 30, 32].map(|at| field(at, 2).unwrap_or(0) as usize);
    let used = 46 + name_bytes + extra_bytes + comment_bytes;
    let name = entry.get(46..46 + name_bytes)?;
    let mut extra = entry.get(46 + name_bytes..46 + name_bytes + extra_bytes)?;
    while let (Some(id), Some(length)) = (number(extra, 0, 2), number(extra, 2, 2)) {
        let (contents, rest) = extra[4..].split_at_checked(length as usize)?;
        if id == 1 {
            // Of each number that does not fit 32 bits, in this order, there are 64.
            let mut large = contents.chunks_exact(8);
            for value in [&mut bytes, &mut stored, &mut offset] {
                if *value == 0xffff_ffff {
                    *value = number(large.next()?, 0, 8)?;
                }
            }
        }
        extra = rest;
    }
    let name = String::from_utf8_lossy(name).into_owned();
    let encrypted = flags & 1 != 0;
    let (is_deflated, checksum) = (method == 8, Some(checksum));
    let member = (!encrypted && (method == 0 || method == 8)).then_some(Member {
        name,
        start: 0,
        stored,
        bytes,
        is_deflated,
        checksum,
    });
    Some((member, offset, used))
}
