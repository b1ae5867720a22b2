//! Pages that have been found ahead, and which tiles want them. Tiles are told by their places in
//! the order of the render.

use std::collections::{BTreeSet, HashMap, HashSet, VecDeque};
use std::ops::Range;

use super::order::Edge;
use crate::trace::shadow::TileOfLight;

/// A page of one of the files.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) struct PageId {
    pub(super) file: u32,
    pub(super) page: u32,
}

/// The pages that the tiles of one square want.
pub(super) struct Looked {
    /// The tiles.
    pub(super) places: Range<u32>,
    /// The pages in the order in which rays are expected to reach them, each with the last place
    /// whose rays can meet it.
    pages: Vec<(PageId, u32)>,
    /// Where in `pages` each is.
    at: HashMap<PageId, usize>,
    /// Tiles of tables of shadows whose pages are among them.
    pub(super) tiles_of_lights: Vec<TileOfLight>,
}

impl Looked {
    pub(super) fn new(places: Range<u32>) -> Self {
        Self { places, pages: Vec::new(), at: HashMap::new(), tiles_of_lights: Vec::new() }
    }

    /// Records that the tiles want a page.
    pub(super) fn want(&mut self, page: PageId, use_by: u32) {
        let at = *self.at.entry(page).or_insert(self.pages.len());
        match self.pages.get_mut(at) {
            Some((_, until)) => *until = use_by.max(*until),
            None => self.pages.push((page, use_by)),
        }
    }
}

/// Pages found ahead.
#[derive(Default)]
pub(super) struct Found {
    /// Whether anything has been looked for yet.
    pub(super) begun: bool,
    /// The first place that has not been examined.
    pub(super) next: u32,
    /// The edge of the squares that are examined.
    pub(super) edge: Edge,
    /// What was found from `next` on, if there was no room for it.
    pub(super) put_off: Option<Looked>,
    /// Places before this one are passed.
    passed_to: u32,
    /// Pages that are wanted but not yet hinted at: the first place that wants the page, the page's
    /// rank in it, and the page.
    pub(super) waiting: BTreeSet<(u32, u32, PageId)>,
    /// Pages found ahead that some upcoming tile may need.
    pub(super) seen: HashMap<PageId, FoundPage>,
    /// Of these, the ones that a tile wants that is not yet passed.
    pub(super) wanted: u64,
    /// Node pages that stay until the picture is finished.
    pub(super) nodes_to_let_go: Vec<PageId>,
    /// Pages that were passed while they were being read, so that they could not be let go.
    pub(super) to_let_go: Vec<PageId>,
    /// Number of pages found so far, from which ranks are assigned.
    sights: u32,
    /// Pages that no tile known then had wanted before, when they were found.
    pub(super) fresh: u64,
    /// Pages of nodes and records that were hinted at for the next squares, each once.
    pub(super) nodes_hinted: HashSet<PageId>,
    /// Pages of records that stay until the picture is finished.
    pub(super) records_to_let_go: HashSet<PageId>,
    /// Pages that the square lacked that was looked at last.
    pub(super) lacking: Vec<PageId>,
    /// Some of them had gone before all were there.
    pub(super) nodes_do_not_fit: bool,
    /// Tiles of tables of shadows whose pages have been looked for.
    pub(super) tiles_of_lights: HashSet<TileOfLight>,
    /// The squares that have been examined but not yet traced: where each ends, and the number of
    /// pages it wants.
    pub(super) demands: VecDeque<(u32, u64)>,
}

/// A page that has been found ahead.
pub(super) struct FoundPage {
    /// Its key in `waiting`, if it is there.
    waits: Option<(u32, u32)>,
    /// The last place known to want it.
    wanted_by: u32,
    /// The last place whose rays can meet it.
    use_by: u32,
}

impl Found {
    /// Of the pages that a square wants, the number of those that no tile before it wants.
    pub(super) fn more_for(&self, looked: &Looked) -> u64 {
        looked.pages.iter().filter(|(page, _)| !self.is_wanted(*page)).count() as u64
    }

    fn is_wanted(&self, page: PageId) -> bool {
        self.seen.get(&page).is_some_and(|seen| seen.wanted_by >= self.passed_to)
    }

    /// Records what a square wants, which then has been examined.
    pub(super) fn take_in(&mut self, looked: Looked) {
        let Looked { places, pages, tiles_of_lights, .. } = looked;
        self.tiles_of_lights.extend(tiles_of_lights);
        self.nodes_hinted.clear();
        self.demands.push_back((places.end, pages.len() as u64));
        for (page, use_by) in pages {
            self.want(page, &places, use_by);
        }
        self.next = places.end;
    }

