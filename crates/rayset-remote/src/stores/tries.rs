//! Attempts at requests: each of them, and all together, in bounded time.

use std::future::Future;
use std::hash::{BuildHasher, RandomState};
use std::io;
use std::time::{Duration, Instant};

use object_store::Error;

use super::failure;
use super::renewal::Renewal;
use crate::times::Times;

/// How far a pause is shortened or lengthened at random, so that those who failed together do not
/// come back together.
const JITTER: f64 = 0.25;

/// Why all attempts at a request have failed.
#[derive(Debug)]
pub(super) struct Failure {
    /// The last error.
    pub(super) error: Error,
    attempts: u32,
    took: Duration,
}

impl Failure {
    /// The error as it is said to the user.
    pub(super) fn in_words(&self, name: &str) -> io::Error {
        let error = failure::in_words(&self.error, name);
        if self.attempts < 2 {
            return error;
        }
        let tried = format!("(tried {} times in {:.1} s)", self.attempts, self.took.as_secs_f64());
        io::Error::new(error.kind(), format!("{error} {tried}"))
    }
}

/// Tries until it succeeds, fails for good or too often, or the time is over. What a server refuses
/// because it is asked for too much at a time does not count as a failure.
pub(super) async fn attempts<T, F: Future<Output = Result<T, Error>>>(
    times: Times,
    renewal: &Renewal,
    mut work: impl FnMut() -> F,
) -> Result<T, Failure> {
    let (begun, mut pause, mut failures) = (Instant::now(), times.first_pause, 0);
    for attempt in 1.. {
        let patience = times.attempt.min(times.all.saturating_sub(begun.elapsed()));
        let outcome = tokio::time::timeout(patience, renewal.with(&mut work)).await;
        let error = match outcome {
            Ok(Ok(value)) => return Ok(value),
            Ok(Err(error)) => error,
            Err(_) => failure::no_answer(patience),
        };
        failures += u32::from(!failure::is_refusal(&error));
        let (took, rest) = (begun.elapsed(), pause.mul_f64(1.0 + JITTER * (2.0 * random() - 1.0)));
        if !failure::may_pass(&error) || failures >= times.attempts || took + rest >= times.all {
            return Err(Failure { error, attempts: attempt, took });
        }
        tokio::time::sleep(rest).await;
        pause = (2 * pause).min(Times::LONGEST_PAUSE);
    }
    unreachable!("the time is bounded")
}

/// A number from 0 to 1.
fn random() -> f64 {
    (RandomState::new().hash_one(0) >> 11) as f64 / (1_u64 << 53) as f64
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;

    const TIMES: Times = Times {
        attempt: Duration::from_millis(300),
        all: Duration::from_secs(1),
        attempts: 20,
        first_pause: Duration::from_millis(10),
        slowest_sending: 1 << 20,
    };

    fn run<T>(work: impl Future<Output = T>) -> T {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
        runtime.expect("a runtime").block_on(work)
    }

    #[test]
    fn whoever_gets_no_answer_has_given_up_when_the_time_is_over() {
        let (tried, begun) = (Cell::new(0), Instant::now());
        let failed = run(attempts(TIMES, &Renewal::default(), || {
            tried.set(tried.get() + 1);
            std::future::pending::<Result<(), Error>>()
        }));
        let said = failed.expect_err("nobody answers").in_words("s3://b/a").to_string();
        assert!(begun.elapsed() < Duration::from_secs(10), "{:?}", begun.elapsed());
        assert!(said.contains("s3://b/a: no answer within") && said.contains("tried"), "{said}");
        assert!((2..=5).contains(&tried.get()), "tried {} times", tried.get());
    }

    #[test]
    fn what_passes_is_tried_again_and_what_lasts_is_not() {
        let tried = Cell::new(0);
        let generic = |text: &'static str| Error::Generic { store: "S3", source: text.into() };
        let found = run(attempts(TIMES, &Renewal::default(), || {
            tried.set(tried.get() + 1);
            std::future::ready(if tried.get() < 4 { Err(generic("status code: 503 Slow")) } else { Ok(7) })
        }));
        assert_eq!((found.expect("the fourth succeeds"), tried.get()), (7, 4));
        tried.set(0);
        let failed = run(attempts(TIMES, &Renewal::default(), || {
            tried.set(tried.get() + 1);
            std::future::ready(Err::<(), _>(generic("status code: 400 Bad Request")))
        }));
        assert!(failed.is_err() && tried.get() == 1, "tried {} times", tried.get());
    }

    #[test]
    fn failures_are_counted_and_refusals_go_on_until_the_time_is_over() {
        for (text, most) in [("status code: 500 Internal", 3), ("status code: 503 Slow Down", 100)] {
            let (tried, begun) = (Cell::new(0), Instant::now());
            let times = Times { attempts: 3, ..TIMES };
            let failed = run(attempts(times, &Renewal::default(), || {
                tried.set(tried.get() + 1);
                std::future::ready(Err::<(), _>(Error::Generic { store: "S3", source: text.into() }))
            }));
            let said = failed.expect_err("it never succeeds").in_words("s3://b/a").to_string();
            assert!(said.contains(&format!("tried {} times", tried.get())), "{said}");
            // Pauses double from 10 ms, within a second.
            assert!(tried.get() == most || most > 3 && tried.get() > 3, "{text}: tried {}", tried.get());
            assert!(begun.elapsed() < Duration::from_secs(10), "{text}: {:?}", begun.elapsed());
        }
    }
}
