//! The threads of a session, and the renders that they share.
//!
//! A thread works on one render at a time, tile by tile. It joins the render with the fewest
//! threads, and after a while leaves it if another render has work and no thread: so two renders on
//! one thread take turns.

use std::cell::Cell;
use std::io;
use std::sync::{Arc, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use rayset_base::sync::atomic::{AtomicU64, Ordering};
use rayset_base::sync::{Condvar, Mutex, MutexGuard, lock_counting};

/// How long a thread stays with a render while another has no thread: long compared to the cost of
/// starting again.
const TURN: Duration = Duration::from_millis(20);

/// A task that threads share: a render.
pub(super) trait Task: Send + Sync {
    /// Whether there is work for another thread.
    fn has_work(&self) -> bool;

    /// Called when a thread is about to work on this.
    fn entered(&self);

    /// Works on this task until nothing is left to do or the thread's turn is over.
    fn work(&self, turn: &Turn<'_>);

    /// Returns what to call when a thread has left this task and released it.
    fn when_left(&self) -> Box<dyn FnOnce()>;
}

pub(super) struct Scheduler {
    shared: Arc<Shared>,
    threads: Vec<JoinHandle<()>>,
}

struct Shared {
    state: Mutex<State>,
    changed: Condvar,
    tally: Arc<Tally>,
}

/// What threads do besides tracing, counted since the start.
#[derive(Default)]
pub(super) struct Tally {
    /// How often a thread had to wait for the lock of the scheduler, or of a render.
    pub(super) lock_waits: AtomicU64,
    /// How often a thread has joined a render.
    pub(super) joined: AtomicU64,
    /// How often an idle thread has been woken.
    pub(super) woken: AtomicU64,
}

#[derive(Default)]
struct State {
    tasks: Vec<ScheduledTask>,
    /// Threads that wait for work.
    idle: usize,
    closed: bool,
}

struct ScheduledTask {
    task: Arc<dyn Task>,
    /// Threads that work on it.
    threads: usize,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, State> {
        lock_counting(&self.state, &self.tally.lock_waits)
    }

    fn call_threads(&self, most: usize) {
        let idle = self.lock().idle;
        if idle > most {
            (0..most).for_each(|_| self.changed.notify_one());
        } else if idle > 0 {
            self.changed.notify_all();
        }
    }
}

impl Scheduler {
    /// Starts threads that wait for work.
    pub(super) fn start(threads: usize) -> io::Result<Self> {
        let shared =
            Arc::new(Shared { state: Mutex::default(), changed: Condvar::new(), tally: Arc::default() });
        let mut scheduler = Self { shared: shared.clone(), threads: Vec::new() };
        for _ in 0..threads {
            let shared = shared.clone();
            let thread = std::thread::Builder::new().name("rayset-trace".into()).spawn(move || work(&shared));
            match thread {
                Ok(thread) => scheduler.threads.push(thread),
                // Fewer threads will do.
                Err(_) if !scheduler.threads.is_empty() => break,
                Err(error) => return Err(error),
            }
        }
        Ok(scheduler)
    }

    pub(super) fn tally(&self) -> &Arc<Tally> {
        &self.shared.tally
    }

    /// Lets the threads work on a render until the returned value is dropped.
    pub(super) fn add(&self, task: Arc<dyn Task>) -> Scheduled<'_> {
        self.shared.lock().tasks.push(ScheduledTask { task: task.clone(), threads: 0 });
        self.shared.changed.notify_all();
        Scheduled { shared: &self.shared, task }
    }
}

impl Drop for Scheduler {
    fn drop(&mut self) {
        self.shared.lock().closed = true;
        self.shared.changed.notify_all();
        for thread in self.threads.drain(..) {
            // The last owner of an engine may be one of its own threads, which cannot join itself.
            if thread.thread().id() != std::thread::current().id() {
                let _ = thread.join();
            }
        }
    }
}

/// A render that threads work on.
pub(super) struct Scheduled<'a> {
    shared: &'a Shared,
    task: Arc<dyn Task>,
}

impl Scheduled<'_> {
    /// Wakes idle threads, at most so many: there may be work for them again.
    pub(super) fn call_threads(&self, most: usize) {
        self.shared.call_threads(most);
    }
}

impl Drop for Scheduled<'_> {
    fn drop(&mut self) {
        self.shared.lock().tasks.retain(|entry| !Arc::ptr_eq(&entry.task, &self.task));
    }
}

/// A thread's turn at a render.
pub(super) struct Turn<'a> {
    shared: &'a Shared,
    /// When it began, or was last found not to be over.
    since: Cell<Instant>,
}

impl Turn<'_> {
    /// Whether the thread is to leave: its turn has been long enough, and another render has work
    /// but no thread.
    pub(super) fn is_over(&self) -> bool {
        if self.since.get().elapsed() <= TURN {
            return false;
        }
        self.since.set(Instant::now());
        self.shared.lock().tasks.iter().any(|entry| entry.threads == 0 && entry.task.has_work())
    }

    /// Wakes idle threads: there is work for them again.
    pub(super) fn call_others(&self) {
        self.shared.call_threads(usize::MAX);
    }
}

fn work(shared: &Shared) {
    while let Some(task) = next_task(shared) {
        task.work(&Turn { shared, since: Cell::new(Instant::now()) });
        let mut state = shared.lock();
        if let Some(entry) = state.tasks.iter_mut().find(|entry| Arc::ptr_eq(&entry.task, &task)) {
            entry.threads -= 1;
        }
        drop(state);
        let left = task.when_left();
        drop(task);
        left();
    }
}

/// Waits for a render that has work, and joins the one with the fewest threads; `None` if the
/// scheduler is closed.
fn next_task(shared: &Shared) -> Option<Arc<dyn Task>> {
    let mut state = shared.lock();
    loop {
        if state.closed {
            return None;
        }
        let waiting = state.tasks.iter_mut().filter(|entry| entry.task.has_work());
        if let Some(entry) = waiting.min_by_key(|entry| entry.threads) {
            entry.threads += 1;
            entry.task.entered();
            shared.tally.joined.fetch_add(1, Ordering::Relaxed);
            return Some(entry.task.clone());
        }
        state.idle += 1;
        state = shared.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        state.idle -= 1;
        shared.tally.woken.fetch_add(1, Ordering::Relaxed);
    }
}
