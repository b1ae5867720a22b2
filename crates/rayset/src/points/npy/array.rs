//! An array of a file as points see it, and the streams that deliver its rows.

use std::io::{self, Read};
use std::path::Path;

use crate::array_file::{self, Header, Member, Scalar};
use crate::points::ColumnType;

/// Largest number of numbers in a row of an array that is not structured.
pub(super) const MOST_WIDTH: u64 = 64;

/// A number, or several in a row, of each element.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Field {
    /// Empty if the array is not structured.
    pub(super) name: String,
    /// Its byte in the element.
    pub(super) offset: usize,
    pub(super) kind: ColumnType,
    pub(super) big_endian: bool,
    pub(super) components: usize,
}

/// An array with its header.
#[derive(Clone, Debug)]
pub(super) struct Array {
    pub(super) member: Member,
    pub(super) header: Header,
    /// Of the elements, those that are numbers of a type that columns have.
    pub(super) fields: Vec<Field>,
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

/// The type of a column for a number; `None` if no column holds it.
fn column_type(scalar: Scalar) -> Option<ColumnType> {
    Some(match (scalar.letter, scalar.bytes) {
        ('f', 4) => ColumnType::F32,
        ('f', 8) => ColumnType::F64,
        ('u' | 'b', 1) => ColumnType::U8,
        ('i', 1) => ColumnType::I8,
        ('u', 2) => ColumnType::U16,
        ('i', 2) => ColumnType::I16,
        ('u', 4) => ColumnType::U32,
        ('i', 4) => ColumnType::I32,
        ('u', 8) => ColumnType::U64,
        ('i', 8) => ColumnType::I64,
        _ => return None,
    })
}

impl Array {
    pub(super) fn new(array: array_file::Array) -> Self {
        let array_file::Array { member, header } = array;
        let fields = header.fields.iter().filter_map(|field| {
            Some(Field {
                name: field.name.clone(),
                offset: field.offset,
                kind: column_type(field.scalar)?,
                big_endian: field.scalar.big_endian,
                components: field.components,
            })
        });
        Self { fields: fields.collect(), member, header }
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
        self.fields.first().filter(|_| !self.header.is_structured)
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
