//! The page pool: the budget, the eviction queue, and the threads that wait.
//!
//! **Locks**, in the order in which they are taken: that of a client's list of hints, or of the
//! pool; then that of a slot; then that of the table of clients. None is held across a read, a
//! check, or a wait for anything but its own condition. The lock of the pool is held for a search
//! through all pages only if an object is forgotten, if a budget is too small (to say by how much),
//! or to remove entries of pages that have been evicted, at a cost proportional to the entries
//! added since the last time.

use std::cell::RefCell;
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::budget::{Budget, Limits, Obstacle};
use super::eviction::{Evicted, EvictionQueue};
use super::object::{Object, Resident, Slot};
use super::reuse::Reuse;
use super::source::{KINDS, Kind};
use crate::storage::PageBuffer;
use rayset_base::cancel::CancelToken;
use rayset_base::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering, fence};
use rayset_base::sync::thread::{self, ThreadId};
use rayset_base::sync::{Condvar, Mutex, MutexGuard, lock_counting, wait_timeout};

/// How far the clock goes on at a time: uses of pages in between have times of their own, thread by
/// thread.
const TICK: u64 = 1 << 20;

/// A waiting thread checks its condition again after this, whether it was notified or not.
const LONGEST_WAIT: Duration = Duration::from_secs(1);

struct State {
    budget: Budget,
    queue: EvictionQueue,
    /// Pages whose room is reserved and whose bytes are still to come, not counting those in
    /// `computing`.
    loading: u64,
    /// For each page that is being computed, the thread that computes it.
    computing: Vec<ThreadId>,
    /// Threads of `computing` that are themselves waiting, for room or for a page.
    halted: Vec<ThreadId>,
    /// Memory of evicted pages, to be reused by the reservation that caused the eviction.
    recycled: Vec<PageBuffer>,
    last_serial: u32,
}

pub(super) struct PagePool {
    state: Mutex<State>,
    changed: Condvar,
    clock: AtomicU64,
    /// Whether any page has been evicted: as long as everything fits, nobody needs to know when it
    /// is used again.
    evicts: AtomicBool,
    /// Number of threads that wait for room, and (`waiting`) of all that wait. Notifying costs a
    /// system call even if no thread waits.
    waiting_for_room: AtomicUsize,
    waiting: AtomicUsize,
    /// How long a thread waits for room, or for a page, while no page is loading.
    patience: Duration,
    lock_waits: Arc<AtomicU64>,
}

/// Why a wait ended without a result.
pub(super) enum WaitError {
    Cancelled,
    /// Nothing that could end the wait is in progress.
    Hopeless,
}

/// Held by a thread while it computes a page.
pub(super) struct Computing<'a> {
    pool: &'a PagePool,
    thread: ThreadId,
}

impl Drop for Computing<'_> {
    fn drop(&mut self) {
        let mut state = self.pool.lock();
        let at = state.computing.iter().position(|&thread| thread == self.thread);
        at.map(|at| state.computing.swap_remove(at));
        state.loading += 1;
    }
}

impl PagePool {
    pub(super) fn new(limits: Limits, patience: Duration, lock_waits: Arc<AtomicU64>) -> Self {
        let state = State {
            budget: Budget::new(limits),
            queue: EvictionQueue::default(),
            loading: 0,
            computing: Vec::new(),
            halted: Vec::new(),
            recycled: Vec::new(),
            last_serial: 0,
        };
        Self {
            state: Mutex::new(state),
            changed: Condvar::new(),
            clock: AtomicU64::new(TICK),
            evicts: AtomicBool::new(false),
            waiting_for_room: AtomicUsize::new(0),
            waiting: AtomicUsize::new(0),
            patience,
            lock_waits,
        }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        lock_counting(&self.state, &self.lock_waits)
    }

    /// A new time, later than any before.
    pub(super) fn tick(&self) -> u64 {
        self.clock.fetch_add(TICK, Ordering::Relaxed) + TICK
    }

    /// The current time.
    pub(super) fn now(&self) -> u64 {
        self.clock.load(Ordering::Relaxed)
    }

