//! A dataset of a snapshot: one row a particle, of one number or a few.

use hdf5_reader::group::Group;
use hdf5_reader::{Dataset, H5Type, SliceInfo, SliceInfoElem};

use super::bits::Bits;
use super::hdf5::{Attributes, File, MOST_CHUNK_BYTES, stored};
use crate::points::{ColumnType, ReadError, Values};
use rayset_base::numbers::{Stored, half};

/// Largest number of numbers in a row.
const MOST_COMPONENTS: u64 = 64;
/// Bytes that are read at once of a dataset that is not chunked: so few that allocators keep the
/// memory for the next ones instead of asking the system for it each time.
const PLAIN_BYTES: u64 = 48 << 10;

/// A dataset of numbers that has a row for each particle.
pub(super) struct Table {
    data: Dataset,
    /// Its name for messages, with that of its group.
    pub(super) name: String,
    pub(super) rows: u64,
    /// Numbers in a row, and the rank of the dataset: 1 or 2.
    pub(super) width: usize,
    rank: usize,
    /// The type of the numbers, and that of the columns that they become.
    stored: Stored,
    pub(super) kind: ColumnType,
    /// Rows of a chunk; `None` if the dataset is not chunked.
    chunk_rows: Option<u64>,
    /// Bytes of the numbers of a chunk in memory.
    pub(super) chunk_bytes: u64,
}

impl Table {
    /// Opens a dataset of a group; `None` if it is not a table of numbers.
    pub(super) fn open(file: &File, group: &Group, name: &str) -> Result<Option<Self>, ReadError> {
        let full = format!("{}/{name}", group.name());
        let data = file.guarded(group.address(), &full, || group.dataset(name))?;
        let (rows, width) = match *data.shape() {
            [rows] => (rows, 1),
            [rows, width @ 1..=MOST_COMPONENTS] => (rows, width as usize),
            _ => return Ok(None),
        };
        let Some(stored) = file.guarded(data.address(), &full, || stored(&data))? else { return Ok(None) };
        let kind = ColumnType::of(stored);
        let row_bytes = (width * kind.bytes()) as u64;
        let chunks = data.chunks();
        let chunk_rows = chunks.as_ref().map(|dims| u64::from(dims.first().copied().unwrap_or(1)).max(1));
        let numbers =
            chunks.map_or(0, |dims| dims.iter().fold(1_u64, |all, &n| all.saturating_mul(n.into())));
        let chunk_bytes = numbers.saturating_mul(stored.bytes() as u64);
        if chunk_bytes > MOST_CHUNK_BYTES as u64 {
            return Err(file.wrong(
                data.address(),
                format!(
                    "{full}: its chunks have {chunk_bytes} bytes, and at most {MOST_CHUNK_BYTES} are read at once; \
                     `h5repack -l {name}:CHUNK=…` makes smaller ones"
                ),
            ));
        }
        let chunk_bytes = numbers.saturating_mul(kind.bytes() as u64);
        let rank = data.ndim();
        debug_assert!(row_bytes > 0);
        Ok(Some(Self { data, name: full, rows, width, rank, kind, chunk_rows, chunk_bytes, stored }))
    }

    /// The byte of the file at which the dataset is described.
    pub(super) fn address(&self) -> u64 {
        self.data.address()
    }

    pub(super) fn row_bytes(&self) -> u64 {
        (self.width * self.kind.bytes()) as u64
    }

    pub(super) fn attributes(&self, file: &File) -> Result<Attributes, ReadError> {
        file.guarded(self.address(), &self.name, || Ok(self.data.attributes())).map(Attributes)
    }

    /// The number of rows that are best read at once, in at most about `bytes` bytes.
    fn block_rows(&self, bytes: u64) -> u64 {
        let most = (bytes / self.row_bytes()).max(1);
        self.chunk_rows.unwrap_or((PLAIN_BYTES / self.row_bytes()).max(1)).min(most)
    }

    /// Bytes that reading with blocks of at most `bytes` bytes keeps.
    pub(super) fn block_bytes(&self, bytes: u64) -> u64 {
        self.block_rows(bytes).min(self.rows).saturating_mul(self.row_bytes())
    }

