//! Which page is evicted: retired pages first, then the least recently used, unless the thread that
//! asks knows which pages are needed last ([`Reuse`]). Pages that are computed age more slowly, for
//! it takes long to make them again.
//!
//! Every page in memory has an entry in the queue of its kind, with the time of its last use when
//! it was entered. A use does not touch the queue: it only makes the page younger than its entry
//! says. An eviction takes the front of the queue; a page that turns out to be younger goes to the
//! end, and so gets a second chance. Each use pays for at most one such return, so that an eviction
//! takes the same few steps whatever the number of pages, and passes over no more than
//! [`MOST_LOOKED_AT`] younger pages. If there are only [`FEW`] pages, all of them are searched for
//! the oldest.

use std::cmp::Reverse;
use std::collections::VecDeque;
use std::sync::Arc;

use super::budget::Obstacle;
use super::entry::{Entry, Outcome};
use super::object::{Object, Resident};
use super::reuse::Reuse;
use super::source::{KINDS, Kind};
use crate::storage::PageBuffer;
use rayset_base::sync::atomic::Ordering;

/// After this many pages that are younger than their entries, an eviction takes the oldest of them
/// instead of searching on.
const MOST_LOOKED_AT: usize = 64;
/// A page that is computed is as old as one that is read and has not been used for one part in so
/// many of the time: a tile of shadows takes 3 to 20 ms, a page from a local disk 0.1 ms.
const SLOWER: u64 = 128;
/// With at most this many pages, an eviction searches all of them.
const FEW: usize = 128;

/// An evicted page.
pub(super) struct Evicted {
    pub(super) object: Arc<Object>,
    pub(super) kind: Kind,
    pub(super) resident: Resident,
}

/// How old a page is that was last used at a time: of two, the one with the larger goes first.
type Age = (u64, Reverse<u64>);

/// Of pages that are equally old, among them all that stay, the one goes whose time is lower.
fn age(kind: Kind, last_use: u64, now: u64) -> Age {
    let unused = now.saturating_sub(last_use);
    (if kind == Kind::Shadows { unused / SLOWER } else { unused }, Reverse(last_use))
}

/// Whether a page is older than one that is read and was last used at a time.
fn is_older(age: Age, before: u64, now: u64) -> bool {
    before > now || age.0 > now - before
}

impl Evicted {
    /// Takes its memory, for the page that replaces it.
    pub(super) fn take_buffer(&mut self) -> PageBuffer {
        std::mem::replace(&mut self.resident.buffer, PageBuffer::new(0))
    }
}

/// The pages of one kind in memory.
#[derive(Default)]
struct Queue {
    /// Every page once, and some that have been evicted; roughly in the order of their uses.
    by_age: VecDeque<Entry>,
    /// Retired pages in the order of retirement, and some that have been used or evicted since.
    retired: VecDeque<Entry>,
    /// Pages in memory.
    resident: usize,
}

impl Queue {
    /// Removes entries of pages that were evicted by another way, before they become too many.
    fn drop_stale(&mut self) {
        if self.by_age.len() > 2 * self.resident + 64 {
            self.by_age.retain(|entry| entry.last_use_if_current().is_some());
        }
        if self.retired.len() > self.resident + 64 {
            self.retired.retain(Entry::is_retired);
        }
    }
}

/// All pages in memory, by kind.
#[derive(Default)]
pub(super) struct EvictionQueue {
    queues: [Queue; KINDS],
}

impl EvictionQueue {
    /// Enters a page that is about to become resident.
    pub(super) fn insert(&mut self, object: &Arc<Object>, page: u32, resident: &Resident) {
        let queue = &mut self.queues[object.kind(page).index()];
        // Before the page is entered: its slot is not resident yet, so that its entry would count
        // as stale.
        queue.drop_stale();
        let (last_use, serial) = (resident.last_use.load(Ordering::Relaxed), resident.serial);
        let entry = Entry { last_use, serial, page, object: object.clone() };
        if resident.retired.load(Ordering::Relaxed) {
            queue.retired.push_back(entry.clone());
        }
        queue.by_age.push_back(entry);
        queue.resident += 1;
    }

