//! A log of requests for pages: reads of a render are compared with those of rules of eviction that
//! know the future.

use std::collections::{BTreeSet, HashMap};
use std::hash::Hash;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use rayset::working_set::WorkingSet;

/// A request for a page.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Requested {
    /// The object: the address of its state, which is the same as long as it exists.
    pub object: usize,
    /// The page.
    pub page: u32,
}

/// The requests of all clients of a working set in the order in which they were made, while they
/// are recorded.
#[derive(Debug, Default)]
pub struct RequestLog {
    is_recording: AtomicBool,
    requests: Mutex<Vec<Requested>>,
}

impl RequestLog {
    /// The log of a working set, which has none yet.
    pub fn of(pages: &WorkingSet) -> Arc<Self> {
        let log = Arc::new(Self::default());
        let noting = log.clone();
        pages.observe_requests(move |object, page| {
            if noting.is_recording.load(Ordering::Relaxed) {
                noting.lock().push(Requested { object: Arc::as_ptr(object) as usize, page });
            }
        });
        log
    }

    fn lock(&self) -> MutexGuard<'_, Vec<Requested>> {
        self.requests.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Begins to record.
    pub fn begin(&self) {
        self.lock().clear();
        self.is_recording.store(true, Ordering::Relaxed);
    }

    /// Number of requests recorded so far.
    #[must_use]
    pub fn len(&self) -> usize {
        self.lock().len()
    }

    /// Whether none is recorded.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Ends recording, and returns what was recorded.
    #[must_use]
    pub fn end(&self) -> Vec<Requested> {
        self.is_recording.store(false, Ordering::Relaxed);
        std::mem::take(&mut self.lock())
    }
}

/// The fewest pages that any rule of eviction can read for some requests, if `fit` of them fit:
/// Belady's rule evicts the page whose next use is the farthest.
#[must_use]
pub fn least_reads<P: Copy + Ord + Hash>(requests: &[P], fit: usize) -> u64 {
    let mut next_use = vec![usize::MAX; requests.len()];
    let mut seen = HashMap::new();
    for (at, page) in requests.iter().enumerate().rev() {
        next_use[at] = seen.insert(page, at).unwrap_or(usize::MAX);
    }
    let mut resident: HashMap<P, usize> = HashMap::new();
    let mut by_next_use: BTreeSet<(usize, P)> = BTreeSet::new();
    let mut reads = 0;
    for (&page, &next) in requests.iter().zip(&next_use) {
        if let Some(now) = resident.insert(page, next) {
            by_next_use.remove(&(now, page));
        } else {
            reads += 1;
            if resident.len() > fit
                && let Some((_, farthest)) = by_next_use.pop_last()
            {
                resident.remove(&farthest);
            }
        }
        by_next_use.insert((next, page));
    }
    reads
}

#[cfg(test)]
mod tests {
    use super::least_reads;

    #[test]
    fn beladys_rule_keeps_all_but_one_of_the_pages_that_fit_from_scan_to_scan() {
        let scans: Vec<u32> = (0..10).flat_map(|_| 0..20).collect();
        // The first scan reads all pages; of each of the others, the 20 - 8 pages that do not fit
        // and none or one that gave way.
        let reads = least_reads(&scans, 8);
        assert!((20 + 9 * 12..=20 + 9 * 13).contains(&reads), "{reads} reads");
        assert_eq!(least_reads(&scans, 20), 20);
    }
}
