//! How pages are brought in before rays need them: of local files, where a page takes microseconds
//! or a disk's few milliseconds, or of remote ones, where each read is a round trip. All that
//! differs is here. Neither policy changes a picture.

use std::ops::Range;
use std::sync::Arc;
use std::time::Duration;

use crate::trace::cloud::CloudPlacement;
use rayset_files::octree::node::Node;
use rayset_store::working_set::Object;

/// What is done about pages that are not there yet.
pub(in crate::trace) trait Policy: Send + Sync {
    /// How rays that are only probed are taken to end.
    fn expects(&self) -> Expects;

    /// Whether pages of a file are asked for many at a time, all along the rays: for each by itself
    /// would take a round trip.
    fn asks_together(&self, file: &Object) -> bool;

    /// The pages of a node's own points that are asked for.
    fn own_pages(&self, cloud: &CloudPlacement, node: &Node) -> Range<u32>;

    /// Whether pages that are asked for ahead stay until the rays that want them have passed: then
    /// it is known of every tile when it is put off and when it is finished.
    fn holds_pages(&self) -> bool;

    /// Whether rays ask for all that lies on their way at once: those that follow from others, the
    /// first of the next band, those to lights from what is met ahead.
    fn asks_along_rays(&self) -> bool;

    /// How far an attempt at a tile looks along its rays, as a factor on the optical depth with
    /// which they are expected to have ended, after so many others. `None` if it does not.
    fn reach(&self, attempts: u32) -> Option<f32>;

    /// How long what tiles that are put off want stays for them; `latency` says how long a page
    /// takes.
    fn patience(&self, latency: &dyn Fn() -> Duration) -> Duration;

    /// Whether what a square wanted stays while the next one is traced by one thread alone.
    fn stays_a_square_longer(&self) -> bool;

    /// Most tiles that a thread may put off, if so many pages are to spare for each thread.
    fn most_deferred(&self, spare_pages_each: u64) -> usize;

    /// Number of attempts at a tile without waiting.
    fn impatient_attempts(&self) -> u32;

    /// Whether a tile that was put off is attempted again, once the page that it lacked is there,
    /// without waiting for others.
    fn retries_without_waiting(&self) -> bool;
}

/// How rays that are only probed are taken to end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::trace) struct Expects {
    /// A safety factor on the optical depth: densities vary, and a page that is read in vain costs
    /// less than one that has to be waited for.
    pub(in crate::trace) margin: f32,
    /// Whether a ray goes on as far as its neighbours, and through what an operator may take away:
    /// a page that has to be waited for costs far more than some that are read in vain.
    pub(in crate::trace) careful: bool,
}

/// That of a graph's files, of which some may be remote.
pub(in crate::trace) fn of_files<'a>(
    mut files: impl Iterator<Item = &'a Arc<Object>>,
) -> &'static dyn Policy {
    if files.any(|file| file.is_remote()) { &Remote } else { &Local }
}

/// Pages come soon: what a tile lacks is read while others are traced, and little is asked for
/// ahead.
pub(in crate::trace) struct Local;

impl Policy for Local {
    fn expects(&self) -> Expects {
        Expects { margin: 1.2, careful: false }
    }

    fn asks_together(&self, _: &Object) -> bool {
        false
    }

    fn own_pages(&self, cloud: &CloudPlacement, node: &Node) -> Range<u32> {
        cloud.own_pages(node)
    }

    fn holds_pages(&self) -> bool {
        false
    }

    fn asks_along_rays(&self) -> bool {
        false
    }

    fn reach(&self, _: u32) -> Option<f32> {
        None
    }

    fn patience(&self, _: &dyn Fn() -> Duration) -> Duration {
        Duration::ZERO
    }

    fn stays_a_square_longer(&self) -> bool {
        true
    }

    fn most_deferred(&self, spare_pages_each: u64) -> usize {
        /// Enough to hide the latency of a slow disk.
        const MOST: u64 = 32;
        /// Pages that a tile may bring in before it is deferred again.
        const PAGES_EACH: u64 = 8;
        (spare_pages_each / PAGES_EACH).min(MOST) as usize
    }

    /// The next attempt waits for every page, so that even with a budget that keeps none of them
    /// between attempts the tile is finished.
    fn impatient_attempts(&self) -> u32 {
        6
    }

    fn retries_without_waiting(&self) -> bool {
        false
    }
}

/// A page is a round trip away: all that rays will need is asked for together, as early as there is
/// room, and stays until they have passed.
pub(in crate::trace) struct Remote;

impl Policy for Remote {
    fn expects(&self) -> Expects {
        Expects { margin: 1.5, careful: true }
    }

    fn asks_together(&self, file: &Object) -> bool {
        file.is_remote()
    }

    fn own_pages(&self, cloud: &CloudPlacement, node: &Node) -> Range<u32> {
        cloud.own_pages_at_most(node)
    }

    fn holds_pages(&self) -> bool {
        true
    }

    fn asks_along_rays(&self) -> bool {
        true
    }

    /// The first attempt finds out whether anything is missing at all. If what was expected did not
    /// suffice, rays go on farther than that; and if many attempts did not bring what is needed,
    /// there is no room for it.
    fn reach(&self, attempts: u32) -> Option<f32> {
        const LAST: u32 = 12;
        const MOST_DOUBLED: u32 = 6;
        let is_asked = (1..=LAST).contains(&attempts);
        is_asked.then(|| (1_u32 << (attempts - 1).min(MOST_DOUBLED)) as f32)
    }

    /// If pages were let go, a tile that is put off would have to bring them in again. Longer, all
    /// others would wait for the few pages that take far longer than usual.
    fn patience(&self, latency: &dyn Fn() -> Duration) -> Duration {
        const LATENCIES: u32 = 4;
        const LEAST: Duration = Duration::from_millis(20);
        (LATENCIES * latency()).max(LEAST)
    }

    fn stays_a_square_longer(&self) -> bool {
        false
    }

    /// Most pages come in time: more tiles would keep more pages from those that come after them.
    fn most_deferred(&self, _: u64) -> usize {
        16
    }

    /// Hundreds of tiles are traced in the time that one page takes, and an attempt that waits for
    /// page after page takes many times that.
    fn impatient_attempts(&self) -> u32 {
        48
    }

    fn retries_without_waiting(&self) -> bool {
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_attempt_at_remote_pages_asks_for_more_until_they_are_too_many() {
        let reach: Vec<_> = (0..14).map(|attempts| Remote.reach(attempts)).collect();
        assert_eq!(reach[..4], [None, Some(1.0), Some(2.0), Some(4.0)]);
        assert!(reach[1..=12].is_sorted() && reach[7..=12].iter().all(|&reach| reach == Some(64.0)));
        assert_eq!(reach[13], None);
        assert!((0..14).all(|attempts| Local.reach(attempts).is_none()));
    }

    #[test]
    fn little_room_lets_few_local_tiles_wait() {
        assert_eq!([0, 7, 8, 80, 8000].map(|spare| Local.most_deferred(spare)), [0, 0, 1, 10, 32]);
        assert_eq!([0, 8000].map(|spare| Remote.most_deferred(spare)), [16, 16]);
    }
}
