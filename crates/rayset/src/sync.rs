//! The primitives that the page pool is built of: the standard library's, or those of a model checker that runs every
//! interleaving (feature `model`, for this project's own tests).

#[cfg(not(feature = "model"))]
pub(crate) use std::sync::{Condvar, Mutex, MutexGuard, atomic};
#[cfg(not(feature = "model"))]
pub(crate) use std::thread;

#[cfg(feature = "model")]
pub(crate) use shuttle::sync::{Condvar, Mutex, MutexGuard, atomic};
#[cfg(feature = "model")]
pub(crate) use shuttle::thread;

use std::sync::PoisonError;
use std::time::Duration;

/// Locks a mutex. Whatever a thread that panicked has left is whole: nothing panics while it holds one of these locks
/// half-way through a change.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Waits for a notification, at most for `limit`. The model checker knows no time: there, only a notification ends a wait.
pub(crate) fn wait_timeout<'a, T>(
    condvar: &Condvar,
    guard: MutexGuard<'a, T>,
    limit: Duration,
) -> MutexGuard<'a, T> {
    if cfg!(feature = "model") {
        return condvar.wait(guard).unwrap_or_else(PoisonError::into_inner);
    }
    condvar.wait_timeout(guard, limit).unwrap_or_else(PoisonError::into_inner).0
}
