//! Stopping work that is under way.

use std::sync::Arc;

use crate::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use crate::sync::{Mutex, lock};

/// Stops a render or a build, from any thread. Clones share one state, which never goes back.
///
/// Work looks at its token in its inner loops, and waits end when it is cancelled: a call returns within milliseconds,
/// leaves no page retained and no temporary file, and everything that others do goes on.
#[derive(Clone, Default)]
pub struct CancelToken {
    inner: Arc<Inner>,
}

type Waker = Arc<dyn Fn() + Send + Sync>;

#[derive(Default)]
struct Inner {
    cancelled: AtomicBool,
    last_number: AtomicU64,
    /// Ends the waits of those who wait now.
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

    /// Cancels all work that has this token. Returns at once; the calls that do the work return shortly after.
    pub fn cancel(&self) {
        self.inner.cancelled.store(true, Ordering::SeqCst);
        // Called without the lock, for they take locks of their own.
        let wakers: Vec<Waker> = lock(&self.inner.wakers).iter().map(|(_, waker)| waker.clone()).collect();
        wakers.iter().for_each(|waker| waker());
    }

    /// Whether [`cancel`](Self::cancel) has been called.
    #[must_use]
    pub fn is_cancelled(&self) -> bool {
        self.inner.cancelled.load(Ordering::Relaxed)
    }

    /// Has `waker` called when this is cancelled, until the registration is dropped. Whoever waits registers first, then
    /// looks at the token under the lock that `waker` takes, then waits: so no cancellation is missed.
    pub(crate) fn register(&self, waker: Waker) -> Registration<'_> {
        let number = self.inner.last_number.fetch_add(1, Ordering::Relaxed);
        lock(&self.inner.wakers).push((number, waker));
        Registration { token: self, number }
    }
}

/// Keeps a waker with its token.
pub(crate) struct Registration<'a> {
    token: &'a CancelToken,
    number: u64,
}

impl Drop for Registration<'_> {
    fn drop(&mut self) {
        lock(&self.token.inner.wakers).retain(|(number, _)| *number != self.number);
    }
}
