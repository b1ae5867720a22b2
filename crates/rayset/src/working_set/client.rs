//! One user of a working set, a render for instance: it retains pages, says which it will want and which it will not, and
//! has its share of the budget. What it says concerns its own pages alone.

use std::collections::HashMap;
use std::sync::Arc;

use super::Shared;
use super::eviction::Evicted;
use super::object::{HintMark, Object, PageGuard, Resident, Slot};
use crate::cancel::CancelToken;
use crate::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use crate::sync::{Mutex, lock};

/// A user of a working set. Dropping it takes back its hints: those of their pages that nobody has asked for are the first to
/// go, and so are those that are still on their way.
pub struct PageClient {
    pub(super) shared: Arc<Shared>,
    pub(super) number: u32,
    pub(super) cancel: CancelToken,
    hints: Arc<Hints>,
}

/// The hints of one client.
#[derive(Default)]
pub(super) struct Hints {
    /// Bytes of pages that were read for a hint and not yet asked for.
    unused_bytes: AtomicU64,
    /// Hints of earlier eras have been taken back.
    era: AtomicU32,
    /// Pages hinted at, and some that have been asked for or have gone since.
    pages: Mutex<Hinted>,
}

#[derive(Default)]
struct Hinted {
    pages: Vec<(Arc<Object>, u32)>,
    /// How many there were when those that are settled were last taken out.
    unsettled: usize,
}

/// The clients of a working set, by number. Numbers begin at 1.
#[derive(Default)]
pub(super) struct Clients {
    last: u32,
    hints: HashMap<u32, Arc<Hints>>,
}

impl PageClient {
    pub(super) fn new(shared: Arc<Shared>, cancel: CancelToken) -> Self {
        let hints = Arc::new(Hints::default());
        let mut clients = lock(&shared.clients);
        // Half of all words tell hints that were read from others.
        clients.last = clients.last % (u32::MAX >> 1) + 1;
        let number = clients.last;
        clients.hints.insert(number, hints.clone());
        drop(clients);
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
        let clients = lock(&self.shared.clients).hints.len().max(1);
        self.shared.pool.limits().all_kinds() / clients as u64
    }

    /// Whether a page can be had without waiting.
    #[must_use]
    pub fn is_resident(&self, object: &Object, page: u32) -> bool {
        object.is_in_place() || matches!(&*object.slot(page), Slot::Resident(_))
    }

    /// A page, if it is in memory now. Looking at it so does not count as its use.
    #[must_use]
    pub fn peek(&self, object: &Object, page: u32) -> Option<PageGuard> {
        if let Some(found) = object.in_place(page) {
            return found.ok();
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
}

impl PageClient {
    /// Takes back all hints so far: those of their pages that nobody has asked for are the first to go.
    pub fn forget_hints(&self) {
        self.hints.era.fetch_add(1, Ordering::Relaxed);
        let hinted = std::mem::take(&mut lock(&self.hints.pages).pages);
        for (object, page) in hinted {
            let unused = |resident: &Resident| resident.hint_mark().client() == Some(self.number);
            self.shared.retire_if(&object, &[page], unused);
        }
    }
}

impl Drop for PageClient {
    fn drop(&mut self) {
        lock(&self.shared.clients).hints.remove(&self.number);
        self.forget_hints();
    }
}

impl Hints {
    fn note(&self, object: &Arc<Object>, pages: &[u32], client: u32) {
        if pages.is_empty() {
            return;
        }
        let mut hinted = lock(&self.pages);
        hinted.pages.extend(pages.iter().map(|&page| (object.clone(), page)));
        if hinted.pages.len() > 2 * hinted.unsettled + 256 {
            hinted.pages.retain(|(object, page)| match &*object.slot(*page) {
                Slot::Loading => true,
                Slot::Resident(resident) => resident.hint_mark().client() == Some(client),
                Slot::Absent | Slot::Failed(_) => false,
            });
            hinted.unsettled = hinted.pages.len();
        }
    }
}

impl Shared {
    /// Whether a hint of an era of a client still holds.
    pub(super) fn is_hint_of(&self, client: u32, era: u32) -> bool {
        let clients = lock(&self.clients);
        clients.hints.get(&client).is_some_and(|hints| hints.era.load(Ordering::Relaxed) == era)
    }

    /// Settles a hint: the page was asked for, or will not be. True where it was read for the hint. The caller holds the
    /// lock of the page's slot, or has taken the page out.
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
        if let Some(hints) = lock(&self.clients).hints.get(&client) {
            hints.unused_bytes.fetch_sub(bytes, Ordering::Relaxed);
        }
    }

    fn retire_if(&self, object: &Arc<Object>, pages: &[u32], wanted: impl Fn(&Resident) -> bool) {
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
