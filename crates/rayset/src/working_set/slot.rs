//! Objects, the states of their pages, and the guards that retain them.

use std::ops::Deref;
use std::sync::atomic::{AtomicU8, AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::Shared;
use super::buffer::PageBuffer;
use super::source::{Kind, PageFault, PageSource};

/// Number of an object in a working set.
pub type ObjectId = usize;

/// States of [`Resident::hint`].
pub(super) const NOT_HINTED: u8 = 0;
pub(super) const READ_FOR_HINT: u8 = 1;
pub(super) const KEPT_FOR_HINT: u8 = 2;

/// A page in memory.
pub(super) struct Resident {
    pub(super) object: Arc<Object>,
    pub(super) page: u32,
    pub(super) buffer: PageBuffer,
    /// Guards alive. Raised only under the lock of the slot.
    pub(super) retained: AtomicU32,
    pub(super) priority: AtomicU8,
    pub(super) last_use: AtomicU64,
    /// Whether a hint that nobody has used yet brought it in, or keeps it.
    pub(super) hint: AtomicU8,
}

pub(super) enum Slot {
    Absent,
    Loading,
    Resident(Arc<Resident>),
    Failed(PageFault),
}

/// An object of a working set: its source and the state of each of its pages.
pub struct Object {
    pub(super) id: ObjectId,
    pub(super) source: Arc<dyn PageSource>,
    pub(super) slots: Vec<Mutex<Slot>>,
    /// For each page, the period of the statistics in which it was last read.
    pub(super) touched: Vec<AtomicU32>,
}

impl std::fmt::Debug for Object {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Object")
            .field("id", &self.id)
            .field("name", &self.source.name())
            .finish_non_exhaustive()
    }
}

impl Object {
    /// Number of the object.
    #[must_use]
    pub fn id(&self) -> ObjectId {
        self.id
    }

    pub(super) fn slot(&self, page: u32) -> MutexGuard<'_, Slot> {
        lock(&self.slots[page as usize])
    }

    pub(super) fn kind(&self, page: u32) -> Kind {
        self.source.kind(page)
    }

    pub(crate) fn bytes(&self) -> u64 {
        self.source.page_bytes() as u64
    }

    /// Marks a page as read in a period of the statistics; true the first time.
    pub(super) fn touch(&self, page: u32, period: u32) -> bool {
        self.touched[page as usize].swap(period, Ordering::Relaxed) != period
    }
}

pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A retained page; its bytes stay in memory while the guard lives.
pub struct PageGuard {
    pub(super) resident: Arc<Resident>,
    pub(super) shared: Arc<Shared>,
    /// Whether the page's priority decays when this is released last.
    pub(super) decays: bool,
}

impl Deref for PageGuard {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        self.resident.buffer.bytes()
    }
}

impl Drop for PageGuard {
    fn drop(&mut self) {
        let resident = &self.resident;
        // Whoever releases last lets the priority decay; the page stays until its room is needed.
        let priority = resident.priority.load(Ordering::Relaxed);
        if resident.retained.fetch_sub(1, Ordering::Release) == 1 {
            if self.decays {
                resident.priority.store(decayed(priority), Ordering::Relaxed);
            }
            self.shared.ledger.released();
        }
    }
}

/// The priority that a page keeps after its release.
#[must_use]
pub fn decayed(priority: u8) -> u8 {
    priority / 2
}
