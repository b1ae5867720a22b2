//! Tables of numbers that lie in a file as they are: row after row, without anything between them.

use std::io;

use super::{ColumnType, Values};
use rayset_store::storage::Storage;

/// Where a table lies, and what its numbers are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Plain {
    /// The byte of the file at which it begins.
    pub(super) start: u64,
    pub(super) kind: ColumnType,
    /// Numbers in a row.
    pub(super) width: usize,
    pub(super) big_endian: bool,
}

impl Plain {
    /// Bytes of a number of rows.
    pub(super) fn bytes(&self, rows: u64) -> u64 {
        rows.saturating_mul((self.width * self.kind.bytes()) as u64)
    }

    /// Reads rows, in little-endian order.
    pub(super) fn load(
        &self,
        file: &dyn Storage,
        first: u64,
        rows: usize,
        bytes: &mut Vec<u8>,
    ) -> io::Result<()> {
        bytes.resize(self.bytes(rows as u64) as usize, 0);
        file.read_exact_at(bytes, self.start.saturating_add(self.bytes(first)))?;
        if self.big_endian {
            bytes.chunks_exact_mut(self.kind.bytes()).for_each(<[u8]>::reverse);
        }
        Ok(())
    }

    /// A number of the rows that were loaded.
    pub(super) fn get(&self, bytes: &[u8], row: usize, component: usize) -> f64 {
        self.kind.decode(&bytes[self.offset(row, component)..])
    }

    /// Appends a component of all rows that were loaded, exactly if `out` is of this type.
    pub(super) fn append(&self, bytes: &[u8], component: usize, out: &mut Values) {
        let rows = bytes.len() / (self.width * self.kind.bytes());
        if out.kind() == self.kind {
            (0..rows).for_each(|row| out.push_le_bytes(&bytes[self.offset(row, component)..]));
        } else {
            (0..rows).for_each(|row| out.push(self.get(bytes, row, component)));
        }
    }

    fn offset(&self, row: usize, component: usize) -> usize {
        (row * self.width + component) * self.kind.bytes()
    }
}