    /// The same, but at most so many pages that no tile before it wants: those that rays reach
    /// first.
    pub(super) fn take_in_at_most(&mut self, mut looked: Looked, more: u64) {
        let mut left = more;
        if self.more_for(&looked) > more {
            looked.tiles_of_lights.clear();
        }
        looked.pages.retain(|&(page, _)| {
            let is_wanted = self.is_wanted(page);
            let keep = is_wanted || left > 0;
            left -= u64::from(keep && !is_wanted);
            keep
        });
        self.take_in(looked);
    }

    /// Records that some tiles want a page.
    fn want(&mut self, page: PageId, places: &Range<u32>, use_by: u32) {
        let last = places.end.saturating_sub(1);
        self.sights += 1;
        let key = (places.start, self.sights);
        let seen = self.seen.entry(page).or_insert_with(|| {
            self.fresh += 1;
            self.wanted += 1;
            FoundPage { waits: None, wanted_by: last, use_by }
        });
        if seen.wanted_by < self.passed_to {
            self.wanted += 1;
        }
        seen.wanted_by = seen.wanted_by.max(last);
        seen.use_by = seen.use_by.max(use_by);
        match seen.waits {
            Some(earlier) if earlier.0 <= places.start => return,
            Some(later) => drop(self.waiting.remove(&(later.0, later.1, page))),
            None => {}
        }
        seen.waits = Some(key);
        self.waiting.insert((key.0, key.1, page));
    }

    /// The pages of places that are passed once rays are at one and none is before it: those that
    /// none of them used, perhaps, and those that no later one can need.
    pub(super) fn pass(&mut self, here: u32) -> Passed {
        let mut passed = Passed::default();
        if here <= self.passed_to {
            return passed;
        }
        let just_passed = self.passed_to..here;
        self.passed_to = here;
        let (waiting, wanted) = (&mut self.waiting, &mut self.wanted);
        self.seen.retain(|&page, seen| {
            if just_passed.contains(&seen.wanted_by) {
                *wanted = wanted.saturating_sub(1);
                passed.unused.push(page);
                if let Some((place, rank)) = seen.waits.take() {
                    waiting.remove(&(place, rank, page));
                }
            }
            let is_finished = seen.use_by.max(seen.wanted_by) < here;
            if is_finished {
                passed.finished.push(page);
            }
            !is_finished
        });
        passed
    }

    /// Removes the first waiting pages.
    pub(super) fn dealt_with(&mut self, count: usize) {
        for _ in 0..count {
            let Some((_, _, page)) = self.waiting.pop_first() else { return };
            if let Some(seen) = self.seen.get_mut(&page) {
                seen.waits = None;
            }
        }
    }
}

/// Pages that tiles have left behind.
#[derive(Default)]
pub(super) struct Passed {
    /// No tile that has been examined wants them any more.
    pub(super) unused: Vec<PageId>,
    /// No tile can meet them any more.
    pub(super) finished: Vec<PageId>,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn page(page: u32) -> PageId {
        PageId { file: 0, page }
    }

    fn looked(places: Range<u32>, pages: &[u32]) -> Looked {
        let end = places.end;
        let mut looked = Looked::new(places);
        pages.iter().for_each(|&number| looked.want(page(number), end));
        looked
    }

    #[test]
    fn pages_are_wanted_until_the_last_tile_that_wants_them_is_passed() {
        let mut found = Found::default();
        found.take_in(looked(0..4, &[1, 2, 3, 2]));
        assert_eq!((found.wanted, found.next), (3, 4));
        assert_eq!(found.more_for(&looked(4..8, &[2, 3, 4])), 1);
        found.take_in(looked(4..8, &[2, 3, 4]));
        assert_eq!((found.wanted, found.fresh), (4, 4));
        let passed = found.pass(4);
        assert_eq!((found.wanted, passed.unused), (3, vec![page(1)]));
        assert_eq!(found.more_for(&looked(8..9, &[1, 4])), 1);
        found.take_in(looked(8..9, &[1]));
        assert_eq!((found.wanted, found.fresh), (4, 4));
        found.pass(9);
        assert_eq!(found.wanted, 0);
    }

    #[test]
    fn of_a_square_for_which_there_is_no_room_the_pages_that_rays_reach_first_are_taken_in() {
        let mut found = Found::default();
        found.take_in(looked(0..1, &[7]));
        found.take_in_at_most(looked(1..2, &[9, 8, 7, 6]), 2);
        assert_eq!((found.wanted, found.next), (3, 2));
        let waiting: Vec<u32> = found.waiting.iter().map(|(_, _, page)| page.page).collect();
        assert_eq!(waiting, [7, 9, 8]);
    }
}
