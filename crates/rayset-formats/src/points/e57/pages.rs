//! The pages of an E57 file: 1020 bytes of content and their checksum, over and over.

use std::io::{self, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use crate::points::{Place, ReadError};
use rayset_store::storage::input_file::InputFile;

/// Size of a page in bytes; the standard allows no other.
pub(super) const PAGE_BYTES: u64 = 1024;
/// Size of its content.
const CONTENT_BYTES: u64 = PAGE_BYTES - 4;
/// Number of pages that are read at a time.
const PAGES_AT_A_TIME: u64 = 64;
/// Memory in bytes of the pages that are read at a time.
pub(super) const BUFFER_BYTES: u64 = PAGES_AT_A_TIME * PAGE_BYTES;

/// The contents of the pages of a file as one stream, each page checked before any of it is used.
///
/// Positions in the stream count contents alone; places in messages are bytes of the file.
pub(super) struct Pages {
    path: PathBuf,
    file: InputFile,
    /// Number of pages of the file.
    count: u64,
    /// Contents of pages from `first` on.
    buffer: Vec<u8>,
    first: u64,
    at: u64,
}

impl Pages {
    /// The pages of a file of `bytes` bytes, which must be a multiple of [`PAGE_BYTES`].
    pub(super) fn new(path: &Path, file: InputFile, bytes: u64) -> Self {
        let count = bytes / PAGE_BYTES;
        Self { path: path.to_owned(), file, count, buffer: Vec::new(), first: 0, at: 0 }
    }

    /// The file.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Number of bytes of content of the whole file.
    pub(super) fn content_bytes(&self) -> u64 {
        self.count * CONTENT_BYTES
    }

    /// The byte of the file at which the stream stands.
    pub(super) fn byte(&self) -> u64 {
        self.at / CONTENT_BYTES * PAGE_BYTES + self.at % CONTENT_BYTES
    }

    /// An error where the stream stands.
    pub(super) fn fail(&self, what: impl Into<String>) -> ReadError {
        ReadError::malformed(&self.path, Place::Byte(self.byte()), what)
    }

    /// Goes to a byte of the file. `what` is said to begin there, and `said_at` is the byte of the
    /// file that says so.
    pub(super) fn go_to(&mut self, byte: u64, what: &str, said_at: u64) -> Result<(), ReadError> {
        let (page, within) = (byte / PAGE_BYTES, byte % PAGE_BYTES);
        if page >= self.count || within >= CONTENT_BYTES {
            let end = self.count * PAGE_BYTES;
            let wrong = format!(
                "{what} is said to begin at byte {byte}, which is in no page's content; the file has {end} bytes, and \
                 is cut off or damaged"
            );
            return Err(ReadError::malformed(&self.path, Place::Byte(said_at), wrong));
        }
        self.at = page * CONTENT_BYTES + within;
        Ok(())
    }

    /// Passes over `bytes` bytes of content.
    pub(super) fn skip(&mut self, bytes: u64) {
        self.at = self.at.saturating_add(bytes);
    }

    /// Goes behind `bytes` bytes of content that begin at a byte of the file, which is in the
    /// content of a page.
    pub(super) fn skip_from(&mut self, start: u64, bytes: u64) -> Result<(), ReadError> {
        self.go_to(start, "a packet", start)?;
        self.skip(bytes);
        Ok(())
    }

    /// Fills `out`, or fails at the end of the file. `what` says what is read.
    pub(super) fn read(&mut self, mut out: &mut [u8], what: &str) -> Result<(), ReadError> {
        while !out.is_empty() {
            let end = self.first + self.buffer.len() as u64;
            if !(self.first..end).contains(&self.at) {
                if self.at >= self.content_bytes() {
                    return Err(self.fail(format!("the file ends within {what}; it is cut off or damaged")));
                }
                self.load(self.at / CONTENT_BYTES)?;
                continue;
            }
            let from = (self.at - self.first) as usize;
            let part = out.len().min(self.buffer.len() - from);
            let (now, later) = out.split_at_mut(part);
            now.copy_from_slice(&self.buffer[from..from + part]);
            self.at += part as u64;
            out = later;
        }
        Ok(())
    }

    /// Reads and checks pages from page `page` on.
    fn load(&mut self, page: u64) -> Result<(), ReadError> {
        let pages = PAGES_AT_A_TIME.min(self.count - page);
        self.first = page * CONTENT_BYTES;
        self.buffer.resize((pages * PAGE_BYTES) as usize, 0);
        let read = self.file.seek(SeekFrom::Start(page * PAGE_BYTES));
        let read = read.and_then(|_| self.file.read_exact(&mut self.buffer));
        if let Err(source) = read {
            self.buffer.clear();
            return Err(if source.kind() == io::ErrorKind::UnexpectedEof {
                self.fail("the file became shorter while it was read")
            } else {
                ReadError::Io { path: self.path.clone(), source }
            });
        }
        let (page_bytes, content) = (PAGE_BYTES as usize, CONTENT_BYTES as usize);
        for index in 0..pages as usize {
            let bytes = &self.buffer[index * page_bytes..][..page_bytes];
            // The checksum, alone among the numbers of the file, has its highest byte first.
            let stored = bytes[content..].iter().fold(0, |sum, &byte| sum << 8 | u32::from(byte));
            if crc32c::crc32c(&bytes[..content]) != stored {
                self.buffer.clear();
                let at = (page + index as u64) * PAGE_BYTES;
                let what = "the page that begins here has another checksum than it was written with; the file is \
                            damaged";
                return Err(ReadError::malformed(&self.path, Place::Byte(at), what));
            }
            self.buffer.copy_within(index * page_bytes..index * page_bytes + content, index * content);
        }
        self.buffer.truncate(pages as usize * content);
        Ok(())
    }
}
