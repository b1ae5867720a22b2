//! How many requests a server is sent at a time: fewer when it refuses some because they are too
//! many, more again as it answers.
//!
//! An object store has a limit of requests a second, which all its clients share and nobody can
//! look up. Each client finds its part by itself, as TCP does (additive increase, multiplicative
//! decrease), with the decrease of CUBIC (RFC 9438, section 4.6).

use std::time::{Duration, Instant};

/// What a refusal leaves of the requests that may be in flight.
const DECREASE: f64 = 0.7;
/// The longest pause after a refusal. It is short: a client that pauses long gets less than its
/// part.
const LONGEST_QUIET: Duration = Duration::from_secs(1);

/// The pace of the requests to one object.
pub(super) struct Pace {
    most: usize,
    /// Requests that may be in flight: at least 1, at most `most`.
    allowed: f64,
    /// When a refusal was last heeded. Requests that were begun before it say nothing new.
    heeded: Option<Instant>,
    /// Until then no request is begun.
    quiet_until: Option<Instant>,
    /// Refusals that were heeded since the last answer.
    in_a_row: u32,
}

impl Pace {
    pub(super) fn new(most: usize) -> Self {
        Self { most, allowed: most as f64, heeded: None, quiet_until: None, in_a_row: 0 }
    }

    /// How many requests may be in flight now.
    pub(super) fn allowed(&self, now: Instant) -> usize {
        if self.quiet_until.is_some_and(|end| now < end) { 0 } else { self.allowed as usize }
    }

    /// A request has been answered: one more may be in flight for every round of answers.
    pub(super) fn answered(&mut self) {
        self.allowed = (self.allowed + 1.0 / self.allowed).min(self.most as f64);
        self.in_a_row = 0;
    }

    /// A request that was begun then has been refused. Returns when the next ones may be begun.
    /// `pause` makes of the number of refusals in a row, and of the longest pause, how long nothing
    /// is begun.
    pub(super) fn refused(
        &mut self,
        begun: Instant,
        now: Instant,
        pause: impl Fn(u32, Duration) -> Duration,
    ) -> Instant {
        if self.heeded.is_none_or(|heeded| begun >= heeded) {
            self.allowed = (self.allowed * DECREASE).max(1.0);
            self.in_a_row += 1;
            self.heeded = Some(now);
            self.quiet_until = Some(now + pause(self.in_a_row, LONGEST_QUIET));
        }
        self.quiet_until.map_or(now, |end| end.max(now))
    }

    /// When requests may be begun again. `None` if they may be now.
    pub(super) fn quiet_until(&self) -> Option<Instant> {
        self.quiet_until
    }

    /// Ends the quiet if its time is over. Returns whether it has ended just now.
    pub(super) fn wake(&mut self, now: Instant) -> bool {
        self.quiet_until.take_if(|end| *end <= now).is_some()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn doubling(in_a_row: u32, longest: Duration) -> Duration {
        Duration::from_millis(100 << (in_a_row - 1).min(10)).min(longest)
    }

    #[test]
    fn requests_that_were_refused_together_lower_the_pace_once() {
        let (begun, mut pace) = (Instant::now(), Pace::new(64));
        let now = begun + Duration::from_millis(50);
        let ends: Vec<Instant> = (0..64).map(|_| pace.refused(begun, now, doubling)).collect();
        assert!(ends.iter().all(|end| *end == now + Duration::from_millis(100)));
        assert_eq!(pace.allowed(now), 0, "nothing is begun at once");
        assert_eq!(pace.allowed(ends[0]), 44);
        let later = ends[0] + Duration::from_millis(50);
        pace.refused(ends[0], later, doubling);
        assert_eq!(pace.allowed(later + Duration::from_secs(1)), 31);
    }

    #[test]
    fn a_server_that_refuses_everything_is_asked_one_thing_at_a_time_once_a_second() {
        let (mut now, mut pace) = (Instant::now(), Pace::new(64));
        for _ in 0..50 {
            let end = pace.refused(now, now, doubling);
            assert!(end <= now + LONGEST_QUIET && pace.allowed(end) >= 1);
            now = end;
        }
        assert_eq!(pace.allowed(now), 1);
        assert_eq!(pace.refused(now, now, doubling), now + LONGEST_QUIET);
    }

    #[test]
    fn answers_lift_the_pace_by_one_for_each_round_and_never_above_the_most() {
        let (now, mut pace) = (Instant::now(), Pace::new(64));
        let end = (0..20).fold(now, |now, _| pace.refused(now, now, doubling));
        assert!(pace.wake(end) && !pace.wake(end) && pace.quiet_until().is_none());
        let mut rounds = 0;
        while pace.allowed(end) < 64 {
            (0..pace.allowed(end)).for_each(|_| pace.answered());
            rounds += 1;
        }
        assert!((60..90).contains(&rounds), "{rounds} rounds");
        (0..1000).for_each(|_| pace.answered());
        assert_eq!(pace.allowed(end), 64);
    }
}