    /// The time of a use of a page by a thread whose last use was at `last`: later than that, and
    /// than all reservations and loads before it. The clock stands still as long as pages are only
    /// used: threads do not write it for every request.
    pub(super) fn time_of_use(&self, last: u64) -> u64 {
        let now = self.now();
        (now.max(last) + 1).min(now + TICK - 1)
    }

    /// Whether any page has been evicted so far.
    pub(super) fn evicts(&self) -> bool {
        self.evicts.load(Ordering::Relaxed)
    }

    pub(super) fn limits(&self) -> Limits {
        self.lock().budget.limits.clone()
    }

    /// Sets new limits and evicts pages that are neither retained nor loading until the limits
    /// hold, if possible. Returns what was evicted.
    pub(super) fn set_limits(&self, limits: Limits) -> Vec<Evicted> {
        let mut state = self.lock();
        state.budget.set_limits(limits);
        state.recycled.clear();
        let evicted = state.evict_excess(self.tick());
        drop(state);
        // There may be room now for a waiting thread.
        self.notify_waiting();
        evicted
    }

    /// Lends bytes, up to one part in so many of the budget, if pages that are not retained make
    /// room. Returns what says when they are due, and what was evicted.
    pub(super) fn lend(&self, bytes: u64, part: u64) -> (Option<Arc<AtomicBool>>, Vec<Evicted>) {
        let mut state = self.lock();
        let Some(due) = state.budget.lend(bytes, part) else { return (None, Vec::new()) };
        let evicted = state.evict_excess(self.tick());
        let fits = state.budget.excess().is_none();
        if !fits {
            state.budget.take_back((bytes, part), &due);
        }
        drop(state);
        self.has_evicted(&evicted);
        (fits.then_some(due), evicted)
    }

    /// Takes back bytes that were lent.
    pub(super) fn take_back(&self, lent: (u64, u64), due: &Arc<AtomicBool>) {
        self.lock().budget.take_back(lent, due);
        self.notify_waiting();
    }

    /// Evicts everything that is neither retained nor loading. Returns what was evicted.
    pub(super) fn evict_all(&self) -> Vec<Evicted> {
        let mut state = self.lock();
        let mut evicted = Vec::new();
        while let Some(page) = state.evict(Obstacle::Total, self.tick(), None) {
            evicted.push(page);
        }
        state.recycled.clear();
        evicted
    }

    /// Evicts the pages of one object that are neither retained nor loading. Returns what was
    /// evicted.
    pub(super) fn evict_object(&self, object: &Object) -> Vec<Evicted> {
        let mut state = self.lock();
        let evicted = state.queue.evict_object(object);
        for page in &evicted {
            state.budget.give_back(page.kind, page.object.bytes());
        }
        state.recycled.clear();
        drop(state);
        self.notify_waiting();
        evicted
    }

    /// Records that a page has been retired.
    pub(super) fn retire(&self, object: &Arc<Object>, page: u32, serial: u32) {
        self.lock().queue.retire(object.clone(), page, serial);
    }

    /// Reserves room for one page, if evicting pages that are not retained makes enough. Also
    /// returns what was evicted.
    pub(super) fn try_reserve(
        &self,
        kind: Kind,
        object: &Object,
        reuse: Option<&RefCell<Reuse>>,
    ) -> (Option<PageBuffer>, Vec<Evicted>) {
        let (mut evicted, mut known) = (Vec::new(), reuse.map(RefCell::borrow_mut));
        let known = known.as_deref_mut();
        let room = self.lock().reserve(kind, object.bytes(), self.tick(), known, &mut evicted);
        self.has_evicted(&evicted);
        (room, evicted)
    }

    fn has_evicted(&self, evicted: &[Evicted]) {
        if !evicted.is_empty() && !self.evicts() {
            self.evicts.store(true, Ordering::Relaxed);
        }
    }

