//! PCD, the format of the Point Cloud Library: ASCII, binary, and compressed with LZF.
//!
//! Fields keep their names and types. A field of several numbers becomes as many columns, as in
//! `fpfh_0`; colours packed into `rgb` or `rgba`, whatever their type, become `red`, `green`,
//! `blue` and `alpha`, of a byte each; fields called `_` are padding. Points of grids that are NaN
//! are delivered as such. As in PCL itself, the viewpoint is not applied: points are where the file
//! says, and the description says from where they were seen. Lines end with LF, CR LF, or CR alone.

mod columns;
mod header;
mod text;
mod transposed;

use std::io::Read;
use std::path::{Path, PathBuf};

use self::columns::{Columns, Origin};
use self::header::{Data, Field, Header};
use self::transposed::Transposed;
use super::lines::Lines;
use super::stream::Stream;
use super::{Place, PointBatch, PointSource, ReadError, Schema};

/// Bytes of records that are decoded at a time; a longer record is decoded on its own.
const BLOCK_BYTES: usize = 128 << 10;

/// Whether a file that begins with these bytes is PCD. Some writers leave out the comment that
/// names it.
pub(super) fn begins(head: &[u8]) -> bool {
    let words = |text: &[u8]| head.windows(text.len()).any(|window| window == text);
    let lines = |first: &[u8]| [b'\n', b'\r'].iter().any(|end| words(&[&[*end], first].concat()));
    head.starts_with(b"# .PCD") || (head.starts_with(b"VERSION") && lines(b"FIELDS") && lines(b"DATA"))
}

/// The points of a PCD file.
pub(super) struct PcdSource {
    path: PathBuf,
    fields: Vec<Field>,
    /// Byte at which each field begins in a record, and the bytes of a record.
    starts: Vec<usize>,
    stride: usize,
    header_bytes: u64,
    count: u64,
    next: u64,
    columns: Columns,
    selected: Vec<usize>,
    body: Body,
    /// Records that are decoded.
    block: Vec<u8>,
    memory: u64,
}

enum Body {
    Ascii(Lines),
    Binary(Stream),
    Compressed(Transposed),
}

impl PcdSource {
    /// Opens a file and reads its header; compressed points are decoded once.
    ///
    /// # Errors
    /// [`ReadError`] if the file cannot be read, violates its format, or has no x, y and z.
    pub(super) fn open(path: &Path) -> Result<Self, ReadError> {
        Self::of(Stream::open(path)?)
    }

    /// The points of a stream.
    pub(super) fn of(mut input: Stream) -> Result<Self, ReadError> {
        let path = input.path().to_owned();
        let header = Header::read(&mut input)?;
        let fail = |what: String| ReadError::malformed(&path, Place::Line(header.lines), what);
        let columns = Columns::new(&header).map_err(fail)?;
        let starts = header.fields.iter().scan(0, |end, field| {
            *end += field.bytes();
            Some(*end - field.bytes())
        });
        let starts: Vec<usize> = starts.collect();
        let stride: usize = header.fields.iter().map(Field::bytes).sum();
        let rows = (BLOCK_BYTES / stride).max(1);
        let mut memory = input.memory_needed() + (rows * stride) as u64;
        let body = match (header.data, input.packing()) {
            (Data::Ascii, _) => Body::Ascii(Lines::after(input, header.lines, header.line_end)),
            (Data::Binary, _) => Body::Binary(input),
            (Data::Compressed, None) => {
                memory = Transposed::memory_needed(&header.fields, rows);
                Body::Compressed(Transposed::open(&path, &header)?)
            }
            (Data::Compressed, Some(packing)) => {
                let what = format!(
                    "the points are compressed, and {} is around the file; they are read in many places: decompress it \
                     first",
                    packing.name()
                );
                return Err(fail(what));
            }
        };
        Ok(Self {
            path,
            starts,
            stride,
            header_bytes: header.bytes,
            count: header.points,
            next: 0,
            columns,
            selected: Vec::new(),
            body,
            block: Vec::new(),
            memory,
            fields: header.fields,
        })
    }

