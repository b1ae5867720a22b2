//! Memory of the budget that is lent for what makes pages useful, as long as there is much of it:
//! it counts as pages do, so that the budget holds.

use std::sync::Arc;

use super::client::PageClient;
use super::shared::Shared;
use rayset_base::sync::atomic::{AtomicBool, Ordering};

/// Bytes that are lent. Dropping it gives them back.
pub struct Loan {
    shared: Arc<Shared>,
    bytes: u64,
    part: u64,
    due: Arc<AtomicBool>,
}

impl PageClient {
    /// Lends memory of the budget, if no more than one part in so many of it, not zero, is lent as
    /// such a part then, and if evicting pages that are not retained makes room.
    #[must_use]
    pub fn lend(&self, bytes: u64, part: u64) -> Option<Loan> {
        let (due, evicted) = self.shared.pool.lend(bytes, part);
        self.shared.count_evictions(&evicted);
        due.map(|due| Loan { shared: self.shared.clone(), bytes, part, due })
    }
}

impl Loan {
    /// How much it is.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Whether it is to be given back as soon as may be: the budget has become smaller, and counts
    /// it no more.
    #[must_use]
    pub fn is_due(&self) -> bool {
        self.due.load(Ordering::Relaxed)
    }
}

impl Drop for Loan {
    fn drop(&mut self) {
        self.shared.pool.take_back((self.bytes, self.part), &self.due);
    }
}
