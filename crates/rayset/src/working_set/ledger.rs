//! The budget: who has how many bytes, and who gives way.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::{self, ThreadId};
use std::time::{Duration, Instant};

use super::buffer::PageBuffer;
use super::slot::{Object, ObjectId, READ_FOR_HINT, Resident, Slot, lock};
use super::source::{KINDS, Kind};

/// Hard limits in bytes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Limits {
    /// For all pages together.
    pub total: u64,
    /// For each kind, in the order of [`Kind::ALL`].
    pub by_kind: [u64; KINDS],
    /// For single objects.
    pub by_object: Vec<(ObjectId, u64)>,
}

impl Limits {
    /// A limit for all pages together and none besides.
    #[must_use]
    pub fn total(bytes: u64) -> Self {
        Self { total: bytes, by_kind: [u64::MAX; KINDS], by_object: Vec::new() }
    }

    /// The same with a limit for one kind.
    #[must_use]
    pub fn with_kind(mut self, kind: Kind, bytes: u64) -> Self {
        self.by_kind[kind.index()] = bytes;
        self
    }

    /// The same with a limit for one object.
    #[must_use]
    pub fn with_object(mut self, object: ObjectId, bytes: u64) -> Self {
        self.by_object.retain(|(id, _)| *id != object);
        self.by_object.push((object, bytes));
        self
    }

    fn object(&self, object: ObjectId) -> u64 {
        self.by_object.iter().find(|(id, _)| *id == object).map_or(u64::MAX, |&(_, bytes)| bytes)
    }
}

/// Page buffers taken from the allocator at a time, besides the one that is wanted.
const BUFFERS_AT_A_TIME: u64 = 31;

/// Books of the working set. `used` counts every page from the moment its room is reserved.
struct Books {
    limits: Limits,
    used: u64,
    used_by_kind: [u64; KINDS],
    used_by_object: Vec<u64>,
    peak: u64,
    peak_by_kind: [u64; KINDS],
    /// Pages whose room is reserved and whose bytes are on their way.
    loading: u64,
    /// For each page that is being computed, the thread that does so.
    computing: Vec<ThreadId>,
    /// Those of `computing` that wait themselves, for room or for a page.
    halted: Vec<ThreadId>,
    residents: Vec<Arc<Resident>>,
    /// Candidates for eviction from the last search, worst last, each with what it looked like then.
    candidates: Vec<(u8, u64, Arc<Object>, u32)>,
    /// Memory of evicted pages, to be used again by the reservation that caused the eviction.
    spare: Vec<PageBuffer>,
    /// Memory that was taken from the allocator together with some that is in use.
    fresh: Vec<PageBuffer>,
    /// Zeros that stand for memory which a read is going to bring.
    stand_in: Option<Arc<Vec<u8>>>,
}

pub(super) struct Ledger {
    books: Mutex<Books>,
    changed: Condvar,
    /// Threads that wait for room, and all that wait. Notifying costs a system call, whether anybody listens or not.
    waiting_for_room: AtomicUsize,
    waiting: AtomicUsize,
}

/// A page is being computed by the thread that holds this.
pub(super) struct Computing<'a> {
    ledger: &'a Ledger,
    thread: ThreadId,
}

impl Drop for Computing<'_> {
    fn drop(&mut self) {
        let mut books = lock(&self.ledger.books);
        let at = books.computing.iter().position(|&thread| thread == self.thread);
        at.map(|at| books.computing.swap_remove(at));
        books.loading += 1;
    }
}

impl Drop for Ledger {
    /// Pages know their objects and objects their pages: someone has to let go.
    fn drop(&mut self) {
        let books = self.books.get_mut().unwrap_or_else(PoisonError::into_inner);
        for resident in books.residents.drain(..) {
            *resident.object.slot(resident.page) = Slot::Absent;
        }
    }
}

/// A page that went.
#[derive(Clone, Copy, Debug)]
pub(super) struct Evicted {
    pub(super) kind: Kind,
    /// Its bytes, where it had been hinted at and never asked for.
    pub(super) unused_hint_bytes: u64,
}

