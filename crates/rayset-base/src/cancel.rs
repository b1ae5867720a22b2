//! Stopping work that is under way.

use std::sync::Arc;

use crate::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use crate::sync::{Mutex, lock};

/// Stops a render or a build, from any thread. Clones share one state; once cancelled, it stays
/// cancelled.
///
/// Work checks its token in its inner loops, and cancelling it ends all waits: a call returns
/// within milliseconds and leaves no page retained and no temporary file behind. Work that has
/// other tokens continues.
#[derive(Clone, Default)]
pub struct CancelToken {
    inner: Arc<Inner>,
}

type Waker = Arc<dyn Fn() + Send + Sync>;

#[derive(Default)]
struct Inner {
    cancelled: AtomicBool,
    last_number: AtomicU64,
    /// Callbacks that wake the threads that are waiting now.
    wakers: Mutex<Vec<(u64, Waker)>>,
}

impl std::fmt::Debug for CancelToken {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "CancelToken({})", if self.is_cancelled() { "cancelled" } else { "not cancelled" })
    }
}

impl CancelToken {
    /// A token that is not cancelled.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Cancels all work that has this token. Returns at once; the calls that do the work return
    /// shortly after.
    pub fn cancel(&self) {
        self.inner.cancelled.store(true, Ordering::SeqCst);
        // Called without holding the lock, because they take locks of their own.
        let wakers: Vec<Waker> = lock(&self.inner.wakers).iter().map(|(_, waker)| waker.clone()).collect();
        wakers.iter().for_each(|waker| waker());
    }

    /// Whether [`cancel`](Self::cancel) has been called.
    #[must_use]
    pub fn is_cancelled(&self) -> bool {
        self.inner.cancelled.load(Ordering::Relaxed)
    }

    /// Calls `waker` when this token is cancelled, until the registration is dropped. A waiting
    /// thread registers first, then checks the token under the lock that `waker` takes, then waits,
    /// so that no cancellation is missed.
    #[doc(hidden)]
    pub fn register(&self, waker: Waker) -> Registration<'_> {
        let number = self.inner.last_number.fetch_add(1, Ordering::Relaxed);
        lock(&self.inner.wakers).push((number, waker));
        Registration { token: self, number }
    }
}

/// Keeps a waker registered with its token until it is dropped.
pub struct Registration<'a> {
    token: &'a CancelToken,
    number: u64,
}

impl Drop for Registration<'_> {
    fn drop(&mut self) {
        lock(&self.token.inner.wakers).retain(|(number, _)| *number != self.number);
    }
}
