//! Which page gives way: pages that are retired first, then the least recently used.
//!
//! Every page in memory has one entry in the heap of its kind, ordered by when it was used at the time of entering. A use
//! does not touch the heap: it only makes the page younger than its entry says. So the oldest entry is never younger than
//! the page that has waited longest, and an entry that turns out to be too old goes back with the right age. Each use pays
//! for one such return, so that an eviction costs O(log n) of n pages in memory, taken over all uses; and one that meets
//! many pages that were used since looks at no more than [`MOST_LOOKED_AT`] of them, and takes the oldest.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, VecDeque};
use std::sync::Arc;

use super::budget::Obstacle;
use super::buffer::PageBuffer;
use super::object::{Object, Resident, Slot};
use super::source::{KINDS, Kind};
use crate::sync::atomic::Ordering;

/// Pages found younger than their entries, of which an eviction takes the oldest rather than look further.
const MOST_LOOKED_AT: usize = 64;

/// A page in memory, and when it had been used when it was entered.
#[derive(Clone)]
struct Entry {
    last_use: u64,
    serial: u32,
    page: u32,
    object: Arc<Object>,
}

impl PartialEq for Entry {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}
impl Eq for Entry {}
impl PartialOrd for Entry {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}
impl Ord for Entry {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        (self.last_use, self.serial).cmp(&(other.last_use, other.serial))
    }
}

/// A page that went.
pub(super) struct Evicted {
    pub(super) object: Arc<Object>,
    pub(super) kind: Kind,
    pub(super) resident: Resident,
}

impl Evicted {
    /// Its memory, for the page that takes its room.
    pub(super) fn take_buffer(&mut self) -> PageBuffer {
        std::mem::replace(&mut self.resident.buffer, PageBuffer::new(0))
    }
}

/// What became of an attempt to evict a page.
enum Outcome {
    Evicted(Resident),
    /// It was used since it was entered, at this time.
    Younger(u64),
    Retained,
    /// The entry is of an earlier stay in memory.
    Stale,
}

impl Entry {
    /// Evicts the page unless it is retained, or was used since it was entered and `only_unused` says that this matters.
    fn evict(&self, only_unused: bool) -> Outcome {
        let mut slot = self.object.slot(self.page);
        let Slot::Resident(resident) = &*slot else { return Outcome::Stale };
        if resident.serial != self.serial {
            return Outcome::Stale;
        }
        let last_use = resident.last_use.load(Ordering::Relaxed);
        if only_unused && last_use > self.last_use {
            return Outcome::Younger(last_use);
        }
        let Slot::Resident(resident) = std::mem::replace(&mut *slot, Slot::Absent) else {
            return Outcome::Stale;
        };
        match Arc::try_unwrap(resident) {
            Ok(resident) => Outcome::Evicted(resident),
            Err(retained) => {
                *slot = Slot::Resident(retained);
                Outcome::Retained
            }
        }
    }

    /// Whether the page is still retired.
    fn is_retired(&self) -> bool {
        let slot = self.object.slot(self.page);
        matches!(&*slot, Slot::Resident(r) if r.serial == self.serial && r.retired.load(Ordering::Relaxed))
    }
}

/// The pages of one kind in memory.
#[derive(Default)]
struct Queue {
    /// Every page once, and some that have gone.
    by_age: BinaryHeap<Reverse<Entry>>,
    /// Those that were retired, in that order, and some that were used since or have gone.
    retired: VecDeque<Entry>,
    /// Pages in memory.
    resident: usize,
}