/// Which limit stands in the way of a page.
#[derive(Clone, Copy)]
enum Obstacle {
    Total,
    Kind(Kind),
    Object(ObjectId),
}

impl Obstacle {
    fn concerns(self, object: &Object, page: u32) -> bool {
        match self {
            Self::Total => true,
            Self::Kind(kind) => object.kind(page) == kind,
            Self::Object(id) => object.id == id,
        }
    }
}

impl Ledger {
    /// Books for so much memory. Where reads bring their own memory, none is taken for them.
    pub(super) fn new(limits: Limits, reads_bring_memory: bool) -> Self {
        let books = Books {
            limits,
            used: 0,
            used_by_kind: [0; KINDS],
            used_by_object: Vec::new(),
            peak: 0,
            peak_by_kind: [0; KINDS],
            loading: 0,
            computing: Vec::new(),
            halted: Vec::new(),
            residents: Vec::new(),
            candidates: Vec::new(),
            spare: Vec::new(),
            fresh: Vec::new(),
            stand_in: reads_bring_memory.then(Arc::default),
        };
        Self {
            books: Mutex::new(books),
            changed: Condvar::new(),
            waiting_for_room: AtomicUsize::new(0),
            waiting: AtomicUsize::new(0),
        }
    }

    pub(super) fn add_object(&self) -> ObjectId {
        let mut books = lock(&self.books);
        books.used_by_object.push(0);
        books.used_by_object.len() - 1
    }

    pub(super) fn limits(&self) -> Limits {
        lock(&self.books).limits.clone()
    }

    pub(super) fn total_limit(&self) -> u64 {
        lock(&self.books).limits.total
    }

    /// Sets new limits and evicts until they hold, as far as pages are neither retained nor loading. Returns what went.
    pub(super) fn set_limits(&self, limits: Limits) -> Vec<Evicted> {
        let mut books = lock(&self.books);
        books.limits = limits;
        books.spare.clear();
        books.fresh.clear();
        books.evict_excess()
    }

    /// Evicts everything that is neither retained nor loading. Returns what went.
    pub(super) fn evict_all(&self) -> Vec<Evicted> {
        self.evict_whatever(Obstacle::Total)
    }

    /// The same of one object.
    pub(super) fn evict_object(&self, object: ObjectId) -> Vec<Evicted> {
        self.evict_whatever(Obstacle::Object(object))
    }

    fn evict_whatever(&self, obstacle: Obstacle) -> Vec<Evicted> {
        let mut books = lock(&self.books);
        let mut evicted = Vec::new();
        while let Some(page) = books.evict(obstacle, None) {
            evicted.push(page);
            books.spare.clear();
        }
        books.fresh.clear();
        evicted
    }

    /// Room for one page, or nothing where that would mean evicting a page whose priority is not below `priority`
    /// (any, where it is `None`). Also returns what was evicted on the way.
    pub(super) fn try_reserve(
        &self,
        kind: Kind,
        object: &Object,
        priority: Option<u8>,
    ) -> (Option<PageBuffer>, Vec<Evicted>) {
        lock(&self.books).reserve(kind, object, priority)
    }

    /// Room for one page that a thread waits for: waits for releases if it must, but not longer than `patience` while
    /// no page is on its way. What is on its way can be evicted when it is there, however slow the disk.
    pub(super) fn reserve(
        &self,
        kind: Kind,
        object: &Object,
        patience: Duration,
    ) -> (Option<PageBuffer>, Vec<Evicted>) {
        let mut deadline = Instant::now() + patience;
        let mut books = lock(&self.books);
        let mut all_evicted = Vec::new();
        loop {
            let (room, evicted) = books.reserve(kind, object, None);
            all_evicted.extend(evicted);
            if books.is_moving() {
                deadline = Instant::now() + patience;
            }
            let left = deadline.saturating_duration_since(Instant::now());
            let impossible = object.bytes() > books.limits.total;
            if room.is_some() || left.is_zero() || impossible {
                return (room, all_evicted);
            }
            // A release that happens between the search and the wait notifies only if it sees us waiting, and
            // notifies without the lock; a short wait bounds what a missed one costs.
            self.waiting_for_room.fetch_add(1, Ordering::SeqCst);
            books = self.wait(books, left.min(Duration::from_millis(2)));
            self.waiting_for_room.fetch_sub(1, Ordering::SeqCst);
        }
    }

