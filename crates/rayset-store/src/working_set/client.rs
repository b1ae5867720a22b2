//! One user of a working set, such as a render: it retains pages, hints those that it will need,
//! retires those that it will not, and has its share of the budget. Its hints and retirements
//! affect only its own pages.

use std::cell::RefCell;
use std::sync::Arc;

use super::guard::PageGuard;
use super::hints::{Hint, Hints};
use super::object::{HintMark, Object, Resident, Slot};
use super::own::Own;
use super::reuse::Reuse;
use super::shared::Shared;
use rayset_base::cancel::CancelToken;
use rayset_base::sync::atomic::Ordering;
use rayset_base::sync::lock;

/// A user of a working set. Dropping it withdraws its hints: hinted pages that nobody has requested
/// are evicted first, including those that are still loading.
pub struct PageClient {
    pub(super) shared: Arc<Shared>,
    pub(super) own: Arc<Own>,
    pub(super) number: u32,
    pub(super) cancel: CancelToken,
    hints: Arc<Hints>,
    /// Whether this is only a part of a client, for one of its threads.
    is_part: bool,
}

impl PageClient {
    pub(super) fn new(shared: Arc<Shared>, cancel: CancelToken) -> Self {
        let hints = Arc::new(Hints::default());
        let number = lock(&shared.clients).enter(&hints);
        Self { own: Own::new(shared.clone()), shared, number, cancel, hints, is_part: false }
    }

    /// The same client, for the use of one of its threads: it has the same hints and the same share
    /// of the budget, but shares no counters with other threads.
    #[must_use]
    pub fn for_thread(&self) -> Self {
        Self {
            shared: self.shared.clone(),
            own: Own::new(self.shared.clone()),
            number: self.number,
            cancel: self.cancel.clone(),
            hints: self.hints.clone(),
            is_part: true,
        }
    }

    /// The token that cancels what this client waits for.
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

    /// Bytes of pages that were read for hints, or are being read for them, and have not been
    /// requested yet.
    #[must_use]
    pub fn hinted_bytes(&self) -> u64 {
        self.hints.unused_bytes.load(Ordering::Relaxed)
    }

    /// A page, if it is in memory now. This does not count as a use of the page.
    #[must_use]
    pub fn peek(&self, object: &Object, page: u32) -> Option<PageGuard> {
        if let Some(found) = object.in_place(page) {
            return found.ok().map(PageGuard::from);
        }
        let slot = object.slot(page);
        if let Slot::Resident(resident) = &*slot { Some(PageGuard::new(resident, &self.own)) } else { None }
    }

    /// Says that a round of requests begins that will be much like the last: a tile.
    pub fn begin_round(&self, reuse: &mut Reuse) {
        reuse.begin_round(self.own.now());
    }

    /// Says that a round is complete.
    pub fn end_round(&self, reuse: &mut Reuse) {
        reuse.end_round();
    }

    /// Says that the slab that begins with a sample of its rays is about to use one of the pages
    /// that it goes through in turn. Nothing is noted as long as no page has ever been evicted.
    pub fn come_to(&self, sample: u64, reuse: &mut Reuse) {
        if self.shared.pool.evicts() {
            reuse.come_to(sample, self.own.now());
        }
    }

    /// Says that the slab uses the page, `again` if the slabs after it will, too.
    pub fn used_in_turn(
        &self,
        object: &Arc<Object>,
        page: u32,
        guard: &PageGuard,
        again: bool,
        reuse: &mut Reuse,
    ) {
        if let Some(resident) = guard.resident().filter(|_| self.shared.pool.evicts()) {
            let last_use = resident.last_use.load(Ordering::Relaxed);
            reuse.used(object, page, (last_use, resident.serial), again);
        }
    }

    /// Hints pages that will be needed soon. Absent pages are read in one batch, as long as there
    /// is room without evicting a retained page, and as long as pages that were read for this
    /// client's hints and not yet requested take no more than `most_bytes`. Resident pages count as
    /// used now. Until they are requested, all of them can be evicted like released pages: if they
    /// stayed longer than what is used meanwhile, wrong hints would fill a small budget. Returns
    /// how many of `pages`, from the first, were handled.
    pub fn hint(&self, object: &Arc<Object>, pages: &[u32], most_bytes: u64) -> usize {
        self.hint_knowing(object, pages, most_bytes, None)
    }

    /// Hints pages as [`hint`](Self::hint) does; room is made by evicting what `reuse` says is
    /// needed last.
    pub fn hint_knowing(
        &self,
        object: &Arc<Object>,
        pages: &[u32],
        most_bytes: u64,
        reuse: Option<&RefCell<Reuse>>,
    ) -> usize {
        self.hint_all(object, pages, most_bytes, reuse, false)
    }

