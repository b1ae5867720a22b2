//! How a remote object is read.

use std::time::Duration;

/// How a remote object is read. None of this changes what is read.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub struct RemoteOptions {
    /// Most requests in flight at a time, at least 1; 64 by default. Fewer, while the server
    /// refuses some.
    pub in_flight: usize,
    /// Most bytes between two reads that are read for nothing, to save a request; 64 KiB by
    /// default.
    pub gap_bytes: u64,
    /// Most bytes of a request that joins several reads; 1 MiB by default.
    pub most_bytes: u64,
    /// Attempts at a request before its reads fail, at least 1; 6 by default. Attempts that the
    /// server refuses, because it is asked for too much at a time, do not count.
    pub attempts: u32,
    /// The pause after the first failure, which doubles with every further one; 100 ms by default.
    pub first_pause: Duration,
    /// The longest pause; 5 s by default.
    pub longest_pause: Duration,
    /// After this time an attempt counts as failed; 30 s by default.
    pub timeout: Duration,
    /// No attempt is begun later than this after the first one of its request; 3 minutes by
    /// default.
    pub give_up_after: Duration,
}

impl Default for RemoteOptions {
    fn default() -> Self {
        Self {
            in_flight: 64,
            gap_bytes: 64 << 10,
            most_bytes: 1 << 20,
            attempts: 6,
            first_pause: Duration::from_millis(100),
            longest_pause: Duration::from_secs(5),
            timeout: Duration::from_secs(30),
            give_up_after: Duration::from_secs(180),
        }
    }
}

impl RemoteOptions {
    /// The pause after a number of failures: doubled with each up to the longest, then shortened or
    /// lengthened at random by at most a fraction of itself.
    pub(super) fn pause_after(&self, failures: u32, longest: Duration, jitter: f64) -> Duration {
        let doubled = 2_u32.saturating_pow(failures.saturating_sub(1));
        let pause = self.first_pause.saturating_mul(doubled).min(longest.min(self.longest_pause));
        pause.mul_f64(1.0 + jitter * (2.0 * random() - 1.0))
    }
}

/// A number from 0 to 1 that differs from call to call and from process to process.
fn random() -> f64 {
    use std::hash::{BuildHasher, RandomState};
    (RandomState::new().hash_one(0) >> 11) as f64 / (1_u64 << 53) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pauses_double_up_to_the_longest() {
        let options = RemoteOptions::default();
        let pauses = |longest, jitter| {
            [1, 2, 3, 7, 40].map(|n| options.pause_after(n, Duration::from_secs(longest), jitter).as_millis())
        };
        assert_eq!(pauses(60, 0.0), [100, 200, 400, 5000, 5000]);
        assert_eq!(pauses(1, 0.0), [100, 200, 400, 1000, 1000]);
        let shaken = pauses(1, 0.25);
        assert!((75..=125).contains(&shaken[0]) && (750..=1250).contains(&shaken[4]), "{shaken:?}");
        // Those who wait longest, too, come back at different times.
        assert!((0..50).any(|_| pauses(1, 0.25)[4] != shaken[4]));
    }
}
