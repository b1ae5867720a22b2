//! A pool of threads with positional reads: works everywhere, and keeps a disk as busy as any other
//! way at these page sizes.

use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread::JoinHandle;

use super::transport::{Read, Transport};

/// Reading threads mostly call the kernel; checks of a page need little stack.
const STACK_BYTES: usize = 128 << 10;

#[derive(Default)]
struct Queue {
    reads: VecDeque<Read>,
    closed: bool,
}

#[derive(Default)]
struct Shared {
    queue: Mutex<Queue>,
    filled: Condvar,
}

/// A pool of reading threads.
pub struct Pool {
    shared: Arc<Shared>,
    threads: Vec<JoinHandle<()>>,
}

impl Pool {
    /// Starts `threads` threads.
    #[must_use]
    pub fn new(threads: usize) -> Self {
        let shared = Arc::new(Shared::default());
        let threads = (0..threads.max(1))
            .filter_map(|_| {
                let shared = shared.clone();
                std::thread::Builder::new()
                    .name("rayset-read".into())
                    .stack_size(STACK_BYTES)
                    .spawn(move || serve(&shared))
                    .ok()
            })
            .collect();
        Self { shared, threads }
    }
}

fn serve(shared: &Shared) {
    let mut queue = shared.queue.lock().unwrap_or_else(PoisonError::into_inner);
    loop {
        if let Some(read) = queue.reads.pop_front() {
            drop(queue);
            read.run();
            queue = shared.queue.lock().unwrap_or_else(PoisonError::into_inner);
        } else if queue.closed {
            return;
        } else {
            queue = shared.filled.wait(queue).unwrap_or_else(PoisonError::into_inner);
        }
    }
}

impl Transport for Pool {
    fn submit(&self, batch: Vec<Read>) {
        if self.threads.is_empty() {
            // The system could not start a thread: read on this one.
            return batch.into_iter().for_each(Read::run);
        }
        let one = batch.len() == 1;
        self.shared.queue.lock().unwrap_or_else(PoisonError::into_inner).reads.extend(batch);
        if one { self.shared.filled.notify_one() } else { self.shared.filled.notify_all() }
    }

    fn submit_awaited(&self, read: Read) {
        if let Err(read) = read.run_if_cached() {
            self.submit(vec![read]);
        }
    }

    fn name(&self) -> String {
        format!("pool of {} threads", self.threads.len())
    }
}

impl Drop for Pool {
    fn drop(&mut self) {
        self.shared.queue.lock().unwrap_or_else(PoisonError::into_inner).closed = true;
        self.shared.filled.notify_all();
        join(&mut self.threads);
    }
}

/// Waits for threads to end; the one that drops the backend may be one of them.
pub(super) fn join(threads: &mut Vec<JoinHandle<()>>) {
    for thread in threads.drain(..) {
        if thread.thread().id() != std::thread::current().id() {
            // A thread that panicked has reported it itself.
            let _ = thread.join();
        }
    }
}
