//! Statistics of the working set, by kind of page.

use std::time::Instant;

use super::source::{KINDS, Kind};
use rayset_base::sync::atomic::{AtomicU64, Ordering};

/// Counters of one kind; all relaxed, so that counting never orders anything.
#[derive(Debug, Default)]
pub(super) struct Counters {
    pub(super) hits: AtomicU64,
    pub(super) misses: AtomicU64,
    pub(super) late: AtomicU64,
    pub(super) hinted: AtomicU64,
    pub(super) hinted_in_time: AtomicU64,
    pub(super) stalls: AtomicU64,
    pub(super) stall_nanoseconds: AtomicU64,
    pub(super) reads: AtomicU64,
    pub(super) bytes_read: AtomicU64,
    pub(super) bytes_unique: AtomicU64,
    pub(super) evictions: AtomicU64,
    pub(super) computed: AtomicU64,
    pub(super) computed_unique: AtomicU64,
}

impl Counters {
    /// Counts a request that has waited since `started`.
    pub(super) fn stalled(&self, started: Instant) {
        self.stalls.fetch_add(1, Ordering::Relaxed);
        self.stall_nanoseconds.fetch_add(started.elapsed().as_nanos() as u64, Ordering::Relaxed);
    }

    pub(super) fn reset(&self) {
        for counter in [
            &self.hits,
            &self.misses,
            &self.late,
            &self.hinted,
            &self.hinted_in_time,
            &self.stalls,
            &self.stall_nanoseconds,
            &self.reads,
            &self.bytes_read,
            &self.bytes_unique,
            &self.evictions,
            &self.computed,
            &self.computed_unique,
        ] {
            counter.store(0, Ordering::Relaxed);
        }
    }
}

/// Requests for resident pages, by kind, of one thread. In lines of the processor's caches that no
/// other thread writes: there may be millions of requests a second, by any number of threads.
#[derive(Debug, Default)]
#[repr(align(128))]
pub(super) struct Hits([AtomicU64; KINDS]);

impl Hits {
    pub(super) fn count(&self, kind: Kind) {
        self.0[kind.index()].fetch_add(1, Ordering::Relaxed);
    }

    pub(super) fn reset(&self) {
        self.0.iter().for_each(|hits| hits.store(0, Ordering::Relaxed));
    }

    /// Adds what was counted to the counters of all kinds.
    pub(super) fn settle(&self, counters: &[Counters; KINDS]) {
        for (hits, counters) in self.0.iter().zip(counters) {
            counters.hits.fetch_add(hits.load(Ordering::Relaxed), Ordering::Relaxed);
        }
    }
}

/// Statistics of the pages of one kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(not(feature = "internals"), non_exhaustive)]
pub struct KindStatistics {
    /// Requests for a resident page.
    pub hits: u64,
    /// Requests for an absent page.
    pub misses: u64,
    /// Requests for a page that was being read, for a hint or for another thread.
    pub late: u64,
    /// Pages read because of a hint.
    pub hinted: u64,
    /// Of these, the ones that were resident or being read when they were first requested.
    pub hinted_in_time: u64,
    /// Requests that had to wait.
    pub stalls: u64,
    /// Time waited in nanoseconds, summed over all threads.
    pub stall_nanoseconds: u64,
    /// Pages read.
    pub reads: u64,
    /// Bytes of these pages.
    pub bytes_read: u64,
    /// The same, each page counted once.
    pub bytes_unique: u64,
    /// Pages evicted.
    pub evictions: u64,
    /// Pages that were computed instead of read.
    pub computed: u64,
    /// The same, each page counted once.
    pub computed_unique: u64,
    /// Most bytes in memory at any time, including pages being read.
    pub peak_bytes: u64,
    /// Bytes in memory now, including pages being read.
    pub resident_bytes: u64,
}

/// Statistics of a working set.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[cfg_attr(not(feature = "internals"), non_exhaustive)]
pub struct Statistics {
    /// By kind, in the order of [`Kind::ALL`].
    by_kind: [KindStatistics; KINDS],
    /// Most bytes in memory at any time, of all kinds together.
    pub peak_bytes: u64,
}

impl Statistics {
    pub(super) fn collect(
        counters: &[Counters; KINDS],
        (peak_bytes, peaks): (u64, [u64; KINDS]),
        resident: [u64; KINDS],
    ) -> Self {
        let get = |c: &AtomicU64| c.load(Ordering::Relaxed);
        let by_kind = std::array::from_fn(|k| {
            let c = &counters[k];
            KindStatistics {
                hits: get(&c.hits),
                misses: get(&c.misses),
                late: get(&c.late),
                hinted: get(&c.hinted),
                hinted_in_time: get(&c.hinted_in_time),
                stalls: get(&c.stalls),
                stall_nanoseconds: get(&c.stall_nanoseconds),
                reads: get(&c.reads),
                bytes_read: get(&c.bytes_read),
                bytes_unique: get(&c.bytes_unique),
                evictions: get(&c.evictions),
                computed: get(&c.computed),
                computed_unique: get(&c.computed_unique),
                peak_bytes: peaks[k],
                resident_bytes: resident[k],
            }
        });
        Self { by_kind, peak_bytes }
    }

    pub(super) fn add_hits(&mut self, hits: &Hits) {
        for (statistics, hits) in self.by_kind.iter_mut().zip(&hits.0) {
            statistics.hits += hits.load(Ordering::Relaxed);
        }
    }

    /// The numbers of one kind.
    #[must_use]
    pub fn kind(&self, kind: Kind) -> &KindStatistics {
        &self.by_kind[kind.index()]
    }

    /// The sum over all kinds of one number.
    #[must_use]
    pub fn total(&self, number: impl Fn(&KindStatistics) -> u64) -> u64 {
        self.by_kind.iter().map(number).sum()
    }
}
