//! Pages in memory, within a hard budget.
//!
//! A [`WorkingSet`] loads pages of any number of objects, for any number of threads and
//! [clients](PageClient). A page is *absent*, *loading* or *resident*; a resident page is
//! *retained* by guards, or merely kept until its room is needed. Room is made by evicting retired
//! pages first, then the least recently used, unless the thread that asks knows that another is
//! needed later ([`Reuse`]); retained pages stay, and a release never evicts.
//!
//! Invariants, for any interleaving of threads:
//! 1. The bytes of all pages, loading ones included, and what is [lent](Loan) never exceed the
//!    budget, nor those of a kind the budget of that kind.
//! 2. A page is never read by two reads at the same time, however many threads request it, and is
//!    checked before use.
//! 3. A lookup of a resident page takes one lock, that of its own slot, which is never held across
//!    a read, a wait or a search.
//!
//! `request` brings a page into memory, `eviction` and `reuse` choose the page to evict, `pool`
//! defines the locks and their order; `object` has the states of pages, `guard` what retains them,
//! `client` and `hints` who requests them; `loan` lends what they leave.

mod budget;
mod client;
mod entry;
mod eviction;
mod guard;
mod hints;
mod loan;
#[cfg(all(test, feature = "model"))]
mod models;
mod object;
mod own;
mod pool;
mod request;
mod reuse;
mod shared;
mod source;
mod stats;
#[cfg(all(test, not(feature = "model")))]
mod tests;

use std::sync::Arc;
use std::time::Duration;

pub use self::budget::Limits;
pub use self::client::PageClient;
pub use self::guard::PageGuard;
pub use self::loan::Loan;
pub use self::object::Object;
pub use self::reuse::Reuse;
use self::shared::Shared;
pub use self::source::{Kind, PageFault, PageSource};
use self::stats::Counters;
pub use self::stats::{KindStatistics, Statistics};
pub use crate::storage::local as read;
use crate::storage::transport::Transport;
pub use crate::storage::{OVERHEAD_BYTES, PageBuffer};
use rayset_base::cancel::CancelToken;
use rayset_base::sync::atomic::Ordering;
use rayset_base::sync::lock;

/// How long a thread waits for room, or for a page, while no page is loading: long enough for any
/// release to happen, short enough not to hang forever.
const PATIENCE: Duration = Duration::from_secs(10);

/// Pages in memory, shared by threads. Cheap to clone.
#[derive(Clone)]
pub struct WorkingSet {
    shared: Arc<Shared>,
}

impl WorkingSet {
    /// An empty set with a budget and a backend to read with.
    #[must_use]
    pub fn new(limits: Limits, backend: Arc<dyn Transport>) -> Self {
        Self::with_patience(limits, backend, PATIENCE)
    }

    fn with_patience(limits: Limits, backend: Arc<dyn Transport>, patience: Duration) -> Self {
        Self { shared: Arc::new(Shared::new(limits, backend, patience)) }
    }

    /// A new client, whose waits end when `cancel` is cancelled.
    #[must_use]
    pub fn client(&self, cancel: &CancelToken) -> PageClient {
        PageClient::new(self.shared.clone(), cancel.clone())
    }

    /// Adds an object, none of whose pages is resident. Pages of one object are cached once,
    /// whoever uses it. If its storage is in memory, its pages are used in place and do not count
    /// towards any budget.
    #[must_use]
    pub fn add(&self, source: Arc<dyn PageSource>) -> Arc<Object> {
        Arc::new(Object::new(source, self.shared.lock_waits.clone()))
    }

    /// Bytes that the set itself needs for an object of `pages` pages, outside the budget.
    #[must_use]
    pub fn overhead_bytes(pages: u32) -> u64 {
        u64::from(pages) * Object::BYTES_A_PAGE as u64
    }

    /// The budget for all pages.
    #[must_use]
    pub fn budget_bytes(&self) -> u64 {
        self.shared.pool.limits().all_kinds()
    }

    /// Changes the budget, also while other threads use the set; evicts what no longer fits and is
    /// not retained.
    pub fn set_limits(&self, limits: Limits) {
        let evicted = self.shared.pool.set_limits(limits);
        self.shared.count_evictions(&evicted);
    }

    /// Evicts all pages of an object that are not retained, because it will not be used again.
    /// Takes time proportional to the number of pages in memory.
    pub fn forget(&self, object: &Object) {
        let evicted = self.shared.pool.evict_object(object);
        self.shared.count_evictions(&evicted);
    }

    /// Statistics since the set was created, or since [`reset_statistics`](Self::reset_statistics).
    #[must_use]
    pub fn statistics(&self) -> Statistics {
        let hits = lock(&self.shared.hits);
        let pool = &self.shared.pool;
        let mut statistics = Statistics::collect(&self.shared.counters, pool.peaks(), pool.used());
        hits.iter().for_each(|hits| statistics.add_hits(hits));
        statistics
    }

    /// Bytes of the pages that are retained now. Looks at every page in memory.
    #[must_use]
    pub fn retained_bytes(&self) -> u64 {
        self.shared.pool.retained_bytes()
    }

    /// Sets all counters to zero; peaks start again from what is in memory now.
    pub fn reset_statistics(&self) {
        self.shared.counters.iter().for_each(Counters::reset);
        lock(&self.shared.hits).iter().for_each(|hits| hits.reset());
        self.shared.period.fetch_add(1, Ordering::Relaxed);
        self.shared.pool.reset_peaks();
    }

    /// How often a thread had to wait for a lock of the set, since it was created.
    #[cfg(feature = "internals")]
    #[must_use]
    pub fn lock_waits(&self) -> u64 {
        self.shared.lock_waits.load(Ordering::Relaxed)
    }

    /// Calls a function with each request for a page from now on, by whichever thread makes it, and
    /// no longer the one before.
    #[cfg(feature = "internals")]
    pub fn observe_requests(&self, observer: impl Fn(&Arc<Object>, u32) + Send + Sync + 'static) {
        let mut place = self.shared.observer.write().unwrap_or_else(std::sync::PoisonError::into_inner);
        *place = Some(Box::new(observer));
    }

    /// Evicts everything that is not retained.
    pub fn clear(&self) {
        let evicted = self.shared.pool.evict_all();
        self.shared.count_evictions(&evicted);
    }
}