impl Queue {
    /// Entries of pages that have gone stay behind where these went by another way; they must not become many.
    fn drop_stale(&mut self) {
        if self.by_age.len() > 2 * self.resident + 64 {
            let is_current = |entry: &Entry| matches!(&*entry.object.slot(entry.page), Slot::Resident(r) if r.serial == entry.serial);
            self.by_age.retain(|Reverse(entry)| is_current(entry));
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
    /// A page is about to come into memory.
    pub(super) fn insert(&mut self, object: &Arc<Object>, page: u32, resident: &Resident) {
        let queue = &mut self.queues[object.kind(page).index()];
        // Before it is entered: its slot does not say yet that it is there.
        queue.drop_stale();
        let (last_use, serial) = (resident.last_use.load(Ordering::Relaxed), resident.serial);
        let entry = Entry { last_use, serial, page, object: object.clone() };
        if resident.retired.load(Ordering::Relaxed) {
            queue.retired.push_back(entry.clone());
        }
        queue.by_age.push(Reverse(entry));
        queue.resident += 1;
    }

    /// A page has been retired.
    pub(super) fn retire(&mut self, object: Arc<Object>, page: u32, serial: u32) {
        let queue = &mut self.queues[object.kind(page).index()];
        queue.retired.push_back(Entry { last_use: 0, serial, page, object });
        queue.drop_stale();
    }

    /// Evicts one page that stands in the way; `None` where all of them are retained.
    pub(super) fn evict(&mut self, obstacle: Obstacle, now: u64) -> Option<Evicted> {
        self.evict_retired(obstacle).or_else(|| self.evict_oldest(obstacle, now))
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

    fn evict_oldest(&mut self, obstacle: Obstacle, now: u64) -> Option<Evicted> {
        let mut retained: Vec<(Kind, Entry)> = Vec::new();
        let mut oldest_younger: Option<(Kind, Entry)> = None;
        let mut looked_at = 0;
        let mut found = None;
        while found.is_none()
            && let Some((kind, entry)) = self.pop_oldest(obstacle)
        {
            match entry.evict(true) {
                Outcome::Evicted(resident) => found = Some((kind, entry, resident)),
                Outcome::Younger(last_use) => {
                    let entry = Entry { last_use, ..entry };
                    if oldest_younger.as_ref().is_none_or(|(_, other)| entry < *other) {
                        oldest_younger = Some((kind, entry.clone()));
                    }
                    self.queues[kind.index()].by_age.push(Reverse(entry));
                    looked_at += 1;
                }
                Outcome::Retained => retained.push((kind, Entry { last_use: now, ..entry })),
                Outcome::Stale => {}
            }
            if looked_at >= MOST_LOOKED_AT
                && let Some((kind, entry)) = oldest_younger.take()
            {
                looked_at = 0;
                if let Outcome::Evicted(resident) = entry.evict(false) {
                    found = Some((kind, entry, resident));
                }
            }
        }
        for (kind, entry) in retained {
            self.queues[kind.index()].by_age.push(Reverse(entry));
        }
        found.map(|(kind, entry, resident)| {
            self.queues[kind.index()].resident -= 1;
            Evicted { object: entry.object, kind, resident }
        })
    }

    fn pop_oldest(&mut self, obstacle: Obstacle) -> Option<(Kind, Entry)> {
        let tops = obstacle
            .kinds()
            .filter_map(|kind| Some((self.queues[kind.index()].by_age.peek()?.0.last_use, kind)));
        let (_, kind) = tops.min_by_key(|&(last_use, _)| last_use)?;
        self.queues[kind.index()].by_age.pop().map(|Reverse(entry)| (kind, entry))
    }

    /// Evicts every page of an object that is not retained.
    pub(super) fn evict_object(&mut self, object: &Object) -> Vec<Evicted> {
        let mut evicted = Vec::new();
        for (kind, queue) in Kind::ALL.into_iter().zip(&mut self.queues) {
            let mut kept = Vec::with_capacity(queue.by_age.len());
            for Reverse(entry) in queue.by_age.drain() {
                if !std::ptr::eq(&raw const *entry.object, object) {
                    kept.push(Reverse(entry));
                    continue;
                }
                match entry.evict(false) {
                    Outcome::Evicted(resident) => {
                        queue.resident -= 1;
                        evicted.push(Evicted { object: entry.object, kind, resident });
                    }
                    Outcome::Retained => kept.push(Reverse(entry)),
                    Outcome::Younger(_) | Outcome::Stale => {}
                }
            }
            queue.by_age = kept.into();
            queue.retired.retain(Entry::is_retired);
        }
        evicted
    }

    /// Bytes of the pages that are retained: looks at them all.
    pub(super) fn retained_bytes(&self) -> u64 {
        let entries = self.queues.iter().flat_map(|queue| &queue.by_age).map(|Reverse(entry)| entry);
        let retained = entries.filter(|entry| {
            matches!(&*entry.object.slot(entry.page),
                Slot::Resident(r) if r.serial == entry.serial && Arc::strong_count(r) > 1)
        });
        retained.map(|entry| entry.object.bytes()).sum()
    }
}
