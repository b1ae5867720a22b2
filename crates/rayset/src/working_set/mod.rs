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
mod files;
mod grid;
mod ledger;
pub mod read;
mod stats;

use std::io;
use std::ops::Deref;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU8, AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

pub use self::buffer::{OVERHEAD_BYTES, PageBuffer};
pub use self::cloud::CloudPages;
pub use self::files::PagedFiles;
pub use self::grid::GridPages;
pub use self::ledger::Limits;
use self::ledger::{Evicted, Ledger};
use self::read::{Read, ReadBackend, Storage};
use self::stats::Counters;
pub use self::stats::{KindStatistics, Statistics};

/// What a page holds; budgets and statistics are kept by kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Kind {
    /// Nodes of an octree.
    Octree,
    /// Points.
    Points,
    /// Bricks of a grid.
    Voxels,
    /// Light that reaches places, computed.
    Shadows,
}

/// Number of kinds.
pub const KINDS: usize = 4;

impl Kind {
    /// Every kind.
    pub const ALL: [Self; KINDS] = [Self::Octree, Self::Points, Self::Voxels, Self::Shadows];

    fn index(self) -> usize {
        match self {
            Self::Octree => 0,
            Self::Points => 1,
            Self::Voxels => 2,
            Self::Shadows => 3,
        }
    }

    /// The name used in statistics.
    #[must_use]
    pub fn name(self) -> &'static str {
        ["octree", "points", "voxels", "shadows"][self.index()]
    }
}

/// Something on disk that consists of pages.
pub trait PageSource: Send + Sync {
    /// Number of pages.
    fn pages(&self) -> u32;
    /// Bytes of every page.
    fn page_bytes(&self) -> usize;
    /// What a page holds.
    fn kind(&self, page: u32) -> Kind;
    /// Where a page starts in the storage.
    fn offset(&self, page: u32) -> u64;
    /// What the pages are read from.
    fn storage(&self) -> Arc<dyn Storage>;
    /// Checks the bytes of a page that has just been read; the error says what is wrong with them.
    ///
    /// # Errors
    /// A sentence for the user.
    fn check(&self, page: u32, bytes: &[u8]) -> Result<(), String>;
    /// What to call the source in messages.
    fn name(&self) -> String;
}

/// Why a page could not be had.
#[derive(Clone, Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PageFault {
    /// The read failed.
    #[error("{name}, byte {offset}: cannot read page {page}: {source}")]
    Read {
        /// The source.
        name: String,
        /// The page.
        page: u32,
        /// Its place.
        offset: u64,
        /// The system's reason.
        source: Arc<io::Error>,
    },
    /// The page is damaged.
    #[error("{name}, byte {offset} (page {page}): {what}")]
    Damaged {
        /// The source.
        name: String,
        /// The page.
        page: u32,
        /// Its place.
        offset: u64,
        /// What is wrong.
        what: String,
    },
    /// Everything in the budget is retained.
    #[error("the budget of {budget} bytes is full of retained pages; at least {needed} bytes are needed")]
    Full {
        /// The budget.
        budget: u64,
        /// The smallest that would have done at this moment.
        needed: u64,
    },
}

/// Number of an object in a working set.
pub type ObjectId = usize;

/// States of [`Resident::hint`].
const NOT_HINTED: u8 = 0;
const READ_FOR_HINT: u8 = 1;
const KEPT_FOR_HINT: u8 = 2;

/// A page in memory.
struct Resident {
    object: Arc<Object>,
    page: u32,
    buffer: PageBuffer,
    /// Guards alive. Raised only under the lock of the slot.
    retained: AtomicU32,
    priority: AtomicU8,
    last_use: AtomicU64,
    /// Whether a hint that nobody has used yet brought it in, or keeps it.
    hint: AtomicU8,
}

enum Slot {
    Absent,
    Loading,
    Resident(Arc<Resident>),
    Failed(PageFault),
}

/// An object of a working set: its source and the state of each of its pages.
pub struct Object {
    id: ObjectId,
    source: Arc<dyn PageSource>,
    slots: Vec<Mutex<Slot>>,
    /// For each page, the period of the statistics in which it was last read.
    touched: Vec<AtomicU32>,
}

impl std::fmt::Debug for Object {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Object")
            .field("id", &self.id)
            .field("name", &self.source.name())
            .finish_non_exhaustive()
    }
}

impl Object {
    /// Number of the object.
    #[must_use]
    pub fn id(&self) -> ObjectId {
        self.id
    }

    fn slot(&self, page: u32) -> MutexGuard<'_, Slot> {
        lock(&self.slots[page as usize])
    }

    fn kind(&self, page: u32) -> Kind {
        self.source.kind(page)
    }

    pub(crate) fn bytes(&self) -> u64 {
        self.source.page_bytes() as u64
    }

    /// Marks a page as read in a period of the statistics; true the first time.
    fn touch(&self, page: u32, period: u32) -> bool {
        self.touched[page as usize].swap(period, Ordering::Relaxed) != period
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

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
    counters: [Counters; KINDS],
}

/// Pages in memory, shared by threads. Cheap to clone.
#[derive(Clone)]
pub struct WorkingSet {
    shared: Arc<Shared>,
}

