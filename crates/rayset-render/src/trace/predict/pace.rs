//! How far ahead pages must be asked for: as many as are used up during the time that one takes to
//! come.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

/// How fast a render uses pages up while it does not wait for any.
#[derive(Default)]
pub(super) struct Pace {
    /// Time that threads have spent with tiles whose pages were there, in nanoseconds.
    busy: AtomicU64,
    /// Pages that the tiles traced so far have needed and those before them have not.
    pages: AtomicU64,
}

impl Pace {
    /// As long as nothing has been measured: fast enough that the first pages are asked for in
    /// numbers.
    const PAGES_PER_SECOND_AT_FIRST: f64 = 1000.0;

    /// A thread has traced for so long.
    pub(super) fn worked(&self, time: Duration) {
        self.busy.fetch_add(time.as_nanos() as u64, Ordering::Relaxed);
    }

    /// The number of pages that have been needed so far.
    pub(super) fn needed(&self, pages: u64) {
        self.pages.store(pages, Ordering::Relaxed);
    }

    /// Pages that some threads use up, at their present pace, in a time.
    pub(super) fn pages_in(&self, time: Duration, threads: usize) -> u64 {
        /// Before this time has passed, the first tiles, which need most pages, would pass for all.
        const MEASURED: Duration = Duration::from_millis(2);
        let busy = Duration::from_nanos(self.busy.load(Ordering::Relaxed));
        let pages = self.pages.load(Ordering::Relaxed) as f64;
        let rate = if busy < MEASURED {
            Self::PAGES_PER_SECOND_AT_FIRST
        } else {
            pages / busy.as_secs_f64() * threads as f64
        };
        (rate * time.as_secs_f64()).ceil() as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pages_ahead_are_those_that_are_used_up_during_the_latency() {
        let pace = Pace::default();
        assert_eq!(pace.pages_in(Duration::from_millis(50), 1), 50);
        pace.worked(Duration::from_millis(100));
        pace.needed(200);
        assert_eq!(pace.pages_in(Duration::from_millis(50), 1), 100);
        assert_eq!(pace.pages_in(Duration::from_millis(50), 2), 200);
        assert_eq!(pace.pages_in(Duration::ZERO, 2), 0);
    }
}
