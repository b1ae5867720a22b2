//! Simulation of a slower disk: every read starts a fixed time after it was submitted.

use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use super::transport::{Read, Transport};

#[derive(Default)]
struct Queue {
    reads: VecDeque<(Instant, Vec<Read>)>,
    closed: bool,
}

/// Adds a latency to another backend, like distant storage; any number of reads wait at the same
/// time.
pub struct Delayed {
    inner: Arc<dyn Transport>,
    delay: Duration,
    shared: Arc<(Mutex<Queue>, Condvar)>,
    thread: Vec<JoinHandle<()>>,
}

impl Delayed {
    /// Delays every read of `inner`.
    ///
    /// # Errors
    /// The system's error, if the thread that keeps time cannot be started.
    pub fn new(inner: Arc<dyn Transport>, delay: Duration) -> std::io::Result<Self> {
        let shared: Arc<(Mutex<Queue>, Condvar)> = Arc::default();
        let (queue, target) = (shared.clone(), inner.clone());
        let thread = std::thread::Builder::new()
            .name("rayset-delay".into())
            .stack_size(128 << 10)
            .spawn(move || forward(&queue, &*target))?;
        Ok(Self { inner, delay, shared, thread: vec![thread] })
    }
}

fn forward(shared: &(Mutex<Queue>, Condvar), target: &dyn Transport) {
    let (mutex, filled) = shared;
    let mut queue = mutex.lock().unwrap_or_else(PoisonError::into_inner);
    loop {
        let now = Instant::now();
        let wait = match queue.reads.front() {
            None if queue.closed => return,
            None => None,
            Some((due, _)) => Some(due.saturating_duration_since(now)),
        };
        if wait == Some(Duration::ZERO) {
            if let Some((_, batch)) = queue.reads.pop_front() {
                drop(queue);
                target.submit(batch);
                queue = mutex.lock().unwrap_or_else(PoisonError::into_inner);
            }
            continue;
        }
        queue = match wait {
            None => filled.wait(queue).unwrap_or_else(PoisonError::into_inner),
            Some(wait) => filled.wait_timeout(queue, wait).unwrap_or_else(PoisonError::into_inner).0,
        };
    }
}

impl Transport for Delayed {
    fn submit(&self, batch: Vec<Read>) {
        let due = Instant::now() + self.delay;
        self.shared.0.lock().unwrap_or_else(PoisonError::into_inner).reads.push_back((due, batch));
        self.shared.1.notify_one();
    }

    fn name(&self) -> String {
        format!("{} + {:?} a read", self.inner.name(), self.delay)
    }
}

impl Drop for Delayed {
    fn drop(&mut self) {
        self.shared.0.lock().unwrap_or_else(PoisonError::into_inner).closed = true;
        self.shared.1.notify_one();
        super::pool::join(&mut self.thread);
    }
}
