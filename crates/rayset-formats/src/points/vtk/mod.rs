//! Points of VTK: legacy files (`.vtk`) of PolyData and UnstructuredGrid, in text and binary, and
//! the same in XML (`.vtp`, `.vtu`), in one piece or several.
//!
//! All points are read, whether cells use them or not; cells are passed. What points have are
//! columns: of arrays of three numbers `name_x`, `name_y` and `name_z`, and of the first array of
//! three or four bytes, or one of that many numbers with a name of colours, red, green, blue (and
//! alpha). Texts and bits are left out.

mod legacy;
mod part;
mod words;
mod xml;

use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use self::part::{Part, Stored, VtkArray};
use super::file_source::{FileSource, RecordReader, Request, set_axis};
use super::{ColorDepth, ColumnInfo, ColumnType, Place, PointBatch, ReadError, Schema, Values, roles};
use crate::vtk_xml::Document;
use rayset_base::text_numbers::{Behind, TextNumbers};
use rayset_store::storage::input_file::InputFile;
use rayset_store::storage::is_of_reading;

/// Bytes that are read at once, of all arrays together; one row of each where that is more.
const STEP_BYTES: usize = 512 << 10;
/// What the stream of an array may need besides: buffers of the file, of base64 and of sizes, and
/// the window of Deflate.
const STREAM_BYTES: u64 = 320 << 10;

/// Whether a file is one of VTK, legacy or in XML.
pub(super) fn begins(head: &[u8]) -> bool {
    head.starts_with(legacy::MAGIC) || xml::begins(head)
}

/// The numbers of an array as a stream, and the rows of it in memory.
struct Stream {
    /// Index of the array in its part; `None` for positions.
    array: Option<usize>,
    data: Box<dyn Read + Send>,
    big_endian: bool,
    kind: ColumnType,
    row_bytes: usize,
    bytes: Vec<u8>,
}

/// The points of a file.
pub(super) struct VtkReader {
    /// Of a file in XML.
    document: Option<Document>,
    parts: Vec<Part>,
    /// The array, and the component of it, that is each column.
    columns: Vec<(usize, usize)>,
    streams: Vec<Stream>,
    /// The part that is read, and how many of its points were.
    part: usize,
    row: u64,
}

impl VtkReader {
    pub(super) fn open(path: &Path) -> Result<FileSource<Self>, ReadError> {
        let mut magic = [0; legacy::MAGIC.len()];
        let mut file = InputFile::open(path).map_err(ReadError::io(path))?;
        let is_legacy = match file.read_exact(&mut magic) {
            Ok(()) => magic == *legacy::MAGIC,
            Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => false,
            Err(source) => return Err(ReadError::Io { path: path.to_owned(), source }),
        };
        let (document, mut parts, description) = if is_legacy {
            let (part, title) = legacy::scan(path)?;
            (None, vec![part], title)
        } else {
            let (document, parts, description) = xml::scan(path)?;
            (Some(document), parts, description)
        };
        in_the_order_of_the_first(path, &mut parts)?;
        let (mut schema, columns) = schema(parts.first().map_or(&[], |part| &part.arrays));
        schema.description = description;
        let count = parts.iter().fold(0_u64, |all, part| all.saturating_add(part.rows));
        let reader = Self { document, parts, columns, streams: Vec::new(), part: 0, row: 0 };
        Ok(FileSource::new(path, schema, Some(count), reader))
    }

    /// An error in the numbers of an array of the current part, or in its positions. What the
    /// system says, it says of the file.
    fn unreadable(&self, path: &Path, array: Option<usize>, source: io::Error) -> ReadError {
        if is_of_reading(&source) {
            return ReadError::io(path)(source);
        }
        let named = array.and_then(|index| self.parts.get(self.part)?.arrays.get(index));
        let of = named.map_or_else(|| "positions".to_owned(), |array| format!("array `{}`", array.name));
        ReadError::io(path)(io::Error::new(source.kind(), format!("{of}: {source}")))
    }

    /// Opens an array of the current part, or its positions.
    fn stream(&self, path: &Path, part: &Part, array: Option<usize>) -> Result<Stream, ReadError> {
        let found = array.map_or(&part.positions, |index| &part.arrays[index]);
        let at = |start| {
            let mut file = InputFile::open(path).map_err(ReadError::io(path))?;
            file.seek(SeekFrom::Start(start)).map_err(ReadError::io(path))?;
            Ok(BufReader::with_capacity(1 << 16, file))
        };
        let (data, big_endian): (Box<dyn Read + Send>, bool) = match (&found.stored, &self.document) {
            (Stored::Plain { start, big_endian }, _) => (Box::new(at(*start)?), *big_endian),
            (Stored::Text(start), _) => {
                let count = part.rows.saturating_mul(found.width as u64);
                (Box::new(TextNumbers::new(at(*start)?, found.kind, count, Behind::Anything)), false)
            }
            (Stored::Xml { .. }, Some(document)) => xml::open(path, document, found, part.rows)?,
            (Stored::Xml { .. }, None) => {
                let what = "an array in XML, without elements";
                return Err(ReadError::malformed(path, Place::Byte(0), what));
            }
        };
        Ok(Stream {
            array,
            data,
            big_endian,
            kind: found.kind,
            row_bytes: found.row_bytes(),
            bytes: Vec::new(),
        })
    }

