//! Entries of pages in the eviction queue: a page, and when it had been used last.

use std::sync::Arc;

use super::object::{Object, Resident, Slot};
use rayset_base::sync::atomic::Ordering;

/// A page in memory, with the time of its last use when it was entered.
#[derive(Clone)]
pub(super) struct Entry {
    pub(super) last_use: u64,
    pub(super) serial: u32,
    pub(super) page: u32,
    pub(super) object: Arc<Object>,
}

/// The outcome of an attempt to evict a page.
pub(super) enum Outcome {
    Evicted(Resident),
    /// It has been used since it was entered, last at this time.
    Younger(u64),
    /// It is kept for rays that will come to it.
    Kept,
    Retained,
    /// The entry belongs to an earlier stay in memory.
    Stale,
}

impl Entry {
    /// Evicts the page unless it is retained or, with `only_unused`, has been used since it was
    /// entered.
    pub(super) fn evict(&self, only_unused: bool) -> Outcome {
        let mut slot = self.object.slot(self.page);
        let Slot::Resident(resident) = &*slot else { return Outcome::Stale };
        if resident.serial != self.serial {
            return Outcome::Stale;
        }
        let last_use = resident.last_use.load(Ordering::Relaxed);
        if only_unused && resident.kept.load(Ordering::Relaxed) {
            return Outcome::Kept;
        }
        if only_unused && last_use > self.last_use {
            return Outcome::Younger(last_use);
        }
        let Slot::Resident(resident) = std::mem::replace(&mut *slot, Slot::Absent) else {
            return Outcome::Stale;
        };
        match Arc::try_unwrap(resident) {
            Ok(resident) => Outcome::Evicted(resident),
            Err(retained) => {
                *slot = Slot::Resident(retained);
                Outcome::Retained
            }
        }
    }

    /// When the page was last used, or later than any use if it is kept, and whether it is
    /// retained; `None` if the entry belongs to an earlier stay in memory.
    pub(super) fn last_use_if_current(&self) -> Option<(u64, bool)> {
        match &*self.object.slot(self.page) {
            Slot::Resident(resident) if resident.serial == self.serial => {
                Some((resident.age(), Arc::strong_count(resident) > 1))
            }
            _ => None,
        }
    }

    /// Whether the page is still retired.
    pub(super) fn is_retired(&self) -> bool {
        let slot = self.object.slot(self.page);
        matches!(&*slot, Slot::Resident(r) if r.serial == self.serial && r.retired.load(Ordering::Relaxed))
    }
}
