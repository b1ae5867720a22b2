//! Tiles that wait for their pages: how many may, how they do, and which there are.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use super::policy::Policy;

/// A tile that is deferred after so many attempts has less room than it needs.
const STUCK: u32 = 5;

/// How many tiles a thread may defer, and how it waits for them.
#[derive(Clone, Copy)]
pub(in crate::trace) struct Deferral {
    /// Most tiles that are deferred at a time.
    pub(in crate::trace) most: usize,
    pub(in crate::trace) policy: &'static dyn Policy,
    /// Whether any tile needs more room than there is beside the others: those that have been
    /// attempted most often come first.
    pub(in crate::trace) stuck: bool,
}

/// The tiles of a render that are deferred, of all its threads.
#[derive(Default)]
pub(super) struct DeferredTiles {
    places: Mutex<BTreeMap<u32, DeferredAt>>,
    /// Number of tiles that attempt after attempt has not finished.
    stuck: AtomicU32,
}

/// The tiles that are deferred at a place: those of several sample passes may be.
struct DeferredAt {
    tiles: u32,
    /// When the first of them was.
    since: Instant,
}

impl DeferredTiles {
    /// A tile is deferred after so many attempts.
    pub(super) fn add(&self, place: u32, attempts: u32, now: Instant) {
        if attempts == 1 {
            let mut places = self.places.lock().unwrap_or_else(PoisonError::into_inner);
            places.entry(place).or_insert(DeferredAt { tiles: 0, since: now }).tiles += 1;
        }
        if attempts == STUCK {
            self.stuck.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// A tile is finished with an attempt of this number.
    pub(super) fn remove(&self, place: u32, attempt: u32) {
        if attempt == 1 {
            return;
        }
        if attempt > STUCK {
            self.stuck.fetch_sub(1, Ordering::Relaxed);
        }
        let mut places = self.places.lock().unwrap_or_else(PoisonError::into_inner);
        if let Entry::Occupied(mut at) = places.entry(place) {
            at.get_mut().tiles -= 1;
            if at.get().tiles == 0 {
                at.remove();
            }
        }
    }

    /// The first place in the order of the picture whose tiles have not been deferred for longer
    /// than `patience`.
    pub(super) fn first_since(&self, now: Instant, patience: Duration) -> Option<u32> {
        let places = self.places.lock().unwrap_or_else(PoisonError::into_inner);
        let waits = |at: &DeferredAt| now.saturating_duration_since(at.since) <= patience;
        places.iter().find(|(_, at)| waits(at)).map(|(&place, _)| place)
    }

    /// Whether any tile has less room than it needs.
    pub(super) fn is_any_stuck(&self) -> bool {
        self.stuck.load(Ordering::Relaxed) > 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PATIENCE: Duration = Duration::from_millis(100);

    #[test]
    fn pages_are_kept_for_the_first_deferred_tile_as_long_as_patience_lasts() {
        let (tiles, begun) = (DeferredTiles::default(), Instant::now());
        let at = |milliseconds| begun + Duration::from_millis(milliseconds);
        assert_eq!(tiles.first_since(begun, PATIENCE), None);
        tiles.add(3, 1, at(0));
        tiles.add(7, 1, at(50));
        // Further attempts do not begin its time anew.
        tiles.add(3, 2, at(90));
        assert_eq!(tiles.first_since(at(100), PATIENCE), Some(3));
        assert_eq!(tiles.first_since(at(101), PATIENCE), Some(7));
        assert_eq!(tiles.first_since(at(151), PATIENCE), None);
    }

    #[test]
    fn a_place_is_free_when_the_last_of_its_tiles_is_finished() {
        let (tiles, now) = (DeferredTiles::default(), Instant::now());
        // Two sample passes of one place; a third is finished without having been deferred.
        tiles.add(3, 1, now);
        tiles.add(3, 1, now);
        tiles.remove(3, 1);
        tiles.remove(3, 2);
        assert_eq!(tiles.first_since(now, PATIENCE), Some(3));
        tiles.remove(3, 2);
        assert_eq!(tiles.first_since(now, PATIENCE), None);
    }

    #[test]
    fn a_tile_is_stuck_from_its_fifth_attempt_until_it_is_finished() {
        let (tiles, now) = (DeferredTiles::default(), Instant::now());
        for (place, attempts) in [(1, STUCK + 2), (2, STUCK), (3, STUCK - 1)] {
            (1..=attempts).for_each(|attempt| tiles.add(place, attempt, now));
            assert!(tiles.is_any_stuck());
        }
        tiles.remove(3, STUCK);
        tiles.remove(2, STUCK + 1);
        assert!(tiles.is_any_stuck());
        tiles.remove(1, STUCK + 3);
        assert!(!tiles.is_any_stuck());
    }
}
