//! The way of a page into memory, step by step: a client requests it
//! ([`retain`](PageClient::retain)); it is absent, so room is made (`make_room`) and a read is
//! submitted (`read_of`); what was read is checked and becomes resident (`complete`); and threads
//! that waited (`wait_for_page`) retain it. [`retain_computed`](PageClient::retain_computed)
//! computes a page instead of reading it.

use std::cell::RefCell;
use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Arc;
use std::time::Instant;

use super::client::PageClient;
use super::guard::PageGuard;
use super::hints::Hint;
use super::object::{HintMark, Object, Resident, Slot};
use super::pool::WaitError;
use super::reuse::Reuse;
use super::shared::Shared;
use super::source::PageFault;
use super::stats::Counters;
use crate::storage::PageBuffer;
use crate::storage::transport::Read;
use rayset_base::cancel::Registration as Registered;
use rayset_base::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};

impl PageClient {
    /// Retains a page, reading it if it is absent.
    ///
    /// # Errors
    /// [`PageFault`] if the page cannot be read or is damaged, if there is no room for it although
    /// nothing is loading, or if the client is cancelled while it waits.
    pub fn retain(&self, object: &Arc<Object>, page: u32) -> Result<PageGuard, PageFault> {
        self.retain_knowing(object, page, None)
    }

    /// Retains a page as [`retain`](Self::retain) does; if another has to make room for it, the one
    /// that `reuse` says is needed last.
    ///
    /// # Errors
    /// As for [`retain`](Self::retain).
    pub fn retain_knowing(
        &self,
        object: &Arc<Object>,
        page: u32,
        reuse: Option<&RefCell<Reuse>>,
    ) -> Result<PageGuard, PageFault> {
        if let Some(found) = object.in_place(page) {
            return found.map(PageGuard::from);
        }
        #[cfg(feature = "internals")]
        self.shared.observe(object, page);
        let counters = self.shared.counters_of(object, page);
        let mut slot = object.slot(page);
        match &*slot {
            Slot::Resident(resident) => {
                self.own.hits.count(object.kind(page));
                Ok(self.guard(object, resident, counters))
            }
            Slot::Failed(fault) => Err((**fault).clone()),
            Slot::Loading => {
                drop(slot);
                counters.late.fetch_add(1, Ordering::Relaxed);
                self.wait_for_page(object, page, reuse, Instant::now())
            }
            Slot::Absent => {
                *slot = Slot::Loading;
                drop(slot);
                counters.misses.fetch_add(1, Ordering::Relaxed);
                let started = Instant::now();
                self.read(object, page, reuse)?;
                self.wait_for_page(object, page, reuse, started)
            }
        }
    }

    /// Retains a page if it is resident now; `None` if it is absent or loading.
    ///
    /// # Errors
    /// [`PageFault`] if the page could not be read or is damaged.
    pub fn retain_resident(&self, object: &Object, page: u32) -> Option<Result<PageGuard, PageFault>> {
        if let Some(found) = object.in_place(page) {
            return Some(found.map(PageGuard::from));
        }
        match &*object.slot(page) {
            Slot::Resident(resident) => {
                let counters = self.shared.counters_of(object, page);
                self.own.hits.count(object.kind(page));
                Some(Ok(self.guard(object, resident, counters)))
            }
            Slot::Failed(fault) => Some(Err((**fault).clone())),
            Slot::Absent | Slot::Loading => None,
        }
    }

    /// Makes room for a page that this thread has set to loading and will wait for, and submits its
    /// read.
    fn read(&self, object: &Arc<Object>, page: u32, reuse: Option<&RefCell<Reuse>>) -> Result<(), PageFault> {
        let buffer = self.make_room(object, page, reuse)?;
        let read = self.shared.read_of(object, page, buffer, self.number, None);
        self.shared.transport_of(object).submit_awaited(read);
        Ok(())
    }

    /// Reserves room for a page that this thread has set to loading; if there is none, the page
    /// becomes absent again.
    fn make_room(
        &self,
        object: &Arc<Object>,
        page: u32,
        reuse: Option<&RefCell<Reuse>>,
    ) -> Result<PageBuffer, PageFault> {
        let mut evicted = Vec::new();
        let _woken = self.registered();
        let room = self.shared.pool.reserve(object.kind(page), object, &self.cancel, reuse, &mut evicted);
        self.shared.count_evictions(&evicted);
        room.map_err(|error| {
            self.shared.give_up(object, page);
            match error {
                WaitError::Cancelled => PageFault::Cancelled,
                WaitError::Hopeless => PageFault::Full {
                    budget: self.shared.pool.limits().all_kinds(),
                    needed: self.shared.pool.retained_bytes() + object.bytes(),
                },
            }
        })
    }

