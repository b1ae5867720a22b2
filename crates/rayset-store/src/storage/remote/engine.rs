//! Requests to a remote object: started as long as few enough are in flight, tried again after a
//! pause if they fail or are refused, given up in bounded time.

use std::collections::HashMap;
use std::io;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError, Weak};
use std::time::{Duration, Instant};

use super::counts::Counts;
use super::flight::{Ended, Flight, Request};
use super::limit::{RequestLimit, Waiting};
use super::options::RemoteOptions;
use super::pace::Pace;
use super::queue::{Joining, PendingRead, Queue};
use super::reader::{Outlook, RangeError, RangeReader, RangeSink};
use super::unread::unread;

/// How far a retry's pause is shortened or lengthened, so that failed requests do not all come back
/// at once.
const JITTER: f64 = 0.25;
/// The clock looks at flights at least this often while there are any.
const TICK: Duration = Duration::from_millis(250);

/// The state behind a [`RemoteStorage`](super::RemoteStorage).
pub(super) struct Engine {
    reader: Arc<dyn RangeReader>,
    pub(super) options: RemoteOptions,
    pub(super) counts: Counts,
    /// What it shares with other engines.
    pub(super) limit: Option<Arc<RequestLimit>>,
    state: Mutex<State>,
    /// Tells the clock that there is something to wait for.
    changed: Condvar,
}

struct State {
    queue: Queue,
    pace: Pace,
    flights: HashMap<u64, Arc<Flight>>,
    /// Requests that failed, and when they are to be tried again.
    paused: Vec<(Instant, Request)>,
    /// Those whose pause is over, that were refused, or that had no room.
    again: Vec<Request>,
    last_flight: u64,
    /// A thread is starting requests; it will look at the queue again before it ends.
    starting: bool,
    closed: bool,
}

impl Engine {
    /// An engine and its clock, a thread that ends when the engine is closed or dropped.
    pub(super) fn start(
        reader: Arc<dyn RangeReader>,
        options: RemoteOptions,
        limit: Option<Arc<RequestLimit>>,
    ) -> io::Result<Arc<Self>> {
        let engine = Arc::new(Self {
            reader,
            options,
            counts: Counts::default(),
            limit,
            state: Mutex::new(State::new(options.in_flight)),
            changed: Condvar::new(),
        });
        let weak = Arc::downgrade(&engine);
        std::thread::Builder::new()
            .name("rayset-remote".into())
            .stack_size(128 << 10)
            .spawn(move || keep_time(&weak))?;
        Ok(engine)
    }