/// A retained page; its bytes stay in memory while the guard lives.
pub struct PageGuard {
    resident: Arc<Resident>,
    shared: Arc<Shared>,
    /// Whether the page's priority decays when this is released last.
    decays: bool,
}

impl Deref for PageGuard {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        self.resident.buffer.bytes()
    }
}

impl Drop for PageGuard {
    fn drop(&mut self) {
        let resident = &self.resident;
        // Whoever releases last lets the priority decay; the page stays until its room is needed.
        let priority = resident.priority.load(Ordering::Relaxed);
        if resident.retained.fetch_sub(1, Ordering::Release) == 1 {
            if self.decays {
                resident.priority.store(decayed(priority), Ordering::Relaxed);
            }
            self.shared.ledger.released();
        }
    }
}

/// The priority that a page keeps after its release.
#[must_use]
pub fn decayed(priority: u8) -> u8 {
    priority / 2
}

impl WorkingSet {
    /// An empty set with a budget and something to read with.
    #[must_use]
    pub fn new(limits: Limits, backend: Arc<dyn ReadBackend>) -> Self {
        let shared = Shared {
            ledger: Ledger::new(limits),
            backend,
            clock: AtomicU64::new(1),
            period: AtomicU32::new(1),
            unused_hint_bytes: AtomicU64::new(0),
            hint_era: AtomicU32::new(0),
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
    /// # Errors
    /// What `compute` returns, which leaves the page absent; a [`PageFault`] where there is no room.
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
                    let is_loading = || matches!(&*object.slot(page), Slot::Loading);
                    self.shared.ledger.wait_until(|| (!is_loading()).then_some(()));
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
            if let Err(error) = compute(buffer.bytes_mut()) {
                *object.slot(page) = Slot::Absent;
                self.shared.ledger.failed(object.kind(page), object, buffer);
                return Err(error);
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

    /// Asks for pages that will be wanted soon. Those that are absent are read in one batch, as far as there is room
    /// without evicting a page of the same or a higher priority, and as long as pages that were read for hints and not
    /// yet asked for take no more than `most_bytes`. Those that are resident are kept. Returns how many of `pages`, from
    /// the first, were dealt with.
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
                    self.keep_for_hint(resident, priority);
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
                    batch.push(self.read_of(object, page, buffer, priority, true));
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

    /// A page that will be wanted is there already: it stays until then, like those that are read for a hint.
    fn keep_for_hint(&self, resident: &Resident, priority: u8) {
        resident.last_use.store(self.tick(), Ordering::Relaxed);
        if resident.retained.load(Ordering::Relaxed) == 0 {
            resident.priority.fetch_max(priority, Ordering::Relaxed);
            let kept = (NOT_HINTED, KEPT_FOR_HINT);
            let _ = resident.hint.compare_exchange(kept.0, kept.1, Ordering::Relaxed, Ordering::Relaxed);
        }
    }

    /// Settles a hint: the page was asked for, or will not be. True where it was read for the hint.
    fn used_hint(&self, resident: &Resident) -> bool {
        let read = resident.hint.swap(NOT_HINTED, Ordering::Relaxed) == READ_FOR_HINT;
        if read {
            self.shared.unused_hint_bytes.fetch_sub(resident.object.bytes(), Ordering::Relaxed);
        }
        read
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

    /// Waits until a page that is loading is there.
    fn wait(
        &self,
        object: &Arc<Object>,
        page: u32,
        priority: u8,
        started: Instant,
        counters: &Counters,
    ) -> Result<PageGuard, PageFault> {
        let result = loop {
            let outcome = self.shared.ledger.wait_until(|| match &*object.slot(page) {
                Slot::Loading => None,
                Slot::Resident(resident) => Some(Some(Ok(self.guard(resident, priority, counters)))),
                Slot::Failed(fault) => Some(Some(Err(fault.clone()))),
                // Loaded and evicted again before this thread woke up, or a hint that found no room.
                Slot::Absent => Some(None),
            });
            match outcome {
                Some(result) => break result,
                None => {
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

    /// Room for a page that a thread waits for.
    fn make_room(&self, object: &Arc<Object>, page: u32) -> Result<PageBuffer, PageFault> {
        /// Long enough for any release or read to happen, short enough not to hang for ever.
        const PATIENCE: Duration = Duration::from_secs(10);
        let kind = object.kind(page);
        let (room, evicted) = self.shared.ledger.reserve(kind, object, PATIENCE);
        self.count_evictions(&evicted);
        room.ok_or_else(|| {
            let limits = self.shared.ledger.limits();
            PageFault::Full {
                budget: limits.total,
                needed: self.shared.ledger.retained_bytes() + object.bytes(),
            }
        })
    }

    fn give_up(&self, object: &Object, page: u32) {
        *object.slot(page) = Slot::Absent;
        self.shared.ledger.notify();
    }

    fn count_evictions(&self, evicted: &[Evicted]) {
        for e in evicted {
            self.shared.counters[e.kind.index()].evictions.fetch_add(1, Ordering::Relaxed);
            self.shared.unused_hint_bytes.fetch_sub(e.unused_hint_bytes, Ordering::Relaxed);
        }
    }

    /// The request that will make a page resident.
    fn read_of(&self, object: &Arc<Object>, page: u32, buffer: PageBuffer, priority: u8, hint: bool) -> Read {
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
