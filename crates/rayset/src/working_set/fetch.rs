//! How an absent page is brought in: room is made, it is read, and whoever waits for it is told.

use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicU8, AtomicU32, AtomicU64, Ordering};
use std::time::Instant;

use super::WorkingSet;
use super::buffer::PageBuffer;
use super::read::Read;
use super::slot::{NOT_HINTED, Object, PageGuard, READ_FOR_HINT, Resident, Slot};
use super::source::PageFault;
use super::stats::Counters;

impl WorkingSet {
    /// Waits until a page that is loading is there.
    pub(super) fn wait(
        &self,
        object: &Arc<Object>,
        page: u32,
        priority: u8,
        started: Instant,
        counters: &Counters,
    ) -> Result<PageGuard, PageFault> {
        let result = loop {
            let outcome = self.shared.ledger.wait_until(self.shared.patience, || match &*object.slot(page) {
                Slot::Loading => None,
                Slot::Resident(resident) => Some(Some(Ok(self.guard(resident, priority, counters)))),
                Slot::Failed(fault) => Some(Some(Err(fault.clone()))),
                // Loaded and evicted again before this thread woke up, or a hint that found no room.
                Slot::Absent => Some(None),
            });
            match outcome {
                None => return Err(PageFault::Stuck { name: object.source.name(), page }),
                Some(Some(result)) => break result,
                Some(None) => {
                    let mut slot = object.slot(page);
                    if matches!(&*slot, Slot::Absent) {
                        *slot = Slot::Loading;
                        drop(slot);
                        let buffer =
                            self.make_room(object, page).inspect_err(|_| self.give_up(object, page))?;
                        self.shared.backend.submit(vec![self.read_of(object, page, buffer, priority, false)]);
                    }
                }
            }
        };
        counters.stalls.fetch_add(1, Ordering::Relaxed);
        counters.stall_nanoseconds.fetch_add(started.elapsed().as_nanos() as u64, Ordering::Relaxed);
        result
    }

    /// Waits until a page that another thread computes is there, or will not come.
    pub(super) fn wait_while_loading(&self, object: &Object, page: u32) -> Result<(), PageFault> {
        let is_loading = || matches!(&*object.slot(page), Slot::Loading);
        let waited = self.shared.ledger.wait_until(self.shared.patience, || (!is_loading()).then_some(()));
        waited.ok_or_else(|| PageFault::Stuck { name: object.source.name(), page })
    }

    /// Room for a page that a thread waits for.
    pub(super) fn make_room(&self, object: &Arc<Object>, page: u32) -> Result<PageBuffer, PageFault> {
        let kind = object.kind(page);
        let (room, evicted) = self.shared.ledger.reserve(kind, object, self.shared.patience);
        self.count_evictions(&evicted);
        room.ok_or_else(|| {
            let limits = self.shared.ledger.limits();
            PageFault::Full {
                budget: limits.total,
                needed: self.shared.ledger.retained_bytes() + object.bytes(),
            }
        })
    }

    pub(super) fn give_up(&self, object: &Object, page: u32) {
        *object.slot(page) = Slot::Absent;
        self.shared.ledger.notify();
    }

    /// The request that will make a page resident.
    pub(super) fn read_of(
        &self,
        object: &Arc<Object>,
        page: u32,
        buffer: PageBuffer,
        priority: u8,
        hint: bool,
    ) -> Read {
        let kind = object.kind(page);
        let counters = &self.shared.counters[kind.index()];
        counters.reads.fetch_add(1, Ordering::Relaxed);
        counters.bytes_read.fetch_add(object.bytes(), Ordering::Relaxed);
        if object.touch(page, self.shared.period.load(Ordering::Relaxed)) {
            counters.bytes_unique.fetch_add(object.bytes(), Ordering::Relaxed);
        }
        let (set, owner) = (self.clone(), object.clone());
        let hint = hint.then(|| self.shared.hint_era.load(Ordering::Relaxed));
        let offset = object.source.offset(page);
        Read {
            storage: object.source.storage(),
            offset,
            buffer,
            done: Box::new(move |buffer, outcome| {
                set.complete(&owner, page, buffer, outcome, priority, hint);
            }),
        }
    }

    fn complete(
        &self,
        object: &Arc<Object>,
        page: u32,
        buffer: PageBuffer,
        outcome: io::Result<()>,
        priority: u8,
        hint_era: Option<u32>,
    ) {
        // A hint that has been forgotten meanwhile is settled here.
        let forgotten = hint_era.is_some_and(|era| era != self.shared.hint_era.load(Ordering::Relaxed));
        if forgotten {
            self.shared.unused_hint_bytes.fetch_sub(object.bytes(), Ordering::Relaxed);
        }
        let (priority, hint) = if forgotten { (0, false) } else { (priority, hint_era.is_some()) };
        let (name, offset) = (|| object.source.name(), object.source.offset(page));
        let checked = match outcome {
            Ok(()) => {
                // A source is anybody's: one that panics must not leave threads waiting for ever.
                let check = AssertUnwindSafe(|| object.source.check(page, buffer.bytes()));
                let checked = catch_unwind(check).unwrap_or_else(|_| Err("its check panicked".into()));
                checked.map_err(|what| PageFault::Damaged { name: name(), page, offset, what })
            }
            Err(e) => Err(PageFault::Read { name: name(), page, offset, source: Arc::new(e) }),
        };
        match checked {
            Ok(()) => {
                let resident = Arc::new(Resident {
                    object: object.clone(),
                    page,
                    buffer,
                    retained: AtomicU32::new(0),
                    priority: AtomicU8::new(priority),
                    last_use: AtomicU64::new(self.tick()),
                    hint: AtomicU8::new(if hint { READ_FOR_HINT } else { NOT_HINTED }),
                });
                *object.slot(page) = Slot::Resident(resident.clone());
                let evicted = self.shared.ledger.loaded(resident);
                self.count_evictions(&evicted);
            }
            Err(fault) => {
                if hint {
                    self.shared.unused_hint_bytes.fetch_sub(object.bytes(), Ordering::Relaxed);
                }
                *object.slot(page) = Slot::Failed(fault);
                self.shared.ledger.failed(object.kind(page), object, buffer);
            }
        }
    }
}