    fn read(&self, file: &File, start: u64, count: u64) -> Result<Values, ReadError> {
        let mut selections = vec![SliceInfoElem::Slice { start, end: start + count, step: 1 }];
        if self.rank == 2 {
            selections.push(SliceInfoElem::Slice { start: 0, end: self.width as u64, step: 1 });
        }
        let selection = SliceInfo { selections };
        let values = match self.stored {
            Stored::U8 => Values::U8(self.numbers(file, &selection, |Bits(bits)| bits)?),
            Stored::I8 => Values::I8(self.numbers(file, &selection, |Bits(bits): Bits<u8>| bits as i8)?),
            Stored::U16 => Values::U16(self.numbers(file, &selection, |Bits(bits)| bits)?),
            Stored::I16 => Values::I16(self.numbers(file, &selection, |Bits(bits): Bits<u16>| bits as i16)?),
            Stored::U32 => Values::U32(self.numbers(file, &selection, |Bits(bits)| bits)?),
            Stored::I32 => Values::I32(self.numbers(file, &selection, |Bits(bits): Bits<u32>| bits as i32)?),
            Stored::U64 => Values::U64(self.numbers(file, &selection, |Bits(bits)| bits)?),
            Stored::I64 => Values::I64(self.numbers(file, &selection, |Bits(bits): Bits<u64>| bits as i64)?),
            Stored::F16 => Values::F32(self.numbers(file, &selection, |Bits(bits)| half::from_bits(bits))?),
            Stored::F32 => Values::F32(self.numbers(file, &selection, |Bits(bits)| f32::from_bits(bits))?),
            Stored::F64 => Values::F64(self.numbers(file, &selection, |Bits(bits)| f64::from_bits(bits))?),
        };
        let expected = count * self.width as u64;
        if values.len() as u64 != expected {
            return Err(file.wrong(
                self.address(),
                format!("{}: {} numbers were read, expected {expected}", self.name, values.len()),
            ));
        }
        Ok(values)
    }

    /// The numbers of a selection, each made of its bits; in the memory of these, if it is of their
    /// size.
    fn numbers<B: H5Type, T>(
        &self,
        file: &File,
        selection: &SliceInfo,
        number: impl Fn(B) -> T,
    ) -> Result<Vec<T>, ReadError> {
        let array = file.guarded(self.address(), &self.name, || self.data.read_slice::<B>(selection))?;
        Ok(array.into_raw_vec_and_offset().0.into_iter().map(number).collect())
    }
}

/// A table, and a block of its rows in memory.
pub(super) struct Blocks {
    pub(super) table: Table,
    values: Values,
    /// The rows that `values` holds.
    start: u64,
    end: u64,
    most_bytes: u64,
}

impl Blocks {
    /// Reads a table in blocks of at most about `most_bytes` bytes.
    pub(super) fn new(table: Table, most_bytes: u64) -> Self {
        let values = Values::empty(table.kind);
        Self { table, values, start: 0, end: 0, most_bytes }
    }

    /// Reads the block with this row, unless it is in memory. Returns the number of rows from this
    /// one on that are.
    pub(super) fn load(&mut self, file: &File, row: u64) -> Result<u64, ReadError> {
        if !(self.start..self.end).contains(&row) {
            let rows = self.table.block_rows(self.most_bytes);
            // A block never reaches into a second chunk, which would be decoded for a part of it.
            let chunk_end =
                self.table.chunk_rows.map_or(u64::MAX, |rows| (row / rows + 1).saturating_mul(rows));
            let end = row.saturating_add(rows).min(chunk_end).min(self.table.rows);
            self.values = Values::empty(self.table.kind);
            (self.start, self.end) = (row, row);
            self.values = self.table.read(file, row, end - row)?;
            self.end = end;
        }
        Ok(self.end - row)
    }

    /// A number of a row in memory.
    pub(super) fn get(&self, row: u64, component: usize) -> f64 {
        self.values.get((row - self.start) as usize * self.table.width + component)
    }

    /// Appends a component of `count` rows in memory, exactly if `out` is of the type of the table.
    pub(super) fn append(&self, row: u64, count: usize, component: usize, out: &mut Values) {
        let (first, width) = ((row - self.start) as usize, self.table.width);
        if out.kind() != self.table.kind {
            (first..first + count).for_each(|i| out.push(self.values.get(i * width + component)));
        } else if width == 1 {
            out.extend_from(&self.values, first..first + count);
        } else {
            for i in first..first + count {
                let place = i * width + component;
                out.extend_from(&self.values, place..place + 1);
            }
        }
    }
}
