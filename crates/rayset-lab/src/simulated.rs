//! An object that is as far away, and as unreliable, as a test or a measurement wants it to be.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::io;
use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};

use rayset::storage::{RangeError, RangeReader, RangeSink, Storage};

/// How a simulated object answers.
#[derive(Clone, Copy, Debug, Default)]
pub struct Behaviour {
    /// Time from a request to its answer.
    pub latency: Duration,
    /// The fraction of it by which it varies, either way, evenly.
    pub jitter: f64,
    /// The fraction of requests that fail, but could succeed at the next attempt.
    pub failing: f64,
    /// The fraction of requests whose connection is cut in the middle.
    pub cut: f64,
    /// The fraction of requests that take longer, and by how much.
    pub slow: (f64, Duration),
    /// The fraction of requests that are never answered.
    pub silent: f64,
    /// The most requests a second that are answered; those beyond are refused. All are if this
    /// is 0.
    pub rate: f64,
}

/// What a simulated object was asked for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SimulatedCounts {
    /// Requests.
    pub requests: u64,
    /// Bytes of all requests.
    pub bytes: u64,
    /// Most requests at a time that waited for their answers.
    pub most_at_once: u64,
    /// Requests that were made to fail, or were cut, delayed, refused or not answered.
    pub faults: u64,
}

/// So many requests a second, of which a tenth of a second's may come at once.
#[derive(Debug, Default)]
pub struct Rate {
    /// When the next request may be answered. `None` before the first.
    next: Option<Instant>,
}

impl Rate {
    /// Whether one more request is within so many a second; all are if there is to be no limit,
    /// which is 0.
    pub fn admits(&mut self, a_second: f64) -> bool {
        if a_second <= 0.0 {
            return true;
        }
        let now = Instant::now();
        let next = self.next.map_or(now, |next| next.max(now));
        let admitted = next <= now + Duration::from_millis(100);
        if admitted {
            self.next = Some(next + Duration::from_secs_f64(1.0 / a_second));
        }
        admitted
    }
}

/// Another storage, seen from far away.
pub struct SimulatedObject {
    shared: Arc<Shared>,
    behaviour: Behaviour,
    /// The state of the random numbers.
    random: AtomicU64,
}

struct Shared {
    storage: Arc<dyn Storage>,
    schedule: Mutex<Schedule>,
    changed: Condvar,
    counts: [AtomicU64; 4],
}

#[derive(Default)]
struct Schedule {
    answers: BinaryHeap<Reverse<(Instant, u64)>>,
    requests: std::collections::HashMap<u64, Pending>,
    /// Requests that will never be answered, kept so that they are not seen to end.
    silent: Vec<RangeSink>,
    last: u64,
    admitted: Rate,
    closed: bool,
}

struct Pending {
    range: Range<u64>,
    sink: RangeSink,
    fate: Fate,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Fate {
    Served,
    Refused,
    Fails,
    Cut,
}

const REQUESTS: usize = 0;
const BYTES: usize = 1;
const MOST: usize = 2;
const FAULTS: usize = 3;

impl SimulatedObject {
    /// Another storage at a distance; the same seed gives the same sequence of faults and times.
    ///
    /// # Errors
    /// The system's error, if the thread that answers cannot be started.
    pub fn new(storage: Arc<dyn Storage>, behaviour: Behaviour, seed: u64) -> io::Result<Self> {
        let shared = Arc::new(Shared {
            storage,
            schedule: Mutex::default(),
            changed: Condvar::new(),
            counts: Default::default(),
        });
        let of_thread = shared.clone();
        std::thread::Builder::new()
            .name("rayset-simulated".into())
            .stack_size(256 << 10)
            .spawn(move || of_thread.serve())?;
        Ok(Self { shared, behaviour, random: seed.into() })
    }

    /// What it was asked for so far.
    #[must_use]
    pub fn counts(&self) -> SimulatedCounts {
        let [requests, bytes, most_at_once, faults] =
            [REQUESTS, BYTES, MOST, FAULTS].map(|at| self.shared.counts[at].load(Ordering::Relaxed));
        SimulatedCounts { requests, bytes, most_at_once, faults }
    }

    /// Sets all counts to zero.
    pub fn reset_counts(&self) {
        self.shared.counts.iter().for_each(|count| count.store(0, Ordering::Relaxed));
    }