    /// Reads the next `rows` records into the block.
    fn read_block(&mut self, rows: usize) -> Result<(), ReadError> {
        self.block.clear();
        match &mut self.body {
            Body::Binary(input) => {
                let wanted = rows * self.stride;
                let read = input.by_ref().take(wanted as u64).read_to_end(&mut self.block);
                let read = read.map_err(|source| ReadError::Io { path: self.path.clone(), source })?;
                if read < wanted {
                    let whole = self.next + (read / self.stride) as u64;
                    let end = self.header_bytes + self.next * self.stride as u64 + read as u64;
                    let what = format!("the file ends early: {whole} of {} points read", self.count);
                    return Err(ReadError::malformed(&self.path, Place::Byte(end), what));
                }
            }
            Body::Ascii(lines) => {
                let mut line = Vec::new();
                for row in 0..rows {
                    line.clear();
                    while line.trim_ascii().is_empty() {
                        line.clear();
                        if !lines.append(&mut line)? {
                            let read = self.next + row as u64;
                            let what = format!("the file ends early: {read} of {} points read", self.count);
                            return Err(lines.fail(what));
                        }
                    }
                    let parsed = text::parse(&line, &self.fields, &mut self.block);
                    parsed.map_err(|what| lines.fail(what))?;
                }
            }
            Body::Compressed(_) => {}
        }
        Ok(())
    }

    /// The bytes in which a field of the current `rows` points is, its start in them, and the bytes
    /// to the next.
    fn bytes(&mut self, origin: Origin, rows: usize) -> Result<(&[u8], usize, usize), ReadError> {
        let field = origin.field;
        match &mut self.body {
            Body::Compressed(points) => {
                let bytes = points.read(&self.path, field, self.next, rows)?;
                Ok((bytes, 0, self.fields[field].bytes()))
            }
            _ => Ok((&self.block, self.starts[field], self.stride)),
        }
    }
}

impl PointSource for PcdSource {
    fn schema(&self) -> &Schema {
        &self.columns.schema
    }

    fn count_hint(&self) -> Option<u64> {
        Some(self.count)
    }

    fn path(&self) -> Option<&Path> {
        Some(&self.path)
    }

    fn memory_needed(&self) -> u64 {
        self.memory
    }

    fn select(&mut self, columns: &[usize]) {
        self.selected = columns.to_vec();
    }

    fn fill(&mut self, batch: &mut PointBatch, limit: usize) -> Result<(), ReadError> {
        batch.reset(&self.columns.schema, &self.selected);
        let mut left = (self.count - self.next).min(limit as u64) as usize;
        while left > 0 {
            let rows = left.min((BLOCK_BYTES / self.stride).max(1));
            self.read_block(rows)?;
            let first = batch.len();
            batch.position.resize(first + rows, [0.0; 3]);
            for axis in 0..3 {
                let origin = self.columns.axes[axis];
                let (bytes, start, stride) = self.bytes(origin, rows)?;
                let numbers = origin.coordinates(bytes, start, stride, rows);
                batch.position[first..].iter_mut().zip(numbers).for_each(|(p, v)| p[axis] = v);
            }
            for (place, column) in batch.columns.iter_mut().enumerate() {
                let origin = self.columns.origins[self.selected[place]];
                let (bytes, start, stride) = self.bytes(origin, rows)?;
                origin.append(bytes, start, stride, rows, column);
            }
            self.next += rows as u64;
            left -= rows;
        }
        if self.next < self.count {
            return Ok(());
        }
        match &mut self.body {
            Body::Ascii(lines) => lines.check_rest(),
            Body::Binary(input) => input.check_rest(),
            Body::Compressed(_) => Ok(()),
        }
    }
}