    /// Records that a page has been retired.
    pub(super) fn retire(&mut self, object: Arc<Object>, page: u32, serial: u32) {
        let queue = &mut self.queues[object.kind(page).index()];
        queue.retired.push_back(Entry { last_use: 0, serial, page, object });
        queue.drop_stale();
    }

    /// Evicts one page of the kinds that `obstacle` names; `None` if all of them are retained.
    /// `reuse` is what the thread that needs the room knows, if it knows anything.
    pub(super) fn evict(
        &mut self,
        obstacle: Obstacle,
        now: u64,
        reuse: Option<&mut Reuse>,
    ) -> Option<Evicted> {
        let retired = self.evict_retired(obstacle);
        if retired.is_some() {
            return retired;
        }
        let known = reuse.and_then(|reuse| {
            let stale = self.evict_oldest(obstacle, reuse.stale_before(), now);
            stale.or_else(|| self.evict_needed_last(obstacle, reuse))
        });
        known.or_else(|| self.evict_oldest(obstacle, u64::MAX, now))
    }

    fn evict_needed_last(&mut self, obstacle: Obstacle, reuse: &mut Reuse) -> Option<Evicted> {
        while let Some(entry) = reuse.needed_last() {
            let kind = entry.object.kind(entry.page);
            if obstacle.kinds().any(|other| other == kind)
                && let Outcome::Evicted(resident) = entry.evict(true)
            {
                self.queues[kind.index()].resident -= 1;
                return Some(Evicted { object: entry.object, kind, resident });
            }
        }
        None
    }

    fn evict_retired(&mut self, obstacle: Obstacle) -> Option<Evicted> {
        for kind in obstacle.kinds() {
            let queue = &mut self.queues[kind.index()];
            while let Some(entry) = queue.retired.pop_front() {
                if entry.is_retired()
                    && let Outcome::Evicted(resident) = entry.evict(false)
                {
                    queue.resident -= 1;
                    return Some(Evicted { object: entry.object, kind, resident });
                }
            }
        }
        None
    }

    /// Evicts the oldest page that was last used before a time.
    fn evict_oldest(&mut self, obstacle: Obstacle, before: u64, now: u64) -> Option<Evicted> {
        let pages: usize = obstacle.kinds().map(|kind| self.queues[kind.index()].by_age.len()).sum();
        let found = if pages <= FEW {
            self.take_oldest(obstacle, before, now)
        } else {
            self.take_in_turn(obstacle, before, pages, now)
        };
        found.map(|(kind, entry, resident)| {
            self.queues[kind.index()].resident -= 1;
            Evicted { object: entry.object, kind, resident }
        })
    }

    /// Searches all pages for the oldest that is not retained, and was last used before a time.
    fn take_oldest(&mut self, obstacle: Obstacle, before: u64, now: u64) -> Option<(Kind, Entry, Resident)> {
        loop {
            let mut oldest: Option<(Age, Kind, usize)> = None;
            for kind in obstacle.kinds() {
                let queue = &mut self.queues[kind.index()].by_age;
                queue.retain(|entry| entry.last_use_if_current().is_some());
                for (at, entry) in queue.iter().enumerate() {
                    let Some((last_use, false)) = entry.last_use_if_current() else { continue };
                    let age = age(kind, last_use, now);
                    if is_older(age, before, now) && oldest.is_none_or(|(oldest, ..)| age > oldest) {
                        oldest = Some((age, kind, at));
                    }
                }
            }
            let (_, kind, at) = oldest?;
            let entry = self.queues[kind.index()].by_age.remove(at)?;
            match entry.evict(false) {
                Outcome::Evicted(resident) => return Some((kind, entry, resident)),
                // Another thread has retained it in between.
                Outcome::Younger(_) | Outcome::Kept | Outcome::Retained => {
                    self.queues[kind.index()].by_age.push_back(entry);
                }
                Outcome::Stale => {}
            }
        }
    }

