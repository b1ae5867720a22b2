//! The state that all clients of a working set share.

use std::sync::Arc;
use std::time::Duration;

use super::budget::Limits;
use super::eviction::Evicted;
use super::hints::Clients;
use super::object::{HintMark, Object, Resident, Slot};
use super::pool::PagePool;
use super::source::KINDS;
use super::stats::{Counters, Hits};
use crate::storage::transport::Transport;
use rayset_base::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use rayset_base::sync::{Mutex, lock};

/// The state that all clients share.
pub(super) struct Shared {
    pub(super) pool: PagePool,
    pub(super) backend: Arc<dyn Transport>,
    pub(super) clients: Mutex<Clients>,
    /// Number of the current period of the statistics; pages of period 0 were never read.
    pub(super) period: AtomicU32,
    pub(super) counters: [Counters; KINDS],
    /// Hits of the clients that there are.
    pub(super) hits: Mutex<Vec<Arc<Hits>>>,
    /// How often a thread had to wait for the lock of the pool or of a slot.
    pub(super) lock_waits: Arc<AtomicU64>,
    #[cfg(feature = "internals")]
    pub(super) observer: std::sync::RwLock<Option<Observer>>,
}

/// Is told of each request for a page.
#[cfg(feature = "internals")]
type Observer = Box<dyn Fn(&Arc<Object>, u32) + Send + Sync>;

impl Shared {
    pub(super) fn new(limits: Limits, backend: Arc<dyn Transport>, patience: Duration) -> Self {
        let lock_waits = Arc::new(AtomicU64::new(0));
        Self {
            pool: PagePool::new(limits, patience, lock_waits.clone()),
            backend,
            clients: Mutex::default(),
            period: AtomicU32::new(1),
            counters: Default::default(),
            hits: Mutex::default(),
            lock_waits,
            #[cfg(feature = "internals")]
            observer: Default::default(),
        }
    }

    /// Tells the observer of a request.
    #[cfg(feature = "internals")]
    pub(super) fn observe(&self, object: &Arc<Object>, page: u32) {
        let observer = self.observer.read().unwrap_or_else(std::sync::PoisonError::into_inner);
        if let Some(observer) = &*observer {
            observer(object, page);
        }
    }

    /// What the pages of an object are read with.
    pub(super) fn transport_of<'a>(&'a self, object: &'a Object) -> &'a dyn Transport {
        object.transport().unwrap_or(&*self.backend)
    }

    pub(super) fn counters_of(&self, object: &Object, page: u32) -> &Counters {
        &self.counters[object.kind(page).index()]
    }

    /// Whether a hint of an era of a client still holds.
    pub(super) fn is_hint_of(&self, client: u32, era: u32) -> bool {
        let clients = lock(&self.clients);
        clients.hints_of(client).is_some_and(|hints| hints.era.load(Ordering::Relaxed) == era)
    }

    /// Settles a hint: the page has been requested, or will not be. Returns whether it was read for
    /// the hint. The caller holds the lock of the page's slot, or has evicted the page.
    pub(super) fn settle_hint(&self, resident: &Resident, bytes: u64) -> bool {
        let mark = resident.hint_mark();
        if mark == HintMark::None {
            return false;
        }
        resident.hint.store(HintMark::None.word(), Ordering::Relaxed);
        let HintMark::Read(client) = mark else { return false };
        self.hint_was_used(client, bytes);
        true
    }

    /// A page that was read for a hint no longer counts as unused.
    pub(super) fn hint_was_used(&self, client: u32, bytes: u64) {
        if let Some(hints) = lock(&self.clients).hints_of(client) {
            hints.unused_bytes.fetch_sub(bytes, Ordering::Relaxed);
        }
    }

    /// Retires those of `pages` that are not retained and for which `wanted` holds.
    pub(super) fn retire_if(&self, object: &Arc<Object>, pages: &[u32], wanted: impl Fn(&Resident) -> bool) {
        if object.is_in_place() {
            return;
        }
        for &page in pages {
            let slot = object.slot(page);
            let serial = match &*slot {
                Slot::Resident(resident)
                    if Arc::strong_count(resident) == 1
                        && wanted(resident)
                        && !resident.retired.swap(true, Ordering::Relaxed) =>
                {
                    self.settle_hint(resident, object.bytes());
                    Some(resident.serial)
                }
                _ => None,
            };
            drop(slot);
            if let Some(serial) = serial {
                self.pool.retire(object, page, serial);
            }
        }
    }

    pub(super) fn count_evictions(&self, evicted: &[Evicted]) {
        for page in evicted {
            self.counters[page.kind.index()].evictions.fetch_add(1, Ordering::Relaxed);
            self.settle_hint(&page.resident, page.object.bytes());
        }
    }
}