    /// Opens what is needed of the current part, if its first point is next. False if there is
    /// none.
    fn prepare(&mut self, request: &Request<'_>) -> Result<bool, ReadError> {
        while self.parts.get(self.part).is_some_and(|part| part.rows == self.row) {
            (self.part, self.row) = (self.part + 1, 0);
            self.streams.clear();
        }
        let Some(part) = self.parts.get(self.part) else { return Ok(false) };
        if self.streams.is_empty() {
            let mut arrays: Vec<usize> =
                request.selected.iter().map(|&index| self.columns[index].0).collect();
            arrays.sort_unstable();
            arrays.dedup();
            let all = [None].into_iter().chain(arrays.into_iter().map(Some));
            let streams: Result<Vec<Stream>, ReadError> =
                all.map(|array| self.stream(request.path(), part, array)).collect();
            self.streams = streams?;
        }
        Ok(true)
    }
}

/// Makes the arrays of all parts those of the first, in its order.
fn in_the_order_of_the_first(path: &Path, parts: &mut [Part]) -> Result<(), ReadError> {
    let Some((first, rest)) = parts.split_first_mut() else { return Ok(()) };
    for part in rest {
        let mut arrays = Vec::new();
        for wanted in &first.arrays {
            let same = |array: &&VtkArray| {
                array.name == wanted.name && array.kind == wanted.kind && array.width == wanted.width
            };
            let found = part.arrays.iter().find(same).cloned();
            arrays.push(found.ok_or_else(|| {
                let what = format!(
                    "a piece has no array `{}` of {} × {}, which the first one has",
                    wanted.name, wanted.width, wanted.kind
                );
                ReadError::malformed(path, Place::Byte(0), what)
            })?);
        }
        part.arrays = arrays;
    }
    Ok(())
}

/// The columns of arrays, and for each the array and its component.
fn schema(arrays: &[VtkArray]) -> (Schema, Vec<(usize, usize)>) {
    let is_color = |array: &VtkArray| {
        let is_named = roles::components(array.name.trim_matches('_'), array.width)
            .first()
            .is_some_and(|name| name == "red");
        (3..=4).contains(&array.width) && (array.kind == ColumnType::U8 || is_named)
    };
    let color = arrays.iter().position(is_color);
    let (mut infos, mut columns) = (Vec::new(), Vec::new());
    let mut depth = ColorDepth::Guess;
    for (index, array) in arrays.iter().enumerate() {
        let names = if color == Some(index) {
            if array.kind == ColumnType::U8 {
                depth = ColorDepth::Byte;
            }
            roles::components("rgb", array.width)
        } else {
            roles::plain_components(&array.name, array.width)
        };
        for (component, name) in names.into_iter().enumerate() {
            let info = ColumnInfo::new(name, array.kind);
            infos.push(if roles::is_class(&array.name) { info.of_classes() } else { info });
            columns.push((index, component));
        }
    }
    let mut schema = Schema::new(infos, depth);
    schema.roles = roles::colors(&schema.columns);
    (schema, columns)
}

impl Stream {
    /// Reads further rows, in little-endian order.
    fn load(&mut self, rows: usize) -> io::Result<()> {
        self.bytes.resize(rows * self.row_bytes, 0);
        self.data.read_exact(&mut self.bytes).map_err(|error| match error.kind() {
            io::ErrorKind::UnexpectedEof => {
                io::Error::new(error.kind(), "the file ends before the numbers of all points are there")
            }
            _ => error,
        })?;
        if self.big_endian {
            self.bytes.chunks_exact_mut(self.kind.bytes()).for_each(<[u8]>::reverse);
        }
        Ok(())
    }

    /// The bytes of a component of each row.
    fn component(&self, component: usize) -> impl Iterator<Item = &[u8]> {
        let offset = component * self.kind.bytes();
        self.bytes.chunks_exact(self.row_bytes).map(move |row| &row[offset..])
    }
}

impl RecordReader for VtkReader {
    fn memory_needed(&self) -> u64 {
        let arrays = self.parts.first().map_or(0, |part| part.arrays.len() as u64);
        STEP_BYTES as u64 + STREAM_BYTES * (1 + arrays)
    }

    fn read(&mut self, request: &Request<'_>, batch: &mut PointBatch) -> Result<(), ReadError> {
        if !self.prepare(request)? {
            return Ok(());
        }
        let together: usize = self.streams.iter().map(|stream| stream.row_bytes).sum();
        let left = usize::try_from(self.parts[self.part].rows - self.row).unwrap_or(usize::MAX);
        let rows = request.most.min(left).min((STEP_BYTES / together.max(1)).max(1));
        for index in 0..self.streams.len() {
            let read = self.streams[index].load(rows);
            read.map_err(|e| self.unreadable(request.path(), self.streams[index].array, e))?;
        }
        let first = batch.len();
        batch.position.resize(first + rows, [0.0; 3]);
        for stream in &self.streams {
            if stream.array.is_none() {
                for axis in 0..3 {
                    let numbers = stream.component(axis).map(|bytes| stream.kind.decode(bytes));
                    set_axis(batch, first, axis, numbers);
                }
            }
            for (column, &index) in batch.columns.iter_mut().zip(request.selected) {
                let (array, component) = self.columns[index];
                if stream.array == Some(array) {
                    append(column, stream, component);
                }
            }
        }
        self.row += rows as u64;
        Ok(())
    }
}

fn append(column: &mut Values, stream: &Stream, component: usize) {
    stream.component(component).for_each(|bytes| column.push_le_bytes(bytes));
}