    /// Takes the first page, from the front of the queues, that has not been used since it was
    /// entered, and was last used before a time.
    fn take_in_turn(
        &mut self,
        obstacle: Obstacle,
        before: u64,
        pages: usize,
        now: u64,
    ) -> Option<(Kind, Entry, Resident)> {
        let mut oldest_younger: Option<(Kind, Entry)> = None;
        let mut last_kept: Option<(Kind, Entry)> = None;
        let mut looked_at = 0;
        // Every page once as entered, and once more after its second chance.
        for _ in 0..2 * pages {
            let (kind, entry) = self.pop_front(obstacle, before, now)?;
            let queue = &mut self.queues[kind.index()].by_age;
            match entry.evict(true) {
                Outcome::Evicted(resident) => return Some((kind, entry, resident)),
                Outcome::Younger(last_use) => {
                    let entry = Entry { last_use, ..entry };
                    let oldest = oldest_younger.as_ref().map(|(kind, other)| age(*kind, other.last_use, now));
                    let age = age(kind, last_use, now);
                    if is_older(age, before, now) && oldest.is_none_or(|oldest| age > oldest) {
                        oldest_younger = Some((kind, entry.clone()));
                    }
                    queue.push_back(entry);
                    looked_at += 1;
                }
                Outcome::Kept => {
                    let entry = Entry { last_use: now, ..entry };
                    last_kept = Some((kind, entry.clone()));
                    queue.push_back(entry);
                }
                Outcome::Retained => queue.push_back(Entry { last_use: now, ..entry }),
                Outcome::Stale => {}
            }
            if looked_at >= MOST_LOOKED_AT {
                let (kind, entry) = oldest_younger.take()?;
                looked_at = 0;
                if let Outcome::Evicted(resident) = entry.evict(false) {
                    return Some((kind, entry, resident));
                }
            }
        }
        // The page that was entered last is the one that rays come to last.
        let (kind, entry) = last_kept?;
        let Outcome::Evicted(resident) = entry.evict(false) else { return None };
        Some((kind, entry, resident))
    }

    /// The oldest of the first entries of the queues that were entered before a time.
    fn pop_front(&mut self, obstacle: Obstacle, before: u64, now: u64) -> Option<(Kind, Entry)> {
        let fronts = obstacle
            .kinds()
            .filter_map(|kind| Some((kind, self.queues[kind.index()].by_age.front()?.last_use)));
        let ages = fronts.map(|(kind, entered)| (age(kind, entered, now), kind));
        let (_, kind) = ages.filter(|&(age, _)| is_older(age, before, now)).max_by_key(|&(age, _)| age)?;
        self.queues[kind.index()].by_age.pop_front().map(|entry| (kind, entry))
    }

    /// Evicts every page of an object that is not retained.
    pub(super) fn evict_object(&mut self, object: &Object) -> Vec<Evicted> {
        let mut evicted = Vec::new();
        for (kind, queue) in Kind::EACH.into_iter().zip(&mut self.queues) {
            for entry in std::mem::take(&mut queue.by_age) {
                if !std::ptr::eq(&raw const *entry.object, object) {
                    queue.by_age.push_back(entry);
                    continue;
                }
                match entry.evict(false) {
                    Outcome::Evicted(resident) => {
                        queue.resident -= 1;
                        evicted.push(Evicted { object: entry.object, kind, resident });
                    }
                    Outcome::Retained => queue.by_age.push_back(entry),
                    Outcome::Younger(_) | Outcome::Kept | Outcome::Stale => {}
                }
            }
            queue.retired.retain(Entry::is_retired);
        }
        evicted
    }

    /// Number of entries in all queues, including those of pages that have been evicted.
    #[cfg(all(test, not(feature = "model")))]
    pub(super) fn entries(&self) -> usize {
        self.queues.iter().map(|queue| queue.by_age.len() + queue.retired.len()).sum()
    }

    /// Bytes of the pages that are retained; searches all pages.
    pub(super) fn retained_bytes(&self) -> u64 {
        let entries = self.queues.iter().flat_map(|queue| &queue.by_age);
        let retained = entries.filter(|entry| matches!(entry.last_use_if_current(), Some((_, true))));
        retained.map(|entry| entry.object.bytes()).sum()
    }
}
