//! The numbers and texts of a file, in order.

use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use super::super::data::{data_at, regular_file_bytes};
use rayset_files::grid::VolumeError;
use rayset_store::storage::input_file::InputFile;

/// What is wrong with a file, and where.
pub(super) struct Wrong {
    pub(super) at: u64,
    pub(super) what: String,
}

impl Wrong {
    pub(super) fn of_file(self, path: &Path) -> VolumeError {
        VolumeError::header(path, &format!("byte {}", self.at), &self.what)
    }
}

impl From<Wrong> for io::Error {
    fn from(wrong: Wrong) -> Self {
        Self::new(io::ErrorKind::InvalidData, format!("{}, at byte {} of the file", wrong.what, wrong.at))
    }
}

/// Little-endian data.
pub(super) struct Stream {
    file: BufReader<InputFile>,
    at: u64,
    length: u64,
}

impl Stream {
    pub(super) fn open(path: &Path) -> Result<Self, VolumeError> {
        Ok(Self { length: regular_file_bytes(path)?, file: data_at(path, 0)?, at: 0 })
    }

    /// The offset of the next byte.
    pub(super) fn at(&self) -> u64 {
        self.at
    }

    /// An error at the next byte.
    pub(super) fn wrong(&self, what: impl Into<String>) -> Wrong {
        Wrong { at: self.at, what: what.into() }
    }

    /// Checks that this many bytes follow.
    fn require(&self, bytes: u64) -> Result<(), Wrong> {
        let left = self.length - self.at;
        if bytes <= left {
            return Ok(());
        }
        Err(self.wrong(format!("the file ends early: {bytes} bytes should follow, and {left} do")))
    }

    /// Goes to an offset, which must be in the file or at its end.
    pub(super) fn seek(&mut self, to: u64) -> Result<(), Wrong> {
        if to > self.length {
            return Err(self.wrong(format!("it refers to byte {to}, and the file has {}", self.length)));
        }
        // Bytes that are in the buffer already are not read again.
        let relative = i64::try_from(to).ok().zip(i64::try_from(self.at).ok());
        let moved = match relative {
            Some((to, at)) => self.file.seek_relative(to - at),
            None => self.file.seek(SeekFrom::Start(to)).map(|_| ()),
        };
        moved.map_err(|error| self.wrong(error.to_string()))?;
        self.at = to;
        Ok(())
    }

    pub(super) fn skip(&mut self, bytes: u64) -> Result<(), Wrong> {
        self.require(bytes)?;
        self.seek(self.at + bytes)
    }

    pub(super) fn fill(&mut self, bytes: &mut [u8]) -> Result<(), Wrong> {
        self.require(bytes.len() as u64)?;
        self.file.read_exact(bytes).map_err(|error| self.wrong(error.to_string()))?;
        self.at += bytes.len() as u64;
        Ok(())
    }

    pub(super) fn array<const N: usize>(&mut self) -> Result<[u8; N], Wrong> {
        let mut bytes = [0; N];
        self.fill(&mut bytes)?;
        Ok(bytes)
    }

    pub(super) fn u8(&mut self) -> Result<u8, Wrong> {
        self.array().map(|[byte]| byte)
    }

    pub(super) fn u32(&mut self) -> Result<u32, Wrong> {
        self.array().map(u32::from_le_bytes)
    }

    pub(super) fn i64(&mut self) -> Result<i64, Wrong> {
        self.array().map(i64::from_le_bytes)
    }

    pub(super) fn coordinates(&mut self) -> Result<[i32; 3], Wrong> {
        let mut all = [0; 3];
        for one in &mut all {
            *one = i32::from_le_bytes(self.array()?);
        }
        Ok(all)
    }

    pub(super) fn doubles<const N: usize>(&mut self) -> Result<[f64; N], Wrong> {
        let mut all = [0.0; N];
        for one in &mut all {
            *one = f64::from_le_bytes(self.array()?);
        }
        Ok(all)
    }

    /// A text after its length. Longer than `most` bytes is an error.
    pub(super) fn text(&mut self, most: u64) -> Result<String, Wrong> {
        let at = self.at;
        let length = u64::from(self.u32()?);
        if length > most {
            return Err(Wrong {
                at,
                what: format!("a name of {length} bytes; at most {most} were expected"),
            });
        }
        self.letters(length)
    }

    /// A text of this many bytes.
    pub(super) fn letters(&mut self, length: u64) -> Result<String, Wrong> {
        self.require(length)?;
        let mut bytes = vec![0; length as usize];
        self.fill(&mut bytes)?;
        Ok(String::from_utf8_lossy(&bytes).into_owned())
    }
}
