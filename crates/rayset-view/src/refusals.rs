//! How often refusals are said in the log.

use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Lines at once.
const AT_ONCE: f64 = 20.0;
/// A line more may follow after this.
const BETWEEN_LINES: Duration = Duration::from_secs(10);

/// Counts refusals: a bucket of lines that fills with time.
pub(crate) struct Refusals(Mutex<State>);

struct State {
    left: f64,
    last: Instant,
    /// Since the last line.
    unsaid: u64,
}

/// What the log says of a refusal.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum LogDecision {
    Line,
    /// A line, and that so many before it had none.
    LineAfter(u64),
    Nothing,
}

impl Default for Refusals {
    fn default() -> Self {
        Self(Mutex::new(State { left: AT_ONCE, last: Instant::now(), unsaid: 0 }))
    }
}

impl Refusals {
    /// Takes note of a refusal.
    pub(crate) fn count(&self) -> LogDecision {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).count_at(Instant::now())
    }
}

impl State {
    fn count_at(&mut self, now: Instant) -> LogDecision {
        let passed = now.saturating_duration_since(self.last);
        self.last = now;
        self.left = (self.left + passed.as_secs_f64() / BETWEEN_LINES.as_secs_f64()).min(AT_ONCE);
        if self.left < 1.0 {
            self.unsaid += 1;
            return LogDecision::Nothing;
        }
        self.left -= 1.0;
        match std::mem::take(&mut self.unsaid) {
            0 => LogDecision::Line,
            unsaid => LogDecision::LineAfter(unsaid),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flood_of_refusals_is_counted_and_not_listed() {
        let start = Instant::now();
        let mut state = State { left: AT_ONCE, last: start, unsaid: 0 };
        // A thousand a second, for a hundred seconds.
        let said: Vec<LogDecision> =
            (0..100_000).map(|at| state.count_at(start + Duration::from_millis(at))).collect();
        let lines = said.iter().filter(|said| **said != LogDecision::Nothing).count();
        assert!((20..=31).contains(&lines), "{lines}");
        // After a quiet while the next is said, and how many were not.
        let next = state.count_at(start + Duration::from_secs(200));
        let counted =
            said.iter().map(|said| if let LogDecision::LineAfter(unsaid) = said { *unsaid } else { 0 });
        let LogDecision::LineAfter(rest) = next else { panic!("{next:?}") };
        assert_eq!(counted.sum::<u64>() + rest + lines as u64, 100_000);
    }
}
