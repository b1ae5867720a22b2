//! When pages are used again, as far as the thread that uses them knows.
//!
//! A thread works in rounds: tiles. One round asks for much the same pages as the next, in the same
//! order, front to back. If they do not all fit, evicting the least recently used page is the worst
//! choice there is: it is the one that is needed next. What is needed last is the page that the
//! round has just passed. So, after retired pages, those go that the round before last has used and
//! the last one has not; then those that this round has passed, the latest first; and only then,
//! the oldest first, those that it still uses, unless it goes through them in turn, slab after
//! slab, when the latest goes first here, too.
//!
//! What is noted here serves eviction alone: it changes which pages are read again, and no picture.

use std::collections::VecDeque;
use std::sync::Arc;

use super::entry::Entry;
use super::object::Object;

/// Most pages that are remembered, the latest, as passed and as gone through in turn: they are
/// asked for from the latest on.
const MOST_REMEMBERED: usize = 1024;
/// Most places of a round that are remembered.
const MOST_MARKS: usize = 512;

/// What one thread knows about the order in which it uses pages.
#[derive(Default)]
pub struct Reuse {
    /// The last complete round, and this one.
    before: Vec<Mark>,
    marks: Vec<Mark>,
    /// How many places of the last round this one has reached.
    reached: usize,
    place: RoundPosition,
    /// Pages that this round and the last have passed, the latest last.
    passed: VecDeque<Used>,
    /// Pages that the current slab has gone through and that are used again, the latest last.
    in_turn: VecDeque<Used>,
    /// The objects that pages belong to.
    objects: Vec<Arc<Object>>,
    /// Whether the request being made is that of a slab that goes through its pages in turn.
    goes_in_turn: bool,
}

/// How far a round has come: the packet, counted from the beginning of the round, and the first
/// sample of its slab.
#[derive(Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord)]
struct RoundPosition {
    packet: u32,
    sample: u64,
}

/// When a round came to a place.
struct Mark {
    place: RoundPosition,
    time: u64,
}

/// A page that was used.
struct Used {
    last_use: u64,
    serial: u32,
    page: u32,
    /// Index in [`Reuse::objects`]: to count references would be one more thing that all threads
    /// write.
    object: usize,
}

impl Reuse {
    /// A round begins; `now` is the time of the last use of any page.
    pub(super) fn begin_round(&mut self, now: u64) {
        (self.reached, self.place, self.goes_in_turn) = (0, RoundPosition::default(), false);
        self.marks.clear();
        self.in_turn.clear();
        self.marks.push(Mark { place: self.place, time: now });
        let last_round = self.before.first().map_or(0, |mark| mark.time);
        while self.passed.front().is_some_and(|page| page.last_use < last_round) {
            self.passed.pop_front();
        }
        self.reach();
    }

    /// The round is complete; one that is not is forgotten when the next begins.
    pub(super) fn end_round(&mut self) {
        std::mem::swap(&mut self.before, &mut self.marks);
        self.reached = 1;
    }

    /// A slab is about to use a page in turn; `sample` is the slab's first. If it lies before that
    /// of the last slab, the slab belongs to another packet.
    pub(super) fn come_to(&mut self, sample: u64, now: u64) {
        self.goes_in_turn = true;
        if sample == self.place.sample {
            return;
        }
        self.in_turn.clear();
        self.place =
            RoundPosition { packet: self.place.packet + u32::from(sample < self.place.sample), sample };
        if self.marks.len() < MOST_MARKS {
            self.marks.push(Mark { place: self.place, time: now });
        }
        self.reach();
    }

    fn reach(&mut self) {
        let ahead = self.before.iter().skip(self.reached);
        self.reached += ahead.take_while(|mark| mark.place <= self.place).count();
    }

    /// The slab has used the page: it is used again by the slabs that follow, or has been passed.
    pub(super) fn used(
        &mut self,
        object: &Arc<Object>,
        page: u32,
        (last_use, serial): (u64, u32),
        again: bool,
    ) {
        self.goes_in_turn = false;
        let known = self.objects.iter().position(|other| Arc::ptr_eq(other, object));
        let object = known.unwrap_or_else(|| {
            self.objects.push(object.clone());
            self.objects.len() - 1
        });
        let page = Used { last_use, serial, page, object };
        let pages = if again { &mut self.in_turn } else { &mut self.passed };
        if pages.len() == MOST_REMEMBERED {
            pages.pop_front();
        }
        pages.push_back(page);
    }

    /// Pages that were last used before this time were passed by the round before last, or earlier.
    pub(super) fn stale_before(&self) -> u64 {
        let reached = self.reached.checked_sub(1).and_then(|at| self.before.get(at));
        reached.map_or(0, |mark| mark.time)
    }

    /// The page that is needed last of those known here; each is returned once.
    pub(super) fn needed_last(&mut self) -> Option<Entry> {
        let latest = self.passed.pop_back();
        let used = latest.or_else(|| if self.goes_in_turn { self.in_turn.pop_back() } else { None })?;
        let object = self.objects[used.object].clone();
        Some(Entry { last_use: used.last_use, serial: used.serial, page: used.page, object })
    }
}
