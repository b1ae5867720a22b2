//! Pages that have been found ahead, and which look-ahead tiles want them.

use std::collections::{BTreeSet, HashMap, HashSet, VecDeque};

/// A page of one of the files.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) struct PageId {
    pub(super) file: u32,
    pub(super) page: u32,
}

/// Pages found ahead. Look-ahead tiles are identified by their position in the order of the render.
#[derive(Default)]
pub(super) struct Found {
    /// Whether anything has been looked for yet.
    pub(super) begun: bool,
    /// Next look-ahead tile to examine.
    pub(super) next: u32,
    /// Look-ahead tile for which pages were last retired.
    pub(super) retired_at: u32,
    /// Pages that are wanted but not yet hinted at: the first look-ahead tile that wants the page, the page's rank in
    /// it, and the page.
    pub(super) waiting: BTreeSet<(u32, u32, PageId)>,
    /// Pages found ahead that some upcoming look-ahead tile may need.
    pub(super) seen: HashMap<PageId, Seen>,
    /// Of these, the ones that a look-ahead tile wants that is not yet passed.
    pub(super) wanted: u64,
    /// Node pages that stay until the picture is finished.
    pub(super) nodes_to_let_go: Vec<PageId>,
    /// Pages that were passed while they were being read, so that they could not be let go.
    pub(super) to_let_go: Vec<PageId>,
    /// Number of pages found so far, from which ranks are assigned.
    pub(super) sights: u32,
    /// Pages that no look-ahead tile known then had wanted before, when they were found.
    pub(super) fresh: u64,
    /// Node pages that were hinted at for the next look-ahead tile, each once.
    pub(super) nodes_hinted: HashSet<PageId>,
    /// Some of them had gone before all were there.
    pub(super) nodes_do_not_fit: bool,
    /// The look-ahead tiles that have been examined but not yet traced, each with the number of pages it wants.
    pub(super) demands: VecDeque<(u32, u64)>,
}

/// A page that has been found ahead.
pub(super) struct Seen {
    /// Its key in `waiting`, if it is there.
    pub(super) waits: Option<(u32, u32)>,
    /// The last look-ahead tile known to want it.
    pub(super) wanted_by: u32,
    /// The last look-ahead tile whose rays can meet it.
    pub(super) use_by: u32,
}

impl Found {
    /// Records that a look-ahead tile wants a page.
    pub(super) fn want(&mut self, page: PageId, lookahead_tile: u32, use_by: u32) {
        self.sights += 1;
        let key = (lookahead_tile, self.sights);
        let seen = self.seen.entry(page).or_insert_with(|| {
            self.fresh += 1;
            self.wanted += 1;
            Seen { waits: None, wanted_by: lookahead_tile, use_by }
        });
        if seen.wanted_by + 1 < self.retired_at {
            self.wanted += 1;
        }
        seen.wanted_by = seen.wanted_by.max(lookahead_tile);
        seen.use_by = seen.use_by.max(use_by);
        match seen.waits {
            Some(earlier) if earlier.0 <= lookahead_tile => return,
            Some(later) => drop(self.waiting.remove(&(later.0, later.1, page))),
            None => {}
        }
        seen.waits = Some(key);
        self.waiting.insert((key.0, key.1, page));
    }

    /// The pages of look-ahead tiles that are passed once rays are at one, without those of the tile before it, where other threads
    /// may still be: those that none of them used, perhaps, and those that no later one can need.
    pub(super) fn pass(&mut self, here: u32) -> Passed {
        let mut passed = Passed::default();
        if here <= self.retired_at {
            return passed;
        }
        let (from, until) = (self.retired_at.saturating_sub(1), here - 1);
        self.retired_at = here;
        let (waiting, wanted) = (&mut self.waiting, &mut self.wanted);
        self.seen.retain(|&page, seen| {
            if (from..until).contains(&seen.wanted_by) {
                *wanted = wanted.saturating_sub(1);
                passed.unused.push(page);
                if let Some((lookahead_tile, order)) = seen.waits.take() {
                    waiting.remove(&(lookahead_tile, order, page));
                }
            }
            let is_finished = seen.use_by.max(seen.wanted_by) < until;
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

/// Pages that look-ahead tiles have left behind.
#[derive(Default)]
pub(super) struct Passed {
    /// No look-ahead tile that has been examined wants them any more.
    pub(super) unused: Vec<PageId>,
    /// No look-ahead tile can meet them any more.
    pub(super) finished: Vec<PageId>,
}