    fn wait<'a>(&self, mut books: MutexGuard<'a, Books>, limit: Duration) -> MutexGuard<'a, Books> {
        let halted = books.halt();
        self.waiting.fetch_add(1, Ordering::SeqCst);
        let mut books = self.changed.wait_timeout(books, limit).unwrap_or_else(PoisonError::into_inner).0;
        self.waiting.fetch_sub(1, Ordering::SeqCst);
        if let Some(thread) = halted {
            books.go_on(thread);
        }
        books
    }

    /// Waits until `ready` gives something, but not longer than `patience` while no page is on its way. It is asked under
    /// the lock of the books, which every change of a slot from loading takes before it notifies: whoever waits was
    /// counted before that, so no change is missed.
    pub(super) fn wait_until<T>(&self, patience: Duration, ready: impl Fn() -> Option<T>) -> Option<T> {
        let mut deadline = Instant::now() + patience;
        let mut books = lock(&self.books);
        loop {
            if let Some(result) = ready() {
                return Some(result);
            }
            if books.is_moving() {
                deadline = Instant::now() + patience;
            }
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return None;
            }
            books = self.wait(books, left.min(Duration::from_secs(1)));
        }
    }

    /// Says that the calling thread computes the page that it has reserved room for, until the guard is dropped: whatever
    /// it waits for meanwhile, its own page does not count as on its way.
    pub(super) fn computing(&self) -> Computing<'_> {
        let thread = thread::current().id();
        let mut books = lock(&self.books);
        books.loading -= 1;
        books.computing.push(thread);
        Computing { ledger: self, thread }
    }

    /// A page is there. Returns what had to go for it, where limits have been lowered meanwhile.
    pub(super) fn loaded(&self, resident: Arc<Resident>) -> Vec<Evicted> {
        let mut books = lock(&self.books);
        books.loading -= 1;
        books.residents.push(resident);
        let evicted = books.evict_excess();
        drop(books);
        self.notify_waiting();
        evicted
    }

    pub(super) fn failed(&self, kind: Kind, object: &Object, buffer: PageBuffer) {
        let mut books = lock(&self.books);
        books.loading -= 1;
        books.give_back(kind, object);
        // For whoever takes the room: freed and taken again, pages would crumble the allocator's memory.
        books.spare.push(buffer);
        drop(books);
        self.notify_waiting();
    }

    pub(super) fn notify(&self) {
        drop(lock(&self.books));
        self.notify_waiting();
    }

    fn notify_waiting(&self) {
        if self.waiting.load(Ordering::SeqCst) > 0 {
            self.changed.notify_all();
        }
    }

    pub(super) fn released(&self) {
        if self.waiting_for_room.load(Ordering::SeqCst) > 0 {
            self.changed.notify_all();
        }
    }

    pub(super) fn residents(&self) -> Vec<Arc<Resident>> {
        lock(&self.books).residents.clone()
    }

    pub(super) fn retained_bytes(&self) -> u64 {
        let books = lock(&self.books);
        let retained = books.residents.iter().filter(|r| r.retained.load(Ordering::Relaxed) > 0);
        retained.map(|r| r.object.bytes()).sum()
    }

    pub(super) fn peaks(&self) -> (u64, [u64; KINDS]) {
        let books = lock(&self.books);
        (books.peak, books.peak_by_kind)
    }

    pub(super) fn reset_peak(&self) {
        let mut books = lock(&self.books);
        (books.peak, books.peak_by_kind) = (books.used, books.used_by_kind);
    }
}

impl Books {
    /// Whether a page is on its way while the calling thread waits: being read, or computed by a thread that does not wait
    /// itself. Threads that compute pages and wait for the room of each other's would else wait for ever.
    fn is_moving(&self) -> bool {
        let waits = |thread: &ThreadId| *thread == thread::current().id() || self.halted.contains(thread);
        self.loading > 0 || !self.computing.iter().all(waits)
    }

