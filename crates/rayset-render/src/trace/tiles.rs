//! The order in which a thread processes its tiles: a tile that needs an absent page is deferred,
//! and traced again from its beginning when the page is resident.

use std::cell::{Cell, RefCell};
use std::collections::VecDeque;

use super::access::{Access, Foreseen, Lacking};
use super::predict::{Deferral, Predictor};
use super::work::TilePlace;
use rayset_store::working_set::{PageClient, Reuse};

/// An attempt at a tile, with its access to pages.
#[derive(Clone, Copy)]
pub(super) struct Attempt<'a> {
    pub(super) place: TilePlace,
    pub(super) access: Access<'a>,
    number: u32,
}

impl Attempt<'_> {
    /// 1 for the first at the tile.
    pub(super) fn number(&self) -> u32 {
        self.number
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
    threads: usize,
    asked_bytes: &'a Cell<u64>,
    reuse: &'a RefCell<Reuse>,
    foreseen: &'a Foreseen,
    /// The longest waiting first.
    deferred: VecDeque<Deferred>,
}

impl<'a> TileQueue<'a> {
    pub(super) fn new(
        (pages, predictor): (&'a PageClient, &'a dyn Predictor),
        threads: usize,
        asked_bytes: &'a Cell<u64>,
        reuse: &'a RefCell<Reuse>,
        foreseen: &'a Foreseen,
    ) -> Self {
        Self { pages, predictor, threads, asked_bytes, reuse, foreseen, deferred: VecDeque::new() }
    }

    /// A tile whose page has become resident, otherwise what `take` returns when told whether any
    /// tile is deferred, otherwise the tile deferred first, which then waits for its pages, or, of
    /// remote ones, for the one that it lacked. A tile from `take` also waits if none may be
    /// deferred.
    pub(super) fn next(
        &mut self,
        deferral: Deferral,
        take: impl FnOnce(bool) -> Option<Deferred>,
    ) -> Option<Attempt<'a>> {
        if let Some(deferred) = deferral.stuck.then(|| self.take_stuck()).flatten() {
            return Some(self.attempt_with_page(&deferred, deferral));
        }
        let ready = self.deferred.iter().position(Deferred::is_ready);
        if let Some(deferred) = ready.and_then(|at| self.deferred.remove(at)) {
            let waits = deferred.attempts >= deferral.policy.impatient_attempts();
            return Some(self.attempt(&deferred, waits, deferral));
        }
        if (self.deferred.is_empty() || self.deferred.len() < deferral.most)
            && let Some(deferred) = take(!self.deferred.is_empty())
        {
            let waits = self.predictor.slabs_on_a_miss() == 0
                || deferral.most == 0
                || deferred.attempts >= deferral.policy.impatient_attempts();
            return Some(self.attempt(&deferred, waits, deferral));
        }
        if deferral.policy.retries_without_waiting() {
            self.wait_for_any();
            if let Some(ready) = self.deferred.iter().position(Deferred::is_ready) {
                self.deferred.swap(0, ready);
            }
        }
        let deferred = self.deferred.pop_front()?;
        Some(self.attempt_with_page(&deferred, deferral))
    }

    /// An attempt at a tile once the page that it lacked is there, or, of near ones and after very
    /// many attempts, one that waits for all.
    fn attempt_with_page(&self, deferred: &Deferred, deferral: Deferral) -> Attempt<'a> {
        let Deferral { policy, .. } = deferral;
        let waits = !policy.retries_without_waiting() || deferred.attempts >= policy.impatient_attempts();
        if !waits && let Some(Lacking { object, page }) = &deferred.lacking {
            // If it cannot be had, the attempt will meet the same error.
            let _ = self.pages.retain(object, *page);
        }
        self.attempt(deferred, waits, deferral)
    }

    /// Takes out the tile that has been attempted most often: it has all the room until it is
    /// finished.
    fn take_stuck(&mut self) -> Option<Deferred> {
        let most = self.deferred.iter().map(|deferred| deferred.attempts).max()?;
        let at = self.deferred.iter().position(|deferred| deferred.attempts == most)?;
        self.deferred.remove(at)
    }

    /// Waits until the page of any deferred tile is there, if the first one's is under way.
    fn wait_for_any(&self) {
        let lacking = self.deferred.front().and_then(|deferred| deferred.lacking.as_ref());
        if lacking.is_some_and(|lacking| !lacking.object.is_absent(lacking.page)) {
            self.pages.wait_until(|| self.deferred.iter().any(Deferred::is_ready));
        }
    }

    pub(super) fn deferred(&mut self, attempt: &Attempt<'_>, lacking: Lacking) {
        // Tiles that were traced together are put off one by one: each needs fewer pages at a time.
        // They are neighbours, and would soon lack the same page.
        let (lacking, attempts) = (Some(lacking), attempt.number);
        let tiles = attempt.place.singly();
        self.deferred.extend(tiles.map(|place| Deferred { place, attempts, lacking: lacking.clone() }));
    }

    /// The deferred tiles that are left when the thread leaves the render.
    pub(super) fn into_deferred(self) -> VecDeque<Deferred> {
        self.deferred
    }

    fn attempt(&self, deferred: &Deferred, waits: bool, deferral: Deferral) -> Attempt<'a> {
        self.foreseen.begin(deferred.place.tile);
        let access = Access {
            pages: self.pages,
            waits,
            slabs_on_a_miss: self.predictor.slabs_on_a_miss(),
            follows_lines: self.predictor.follows_lines(),
            foresees: if waits { None } else { deferral.policy.reach(deferred.attempts) },
            foreseen: self.foreseen,
            threads: self.threads,
            asked_bytes: self.asked_bytes,
            sight: None,
            reuse: self.reuse,
        };
        Attempt { place: deferred.place, access, number: deferred.attempts + 1 }
    }
}