    pub(super) fn name(&self) -> String {
        self.reader.name()
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Queues reads, and starts as many requests as may be in flight.
    pub(super) fn submit(self: &Arc<Self>, reads: Vec<PendingRead>, urgent: bool) {
        let (empty, reads): (Vec<PendingRead>, Vec<PendingRead>) =
            reads.into_iter().partition(|read| read.length == 0);
        empty.into_iter().for_each(|read| read.complete(Ok(())));
        let mut state = self.lock();
        if state.closed {
            drop(state);
            return reads.into_iter().for_each(|read| read.complete(Err(closed())));
        }
        self.counts.asked(reads.len());
        reads.into_iter().for_each(|read| state.queue.push(read, urgent));
        drop(state);
        self.start_requests();
    }

    /// Starts requests as long as there is anything to start.
    fn start_requests(self: &Arc<Self>) {
        // A reader may end a request before `start` returns: the loop then goes on here, not one
        // call deeper.
        if std::mem::replace(&mut self.lock().starting, true) {
            return;
        }
        while let Some(flight) = self.next_flight() {
            let range = flight.range();
            self.counts.begun(&range);
            let engine = self.clone();
            let ended = move |flight: &Flight, outcome| engine.ended(flight, outcome);
            self.reader.start(range, RangeSink::new(flight, Box::new(ended)));
        }
    }

    /// The next request to start, which counts as in flight from now on; `None`, and nobody is
    /// starting requests any more, if nothing waits or enough are in flight.
    fn next_flight(self: &Arc<Self>) -> Option<Arc<Flight>> {
        let mut state = self.lock();
        let may_begin = state.flights.len() < state.pace.allowed(Instant::now());
        let request = if may_begin { self.next_request(&mut state) } else { None };
        let Some(request) = request else {
            state.starting = false;
            return None;
        };
        let bytes = request.bytes();
        let asks = || -> Weak<dyn Waiting> { Arc::<Self>::downgrade(self) };
        if self.limit.as_ref().is_some_and(|limit| !limit.take(bytes, asks)) {
            // Whoever gives room back comes here again, once the lock is free.
            state.again.push(request);
            state.starting = false;
            return None;
        }
        state.last_flight += 1;
        let flight = Arc::new(Flight::new(state.last_flight, request));
        if state.flights.insert(flight.number, flight.clone()).is_none() && state.flights.len() == 1 {
            self.changed.notify_all();
        }
        Some(flight)
    }

    fn next_request(&self, state: &mut State) -> Option<Request> {
        if let Some(oldest) = (0..state.again.len()).min_by_key(|&index| state.again[index].since) {
            return Some(state.again.swap_remove(oldest));
        }
        let joining = Joining { gap_bytes: self.options.gap_bytes, most_bytes: self.options.most_bytes };
        let reads = state.queue.take(joining);
        (!reads.is_empty()).then(|| Request { reads, failures: 0, refusals: 0, since: Instant::now() })
    }

    /// A request has ended, as its sink says.
    fn ended(self: &Arc<Self>, flight: &Flight, outcome: Result<(), RangeError>) {
        if let Some(ended) = flight.take() {
            self.settle(flight, ended, outcome);
        }
    }

    /// Completes what a request has read; what it has not is tried again or fails.
    fn settle(self: &Arc<Self>, flight: &Flight, ended: Ended, outcome: Result<(), RangeError>) {
        let Ended { request, missing } = ended;
        self.lock().flights.remove(&flight.number);
        self.give_back(flight.bytes);
        let outcome = outcome.and_then(|()| if missing == 0 { Ok(()) } else { Err(too_short(missing)) });
        let failed = match outcome {
            Ok(()) => {
                self.counts.took(flight.begun.elapsed());
                self.lock().pace.answered();
                None
            }
            // Everything that was asked for has come before the connection broke.
            Err(_) if request.reads.is_empty() => None,
            Err(error) => self.try_again(request, error, flight.begun),
        };
        if let Some((request, error)) = failed {
            self.fail(request, &error);
        }
        self.start_requests();
    }

    /// A request of so many bytes is in flight no longer: others may be begun.
    fn give_back(&self, bytes: u64) {
        if let Some(limit) = &self.limit {
            limit.give_back(bytes);
        }
    }

    /// Lets a request pause before its next attempt; returns it if there is to be none. Its last
    /// one was begun then.
    fn try_again(
        &self,
        mut request: Request,
        error: RangeError,
        begun: Instant,
    ) -> Option<(Request, RangeError)> {
        let now = Instant::now();
        let pause = |times, longest| self.options.pause_after(times, longest, JITTER);
        let mut state = self.lock();
        let next = match error.outlook {
            Outlook::Lasts => {
                request.failures += 1;
                None
            }
            Outlook::Passes => {
                request.failures += 1;
                let pause = pause(request.failures, self.options.longest_pause);
                (request.failures < self.options.attempts).then(|| now + pause)
            }
            Outlook::Refused => {
                request.refusals += 1;
                Some(state.pace.refused(begun, now, pause))
            }
        };
        let in_time = |next: &Instant| *next <= request.since + self.options.give_up_after;
        let Some(next) = next.filter(in_time).filter(|_| !state.closed) else {
            return Some((request, error));
        };
        self.counts.failed();
        state.paused.push((next, request));
        self.changed.notify_all();
        None
    }

    fn fail(&self, request: Request, error: &RangeError) {
        let Request { reads, failures, refusals, since } = request;
        let tried = match failures + refusals {
            0 | 1 => String::new(),
            times => format!(" (tried {times} times in {:.1} s)", since.elapsed().as_secs_f64()),
        };
        for read in reads {
            read.complete(Err(unread(error.source.kind(), format!("{}{tried}", error.source))));
        }
    }

    /// Fails what waits and what is in flight.
    pub(super) fn close(&self) {
        let mut state = self.lock();
        state.closed = true;
        let waiting = state.queue.drain();
        let paused: Vec<Request> = state.paused.drain(..).map(|(_, request)| request).collect();
        let again = std::mem::take(&mut state.again);
        let flights: Vec<Arc<Flight>> = state.flights.drain().map(|(_, flight)| flight).collect();
        drop(state);
        self.changed.notify_all();
        let taken = |flight: &Arc<Flight>| Some((flight.bytes, flight.take()?.request));
        let flying: Vec<(u64, Request)> = flights.iter().filter_map(taken).collect();
        flying.iter().for_each(|&(bytes, _)| self.give_back(bytes));
        let flying = flying.into_iter().map(|(_, request)| request);
        let requests = paused.into_iter().chain(again).chain(flying);
        let reads = requests.flat_map(|request| request.reads).chain(waiting);
        reads.for_each(|read| read.complete(Err(closed())));
    }

    /// One look of the clock: ends what takes too long, and lets go what has paused long enough.
    fn look(self: &Arc<Self>) {
        let now = Instant::now();
        let mut state = self.lock();
        let late: Vec<Arc<Flight>> = (state.flights.values())
            .filter(|flight| now.saturating_duration_since(flight.begun) > self.options.timeout)
            .cloned()
            .collect();
        let (due, paused): (Vec<_>, Vec<_>) = state.paused.drain(..).partition(|(due, _)| *due <= now);
        state.paused = paused;
        state.again.extend(due.into_iter().map(|(_, request)| request));
        let goes_on = state.pace.wake(now) || !state.again.is_empty();
        drop(state);
        for flight in late {
            if let Some(ended) = flight.take() {
                let what = format!("no answer within {:.0} s", self.options.timeout.as_secs_f64());
                let error = io::Error::new(io::ErrorKind::TimedOut, what);
                self.settle(&flight, ended, Err(RangeError::passing(error)));
            }
        }
        if goes_on {
            self.start_requests();
        }
    }
}

impl Waiting for Engine {
    fn start(self: Arc<Self>) {
        self.start_requests();
    }
}

impl std::fmt::Debug for Engine {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Engine").field("name", &self.name()).finish_non_exhaustive()
    }
}

