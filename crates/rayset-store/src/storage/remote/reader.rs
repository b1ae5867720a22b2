//! What is known of a remote object: how to start reading one of its ranges, and where the bytes
//! go.

use std::io;
use std::ops::Range;
use std::sync::Arc;

use super::flight::Flight;

/// Starts reading ranges of one object, which is remote: on an object store, on a web server.
///
/// Everything else (how many requests are in flight, joining of neighbours, retries, time-outs) is
/// done by [`RemoteStorage`](super::RemoteStorage).
pub trait RangeReader: Send + Sync {
    /// Starts reading a range of bytes, and returns without waiting for them. The bytes are handed
    /// to the sink in order, from any thread, in parts of any length; then the sink is ended. A
    /// sink that is dropped counts as a connection that was cut.
    fn start(&self, range: Range<u64>, sink: RangeSink);

    /// The object in messages: its address, without secrets.
    fn name(&self) -> String;
}

/// Why a range could not be read.
#[derive(Debug)]
pub struct RangeError {
    pub(super) source: io::Error,
    pub(super) outlook: Outlook,
}

/// What another attempt would meet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Outlook {
    /// Another outcome, perhaps.
    Passes,
    /// A server that answers if it is asked for less at a time.
    Refused,
    /// The same error.
    Lasts,
}

impl RangeError {
    /// An error that may be gone at the next attempt: a connection that was cut, a server that had
    /// to be restarted.
    #[must_use]
    pub fn passing(source: io::Error) -> Self {
        Self { source, outlook: Outlook::Passes }
    }

    /// The server would answer, if it were not asked for so much at a time (429 and 503 in HTTP).
    /// It is asked for less then, and as long as
    /// [`give_up_after`](super::RemoteOptions::give_up_after) says: this does not count as one of
    /// the attempts.
    #[must_use]
    pub fn refused(source: io::Error) -> Self {
        Self { source, outlook: Outlook::Refused }
    }

    /// An error that another attempt would meet again: no permission, no such object, an object
    /// that has changed.
    #[must_use]
    pub fn lasting(source: io::Error) -> Self {
        Self { source, outlook: Outlook::Lasts }
    }
}

/// Called when a request has ended.
pub(super) type Ended = Box<dyn FnOnce(&Flight, Result<(), RangeError>) + Send>;

/// Where the bytes of a range go.
pub struct RangeSink {
    flight: Arc<Flight>,
    /// Called when the sink is ended; `None` from then on.
    ended: Option<Ended>,
}

impl RangeSink {
    pub(super) fn new(flight: Arc<Flight>, ended: Ended) -> Self {
        Self { flight, ended: Some(ended) }
    }

    /// Takes the next bytes of the range. Returns whether more are wanted: not if the request has
    /// timed out meanwhile, or the range is complete; the rest of the answer need not be received
    /// then.
    pub fn put(&mut self, bytes: &[u8]) -> bool {
        self.flight.put(bytes)
    }

    /// Says that the range has ended: with all of its bytes, or with an error.
    pub fn end(mut self, outcome: Result<(), RangeError>) {
        self.finish(outcome);
    }

    fn finish(&mut self, outcome: Result<(), RangeError>) {
        if let Some(ended) = self.ended.take() {
            ended(&self.flight, outcome);
        }
    }
}

impl Drop for RangeSink {
    fn drop(&mut self) {
        let cut = io::Error::new(io::ErrorKind::ConnectionAborted, "the connection was cut");
        self.finish(Err(RangeError::passing(cut)));
    }
}

impl std::fmt::Debug for RangeSink {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("RangeSink").field("open", &self.ended.is_some()).finish_non_exhaustive()
    }
}
