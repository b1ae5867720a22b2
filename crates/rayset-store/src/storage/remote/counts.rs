//! What a remote storage has done.

use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

/// What has been asked of a remote storage, and what it cost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct RemoteCounts {
    /// Reads, of pages mostly.
    pub reads: u64,
    /// Requests, each for one range, repeated ones included.
    pub requests: u64,
    /// Bytes requested, gaps between pages and repetitions included.
    pub bytes: u64,
    /// Requests that failed or were refused, and were tried again.
    pub retries: u64,
    /// The usual time from a request to its last byte: a moving average. Zero as long as none has
    /// ended.
    pub latency: Duration,
}

/// The counters behind [`RemoteCounts`].
#[derive(Default)]
pub(super) struct Counts {
    reads: AtomicU64,
    requests: AtomicU64,
    bytes: AtomicU64,
    retries: AtomicU64,
    /// Moving average in nanoseconds; 0 if nothing has been measured.
    latency: AtomicU64,
}

impl Counts {
    pub(super) fn asked(&self, reads: usize) {
        self.reads.fetch_add(reads as u64, Ordering::Relaxed);
    }

    pub(super) fn begun(&self, range: &Range<u64>) {
        self.requests.fetch_add(1, Ordering::Relaxed);
        self.bytes.fetch_add(range.end - range.start, Ordering::Relaxed);
    }

    pub(super) fn failed(&self) {
        self.retries.fetch_add(1, Ordering::Relaxed);
    }

    /// A request took so long. Of two that are counted at once one may be lost, which an average
    /// does not notice.
    pub(super) fn took(&self, time: Duration) {
        let time = u64::try_from(time.as_nanos()).unwrap_or(u64::MAX).max(1);
        let before = self.latency.load(Ordering::Relaxed);
        let average = if before == 0 { time } else { before - before / 8 + time / 8 };
        self.latency.store(average.max(1), Ordering::Relaxed);
    }

    pub(super) fn latency(&self) -> Option<Duration> {
        let nanoseconds = self.latency.load(Ordering::Relaxed);
        (nanoseconds > 0).then(|| Duration::from_nanos(nanoseconds))
    }

    pub(super) fn all(&self) -> RemoteCounts {
        RemoteCounts {
            reads: self.reads.load(Ordering::Relaxed),
            requests: self.requests.load(Ordering::Relaxed),
            bytes: self.bytes.load(Ordering::Relaxed),
            retries: self.retries.load(Ordering::Relaxed),
            latency: self.latency().unwrap_or_default(),
        }
    }
}
