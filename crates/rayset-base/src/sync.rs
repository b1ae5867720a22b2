//! The synchronization primitives of the page pool: the standard library's, or those of a model
//! checker that runs many interleavings (feature `model`, for this project's own tests).

#[cfg(not(feature = "model"))]
pub use std::sync::{Condvar, Mutex, MutexGuard, atomic};
#[cfg(not(feature = "model"))]
pub use std::thread;

#[cfg(feature = "model")]
pub use shuttle::sync::{Condvar, Mutex, MutexGuard, atomic};
#[cfg(feature = "model")]
pub use shuttle::thread;

use std::sync::{PoisonError, TryLockError};
use std::time::Duration;

/// Locks a mutex, poisoned or not. The data are consistent even after a panic: no thread panics in
/// the middle of a change while it holds one of these locks.
pub fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Locks a mutex as [`lock`] does, and counts in `waits` if another thread holds it.
pub fn lock_counting<'a, T>(mutex: &'a Mutex<T>, waits: &atomic::AtomicU64) -> MutexGuard<'a, T> {
    match mutex.try_lock() {
        Ok(guard) => guard,
        Err(TryLockError::Poisoned(poisoned)) => poisoned.into_inner(),
        Err(TryLockError::WouldBlock) => {
            waits.fetch_add(1, atomic::Ordering::Relaxed);
            lock(mutex)
        }
    }
}

/// Waits for a notification, for at most `limit`. The model checker does not model time: there,
/// only a notification ends a wait.
pub fn wait_timeout<'a, T>(
    condvar: &Condvar,
    guard: MutexGuard<'a, T>,
    limit: Duration,
) -> MutexGuard<'a, T> {
    if cfg!(feature = "model") {
        return condvar.wait(guard).unwrap_or_else(PoisonError::into_inner);
    }
    condvar.wait_timeout(guard, limit).unwrap_or_else(PoisonError::into_inner).0
}