    /// The next random number, from 0 to 1 (SplitMix64).
    fn draw(&self) -> f64 {
        const STEP: u64 = 0x9e37_79b9_7f4a_7c15;
        let mut z = self.random.fetch_add(STEP, Ordering::Relaxed).wrapping_add(STEP);
        z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ z >> 31) >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn fault(&self, share: f64) -> bool {
        let hit = share > 0.0 && self.draw() < share;
        if hit {
            self.shared.counts[FAULTS].fetch_add(1, Ordering::Relaxed);
        }
        hit
    }
}

impl RangeReader for SimulatedObject {
    fn start(&self, range: Range<u64>, sink: RangeSink) {
        let Behaviour { latency, jitter, failing, cut, slow, silent, rate } = self.behaviour;
        let shared = &self.shared;
        shared.counts[REQUESTS].fetch_add(1, Ordering::Relaxed);
        shared.counts[BYTES].fetch_add(range.end - range.start, Ordering::Relaxed);
        let mut time = latency.mul_f64(1.0 + jitter * (2.0 * self.draw() - 1.0));
        if self.fault(slow.0) {
            time += slow.1;
        }
        let mut fate = match (self.fault(failing), self.fault(cut)) {
            (true, _) => Fate::Fails,
            (_, true) => Fate::Cut,
            _ => Fate::Served,
        };
        let is_silent = self.fault(silent);
        let mut schedule = shared.schedule.lock().unwrap_or_else(PoisonError::into_inner);
        if is_silent {
            return schedule.silent.push(sink);
        }
        if !schedule.admitted.admits(rate) {
            shared.counts[FAULTS].fetch_add(1, Ordering::Relaxed);
            fate = Fate::Refused;
        }
        schedule.last += 1;
        let number = schedule.last;
        schedule.answers.push(Reverse((Instant::now() + time, number)));
        schedule.requests.insert(number, Pending { range, sink, fate });
        shared.counts[MOST].fetch_max(schedule.requests.len() as u64, Ordering::Relaxed);
        drop(schedule);
        shared.changed.notify_one();
    }

    fn name(&self) -> String {
        "a simulated object".into()
    }
}

impl Shared {
    fn serve(&self) {
        let mut schedule = self.schedule.lock().unwrap_or_else(PoisonError::into_inner);
        loop {
            let now = Instant::now();
            let due = schedule.answers.peek().map(|Reverse((due, _))| due.saturating_duration_since(now));
            schedule = match due {
                _ if schedule.closed => return,
                Some(Duration::ZERO) => {
                    let number = schedule.answers.pop().map_or(0, |Reverse((_, number))| number);
                    let pending = schedule.requests.remove(&number);
                    drop(schedule);
                    pending.into_iter().for_each(|pending| self.answer(pending));
                    self.schedule.lock().unwrap_or_else(PoisonError::into_inner)
                }
                Some(wait) => {
                    self.changed.wait_timeout(schedule, wait).unwrap_or_else(PoisonError::into_inner).0
                }
                None => self.changed.wait(schedule).unwrap_or_else(PoisonError::into_inner),
            };
        }
    }

    fn answer(&self, Pending { range, mut sink, fate }: Pending) {
        /// Bytes that arrive at a time.
        const PART: u64 = 16 << 10;
        if fate == Fate::Refused {
            return sink.end(Err(RangeError::refused(io::Error::other("429: too many requests a second"))));
        }
        if fate == Fate::Fails {
            return sink.end(Err(RangeError::passing(io::Error::other("503: the server is overloaded"))));
        }
        let end = if fate == Fate::Cut { range.start + (range.end - range.start) / 2 } else { range.end };
        let mut part = vec![0; PART as usize];
        let mut at = range.start;
        while at < end {
            let part = &mut part[..(end - at).min(PART) as usize];
            if let Err(error) = self.storage.read_exact_at(part, at) {
                return sink.end(Err(RangeError::lasting(error)));
            }
            at += part.len() as u64;
            if !sink.put(part) {
                break;
            }
        }
        // A connection that is cut is not ended, but dropped.
        if fate == Fate::Served {
            sink.end(Ok(()));
        }
    }
}

impl Drop for SimulatedObject {
    fn drop(&mut self) {
        self.shared.schedule.lock().unwrap_or_else(PoisonError::into_inner).closed = true;
        self.shared.changed.notify_one();
    }
}