    /// Waits until a page that is loading is resident, and retains it.
    fn wait_for_page(
        &self,
        object: &Arc<Object>,
        page: u32,
        reuse: Option<&RefCell<Reuse>>,
        started: Instant,
    ) -> Result<PageGuard, PageFault> {
        let counters = self.shared.counters_of(object, page);
        let _woken = self.registered();
        let result = loop {
            let outcome = self.shared.pool.wait_until(&self.cancel, || match &*object.slot(page) {
                Slot::Loading => None,
                Slot::Resident(resident) => Some(Some(Ok(self.guard(object, resident, counters)))),
                Slot::Failed(fault) => Some(Some(Err((**fault).clone()))),
                // The page was loaded and evicted again before this thread woke up, or a hint found
                // no room for it.
                Slot::Absent => Some(None),
            });
            match outcome {
                Err(WaitError::Cancelled) => return Err(PageFault::Cancelled),
                Err(WaitError::Hopeless) => {
                    return Err(PageFault::Stuck { name: object.source.name(), page });
                }
                Ok(Some(result)) => break result,
                Ok(None) => {
                    let mut slot = object.slot(page);
                    if matches!(&*slot, Slot::Absent) {
                        *slot = Slot::Loading;
                        drop(slot);
                        self.read(object, page, reuse)?;
                    }
                }
            }
        };
        counters.stalled(started);
        result
    }

    /// Retains a page that is computed, not read: if it is absent, `compute` fills its bytes on the
    /// calling thread, which may retain other pages meanwhile. Another thread that requests the
    /// page waits for it, or computes it if this one fails.
    ///
    /// Panics if `compute` panics; requests for the page fail from then on.
    ///
    /// # Errors
    /// The error that `compute` returns, which leaves the page absent; a [`PageFault`] if there is
    /// no room, an earlier `compute` has panicked, the page is being computed by a thread that
    /// waits for this one, or the client is cancelled while it waits.
    pub fn retain_computed<E: From<PageFault>>(
        &self,
        object: &Arc<Object>,
        page: u32,
        mut compute: impl FnMut(&mut [u8]) -> Result<(), E>,
    ) -> Result<PageGuard, E> {
        let counters = self.shared.counters_of(object, page);
        loop {
            let mut slot = object.slot(page);
            match &*slot {
                Slot::Resident(resident) => {
                    self.own.hits.count(object.kind(page));
                    return Ok(self.guard(object, resident, counters));
                }
                Slot::Failed(fault) => return Err((**fault).clone().into()),
                Slot::Loading => {
                    drop(slot);
                    counters.late.fetch_add(1, Ordering::Relaxed);
                    self.wait_while_loading(object, page)?;
                }
                Slot::Absent => {
                    *slot = Slot::Loading;
                    drop(slot);
                    counters.misses.fetch_add(1, Ordering::Relaxed);
                    let buffer = self.make_room(object, page, None)?;
                    return self.compute(object, page, buffer, &mut compute);
                }
            }
        }
    }

    /// Waits until a page that another thread computes is resident or has failed.
    fn wait_while_loading(&self, object: &Arc<Object>, page: u32) -> Result<(), PageFault> {
        let started = Instant::now();
        let _woken = self.registered();
        let is_loading = || matches!(&*object.slot(page), Slot::Loading);
        let waited = self.shared.pool.wait_until(&self.cancel, || (!is_loading()).then_some(()));
        waited.map_err(|error| match error {
            WaitError::Cancelled => PageFault::Cancelled,
            WaitError::Hopeless => PageFault::Stuck { name: object.source.name(), page },
        })?;
        self.shared.counters_of(object, page).stalled(started);
        Ok(())
    }

    /// Computes a page that this thread has set to loading and made room for.
    fn compute<E>(
        &self,
        object: &Arc<Object>,
        page: u32,
        mut buffer: PageBuffer,
        compute: &mut impl FnMut(&mut [u8]) -> Result<(), E>,
    ) -> Result<PageGuard, E> {
        let computing = self.shared.pool.computing();
        let outcome = catch_unwind(AssertUnwindSafe(|| compute(buffer.bytes_mut())));
        drop(computing);
        match outcome {
            Ok(Ok(())) => {
                let counters = self.shared.counters_of(object, page);
                counters.computed.fetch_add(1, Ordering::Relaxed);
                if object.touch(page, self.shared.period.load(Ordering::Relaxed)) {
                    counters.computed_unique.fetch_add(1, Ordering::Relaxed);
                }
                let resident = self.shared.resident(buffer, self.number, HintMark::None, false);
                let hold = |resident: &Arc<Resident>| PageGuard::new(resident, &self.own);
                let (guard, evicted) = self.shared.pool.loaded(object, page, resident, hold);
                self.shared.count_evictions(&evicted);
                Ok(guard)
            }
            Ok(Err(error)) => {
                self.shared.pool.failed(object, page, Slot::Absent, buffer);
                Err(error)
            }
            Err(panic) => {
                // Threads that wait for the page must learn that it has failed.
                let fault = PageFault::Panicked { name: object.source.name(), page };
                self.shared.pool.failed(object, page, Slot::Failed(Box::new(fault)), buffer);
                resume_unwind(panic);
            }
        }
    }

