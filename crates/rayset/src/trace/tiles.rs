//! The order in which a thread processes its tiles: a tile that needs an absent page is deferred, and traced again from
//! its beginning when the page is resident.

use std::cell::{Cell, RefCell};
use std::collections::VecDeque;

use super::access::{Access, Lacking};
use super::predict::{Deferral, Predictor};
use super::work::TilePlace;
use crate::working_set::{PageClient, Reuse};

/// An attempt at a tile, with its access to pages.
#[derive(Clone, Copy)]
pub(super) struct Attempt<'a> {
    pub(super) place: TilePlace,
    pub(super) access: Access<'a>,
    number: u32,
}

impl Attempt<'_> {
    /// Whether the tile has been deferred before.
    pub(super) fn is_repeated(&self) -> bool {
        self.number > 1
    }
}

/// A tile that is still to be traced.
pub(super) struct Deferred {
    place: TilePlace,
    /// Attempts so far.
    attempts: u32,
    /// The page that the last attempt lacked.
    lacking: Option<Lacking>,
}

impl Deferred {
    /// A tile that has not been attempted.
    pub(super) fn fresh(place: TilePlace) -> Self {
        Self { place, attempts: 0, lacking: None }
    }

    /// Whether the page that it lacked is resident.
    fn is_ready(&self) -> bool {
        self.lacking.as_ref().is_none_or(|lacking| lacking.object.is_resident(lacking.page))
    }
}

/// The tiles that one thread works on: those that it takes, and those that it deferred.
pub(super) struct TileQueue<'a> {
    pages: &'a PageClient,
    predictor: &'a dyn Predictor,
    asked_bytes: &'a Cell<u64>,
    reuse: &'a RefCell<Reuse>,
    /// The longest waiting first.
    deferred: VecDeque<Deferred>,
}

impl<'a> TileQueue<'a> {
    pub(super) fn new(
        pages: &'a PageClient,
        predictor: &'a dyn Predictor,
        asked_bytes: &'a Cell<u64>,
        reuse: &'a RefCell<Reuse>,
    ) -> Self {
        Self { pages, predictor, asked_bytes, reuse, deferred: VecDeque::new() }
    }

    /// A tile whose page has become resident, otherwise what `take` returns when told whether any tile is deferred, otherwise the tile deferred first, which
    /// then waits for its pages, or, of far ones, for the one that it lacked. A tile from `take` also waits if none may be deferred.
    pub(super) fn next(
        &mut self,
        deferral: Deferral,
        take: impl FnOnce(bool) -> Option<Deferred>,
    ) -> Option<Attempt<'a>> {
        let ready = self.deferred.iter().position(Deferred::is_ready);
        if let Some(deferred) = ready.and_then(|at| self.deferred.remove(at)) {
            let waits = deferred.attempts >= deferral.impatient_attempts();
            return Some(self.attempt(&deferred, waits));
        }
        if (self.deferred.is_empty() || self.deferred.len() < deferral.most)
            && let Some(deferred) = take(!self.deferred.is_empty())
        {
            let waits = self.predictor.slabs_on_a_miss() == 0
                || deferral.most == 0
                || deferred.attempts >= deferral.impatient_attempts();
            return Some(self.attempt(&deferred, waits));
        }
        if deferral.far {
            self.wait_for_any();
            if let Some(ready) = self.deferred.iter().position(Deferred::is_ready) {
                self.deferred.swap(0, ready);
            }
        }
        let deferred = self.deferred.pop_front()?;
        let waits = !deferral.far || deferred.attempts >= deferral.impatient_attempts();
        if !waits && let Some(Lacking { object, page }) = &deferred.lacking {
            // If it cannot be had, the attempt will meet the same error.
            let _ = self.pages.retain(object, *page);
        }
        Some(self.attempt(&deferred, waits))
    }

    /// Waits until the page of any deferred tile is there, if the first one's is under way.
    fn wait_for_any(&self) {
        let lacking = self.deferred.front().and_then(|deferred| deferred.lacking.as_ref());
        if lacking.is_some_and(|lacking| !lacking.object.is_absent(lacking.page)) {
            self.pages.wait_until(|| self.deferred.iter().any(Deferred::is_ready));
        }
    }

    pub(super) fn deferred(&mut self, attempt: &Attempt<'_>, lacking: Lacking) {
        // Tiles that were traced together are put off one by one: each needs fewer pages at a time. They are neighbours, and
        // would soon lack the same page.
        let (lacking, attempts) = (Some(lacking), attempt.number);
        let tiles = attempt.place.singly();
        self.deferred.extend(tiles.map(|place| Deferred { place, attempts, lacking: lacking.clone() }));
    }

    /// The deferred tiles that are left when the thread leaves the render.
    pub(super) fn into_deferred(self) -> VecDeque<Deferred> {
        self.deferred
    }

    fn attempt(&self, deferred: &Deferred, waits: bool) -> Attempt<'a> {
        let access = Access {
            pages: self.pages,
            waits,
            slabs_on_a_miss: self.predictor.slabs_on_a_miss(),
            follows_lines: self.predictor.follows_lines(),
            asked_bytes: self.asked_bytes,
            reuse: self.reuse,
        };
        Attempt { place: deferred.place, access, number: deferred.attempts + 1 }
    }
}

/// Tiles in a row, none of which was put off, after which more are traced together again.
const CALM_TILES: usize = 64;

/// How many tiles a thread traces together: soon as many as may be, but fewer where pages are missing, for what is put off is
/// traced again from its beginning.
pub(super) struct Together {
    now: usize,
    /// The limit at present, and the limit of that.
    limit: usize,
    most: usize,
    /// Tiles that were finished since the limit was changed.
    calm: usize,
}

impl Together {
    /// At most `most` tiles, of which there is at least one.
    pub(super) fn new(most: usize) -> Self {
        Self { now: 1, limit: most, most, calm: 0 }
    }

    pub(super) fn tiles(&self) -> usize {
        self.now
    }

    pub(super) fn finished(&mut self, tiles: usize) {
        self.calm += tiles;
        if self.calm >= CALM_TILES {
            (self.limit, self.calm) = ((2 * self.limit).min(self.most), 0);
        }
        self.now = (2 * self.now).min(self.limit);
    }

    pub(super) fn put_off(&mut self) {
        (self.now, self.limit, self.calm) = (1, (self.limit / 2).max(1), 0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fewer_tiles_are_traced_together_where_pages_are_missing_and_more_again_where_not() {
        let mut together = Together::new(16);
        let mut taken = |finished: usize, put_off: usize| {
            (0..put_off).for_each(|_| together.put_off());
            (0..finished)
                .map(|_| (together.tiles(), together.finished(together.tiles())).0)
                .collect::<Vec<_>>()
        };
        assert_eq!(taken(6, 0), [1, 2, 4, 8, 16, 16]);
        assert_eq!(taken(5, 2), [1, 2, 4, 4, 4]);
        assert_eq!(taken(3, 9), [1, 1, 1]);
        // After 64 tiles twice as many, and so on.
        assert_eq!(taken(64, 0)[61..], [2, 2, 2]);
        let later = taken(200, 0);
        assert_eq!(later[199], 16, "{later:?}");
    }
}
