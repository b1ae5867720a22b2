//! Parallel work with results in order, and a bounded number of both in memory.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Condvar, Mutex};

struct State<T> {
    next: usize,
    consumed: usize,
    done: Vec<(usize, T)>,
}

/// Runs `work(i)` for `i` in `0..count` on `threads` threads and passes the results to `consume` in
/// order, on the calling thread. At most `threads + 1` results exist at any time. The first error,
/// in order, ends it and is returned.
pub(super) fn ordered<T: Send, E: Send>(
    count: usize,
    threads: usize,
    work: impl Fn(usize) -> Result<T, E> + Sync,
    mut consume: impl FnMut(usize, T) -> Result<(), E>,
) -> Result<(), E> {
    if threads <= 1 || count <= 1 {
        return (0..count).try_for_each(|i| consume(i, work(i)?));
    }
    let state = Mutex::new(State { next: 0, consumed: 0, done: Vec::new() });
    let (changed, stop) = (Condvar::new(), AtomicBool::new(false));
    let lock = || state.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    std::thread::scope(|scope| {
        // A panic of a worker or of the consumer must not leave the others waiting; the scope
        // propagates the panic.
        struct StopOnDrop<'a, T>(&'a AtomicBool, &'a Mutex<T>, &'a Condvar);
        impl<T> Drop for StopOnDrop<'_, T> {
            fn drop(&mut self) {
                if std::thread::panicking() {
                    self.0.store(true, Ordering::SeqCst);
                }
                // The lock orders the store before any wait that began earlier.
                drop(self.1.lock().unwrap_or_else(std::sync::PoisonError::into_inner));
                self.2.notify_all();
            }
        }
        let _caller = StopOnDrop(&stop, &state, &changed);
        for _ in 0..threads.min(count) {
            scope.spawn(|| {
                let _guard = StopOnDrop(&stop, &state, &changed);
                loop {
                    let mut s = lock();
                    while s.next < count && s.next > s.consumed + threads && !stop.load(Ordering::SeqCst) {
                        s = changed.wait(s).unwrap_or_else(std::sync::PoisonError::into_inner);
                    }
                    if s.next >= count || stop.load(Ordering::SeqCst) {
                        return;
                    }
                    let i = s.next;
                    s.next += 1;
                    drop(s);
                    let result = work(i);
                    lock().done.push((i, result));
                    changed.notify_all();
                }
            });
        }
        let outcome = (0..count).try_for_each(|i| {
            let mut s = lock();
            let result = loop {
                if let Some(at) = s.done.iter().position(|d| d.0 == i) {
                    break Some(s.done.swap_remove(at).1);
                }
                if stop.load(Ordering::SeqCst) {
                    break None;
                }
                s = changed.wait(s).unwrap_or_else(std::sync::PoisonError::into_inner);
            };
            drop(s);
            let Some(result) = result else { return Ok(()) };
            consume(i, result?)?;
            lock().consumed = i + 1;
            changed.notify_all();
            Ok(())
        });
        stop.store(true, Ordering::SeqCst);
        // The lock orders the store before any wait that began earlier.
        drop(lock());
        changed.notify_all();
        outcome
    })
}

/// Runs `work(chunk)` for chunks of `0..count` on `threads` threads, in no particular order. The
/// first error found ends it.
pub(super) fn chunks<E: Send>(
    count: u64,
    chunk: u64,
    threads: usize,
    work: impl Fn(&mut Vec<u8>, std::ops::Range<u64>) -> Result<(), E> + Sync,
) -> Result<(), E> {
    use std::sync::atomic::AtomicU64;
    let next = AtomicU64::new(0);
    let failed = Mutex::new(None);
    std::thread::scope(|scope| {
        for _ in 0..threads.max(1) {
            scope.spawn(|| {
                let mut buffer = Vec::new();
                loop {
                    let start = next.fetch_add(chunk, Ordering::Relaxed);
                    if start >= count {
                        return;
                    }
                    if let Err(e) = work(&mut buffer, start..(start + chunk).min(count)) {
                        next.store(count, Ordering::Relaxed);
                        *failed.lock().unwrap_or_else(std::sync::PoisonError::into_inner) = Some(e);
                        return;
                    }
                }
            });
        }
    });
    failed.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner).map_or(Ok(()), Err)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_come_in_order_and_few_exist_at_once() {
        let alive = std::sync::atomic::AtomicUsize::new(0);
        let mut seen = Vec::new();
        let result: Result<(), ()> = ordered(
            200,
            4,
            |i| {
                assert!(alive.fetch_add(1, Ordering::SeqCst) < 6);
                Ok(i)
            },
            |i, r| {
                alive.fetch_sub(1, Ordering::SeqCst);
                seen.push((i, r));
                Ok(())
            },
        );
        assert!(result.is_ok());
        assert!(seen.iter().enumerate().all(|(k, &(i, r))| k == i && k == r) && seen.len() == 200);
    }

    #[test]
    fn a_panic_of_the_one_that_consumes_ends_the_work() {
        let (send, receive) = std::sync::mpsc::channel();
        std::thread::spawn(move || {
            let consume =
                |i, _| -> Result<(), ()> { if i == 3 { panic!("a bug of the caller's") } else { Ok(()) } };
            let outcome = std::panic::catch_unwind(|| ordered(1000, 3, Ok, consume));
            let _ = send.send(outcome.is_err());
        });
        let panicked =
            receive.recv_timeout(std::time::Duration::from_secs(20)).expect("a wait that lasts for ever");
        assert!(panicked);
    }

    #[test]
    fn the_first_error_ends_the_work() {
        let result = ordered(1000, 3, |i| if i == 7 { Err(i) } else { Ok(i) }, |_, _| Ok(()));
        assert_eq!(result, Err(7));
    }
}
