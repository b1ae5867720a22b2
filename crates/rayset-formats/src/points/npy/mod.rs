//! Arrays of NumPy as points: NPY files, and NPZ archives of several.
//!
//! **Plain arrays** have a row a point, N × 3 or wider, in either order of memory; three rows of
//! more than 64 numbers are x, y and z. Numbers behind the first three are named as in text files:
//! four are x y z intensity, six x y z red green blue; others are `column_3` and so on. Dimensions
//! of length one, as those of batches are, do not count. **Structured arrays** have fields x, y and
//! z, or one of three numbers with a name of positions. **Archives** have an array with such a
//! name, or x, y and z, or an array of three numbers that others agree with in its rows and whose
//! name is of nothing else; every other array with as many rows is a column. Of fields of three
//! numbers the columns are `name_x`, `name_y`, `name_z`; of those with a name of colours, red,
//! green and blue.
//!
//! Numbers are integers and floating-point numbers of 8 to 64 bits, in both byte orders; of
//! `float16` the columns are of single precision.

mod array;
mod layout;

use std::io::Read;
use std::path::Path;

use self::array::{Strand, column_bytes, dimensions};
use self::layout::{Layout, Source};
use super::file_source::{FileSource, RecordReader, Request, set_axis};
use super::{Place, PointBatch, ReadError, Values};
use crate::array_file::{Array, Fault, Header, MAGIC, Member, begins_with_array, text_place};

/// Bytes that are read at once, of all strands together; one row of each where that is more.
const STEP_BYTES: usize = 512 << 10;
/// What a strand may need besides: the buffer of its file, and the window of the decompressor.
const STRAND_BYTES: u64 = 64 << 10;

/// Whether a file is an array of NumPy that can be points, or an archive of arrays. Arrays of three
/// and more dimensions are volumes.
pub(super) fn begins(head: &[u8]) -> bool {
    if !head.starts_with(MAGIC) {
        return begins_with_array(head);
    }
    let Some((start, length)) = text_place(head) else { return false };
    // A header that is too long for the head has many fields.
    let Some(text) = head.get(start..start.saturating_add(length as usize)) else { return true };
    Header::parse(text, start).is_ok_and(|header| dimensions(&header.shape).len() < 3)
}

/// The points of a file of arrays.
pub(super) struct NpyReader {
    strands: Vec<Strand>,
    axes: [Source; 3],
    columns: Vec<Source>,
}

impl NpyReader {
    /// Opens a file. `names` are those of all columns: of a plain array, or of the fields or arrays
    /// that have a row a point.
    pub(super) fn open(path: &Path, names: Option<&[String]>) -> Result<FileSource<Self>, ReadError> {
        let of_fault = |fault: Fault| match fault {
            Fault::Io(source) => ReadError::io(path)(source),
            Fault::Wrong { at, what } => ReadError::malformed(path, Place::Byte(at), what),
        };
        let mut file =
            rayset_store::storage::input_file::InputFile::open(path).map_err(ReadError::io(path))?;
        let bytes = file.length().map_err(ReadError::io(path))?;
        let mut magic = Vec::new();
        (&mut file).take(MAGIC.len() as u64).read_to_end(&mut magic).map_err(ReadError::io(path))?;
        let layout = if magic == *MAGIC {
            let array = Array::open(path, Member::whole(bytes)).map_err(of_fault)?;
            Layout::of_array(path, &array, names)
        } else {
            let arrays = Array::all(path).map_err(of_fault)?;
            Layout::of_archive(path, &arrays, names)
        };
        let Layout { strands, axes, columns, schema, rows } = layout.map_err(of_fault)?;
        Ok(FileSource::new(path, schema, Some(rows), Self { strands, axes, columns }))
    }

    /// The strands that positions and the selected columns need.
    fn used(&self, selected: &[usize]) -> Vec<usize> {
        let columns = selected.iter().map(|&index| &self.columns[index]);
        let mut used: Vec<usize> = self.axes.iter().chain(columns).map(|source| source.strand).collect();
        used.sort_unstable();
        used.dedup();
        used
    }
}

/// Appends a number of each row, exactly if `out` is of the type of its column.
fn append(strand: &Strand, source: &Source, out: &mut Values) {
    let end = source.offset + source.scalar.stored.bytes();
    for row in strand.bytes.chunks_exact(strand.row_bytes) {
        out.push_le_bytes(&column_bytes(source.scalar, &row[source.offset..end]));
    }
}

impl RecordReader for NpyReader {
    fn memory_needed(&self) -> u64 {
        STEP_BYTES as u64 + STRAND_BYTES * self.strands.len() as u64
    }

    fn can_skip(&self) -> bool {
        self.strands.iter().all(Strand::can_skip)
    }

    fn skip(&mut self, _: &Request<'_>) -> Result<bool, ReadError> {
        // They begin again at the next row.
        self.strands.iter_mut().for_each(Strand::close);
        Ok(true)
    }

    fn read(&mut self, request: &Request<'_>, batch: &mut PointBatch) -> Result<(), ReadError> {
        let used = self.used(request.selected);
        let together: usize = used.iter().map(|&strand| self.strands[strand].row_bytes).sum();
        let count = request.most.min((STEP_BYTES / together.max(1)).max(1));
        for &strand in &used {
            let read = self.strands[strand].load(request.path(), request.first, count);
            read.map_err(ReadError::io(request.path()))?;
        }
        let first = batch.len();
        batch.position.resize(first + count, [0.0; 3]);
        for (axis, source) in self.axes.iter().enumerate() {
            let mut values = Values::empty(source.column_type());
            append(&self.strands[source.strand], source, &mut values);
            set_axis(batch, first, axis, (0..count).map(|i| values.get(i)));
        }
        for (column, &index) in batch.columns.iter_mut().zip(request.selected) {
            let source = &self.columns[index];
            append(&self.strands[source.strand], source, column);
        }
        Ok(())
    }
}