    /// Reserves room for one page that a thread waits for, by evicting what `reuse` says is needed
    /// last. Waits for releases if it must, but not longer than its patience while no page is
    /// loading: a page that is loading can be evicted once it is resident, however slow the disk.
    pub(super) fn reserve(
        &self,
        kind: Kind,
        object: &Object,
        cancel: &CancelToken,
        reuse: Option<&RefCell<Reuse>>,
        evicted: &mut Vec<Evicted>,
    ) -> Result<PageBuffer, WaitError> {
        let bytes = object.bytes();
        let mut known = reuse.map(RefCell::borrow_mut);
        let mut try_now = |state: &mut State| {
            let room = state.reserve(kind, bytes, self.tick(), known.as_deref_mut(), evicted);
            self.has_evicted(evicted);
            room
        };
        if let Some(room) = try_now(&mut self.lock()) {
            return Ok(room);
        }
        // A thread that releases a page from now on notifies; what was released before is seen by
        // the next search.
        self.waiting_for_room.fetch_add(1, Ordering::SeqCst);
        fence(Ordering::SeqCst);
        let room = self.wait_for(cancel, |state| {
            let room = try_now(state).map(Ok);
            room.or_else(|| (!state.budget.could_hold(kind, bytes)).then_some(Err(WaitError::Hopeless)))
        });
        self.waiting_for_room.fetch_sub(1, Ordering::SeqCst);
        room?
    }

    /// Waits until `ready` returns something, but not longer than the patience while no page is
    /// loading. `ready` is called under the lock of the pool, which every change of a slot from
    /// loading takes before it notifies: a waiting thread was counted before that, so no change is
    /// missed.
    pub(super) fn wait_until<T>(
        &self,
        cancel: &CancelToken,
        mut ready: impl FnMut() -> Option<T>,
    ) -> Result<T, WaitError> {
        self.wait_for(cancel, |_| ready())
    }

    fn wait_for<T>(
        &self,
        cancel: &CancelToken,
        mut ready: impl FnMut(&mut State) -> Option<T>,
    ) -> Result<T, WaitError> {
        let mut deadline = Instant::now() + self.patience;
        let mut state = self.lock();
        loop {
            if let Some(result) = ready(&mut state) {
                return Ok(result);
            }
            if cancel.is_cancelled() {
                return Err(WaitError::Cancelled);
            }
            if state.is_moving() {
                state = self.wait(state, LONGEST_WAIT);
                deadline = Instant::now() + self.patience;
                continue;
            }
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Err(WaitError::Hopeless);
            }
            state = self.wait(state, left.min(LONGEST_WAIT));
        }
    }

    fn wait<'a>(&self, mut state: MutexGuard<'a, State>, limit: Duration) -> MutexGuard<'a, State> {
        let halted = state.halt();
        self.waiting.fetch_add(1, Ordering::SeqCst);
        let mut state = wait_timeout(&self.changed, state, limit);
        self.waiting.fetch_sub(1, Ordering::SeqCst);
        if let Some(thread) = halted {
            state.go_on(thread);
        }
        state
    }

    /// Declares that the calling thread computes the page that it has reserved room for, until the
    /// guard is dropped: while it waits for anything meanwhile, its own page does not count as
    /// loading.
    pub(super) fn computing(&self) -> Computing<'_> {
        let thread = thread::current().id();
        let mut state = self.lock();
        state.loading -= 1;
        state.computing.push(thread);
        Computing { pool: self, thread }
    }

    /// Makes a page resident for which room was reserved: from now on it can be retained, and
    /// evicted unless `hold` retains it. Returns the result of `hold`, and what was evicted because
    /// limits have been lowered meanwhile.
    pub(super) fn loaded<T>(
        &self,
        object: &Arc<Object>,
        page: u32,
        mut resident: Resident,
        hold: impl FnOnce(&Arc<Resident>) -> T,
    ) -> (T, Vec<Evicted>) {
        let mut state = self.lock();
        state.loading -= 1;
        state.last_serial = state.last_serial.wrapping_add(1);
        resident.serial = state.last_serial;
        let resident = Arc::new(resident);
        state.queue.insert(object, page, &resident);
        let held = hold(&resident);
        *object.slot(page) = Slot::Resident(resident);
        let evicted = state.evict_excess(self.tick());
        drop(state);
        self.notify_waiting();
        (held, evicted)
    }

    /// Reports that a page will not become resident: its slot says why, and its room is free again.
    pub(super) fn failed(&self, object: &Object, page: u32, slot: Slot, buffer: PageBuffer) {
        let mut state = self.lock();
        state.loading -= 1;
        *object.slot(page) = slot;
        state.budget.give_back(object.kind(page), object.bytes());
        // Kept for the next reservation.
        state.recycled.push(buffer);
        drop(state);
        self.notify_waiting();
    }

    /// Reports that a slot has changed: wakes all waiting threads.
    pub(super) fn notify(&self) {
        drop(self.lock());
        self.notify_waiting();
    }

    fn notify_waiting(&self) {
        if self.waiting.load(Ordering::SeqCst) > 0 {
            self.changed.notify_all();
        }
    }

    /// Reports that a page has been released.
    pub(super) fn released(&self) {
        if self.waiting_for_room.load(Ordering::SeqCst) > 0 {
            // A thread that has searched in vain holds the lock until it waits.
            drop(self.lock());
            self.changed.notify_all();
        }
    }

    pub(super) fn retained_bytes(&self) -> u64 {
        self.lock().queue.retained_bytes()
    }

    #[cfg(all(test, not(feature = "model")))]
    pub(super) fn entries(&self) -> usize {
        self.lock().queue.entries()
    }

    pub(super) fn peaks(&self) -> (u64, [u64; KINDS]) {
        self.lock().budget.peaks()
    }

    /// Bytes in memory, by kind.
    pub(super) fn used(&self) -> [u64; KINDS] {
        self.lock().budget.used()
    }

    pub(super) fn reset_peaks(&self) {
        self.lock().budget.reset_peaks();
    }
}

