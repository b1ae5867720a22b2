//! What the storages of a process may have in flight together, so that the memory for it has a
//! bound.

use std::fmt::Debug;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

/// Who has requests to start, and waits for room.
pub(super) trait Waiting: Debug + Send + Sync {
    /// There may be room now.
    fn start(self: Arc<Self>);
}

/// A limit on what all storages that share it have in flight.
#[derive(Debug)]
pub struct RequestLimit {
    requests: usize,
    bytes: u64,
    memory_bytes: u64,
    taken: Mutex<Taken>,
}

#[derive(Debug, Default)]
struct Taken {
    requests: usize,
    bytes: u64,
    /// Those that have had to wait since anything was given back.
    waiting: Vec<Weak<dyn Waiting>>,
}

impl RequestLimit {
    /// At most so many requests at a time, at least one, which ask for at most so many bytes
    /// together; one request may ask for more if it is alone. `memory_bytes` is what they take at
    /// most besides the buffers that they fill: connections, code, copies. Renders within a memory
    /// budget set it aside.
    #[must_use]
    pub fn new(requests: usize, bytes: u64, memory_bytes: u64) -> Arc<Self> {
        Arc::new(Self { requests: requests.max(1), bytes, memory_bytes, taken: Mutex::default() })
    }

    pub(super) fn memory_bytes(&self) -> u64 {
        self.memory_bytes
    }

    fn lock(&self) -> MutexGuard<'_, Taken> {
        self.taken.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes room for a request of so many bytes. If there is none, who asks is among the next that
    /// are told.
    pub(super) fn take(&self, bytes: u64, asks: impl FnOnce() -> Weak<dyn Waiting>) -> bool {
        let mut taken = self.lock();
        let fits = taken.requests < self.requests && taken.bytes.saturating_add(bytes) <= self.bytes;
        if !fits && taken.requests > 0 {
            taken.waiting.push(asks());
            return false;
        }
        taken.requests += 1;
        taken.bytes += bytes;
        true
    }

    /// Gives back what a request of so many bytes took. All who have waited may start theirs.
    pub(super) fn give_back(&self, bytes: u64) {
        let mut taken = self.lock();
        taken.requests -= 1;
        taken.bytes -= bytes;
        let waiting = std::mem::take(&mut taken.waiting);
        drop(taken);
        waiting.into_iter().filter_map(|asked| asked.upgrade()).for_each(Waiting::start);
    }
}
