//! An array of a file, and the streams that deliver its rows.

use std::io::{self, Read};
use std::path::Path;

use super::header::{Field, Header, MOST_HEADER_BYTES, text_place};
use super::zip::Member;
use crate::points::{Place, ReadError};

/// Largest number of numbers in a row of an array that is not structured.
pub(super) const MOST_WIDTH: u64 = 64;

/// An array with its header.
#[derive(Clone, Debug)]
pub(super) struct Array {
    pub(super) member: Member,
    pub(super) header: Header,
}

/// How the rows of an array lie in it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Rows {
    pub(super) rows: u64,
    /// Numbers in a row.
    pub(super) width: u64,
    /// Whether all numbers of the first component come first, then all of the second, and so on.
    pub(super) apart: bool,
}

impl Array {
    pub(super) fn open(path: &Path, member: Member) -> Result<Self, ReadError> {
        let io = |source| ReadError::Io { path: path.to_owned(), source };
        let fail = |at: u64, what: &str| {
            let name =
                if member.name.is_empty() { String::new() } else { format!("the array {}: ", member.name) };
            ReadError::malformed(path, Place::Byte(member.start + at), format!("{name}{what}"))
        };
        let early = "the header of the array is cut off";
        let mut data = member.open(path, 0).map_err(io)?;
        let mut head = vec![0; member.bytes.min(12) as usize];
        data.read_exact(&mut head).map_err(|_| fail(0, early))?;
        let (start, length) = text_place(&head)
            .ok_or_else(|| fail(0, "expected the header of NumPy's format, version 1 to 3"))?;
        if length > MOST_HEADER_BYTES || start as u64 + length > member.bytes {
            return Err(fail(8, &format!("a header of {length} bytes is too long, or cut off")));
        }
        // Of the first version two bytes of the text have been read.
        let mut text = head[start..].to_vec();
        data.take(length - text.len().min(length as usize) as u64).read_to_end(&mut text).map_err(io)?;
        text.truncate(length as usize);
        if (text.len() as u64) < length {
            return Err(fail(8, early));
        }
        let header = Header::parse(&text, start).map_err(|(at, what)| fail(at, &what))?;
        let needed =
            header.count().checked_mul(header.element_bytes as u64).and_then(|n| n.checked_add(header.bytes));
        if needed.is_none_or(|needed| needed > member.bytes) {
            let what = format!(
                "an array of {} elements of {} bytes, and {} bytes follow its header; it is cut off",
                header.shape_text(),
                header.element_bytes,
                member.bytes - header.bytes
            );
            return Err(fail(header.bytes, &what));
        }
        Ok(Self { member, header })
    }

    /// The rows of an array of one or two dimensions. With two, three rows of more than 64 numbers are three axes. `None`
    /// if it has other dimensions, or rows that are too long.
    pub(super) fn rows(&self) -> Option<Rows> {
        let fortran = self.header.fortran;
        match *self.header.shape.as_slice() {
            [rows] => Some(Rows { rows, width: 1, apart: false }),
            [width @ 3, rows] if rows > MOST_WIDTH => Some(Rows { rows, width, apart: !fortran }),
            [rows, width] if width <= MOST_WIDTH => Some(Rows { rows, width, apart: fortran }),
            _ => None,
        }
    }

    /// The number of an array that is not structured. `None` if its elements are none.
    pub(super) fn number(&self) -> Option<&Field> {
        self.header.fields.first().filter(|_| !self.header.is_structured)
    }
}

/// Rows of an array that follow each other, or of one component of it.
pub(super) struct Strand {
    member: Member,
    /// Byte of the array at which the first row begins.
    start: u64,
    pub(super) row_bytes: usize,
    stream: Option<Box<dyn Read + Send>>,
    pub(super) bytes: Vec<u8>,
}

impl Strand {
    pub(super) fn new(array: &Array, start: u64, row_bytes: usize) -> Self {
        let start = array.header.bytes.saturating_add(start);
        Self { member: array.member.clone(), start, row_bytes, stream: None, bytes: Vec::new() }
    }

    /// Reads `count` rows after the first `done`, which were read before, or not at all.
    pub(super) fn load(&mut self, path: &Path, done: u64, count: usize) -> io::Result<()> {
        if self.stream.is_none() {
            let skip = self.start.saturating_add(done.saturating_mul(self.row_bytes as u64));
            self.stream = Some(self.member.open(path, skip)?);
        }
        self.bytes.resize(count * self.row_bytes, 0);
        let Some(stream) = &mut self.stream else { return Ok(()) };
        stream.read_exact(&mut self.bytes).map_err(|error| match error.kind() {
            io::ErrorKind::UnexpectedEof => {
                let name = &self.member.name;
                io::Error::new(
                    error.kind(),
                    format!("the array {name} ends before its last row; the file is damaged"),
                )
            }
            _ => error,
        })
    }
}
