//! One user of a working set, a render for instance: it retains pages, says which it will want and which it will not, and
//! has its share of the budget. What it says concerns its own pages alone.

use std::sync::Arc;

use super::guard::PageGuard;
use super::hints::Hints;
use super::object::{HintMark, Object, Resident, Slot};
use super::shared::Shared;
use crate::cancel::CancelToken;
use crate::sync::atomic::Ordering;
use crate::sync::lock;

/// A user of a working set. Dropping it takes back its hints: those of their pages that nobody has asked for are the first to
/// go, and so are those that are still on their way.
pub struct PageClient {
    pub(super) shared: Arc<Shared>,
    pub(super) number: u32,
    pub(super) cancel: CancelToken,
    hints: Arc<Hints>,
}

impl PageClient {
    pub(super) fn new(shared: Arc<Shared>, cancel: CancelToken) -> Self {
        let hints = Arc::new(Hints::default());
        let number = lock(&shared.clients).enter(&hints);
        Self { shared, number, cancel, hints }
    }

    /// Stops what this client waits for.
    #[must_use]
    pub fn cancel_token(&self) -> &CancelToken {
        &self.cancel
    }

    /// Bytes that this client can count on, for planning ahead: an equal share of the budget.
    #[must_use]
    pub fn share_bytes(&self) -> u64 {
        let clients = lock(&self.shared.clients).len().max(1);
        self.shared.pool.limits().all_kinds() / clients as u64
    }

    /// A page, if it is in memory now. Looking at it so does not count as its use.
    #[must_use]
    pub fn peek(&self, object: &Object, page: u32) -> Option<PageGuard> {
        if let Some(found) = object.in_place(page) {
            return found.ok().map(PageGuard::from);
        }
        let slot = object.slot(page);
        if let Slot::Resident(resident) = &*slot {
            Some(PageGuard::new(resident, &self.shared))
        } else {
            None
        }
    }

    /// Asks for pages that will be wanted soon. Those that are absent are read in one batch, as far as there is room
    /// without evicting a page that is retained, and as long as pages that were read for this client's hints and not yet
    /// asked for take no more than `most_bytes`. Those that are resident count as used now. Until somebody asks for them
    /// all wait like pages that were released: if they stayed longer than what is used meanwhile, hints that come to
    /// nothing would fill a small budget. Returns how many of `pages`, from the first, were dealt with.
    pub fn hint(&self, object: &Arc<Object>, pages: &[u32], most_bytes: u64) -> usize {
        if object.is_in_place() {
            return pages.len();
        }
        let era = self.hints.era.load(Ordering::Relaxed);
        let mut batch = Vec::new();
        let mut noted = Vec::new();
        let mut dealt_with = pages.len();
        for (at, &page) in pages.iter().enumerate() {
            let unused = self.hints.unused_bytes.load(Ordering::Relaxed);
            let mut slot = object.slot(page);
            match &*slot {
                Slot::Absent if unused.saturating_add(object.bytes()) > most_bytes => {
                    dealt_with = at;
                    break;
                }
                Slot::Absent => *slot = Slot::Loading,
                Slot::Resident(resident) => {
                    if self.keep(resident) {
                        noted.push(page);
                    }
                    continue;
                }
                Slot::Loading | Slot::Failed(_) => continue,
            }
            drop(slot);
            let kind = object.kind(page);
            let (room, evicted) = self.shared.pool.try_reserve(kind, object);
            self.shared.count_evictions(&evicted);
            match room {
                Some(buffer) => {
                    self.hints.unused_bytes.fetch_add(object.bytes(), Ordering::Relaxed);
                    self.shared.counters[kind.index()].hinted.fetch_add(1, Ordering::Relaxed);
                    batch.push(self.shared.read_of(object, page, buffer, self.number, Some(era)));
                    noted.push(page);
                }
                None => {
                    self.shared.give_up(object, page);
                    dealt_with = at;
                    break;
                }
            }
        }
        self.hints.note(object, &noted, self.number);
        if !batch.is_empty() {
            self.shared.backend.submit(batch);
        }
        dealt_with
    }

    /// A page that will be wanted is there already: it waits like those that are read for a hint. True where nobody else
    /// had hinted at it. The caller holds the lock of its slot.
    fn keep(&self, resident: &Arc<Resident>) -> bool {
        resident.last_use.store(self.shared.pool.tick(), Ordering::Relaxed);
        if Arc::strong_count(resident) > 1 {
            return false;
        }
        resident.retired.store(false, Ordering::Relaxed);
        let fresh = resident.hint_mark() == HintMark::None;
        if fresh {
            resident.hint.store(HintMark::Kept(self.number).word(), Ordering::Relaxed);
        }
        fresh
    }

    /// Says that this client will hardly want pages again: they are the first to go. Pages that are not resident, retained,
    /// or last used by somebody else are left as they are.
    pub fn retire(&self, object: &Arc<Object>, pages: &[u32]) {
        let mine = |resident: &Resident| {
            let user = resident.hint_mark().client().unwrap_or(resident.user.load(Ordering::Relaxed));
            user == self.number
        };
        self.shared.retire_if(object, pages, mine);
    }

    /// Says that hints have turned out wrong: those of `pages` that this client hinted at and nobody has asked for since
    /// are retired.
    pub fn retire_unused(&self, object: &Arc<Object>, pages: &[u32]) {
        self.shared.retire_if(object, pages, |resident| resident.hint_mark().client() == Some(self.number));
    }

    /// Takes back all hints so far: those of their pages that nobody has asked for are the first to go.
    pub fn forget_hints(&self) {
        for (object, page) in self.hints.take_back() {
            let unused = |resident: &Resident| resident.hint_mark().client() == Some(self.number);
            self.shared.retire_if(&object, &[page], unused);
        }
    }
}

impl Drop for PageClient {
    fn drop(&mut self) {
        lock(&self.shared.clients).leave(self.number);
        self.forget_hints();
    }
}