    /// Hints pages that are to stay until they are [let go](Self::let_go), however much else is
    /// used meanwhile: as long as there are others, these are not evicted.
    pub fn hint_to_stay(&self, object: &Arc<Object>, pages: &[u32], reuse: &RefCell<Reuse>) -> usize {
        self.hint_all(object, pages, u64::MAX, Some(reuse), true)
    }

    /// Waits until pages that are being read are there, as `ready` tells; not for ever, if none
    /// are, and not when the client is cancelled.
    pub fn wait_until(&self, ready: impl Fn() -> bool) {
        let shared = self.shared.clone();
        let _woken = self.cancel.register(Arc::new(move || shared.pool.notify()));
        // Why it has ended shows when a page is requested.
        let _ = self.shared.pool.wait_until(&self.cancel, || ready().then_some(()));
    }

    /// Lets a page go that was hinted at [to stay](Self::hint_to_stay). Returns whether it is still
    /// being read: then it is to be let go once more.
    pub fn let_go(&self, object: &Arc<Object>, page: u32) -> bool {
        if object.is_in_place() {
            return false;
        }
        match &*object.slot(page) {
            Slot::Resident(resident) => resident.kept.store(false, Ordering::Relaxed),
            Slot::Loading => return true,
            Slot::Absent | Slot::Failed(_) => {}
        }
        false
    }

    fn hint_all(
        &self,
        object: &Arc<Object>,
        pages: &[u32],
        most_bytes: u64,
        reuse: Option<&RefCell<Reuse>>,
        keep: bool,
    ) -> usize {
        if object.is_in_place() {
            return pages.len();
        }
        let hint = Hint { era: self.hints.era.load(Ordering::Relaxed), keep };
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
                    if keep {
                        resident.kept.store(true, Ordering::Relaxed);
                    }
                    if self.mark(resident) {
                        noted.push(page);
                    }
                    continue;
                }
                Slot::Loading | Slot::Failed(_) => continue,
            }
            drop(slot);
            let kind = object.kind(page);
            let (room, evicted) = self.shared.pool.try_reserve(kind, object, reuse);
            self.shared.count_evictions(&evicted);
            match room {
                Some(buffer) => {
                    self.hints.unused_bytes.fetch_add(object.bytes(), Ordering::Relaxed);
                    self.shared.counters[kind.index()].hinted.fetch_add(1, Ordering::Relaxed);
                    batch.push(self.shared.read_of(object, page, buffer, self.number, Some(hint)));
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
            self.shared.transport_of(object).submit(batch);
        }
        dealt_with
    }

    /// Keeps a hinted page that is resident already, like those that are read for a hint. Returns
    /// whether the hint was recorded: not if the page is retained or has been hinted before. The
    /// caller holds the lock of its slot.
    fn mark(&self, resident: &Arc<Resident>) -> bool {
        resident.last_use.store(self.own.time_of_use(), Ordering::Relaxed);
        if Arc::strong_count(resident) > 1 {
            return false;
        }
        resident.retired.store(false, Ordering::Relaxed);
        let fresh = matches!(resident.hint_mark(), HintMark::None | HintMark::Requested);
        if fresh {
            resident.hint.store(HintMark::Kept(self.number).word(), Ordering::Relaxed);
        }
        fresh
    }

    /// Retires pages that this client is unlikely to need again: they are evicted first. Pages that
    /// are absent, retained, or last used by another client are left as they are.
    pub fn retire(&self, object: &Arc<Object>, pages: &[u32]) {
        let mine = |resident: &Resident| {
            let user = resident.hint_mark().client().unwrap_or(resident.user.load(Ordering::Relaxed));
            user == self.number
        };
        self.shared.retire_if(object, pages, mine);
    }

    /// Withdraws hints that have turned out wrong: those of `pages` that this client hinted and
    /// nobody has requested since are retired.
    pub fn retire_unused(&self, object: &Arc<Object>, pages: &[u32]) {
        self.shared.retire_if(object, pages, |resident| resident.hint_mark().client() == Some(self.number));
    }

    /// Withdraws all hints so far: hinted pages that nobody has requested are evicted first.
    pub fn forget_hints(&self) {
        for (object, page) in self.hints.take_back() {
            let unused = |resident: &Resident| resident.hint_mark().client() == Some(self.number);
            self.shared.retire_if(&object, &[page], unused);
        }
    }
}

impl Drop for PageClient {
    fn drop(&mut self) {
        self.own.settle();
        if !self.is_part {
            lock(&self.shared.clients).leave(self.number);
            self.forget_hints();
        }
    }
}