    /// The calling thread is about to wait; who it is, where it computes a page.
    fn halt(&mut self) -> Option<ThreadId> {
        if self.computing.is_empty() {
            return None;
        }
        let thread = thread::current().id();
        let computes = self.computing.contains(&thread);
        computes.then(|| {
            self.halted.push(thread);
            thread
        })
    }

    fn go_on(&mut self, thread: ThreadId) {
        let at = self.halted.iter().position(|&halted| halted == thread);
        at.map(|at| self.halted.swap_remove(at));
    }

    fn obstacle(&self, kind: Kind, object: &Object) -> Option<Obstacle> {
        let bytes = object.bytes();
        if self.used + bytes > self.limits.total {
            Some(Obstacle::Total)
        } else if self.used_by_kind[kind.index()] + bytes > self.limits.by_kind[kind.index()] {
            Some(Obstacle::Kind(kind))
        } else if self.used_by_object[object.id].saturating_add(bytes) > self.limits.object(object.id) {
            Some(Obstacle::Object(object.id))
        } else {
            None
        }
    }

    /// A limit that is exceeded now.
    fn excess(&self) -> Option<Obstacle> {
        if self.used > self.limits.total {
            return Some(Obstacle::Total);
        }
        let kind =
            Kind::ALL.into_iter().find(|k| self.used_by_kind[k.index()] > self.limits.by_kind[k.index()]);
        let object =
            || (0..self.used_by_object.len()).find(|&o| self.used_by_object[o] > self.limits.object(o));
        kind.map(Obstacle::Kind).or_else(|| object().map(Obstacle::Object))
    }

    /// Evicts until the limits hold, as far as pages are neither retained nor loading.
    fn evict_excess(&mut self) -> Vec<Evicted> {
        let mut evicted = Vec::new();
        while let Some(obstacle) = self.excess() {
            match self.evict(obstacle, None) {
                Some(page) => evicted.push(page),
                None => break,
            }
        }
        if !evicted.is_empty() {
            self.spare.clear();
            self.fresh.clear();
        }
        evicted
    }

    fn reserve(
        &mut self,
        kind: Kind,
        object: &Object,
        priority: Option<u8>,
    ) -> (Option<PageBuffer>, Vec<Evicted>) {
        let mut evicted = Vec::new();
        while let Some(obstacle) = self.obstacle(kind, object) {
            match self.evict(obstacle, priority) {
                Some(page) => evicted.push(page),
                None => return (None, evicted),
            }
        }
        let bytes = object.bytes();
        self.loading += 1;
        self.used += bytes;
        self.used_by_kind[kind.index()] += bytes;
        self.used_by_object[object.id] += bytes;
        self.peak = self.peak.max(self.used);
        let peak = &mut self.peak_by_kind[kind.index()];
        *peak = (*peak).max(self.used_by_kind[kind.index()]);
        let fits = |b: &PageBuffer| b.bytes().len() as u64 == bytes;
        let buffer = match self.spare.iter().position(fits) {
            Some(at) => self.spare.swap_remove(at),
            None => self.take_fresh(bytes),
        };
        // Memory of other sizes goes back to the system, or the process would exceed what the books say.
        self.spare.clear();
        let unused: u64 = self.fresh.iter().map(|b| b.bytes().len() as u64).sum();
        if self.used + unused > self.limits.total {
            self.fresh.clear();
        }
        (Some(buffer), evicted)
    }

    /// Memory for a page, many at a time: taken one by one, in between what else is allocated, pages would crumble the
    /// allocator's memory, and the process would exceed its budget.
    fn take_fresh(&mut self, bytes: u64) -> PageBuffer {
        if let Some(stand_in) = &mut self.stand_in {
            if (stand_in.len() as u64) < bytes {
                *stand_in = Arc::new(vec![0; bytes as usize]);
            }
            if let Some(buffer) = PageBuffer::shared(stand_in.clone(), 0..bytes as usize) {
                return buffer;
            }
        }
        let fits = |b: &PageBuffer| b.bytes().len() as u64 == bytes;
        if let Some(at) = self.fresh.iter().position(fits) {
            return self.fresh.swap_remove(at);
        }
        let room = self.limits.total.saturating_sub(self.used) / bytes.max(1);
        let together = room.min(BUFFERS_AT_A_TIME);
        self.fresh.extend((0..together).map(|_| PageBuffer::new(bytes as usize)));
        PageBuffer::new(bytes as usize)
    }

