//! Parts of stored records.

use rayset_store::spill::Spill;

/// The records `first` to `first + count` (exclusive) of a spill.
#[derive(Clone, Copy)]
pub(super) struct Region<'a> {
    pub(super) spill: &'a Spill,
    pub(super) first: u64,
    pub(super) count: u64,
}

impl<'a> Region<'a> {
    pub(super) fn all(spill: &'a Spill, count: u64) -> Self {
        Self::of(spill, 0, count)
    }

    pub(super) fn of(spill: &'a Spill, first: u64, count: u64) -> Self {
        Self { spill, first, count }
    }
}
