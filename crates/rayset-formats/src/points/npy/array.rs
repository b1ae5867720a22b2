//! An array of a file as points see it, and the streams that deliver its rows.

use std::io::{self, Read};
use std::path::Path;

use crate::array_file::{Array, Member, Scalar};
use crate::points::ColumnType;
use rayset_base::numbers::{Stored, half};

/// Largest number of numbers in a row of an array that is not structured.
pub(super) const MOST_WIDTH: u64 = 64;

/// How the rows of an array lie in it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Rows {
    pub(super) rows: u64,
    /// Numbers in a row.
    pub(super) width: u64,
    /// Whether all numbers of the first component come first, then all of the second, and so on.
    pub(super) apart: bool,
}

/// A number as a column holds it, little-endian; half precision becomes single precision.
pub(super) fn column_bytes(scalar: Scalar, number: &[u8]) -> [u8; 8] {
    let mut bytes = [0; 8];
    bytes[..number.len()].copy_from_slice(number);
    if scalar.big_endian {
        bytes[..number.len()].reverse();
    }
    if scalar.stored == Stored::F16 {
        let single = half::from_le_bytes([bytes[0], bytes[1]]);
        bytes[..4].copy_from_slice(&single.to_le_bytes());
    }
    bytes
}

/// The dimensions of an array; of three and more those that are longer than one.
pub(super) fn dimensions(shape: &[u64]) -> Vec<u64> {
    let longer = || shape.iter().copied().filter(|length| *length != 1).collect();
    if shape.len() > 2 { longer() } else { shape.to_vec() }
}

impl Array {
    /// The rows of an array of one or two dimensions. With two, three rows of more than 64 numbers
    /// are three axes. `None` if it has other dimensions, or rows that are too long. Of three and
    /// more dimensions those of length one do not count.
    pub(super) fn rows(&self) -> Option<Rows> {
        let fortran = self.header.fortran;
        match *dimensions(&self.header.shape) {
            [rows] => Some(Rows { rows, width: 1, apart: false }),
            [width @ 3, rows] if rows > MOST_WIDTH => Some(Rows { rows, width, apart: !fortran }),
            [rows, width] if width <= MOST_WIDTH => Some(Rows { rows, width, apart: fortran }),
            _ => None,
        }
    }

    /// Numbers of the first rows, up to `most`.
    pub(super) fn first_rows(
        &self,
        path: &Path,
        rows: Rows,
        scalar: Scalar,
        most: usize,
    ) -> io::Result<Vec<Vec<f64>>> {
        let (count, width) = (rows.rows.min(most as u64) as usize, rows.width as usize);
        let (size, kind) = (scalar.stored.bytes(), ColumnType::of(scalar.stored));
        let mut numbers = vec![Vec::with_capacity(width); count];
        let together = if rows.apart { 1 } else { width };
        for component in (0..width).step_by(together.max(1)) {
            let start = if rows.apart { rows.rows.saturating_mul((component * size) as u64) } else { 0 };
            let mut strand = Strand::new(self, start, size * together);
            strand.load(path, 0, count)?;
            for (row, bytes) in numbers.iter_mut().zip(strand.bytes.chunks_exact(size * together)) {
                let of_row = bytes.chunks_exact(size);
                row.extend(of_row.map(|number| kind.decode(&column_bytes(scalar, number))));
            }
        }
        Ok(numbers)
    }

    /// The type of the numbers of an array that is not structured. `None` if its elements are none.
    pub(super) fn number(&self) -> Option<Scalar> {
        self.header.fields.first().filter(|_| !self.header.is_structured).map(|field| field.scalar)
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

    /// Whether a row is reached without reading those before it.
    pub(super) fn can_skip(&self) -> bool {
        self.member.can_seek()
    }

    /// Lets go of the stream; the next rows are sought when they are read.
    pub(super) fn close(&mut self) {
        self.stream = None;
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
