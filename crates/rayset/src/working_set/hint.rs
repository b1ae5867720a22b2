//! Pages that will be wanted, and pages that will not.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use super::WorkingSet;
use super::slot::{KEPT_FOR_HINT, NOT_HINTED, Object, READ_FOR_HINT, Resident, Slot, decayed};

impl WorkingSet {
    /// Asks for pages that will be wanted soon. Those that are absent are read in one batch, as far as there is room
    /// without evicting a page that is in use, or waits at the same or a higher priority, and as long as pages that were
    /// read for hints and not yet asked for take no more than `most_bytes`. Those that are resident count as used now.
    /// Until somebody asks for them all wait like pages that were released: if they stayed longer than what is used
    /// meanwhile, hints that come to nothing would fill a small budget. Returns how many of `pages`, from the first, were
    /// dealt with.
    pub fn hint(&self, object: &Arc<Object>, pages: &[u32], priority: u8, most_bytes: u64) -> usize {
        let mut batch = Vec::new();
        let mut dealt_with = pages.len();
        for (at, &page) in pages.iter().enumerate() {
            let unused = self.shared.unused_hint_bytes.load(Ordering::Relaxed);
            let mut slot = object.slot(page);
            match &*slot {
                Slot::Absent if unused + object.bytes() > most_bytes => {
                    dealt_with = at;
                    break;
                }
                Slot::Absent => *slot = Slot::Loading,
                Slot::Resident(resident) => {
                    self.keep_for_hint(resident, decayed(priority));
                    continue;
                }
                Slot::Loading | Slot::Failed(_) => continue,
            }
            drop(slot);
            let kind = object.kind(page);
            let (room, evicted) = self.shared.ledger.try_reserve(kind, object, Some(priority));
            self.count_evictions(&evicted);
            match room {
                Some(buffer) => {
                    self.shared.unused_hint_bytes.fetch_add(object.bytes(), Ordering::Relaxed);
                    self.shared.counters[kind.index()].hinted.fetch_add(1, Ordering::Relaxed);
                    batch.push(self.read_of(object, page, buffer, decayed(priority), true));
                }
                None => {
                    self.give_up(object, page);
                    dealt_with = at;
                    break;
                }
            }
        }
        if !batch.is_empty() {
            self.shared.backend.submit(batch);
        }
        dealt_with
    }

    /// A page that will be wanted is there already: it waits like those that are read for a hint.
    fn keep_for_hint(&self, resident: &Resident, priority: u8) {
        resident.last_use.store(self.tick(), Ordering::Relaxed);
        if resident.retained.load(Ordering::Relaxed) == 0 {
            resident.priority.fetch_max(priority, Ordering::Relaxed);
            let kept = (NOT_HINTED, KEPT_FOR_HINT);
            let _ = resident.hint.compare_exchange(kept.0, kept.1, Ordering::Relaxed, Ordering::Relaxed);
        }
    }

    /// Settles a hint: the page was asked for, or will not be. True where it was read for the hint.
    pub(super) fn used_hint(&self, resident: &Resident) -> bool {
        let read = resident.hint.swap(NOT_HINTED, Ordering::Relaxed) == READ_FOR_HINT;
        if read {
            self.shared.unused_hint_bytes.fetch_sub(resident.object.bytes(), Ordering::Relaxed);
        }
        read
    }

    /// Says that what was hinted at until now and not asked for since will not be: those pages are the first to go, and
    /// so are those that are still on their way.
    pub fn forget_hints(&self) {
        self.shared.hint_era.fetch_add(1, Ordering::Relaxed);
        for resident in self.shared.ledger.residents() {
            if resident.hint.load(Ordering::Relaxed) != NOT_HINTED {
                // Under the lock of the slot, so that it is either still unused or retained for good.
                let object = resident.object.clone();
                let _slot = object.slot(resident.page);
                if resident.retained.load(Ordering::Relaxed) == 0 {
                    resident.priority.store(0, Ordering::Relaxed);
                    self.used_hint(&resident);
                }
            }
        }
    }

    /// Says that pages will hardly be wanted again: they are the first to go. Pages that are not resident, or
    /// retained, are left as they are.
    pub fn retire(&self, object: &Object, pages: &[u32]) {
        self.retire_if(object, pages, |_| true);
    }

    /// Says that hints have turned out wrong: those of `pages` that were hinted at and not asked for since are retired.
    pub fn retire_unused(&self, object: &Object, pages: &[u32]) {
        self.retire_if(object, pages, |resident| resident.hint.load(Ordering::Relaxed) != NOT_HINTED);
    }

    fn retire_if(&self, object: &Object, pages: &[u32], wanted: impl Fn(&Resident) -> bool) {
        for &page in pages {
            if let Slot::Resident(resident) = &*object.slot(page)
                && resident.retained.load(Ordering::Relaxed) == 0
                && wanted(resident)
            {
                resident.priority.store(0, Ordering::Relaxed);
                self.used_hint(resident);
            }
        }
    }
}