/// Tiles in a row, none of which was put off, after which more are traced together again.
const CALM_TILES: usize = 64;

/// How many tiles a thread traces together: soon as many as may be, but fewer where pages are
/// missing, for what is put off is traced again from its beginning.
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
    use super::super::predict::PacketPredictor;
    use super::*;
    use crate::trace::predict::policy;
    use rayset_base::CancelToken;
    use rayset_store::storage::local::Pool;
    use rayset_store::working_set::{Limits, WorkingSet};

    /// The places of the tiles that a queue attempts, of those deferred after some attempts and a
    /// fresh one, 9.
    fn attempted(attempts: &[(usize, u32)], stuck: bool) -> Vec<usize> {
        let set = WorkingSet::new(Limits::total(1 << 20), std::sync::Arc::new(Pool::new(1)));
        let (pages, predictor) = (set.client(&CancelToken::new()), PacketPredictor::default());
        let (asked_bytes, reuse, foreseen) = (Cell::new(0), RefCell::default(), Foreseen::default());
        let mut queue = TileQueue::new((&pages, &predictor), 1, &asked_bytes, &reuse, &foreseen);
        let place = |tile| TilePlace { tile, count: 1, pass: 0 };
        for &(tile, attempts) in attempts {
            queue.deferred.push_back(Deferred { place: place(tile), attempts, lacking: None });
        }
        let mut fresh = Some(Deferred::fresh(place(9)));
        let deferral = Deferral { most: 16, policy: &policy::Remote, stuck };
        std::iter::from_fn(|| queue.next(deferral, |_| fresh.take())).map(|next| next.place.tile).collect()
    }

    #[test]
    fn where_tiles_are_stuck_those_attempted_most_often_come_first() {
        assert_eq!(attempted(&[(1, 2), (2, 7), (3, 5), (4, 7)], true), [2, 4, 3, 1, 9]);
        assert_eq!(attempted(&[(1, 2), (2, 7), (3, 5), (4, 7)], false), [1, 2, 3, 4, 9]);
        assert_eq!(attempted(&[], true), [9]);
    }

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