    /// A guard on a page that has been requested. The caller holds the lock of its slot.
    fn guard(&self, object: &Object, resident: &Arc<Resident>, counters: &Counters) -> PageGuard {
        match resident.hint_mark() {
            // Whoever requested it takes it for the first time.
            HintMark::Requested if resident.user.load(Ordering::Relaxed) == self.number => {
                resident.hint.store(HintMark::None.word(), Ordering::Relaxed);
            }
            mark => {
                resident.last_use.store(self.own.time_of_use(), Ordering::Relaxed);
                if mark != HintMark::None && self.shared.settle_hint(resident, object.bytes()) {
                    counters.hinted_in_time.fetch_add(1, Ordering::Relaxed);
                }
            }
        }
        resident.user.store(self.number, Ordering::Relaxed);
        if resident.retired.load(Ordering::Relaxed) {
            resident.retired.store(false, Ordering::Relaxed);
        }
        PageGuard::new(resident, &self.own)
    }

    /// While this lives, a cancellation wakes the threads that wait in the pool.
    fn registered(&self) -> Registered<'_> {
        let shared = self.shared.clone();
        self.cancel.register(Arc::new(move || shared.pool.notify()))
    }
}

impl Shared {
    /// Makes a page that was to be loaded absent again.
    pub(super) fn give_up(&self, object: &Object, page: u32) {
        *object.slot(page) = Slot::Absent;
        self.pool.notify();
    }

    /// The read that will make a page resident, for a client, and the hint if the page is read for
    /// one.
    pub(super) fn read_of(
        self: &Arc<Self>,
        object: &Arc<Object>,
        page: u32,
        buffer: PageBuffer,
        client: u32,
        hint: Option<Hint>,
    ) -> Read {
        let counters = self.counters_of(object, page);
        counters.reads.fetch_add(1, Ordering::Relaxed);
        counters.bytes_read.fetch_add(object.bytes(), Ordering::Relaxed);
        if object.touch(page, self.period.load(Ordering::Relaxed)) {
            counters.bytes_unique.fetch_add(object.bytes(), Ordering::Relaxed);
        }
        let (shared, owner, asked) = (self.clone(), object.clone(), Instant::now());
        Read {
            storage: object.source.storage(),
            offset: object.source.offset(page),
            buffer,
            done: Box::new(move |buffer, outcome| {
                owner.took(asked.elapsed());
                shared.complete(&owner, page, buffer, outcome, client, hint);
            }),
        }
    }

    /// Completes a read: checks the page, which then is resident or failed.
    fn complete(
        self: &Arc<Self>,
        object: &Arc<Object>,
        page: u32,
        buffer: PageBuffer,
        outcome: io::Result<()>,
        client: u32,
        hint: Option<Hint>,
    ) {
        let (name, offset) = (|| object.source.name(), object.source.offset(page));
        let checked = match outcome {
            Ok(()) => {
                // Sources may be user code: one that panics must not leave threads waiting forever.
                let check = AssertUnwindSafe(|| object.source.check(page, buffer.bytes()));
                let checked = catch_unwind(check).unwrap_or_else(|_| Err("its check panicked".into()));
                checked.map_err(|what| PageFault::Damaged { name: name(), page, offset, what })
            }
            Err(e) => Err(PageFault::Read { name: name(), page, offset, source: Arc::new(e) }),
        };
        match checked {
            Ok(()) => {
                // A page whose hint has been withdrawn meanwhile is evicted first.
                let wanted = hint.is_none_or(|hint| self.is_hint_of(client, hint.era));
                let mark = match hint {
                    None => HintMark::Requested,
                    Some(_) if wanted => HintMark::Read(client),
                    Some(_) => HintMark::None,
                };
                if !wanted {
                    self.hint_was_used(client, object.bytes());
                }
                let resident = self.resident(buffer, client, mark, !wanted);
                resident.kept.store(wanted && hint.is_some_and(|hint| hint.keep), Ordering::Relaxed);
                let ((), evicted) = self.pool.loaded(object, page, resident, |_| ());
                self.count_evictions(&evicted);
            }
            Err(fault) => {
                if hint.is_some() {
                    self.hint_was_used(client, object.bytes());
                }
                self.pool.failed(object, page, Slot::Failed(Box::new(fault)), buffer);
            }
        }
    }

    /// A page as it becomes resident; evicted first if it is `retired` already.
    fn resident(&self, buffer: PageBuffer, client: u32, mark: HintMark, retired: bool) -> Resident {
        Resident {
            buffer,
            // Set by the pool.
            serial: 0,
            last_use: AtomicU64::new(self.pool.tick()),
            user: AtomicU32::new(client),
            retired: AtomicBool::new(retired),
            kept: AtomicBool::new(false),
            hint: AtomicU32::new(mark.word()),
        }
    }
}