impl State {
    fn new(most: usize) -> Self {
        Self {
            queue: Queue::default(),
            pace: Pace::new(most),
            flights: HashMap::new(),
            paused: Vec::new(),
            again: Vec::new(),
            last_flight: 0,
            starting: false,
            closed: false,
        }
    }

    /// How long the clock may wait until it looks again, if nothing changes.
    fn until_next_look(&self) -> Duration {
        /// Without anything to wait for: long enough to cost nothing, short enough to notice that
        /// the engine has been dropped.
        const IDLE: Duration = Duration::from_secs(5);
        let now = Instant::now();
        let ends = self.paused.iter().map(|(due, _)| *due).chain(self.pace.quiet_until());
        let pauses = ends.map(|end| end.saturating_duration_since(now));
        let watched = (!self.flights.is_empty()).then_some(TICK);
        pauses.chain(watched).min().unwrap_or(IDLE)
    }
}

/// The clock's thread.
fn keep_time(engine: &Weak<Engine>) {
    while let Some(engine) = engine.upgrade() {
        engine.look();
        let state = engine.lock();
        if state.closed {
            return;
        }
        // Under the lock: what comes from now on wakes it.
        let wait = state.until_next_look();
        let waited = engine.changed.wait_timeout(state, wait);
        drop(waited);
    }
}

fn too_short(missing: u64) -> RangeError {
    let what = format!("the answer ended {missing} bytes too early");
    RangeError::passing(io::Error::new(io::ErrorKind::UnexpectedEof, what))
}

fn closed() -> io::Error {
    io::Error::new(io::ErrorKind::NotConnected, "the storage has been closed")
}
