//! Guards that retain pages.

use std::ops::Deref;
use std::sync::Arc;

use super::object::{PageInPlace, Resident};
use super::own::Own;
use rayset_base::sync::atomic::{Ordering, fence};

/// A retained page; its bytes stay in memory while the guard lives.
pub struct PageGuard(Held);

enum Held {
    // Fields are dropped in this order: threads that wait for room are notified when the page is
    // free.
    Resident(Arc<Resident>, #[expect(dead_code, reason = "it acts when it is dropped")] Release),
    InPlace(PageInPlace),
}

/// Notifies threads that wait for room that a page has been released.
struct Release(Arc<Own>);

impl PageGuard {
    /// The caller holds the lock of the page's slot.
    pub(super) fn new(resident: &Arc<Resident>, own: &Arc<Own>) -> Self {
        Self(Held::Resident(resident.clone(), Release(own.clone())))
    }
}

impl PageGuard {
    /// The page in the working set; `None` if it lies in memory anyway.
    pub(super) fn resident(&self) -> Option<&Resident> {
        match &self.0 {
            Held::Resident(resident, _) => Some(resident),
            Held::InPlace(_) => None,
        }
    }
}

impl From<PageInPlace> for PageGuard {
    fn from(page: PageInPlace) -> Self {
        Self(Held::InPlace(page))
    }
}

impl Deref for PageGuard {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        match &self.0 {
            Held::Resident(resident, _) => resident.buffer.bytes(),
            Held::InPlace(page) => page.bytes(),
        }
    }
}

impl Drop for Release {
    fn drop(&mut self) {
        // Either this thread sees the waiting one, or that one sees that the page is free: see
        // `PagePool::reserve`.
        fence(Ordering::SeqCst);
        self.0.shared.pool.released();
    }
}