    fn give_back(&mut self, kind: Kind, object: &Object) {
        let bytes = object.bytes();
        self.used -= bytes;
        self.used_by_kind[kind.index()] -= bytes;
        self.used_by_object[object.id] -= bytes;
    }

    /// Evicts one page that stands in the way: of lowest priority, least recently used among equals, and of a
    /// priority below `below` if that is given. Returns what went, or nothing where no page may go.
    fn evict(&mut self, obstacle: Obstacle, below: Option<u8>) -> Option<Evicted> {
        let allowed = |priority: u8| below.is_none_or(|b| priority < b);
        for searched in [false, true] {
            if searched {
                self.search(obstacle);
            }
            while let Some((priority, last_use, object, page)) = self.candidates.pop() {
                if !obstacle.concerns(&object, page) {
                    continue;
                }
                if !allowed(priority) {
                    self.candidates.push((priority, last_use, object, page));
                    // The best candidate is not allowed; older searches may have missed pages released since.
                    if searched {
                        return None;
                    }
                    break;
                }
                if let Some(evicted) = self.drop_page(&object, page, priority, last_use) {
                    return Some(evicted);
                }
            }
        }
        None
    }

    /// Finds the pages to evict next, worst last. Searching for several at a time keeps the cost of an eviction
    /// independent of the number of pages; up to 256 pages the order is exact.
    fn search(&mut self, obstacle: Obstacle) {
        let keep = (self.residents.len() / 256).max(1);
        let mut found: Vec<(u8, u64, usize)> = (self.residents.iter().enumerate())
            .filter(|(_, r)| r.retained.load(Ordering::Relaxed) == 0 && obstacle.concerns(&r.object, r.page))
            .map(|(i, r)| (r.priority.load(Ordering::Relaxed), r.last_use.load(Ordering::Relaxed), i))
            .collect();
        if found.len() > keep {
            found.select_nth_unstable(keep - 1);
            found.truncate(keep);
        }
        found.sort_unstable_by(|a, b| b.cmp(a));
        self.candidates = (found.into_iter())
            .map(|(p, t, i)| (p, t, self.residents[i].object.clone(), self.residents[i].page))
            .collect();
    }

    /// Evicts a page unless it has been used or retained since it became a candidate.
    fn drop_page(&mut self, object: &Arc<Object>, page: u32, priority: u8, last_use: u64) -> Option<Evicted> {
        let mut slot = object.slot(page);
        let Slot::Resident(resident) = &*slot else { return None };
        // Guards are made under the lock of the slot, which we hold; one being dropped may still read `retained`.
        let unchanged = resident.priority.load(Ordering::Relaxed) == priority
            && resident.last_use.load(Ordering::Relaxed) == last_use;
        if resident.retained.load(Ordering::Acquire) > 0 || !unchanged {
            return None;
        }
        let at = self.residents.iter().position(|r| Arc::ptr_eq(r, resident))?;
        self.residents.swap_remove(at);
        let Slot::Resident(mut resident) = std::mem::replace(&mut *slot, Slot::Absent) else { return None };
        drop(slot);
        // The last guard may be between its decrement and the end of its drop: a few instructions.
        let resident = loop {
            match Arc::try_unwrap(resident) {
                Ok(owned) => break owned,
                Err(shared) => {
                    resident = shared;
                    std::hint::spin_loop();
                }
            }
        };
        self.give_back(object.kind(page), object);
        // Somebody else's memory is nobody's to use again.
        if self.stand_in.is_none() {
            self.spare.push(resident.buffer);
        }
        let hinted = resident.hint.into_inner() == READ_FOR_HINT;
        Some(Evicted { kind: object.kind(page), unused_hint_bytes: if hinted { object.bytes() } else { 0 } })
    }
}
