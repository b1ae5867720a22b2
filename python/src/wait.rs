//! Work that Python waits for: on a thread of its own, without the interpreter's lock, ended by
//! Ctrl-C.

use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use pyo3::prelude::*;
use rayset::CancelToken;
use rayset::build::Stage;

use crate::errors;

/// How long signals may wait to be seen.
pub(crate) const PATIENCE: Duration = Duration::from_millis(10);
/// How often a caller is told of progress.
const TELLING: Duration = Duration::from_millis(100);

/// What is being done, how much of it is done, and how much there is.
type Step = (&'static str, u64, u64);

/// How far some work is, written by the work and told to a callable.
#[derive(Default)]
pub(crate) struct Progress(Mutex<Option<Step>>);

impl Progress {
    pub(crate) fn set(&self, doing: &'static str, done: u64, total: u64) {
        *lock(&self.0) = Some((doing, done, total));
    }

    fn take(&self) -> Option<Step> {
        lock(&self.0).take()
    }
}

impl rayset::build::Progress for Progress {
    fn update(&self, stage: Stage, done: u64, total: u64) {
        self.set(rayset_inputs::stage_name(stage), done, total);
    }
}

/// Locks; what a thread left that panicked is as good as any.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// What a thread hands to another.
pub(crate) struct Mailbox<T> {
    state: Mutex<Letters<T>>,
    changed: Condvar,
}

struct Letters<T> {
    waiting: VecDeque<T>,
    closed: bool,
}

/// What came of waiting for a letter.
pub(crate) enum Waited<T> {
    Letter(T),
    /// None will come any more.
    Closed,
    /// None has come yet.
    NotYet,
}

impl<T> Mailbox<T> {
    pub(crate) fn new() -> Self {
        let state = Mutex::new(Letters { waiting: VecDeque::new(), closed: false });
        Self { state, changed: Condvar::new() }
    }

    pub(crate) fn put(&self, letter: T) {
        lock(&self.state).waiting.push_back(letter);
        self.changed.notify_all();
    }

    pub(crate) fn close(&self) {
        lock(&self.state).closed = true;
        self.changed.notify_all();
    }

    /// The oldest letter, waited for a while.
    pub(crate) fn wait(&self, patience: Duration) -> Waited<T> {
        let state = lock(&self.state);
        let is_waiting = |state: &mut Letters<T>| state.waiting.is_empty() && !state.closed;
        let waited = self.changed.wait_timeout_while(state, patience, is_waiting);
        let (mut state, _) = waited.unwrap_or_else(PoisonError::into_inner);
        match state.waiting.pop_front() {
            Some(letter) => Waited::Letter(letter),
            None if state.closed => Waited::Closed,
            None => Waited::NotYet,
        }
    }
}

/// Closes a mailbox when dropped, so that nobody waits for a thread that has panicked.
pub(crate) struct Closing<'a, T>(pub(crate) &'a Mailbox<T>);

impl<T> Drop for Closing<'_, T> {
    fn drop(&mut self) {
        self.0.close();
    }
}

/// Runs `work` on a thread of its own, and waits for it without the interpreter's lock. A signal
/// whose handler raises, and a `told` that raises, cancel the work; their exception is returned
/// when the work has ended.
pub(crate) fn run<T: Send>(
    py: Python<'_>,
    cancel: &CancelToken,
    progress: &Progress,
    told: Option<&Bound<'_, PyAny>>,
    work: impl FnOnce() -> T + Send,
) -> PyResult<T> {
    let done = Mailbox::new();
    std::thread::scope(|scope| {
        let done = &done;
        let work = move || {
            let _closing = Closing(done);
            done.put(work());
        };
        let thread = std::thread::Builder::new().name("rayset-call".into()).spawn_scoped(scope, work);
        thread.map_err(|error| errors::os(format!("cannot start a thread: {error}")))?;
        let mut last = Instant::now();
        loop {
            match py.detach(|| done.wait(PATIENCE)) {
                Waited::Letter(result) => {
                    // The end is told, too, if the work ended well or not.
                    tell(progress, told)?;
                    return Ok(result);
                }
                Waited::Closed => return Err(errors::defect(py)),
                Waited::NotYet => {}
            }
            let mut heard = py.check_signals();
            if heard.is_ok() && last.elapsed() >= TELLING {
                last = Instant::now();
                heard = tell(progress, told);
            }
            if let Err(error) = heard {
                cancel.cancel();
                py.detach(|| while let Waited::NotYet = done.wait(PATIENCE) {});
                return Err(error);
            }
        }
    })
}

fn tell(progress: &Progress, told: Option<&Bound<'_, PyAny>>) -> PyResult<()> {
    if let (Some(told), Some(step)) = (told, progress.take()) {
        told.call1(step)?;
    }
    Ok(())
}