impl State {
    /// Whether a page is loading while the calling thread waits: being read, or computed by a
    /// thread that is not waiting itself. Otherwise threads that compute pages and wait for room
    /// taken by each other's pages would wait forever.
    fn is_moving(&self) -> bool {
        let waits = |thread: &ThreadId| *thread == thread::current().id() || self.halted.contains(thread);
        self.loading > 0 || !self.computing.iter().all(waits)
    }

    /// Records that the calling thread is about to wait; returns its id if it computes a page.
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

    fn evict(&mut self, obstacle: Obstacle, now: u64, reuse: Option<&mut Reuse>) -> Option<Evicted> {
        let evicted = self.queue.evict(obstacle, now, reuse)?;
        self.budget.give_back(evicted.kind, evicted.object.bytes());
        Some(evicted)
    }

    /// Evicts pages that are neither retained nor loading until the limits hold, if possible.
    fn evict_excess(&mut self, now: u64) -> Vec<Evicted> {
        let mut evicted = Vec::new();
        while let Some(page) = self.budget.excess().and_then(|obstacle| self.evict(obstacle, now, None)) {
            evicted.push(page);
        }
        if !evicted.is_empty() {
            self.recycled.clear();
        }
        evicted
    }

    /// Takes room for a page, if evictions can make enough; evicted pages are added to `evicted`,
    /// without their memory.
    fn reserve(
        &mut self,
        kind: Kind,
        bytes: u64,
        now: u64,
        mut reuse: Option<&mut Reuse>,
        evicted: &mut Vec<Evicted>,
    ) -> Option<PageBuffer> {
        while let Some(obstacle) = self.budget.obstacle(kind, bytes) {
            let mut page = self.evict(obstacle, now, reuse.as_deref_mut())?;
            self.recycled.push(page.take_buffer());
            evicted.push(page);
        }
        self.loading += 1;
        self.budget.take(kind, bytes);
        let fits = |b: &PageBuffer| b.bytes().len() as u64 == bytes;
        let buffer = match self.recycled.iter().position(fits) {
            Some(at) => self.recycled.swap_remove(at),
            None => PageBuffer::new(bytes as usize),
        };
        // Memory of other sizes goes back to the system; otherwise the process would exceed its
        // budget.
        self.recycled.clear();
        Some(buffer)
    }
}
