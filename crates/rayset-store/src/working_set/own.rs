//! What each thread has for itself, so that threads that request resident pages write nothing in
//! common but the state of these pages.

use std::sync::Arc;

use super::shared::Shared;
use super::stats::Hits;
use rayset_base::sync::atomic::{AtomicU64, Ordering};
use rayset_base::sync::lock;

/// What the guards of one client, or of one of its threads, refer to: their references are counted
/// here, and their hits, so that threads that request resident pages write nothing in common but
/// the pages' own state.
#[repr(align(128))]
pub(super) struct Own {
    pub(super) shared: Arc<Shared>,
    pub(super) hits: Arc<Hits>,
    /// When a page was last used.
    last_use: AtomicU64,
}

impl Own {
    pub(super) fn new(shared: Arc<Shared>) -> Arc<Self> {
        let hits = Arc::new(Hits::default());
        lock(&shared.hits).push(hits.clone());
        Arc::new(Self { shared, hits, last_use: AtomicU64::new(0) })
    }

    /// The time of a use of a page now, later than that of any before it.
    pub(super) fn time_of_use(&self) -> u64 {
        let time = self.shared.pool.time_of_use(self.last_use.load(Ordering::Relaxed));
        self.last_use.store(time, Ordering::Relaxed);
        time
    }

    /// The time of the last use of a page, or of the last load.
    pub(super) fn now(&self) -> u64 {
        self.shared.pool.now().max(self.last_use.load(Ordering::Relaxed))
    }

    /// Adds the hits to the counters of all; called when no more will be counted.
    pub(super) fn settle(&self) {
        let mut all = lock(&self.shared.hits);
        self.hits.settle(&self.shared.counters);
        all.retain(|hits| !Arc::ptr_eq(hits, &self.hits));
    }
}
