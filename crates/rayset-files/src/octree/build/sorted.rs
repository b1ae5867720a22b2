//! Records in memory, in file order.

use super::record::{Key, KeyMaker};

/// Key and index of a record.
#[derive(Clone, Copy, Debug)]
pub(super) struct KeyOfRecord {
    pub(super) key: Key,
    pub(super) index: u32,
}

/// Records in memory, with their sorted order.
pub(super) struct Records {
    bytes: Vec<u8>,
    entries: Vec<KeyOfRecord>,
    stride: usize,
}

/// A stretch of sorted records.
#[derive(Clone, Copy)]
pub(super) struct Sorted<'a> {
    bytes: &'a [u8],
    pub(super) entries: &'a [KeyOfRecord],
    stride: usize,
}

impl<'a> Sorted<'a> {
    /// Records that are in file order already.
    pub(super) fn in_order(bytes: &'a [u8], entries: &'a [KeyOfRecord], stride: usize) -> Self {
        Self { bytes, entries, stride }
    }

    pub(super) fn len(&self) -> usize {
        self.entries.len()
    }

    pub(super) fn record(&self, i: usize) -> &'a [u8] {
        let at = self.entries[i].index as usize * self.stride;
        &self.bytes[at..at + self.stride]
    }

    pub(super) fn slice(&self, range: std::ops::Range<usize>) -> Self {
        Self { entries: &self.entries[range], ..*self }
    }

    /// The records that a node at `level` owns itself, which come first, and the stretch of each
    /// child.
    pub(super) fn split(&self, level: u32) -> (Self, [Self; 8]) {
        let own = self.entries.iter().take_while(|e| e.key.level() == level).count();
        let rest = self.slice(own..self.len());
        let mut start = 0;
        let children = std::array::from_fn(|octant| {
            let end = rest.entries.partition_point(|e| e.key.cell_at(level + 1) & 7 <= octant as u64);
            let child = rest.slice(start..end);
            start = end;
            child
        });
        (self.slice(0..own), children)
    }
}

impl Records {
    /// Records that are not sorted yet, and have no entries.
    pub(super) fn unsorted(bytes: Vec<u8>, stride: usize) -> Self {
        let entries = Vec::with_capacity(bytes.len() / stride);
        Self { bytes, entries, stride }
    }

    /// Makes the entry of each record. `go_on` is asked every few thousand records; once it fails,
    /// so does this.
    pub(super) fn index<E>(&mut self, keys: &KeyMaker, go_on: impl Fn() -> Result<(), E>) -> Result<(), E> {
        for (index, record) in self.bytes.chunks_exact(self.stride).enumerate() {
            if index % 8192 == 0 {
                go_on()?;
            }
            self.entries.push(KeyOfRecord { key: keys.key(record), index: index as u32 });
        }
        Ok(())
    }

    /// The records as they were loaded.
    pub(super) fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Records that equal each other are in any order.
    pub(super) fn sort(&mut self) {
        let (bytes, stride) = (&self.bytes, self.stride);
        let record = |e: &KeyOfRecord| &bytes[e.index as usize * stride..(e.index as usize + 1) * stride];
        self.entries.sort_unstable_by(|a, b| a.key.cmp(&b.key).then_with(|| record(a).cmp(record(b))));
    }

    pub(super) fn sorted(&self) -> Sorted<'_> {
        Sorted { bytes: &self.bytes, entries: &self.entries, stride: self.stride }
    }
}
