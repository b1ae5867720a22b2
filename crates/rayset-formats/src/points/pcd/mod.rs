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
use std::path::Path;

use self::columns::{Columns, Origin};
use self::header::{Data, Field, Header};
use self::transposed::Transposed;
use super::file_source::{FileSource, RecordReader, Request, set_axis};
use super::lines::Lines;
use super::stream::Stream;
use super::{Place, PointBatch, ReadError};

/// Bytes of records that are decoded at a time; a longer record is decoded on its own.
const BLOCK_BYTES: usize = 128 << 10;

/// Whether a file that begins with these bytes is PCD. Some writers leave out the comment that
/// names it.
pub(super) fn begins(head: &[u8]) -> bool {
    let words = |text: &[u8]| head.windows(text.len()).any(|window| window == text);
    let lines = |first: &[u8]| [b'\n', b'\r'].iter().any(|end| words(&[&[*end], first].concat()));
    head.starts_with(b"# .PCD") || (head.starts_with(b"VERSION") && lines(b"FIELDS") && lines(b"DATA"))
}

/// The records of a PCD file.
pub(super) struct PcdReader {
    fields: Vec<Field>,
    /// Byte at which each field begins in a record, and the bytes of a record.
    starts: Vec<usize>,
    stride: usize,
    header_bytes: u64,
    axes: [Origin; 3],
    /// Where each column of the schema is.
    origins: Vec<Origin>,
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

impl PcdReader {
    /// Opens a file and reads its header; compressed points are decoded once.
    ///
    /// # Errors
    /// [`ReadError`] if the file cannot be read, violates its format, or has no x, y and z.
    pub(super) fn open(path: &Path) -> Result<FileSource<Self>, ReadError> {
        Self::of(Stream::open(path)?)
    }

    /// The points of a stream.
    pub(super) fn of(mut input: Stream) -> Result<FileSource<Self>, ReadError> {
        let path = input.path().to_owned();
        let header = Header::read(&mut input)?;
        let fail = |what: String| ReadError::malformed(&path, Place::Line(header.lines), what);
        let Columns { schema, axes, origins } = Columns::new(&header).map_err(fail)?;
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
        let reader = Self {
            starts,
            stride,
            header_bytes: header.bytes,
            axes,
            origins,
            body,
            block: Vec::new(),
            memory,
            fields: header.fields,
        };
        Ok(FileSource::new(&path, schema, Some(header.points), reader))
    }

    /// Reads the next `rows` records into the block.
    fn read_block(&mut self, request: &Request<'_>, rows: usize) -> Result<(), ReadError> {
        self.block.clear();
        match &mut self.body {
            Body::Binary(input) => {
                let wanted = rows * self.stride;
                let read = input.by_ref().take(wanted as u64).read_to_end(&mut self.block);
                let read = read.map_err(ReadError::io(request.path()))?;
                if read < wanted {
                    let whole = request.first + (read / self.stride) as u64;
                    let end = self.header_bytes + request.first * self.stride as u64 + read as u64;
                    let what = format!("the file ends early: {whole} of {} points read", request.count);
                    return Err(ReadError::malformed(request.path(), Place::Byte(end), what));
                }
            }
            Body::Ascii(lines) => {
                let mut line = Vec::new();
                for row in 0..rows {
                    line.clear();
                    while line.trim_ascii().is_empty() {
                        line.clear();
                        if !lines.append(&mut line)? {
                            let read = request.first + row as u64;
                            let what =
                                format!("the file ends early: {read} of {} points read", request.count);
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
    fn bytes(
        &mut self,
        request: &Request<'_>,
        origin: Origin,
        rows: usize,
    ) -> Result<(&[u8], usize, usize), ReadError> {
        let field = origin.field;
        match &mut self.body {
            Body::Compressed(points) => {
                let bytes = points.read(request.path(), field, request.first, rows)?;
                Ok((bytes, 0, self.fields[field].bytes()))
            }
            _ => Ok((&self.block, self.starts[field], self.stride)),
        }
    }
}

impl RecordReader for PcdReader {
    fn memory_needed(&self) -> u64 {
        self.memory
    }

    fn read(&mut self, request: &Request<'_>, batch: &mut PointBatch) -> Result<(), ReadError> {
        let rows = request.most.min((BLOCK_BYTES / self.stride).max(1));
        self.read_block(request, rows)?;
        let first = batch.len();
        batch.position.resize(first + rows, [0.0; 3]);
        for axis in 0..3 {
            let origin = self.axes[axis];
            let (bytes, start, stride) = self.bytes(request, origin, rows)?;
            set_axis(batch, first, axis, origin.coordinates(bytes, start, stride, rows));
        }
        for (column, &index) in batch.columns.iter_mut().zip(request.selected) {
            let origin = self.origins[index];
            let (bytes, start, stride) = self.bytes(request, origin, rows)?;
            origin.append(bytes, start, stride, rows, column);
        }
        Ok(())
    }

    fn finish(&mut self) -> Result<(), ReadError> {
        match &mut self.body {
            Body::Ascii(lines) => lines.check_rest(),
            Body::Binary(input) => input.check_rest(),
            Body::Compressed(_) => Ok(()),
        }
    }
}
