//! Pages in memory, inside a budget that holds.
//!
//! A [`WorkingSet`] brings in pages of any number of objects, for any number of threads. A page is *absent*, *loading*
//! or *resident*; a resident page is *retained* by guards or merely kept until its room is needed. Room is made by
//! evicting the page of lowest priority, the least recently used among equals; retained pages stay. A release
//! decays the priority and never evicts.
//!
//! Invariants, whatever the threads do:
//! 1. The bytes of all pages, loading ones included, never exceed the budget, nor a kind's its own, nor an
//!    object's.
//! 2. A page is read at most once at a time, however many threads want it, and checked before anyone sees it.
//! 3. A lookup of a resident page takes one lock, that of its own slot, which nobody holds across a read, a wait or
//!    a search.

mod buffer;
mod cloud;
mod fetch;
mod files;
mod grid;
mod hint;
mod ledger;
pub mod read;
mod slot;
mod source;
mod stats;
#[cfg(test)]
mod tests;

use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::atomic::{AtomicU8, AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

pub use self::buffer::{OVERHEAD_BYTES, PageBuffer};
pub use self::cloud::CloudPages;
pub use self::files::PagedFiles;
pub use self::grid::GridPages;
pub use self::ledger::Limits;
use self::ledger::{Evicted, Ledger};
use self::read::ReadBackend;
use self::slot::{NOT_HINTED, Resident, Slot};
pub use self::slot::{Object, ObjectId, PageGuard, decayed};
pub use self::source::{KINDS, Kind, PageFault, PageSource};
use self::stats::Counters;
pub use self::stats::{KindStatistics, Statistics};

/// How long a thread waits for room, or for a page, while no page is on its way: long enough for any release to happen,
/// short enough not to hang for ever.
const PATIENCE: Duration = Duration::from_secs(10);

struct Shared {
    ledger: Ledger,
    backend: Arc<dyn ReadBackend>,
    clock: AtomicU64,
    /// Number of the current period of the statistics; pages of period 0 were never read.
    period: AtomicU32,
    /// Bytes of pages that were read for a hint and not yet asked for.
    unused_hint_bytes: AtomicU64,
    /// Hints of earlier eras are forgotten.
    hint_era: AtomicU32,
    patience: Duration,
    counters: [Counters; KINDS],
}

/// Pages in memory, shared by threads. Cheap to clone.
#[derive(Clone)]
pub struct WorkingSet {
    shared: Arc<Shared>,
}

impl WorkingSet {
    /// An empty set with a budget and something to read with.
    #[must_use]
    pub fn new(limits: Limits, backend: Arc<dyn ReadBackend>) -> Self {
        Self::with_patience(limits, backend, PATIENCE)
    }

    fn with_patience(limits: Limits, backend: Arc<dyn ReadBackend>, patience: Duration) -> Self {
        let shared = Shared {
            ledger: Ledger::new(limits, backend.brings_memory()),
            backend,
            clock: AtomicU64::new(1),
            period: AtomicU32::new(1),
            unused_hint_bytes: AtomicU64::new(0),
            hint_era: AtomicU32::new(0),
            patience,
            counters: Default::default(),
        };
        Self { shared: Arc::new(shared) }
    }

    /// Adds an object, none of whose pages is resident. Pages of one object are cached once, whoever uses it.
    #[must_use]
    pub fn add(&self, source: Arc<dyn PageSource>) -> Arc<Object> {
        let pages = source.pages() as usize;
        let id = self.shared.ledger.add_object();
        let slots = (0..pages).map(|_| Mutex::new(Slot::Absent)).collect();
        let touched = (0..pages).map(|_| AtomicU32::new(0)).collect();
        Arc::new(Object { id, source, slots, touched })
    }

    /// Bytes that the set itself takes for an object of `pages` pages, outside the budget.
    #[must_use]
    pub fn overhead_bytes(pages: u32) -> u64 {
        u64::from(pages) * (size_of::<Mutex<Slot>>() + size_of::<AtomicU32>()) as u64
    }

    /// The budget for all pages.
    #[must_use]
    pub fn budget_bytes(&self) -> u64 {
        self.shared.ledger.total_limit()
    }

    /// Changes the budget, also while other threads use the set; evicts what no longer fits and is not retained.
    pub fn set_limits(&self, limits: Limits) {
        let evicted = self.shared.ledger.set_limits(limits);
        self.count_evictions(&evicted);
    }

    /// Retains a page, reading it if need be, with a priority from 0 to 255 that counts when room is needed.
    ///
    /// # Errors
    /// [`PageFault`] where the page cannot be read, is damaged, or has no room although nothing is loading.
    pub fn retain(&self, object: &Arc<Object>, page: u32, priority: u8) -> Result<PageGuard, PageFault> {
        let counters = &self.shared.counters[object.kind(page).index()];
        let mut slot = object.slot(page);
        match &*slot {
            Slot::Resident(resident) => {
                counters.hits.fetch_add(1, Ordering::Relaxed);
                return Ok(self.guard(resident, priority, counters));
            }
            Slot::Failed(fault) => return Err(fault.clone()),
            Slot::Loading => {
                counters.late.fetch_add(1, Ordering::Relaxed);
                drop(slot);
            }
            Slot::Absent => {
                *slot = Slot::Loading;
                drop(slot);
                counters.misses.fetch_add(1, Ordering::Relaxed);
                let started = Instant::now();
                let room = self.make_room(object, page);
                let buffer = room.inspect_err(|_| self.give_up(object, page))?;
                self.shared.backend.submit(vec![self.read_of(object, page, buffer, priority, false)]);
                return self.wait(object, page, priority, started, counters);
            }
        }
        self.wait(object, page, priority, Instant::now(), counters)
    }

    /// Retains a page if it is resident now; nothing where it is absent or on its way.
    ///
    /// # Errors
    /// [`PageFault`] where the page could not be read, or is damaged.
    pub fn retain_resident(
        &self,
        object: &Object,
        page: u32,
        priority: u8,
    ) -> Option<Result<PageGuard, PageFault>> {
        match &*object.slot(page) {
            Slot::Resident(resident) => {
                let counters = &self.shared.counters[object.kind(page).index()];
                counters.hits.fetch_add(1, Ordering::Relaxed);
                Some(Ok(self.guard(resident, priority, counters)))
            }
            Slot::Failed(fault) => Some(Err(fault.clone())),
            Slot::Absent | Slot::Loading => None,
        }
    }

    /// Retains a page that is made, not read: `compute` fills its bytes where it is absent, on the calling thread, which
    /// may retain other pages meanwhile. Another thread that wants the page waits for it, or makes it where this one fails.
    ///
    /// Panics where `compute` panics; the page is an error from then on.
    ///
    /// # Errors
    /// What `compute` returns, which leaves the page absent; a [`PageFault`] where there is no room, where an earlier
    /// `compute` has panicked, or where the page is being made by a thread that waits for this one.
    pub fn retain_computed<E: From<PageFault>>(
        &self,
        object: &Arc<Object>,
        page: u32,
        priority: u8,
        mut compute: impl FnMut(&mut [u8]) -> Result<(), E>,
    ) -> Result<PageGuard, E> {
        let counters = &self.shared.counters[object.kind(page).index()];
        loop {
            let mut slot = object.slot(page);
            match &*slot {
                Slot::Resident(resident) => {
                    counters.hits.fetch_add(1, Ordering::Relaxed);
                    return Ok(self.guard(resident, priority, counters));
                }
                Slot::Failed(fault) => return Err(fault.clone().into()),
                Slot::Loading => {
                    drop(slot);
                    let started = Instant::now();
                    counters.late.fetch_add(1, Ordering::Relaxed);
                    self.wait_while_loading(object, page)?;
                    counters.stalls.fetch_add(1, Ordering::Relaxed);
                    let waited = started.elapsed().as_nanos() as u64;
                    counters.stall_nanoseconds.fetch_add(waited, Ordering::Relaxed);
                    continue;
                }
                Slot::Absent => *slot = Slot::Loading,
            }
            drop(slot);
            counters.misses.fetch_add(1, Ordering::Relaxed);
            let mut buffer = self.make_room(object, page).inspect_err(|_| self.give_up(object, page))?;
            let computing = self.shared.ledger.computing();
            let outcome = catch_unwind(AssertUnwindSafe(|| compute(buffer.bytes_mut())));
            drop(computing);
            let failed = |slot: Slot, buffer: PageBuffer| {
                *object.slot(page) = slot;
                self.shared.ledger.failed(object.kind(page), object, buffer);
            };
            match outcome {
                Ok(Ok(())) => {}
                Ok(Err(error)) => {
                    failed(Slot::Absent, buffer);
                    return Err(error);
                }
                Err(panic) => {
                    // Whoever waits for the page must learn that it will not come.
                    failed(Slot::Failed(PageFault::Panicked { name: object.source.name(), page }), buffer);
                    resume_unwind(panic);
                }
            }
            let resident = Arc::new(Resident {
                object: object.clone(),
                page,
                buffer,
                retained: AtomicU32::new(1),
                priority: AtomicU8::new(priority),
                last_use: AtomicU64::new(self.tick()),
                hint: AtomicU8::new(NOT_HINTED),
            });
            *object.slot(page) = Slot::Resident(resident.clone());
            let evicted = self.shared.ledger.loaded(resident.clone());
            self.count_evictions(&evicted);
            return Ok(PageGuard { resident, shared: self.shared.clone(), decays: true });
        }
    }

    /// Evicts all pages of an object that are not retained: it will not be used again.
    pub fn forget(&self, object: &Object) {
        let evicted = self.shared.ledger.evict_object(object.id);
        self.count_evictions(&evicted);
    }

    /// A page, if it is resident now. Looking at it so does not count as its use.
    #[must_use]
    pub fn peek(&self, object: &Object, page: u32) -> Option<PageGuard> {
        let slot = object.slot(page);
        let Slot::Resident(resident) = &*slot else { return None };
        resident.retained.fetch_add(1, Ordering::Acquire);
        Some(PageGuard { resident: resident.clone(), shared: self.shared.clone(), decays: false })
    }

    /// Whether a page is resident now.
    #[must_use]
    pub fn is_resident(&self, object: &Object, page: u32) -> bool {
        matches!(&*object.slot(page), Slot::Resident(_))
    }

    /// What has happened since the set was made, or since [`reset_statistics`](Self::reset_statistics).
    #[must_use]
    pub fn statistics(&self) -> Statistics {
        Statistics::collect(&self.shared.counters, &self.shared.ledger)
    }

    /// Sets all counters to zero; the peak starts again from what is resident.
    pub fn reset_statistics(&self) {
        self.shared.counters.iter().for_each(Counters::reset);
        self.shared.period.fetch_add(1, Ordering::Relaxed);
        self.shared.ledger.reset_peak();
    }

    /// Evicts everything that is not retained.
    pub fn clear(&self) {
        let evicted = self.shared.ledger.evict_all();
        self.count_evictions(&evicted);
    }

    fn tick(&self) -> u64 {
        self.shared.clock.fetch_add(1, Ordering::Relaxed)
    }

    /// A guard on a resident page. The caller holds the lock of its slot.
    fn guard(&self, resident: &Arc<Resident>, priority: u8, counters: &Counters) -> PageGuard {
        resident.retained.fetch_add(1, Ordering::Acquire);
        resident.priority.fetch_max(priority, Ordering::Relaxed);
        resident.last_use.store(self.tick(), Ordering::Relaxed);
        if self.used_hint(resident) {
            counters.hinted_in_time.fetch_add(1, Ordering::Relaxed);
        }
        PageGuard { resident: resident.clone(), shared: self.shared.clone(), decays: true }
    }

    fn count_evictions(&self, evicted: &[Evicted]) {
        for e in evicted {
            self.shared.counters[e.kind.index()].evictions.fetch_add(1, Ordering::Relaxed);
            self.shared.unused_hint_bytes.fetch_sub(e.unused_hint_bytes, Ordering::Relaxed);
        }
    }
}
