//! The pages that clients have hinted, and how much of them has not been requested yet.

use std::collections::HashMap;
use std::sync::Arc;

use super::object::{Object, Slot};
use rayset_base::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use rayset_base::sync::{Mutex, lock};

/// Why a page is read ahead.
#[derive(Clone, Copy, Debug)]
pub(super) struct Hint {
    /// The era of its client in which it was hinted at.
    pub(super) era: u32,
    /// Whether the page is to stay until it is let go.
    pub(super) keep: bool,
}

/// The hints of one client.
#[derive(Default)]
pub(super) struct Hints {
    /// Bytes of pages that were read for a hint and have not been requested yet.
    pub(super) unused_bytes: AtomicU64,
    /// The current era: hints of earlier eras have been withdrawn.
    pub(super) era: AtomicU32,
    /// Hinted pages, including some that have been requested or evicted since.
    pages: Mutex<Hinted>,
}

#[derive(Default)]
struct Hinted {
    pages: Vec<(Arc<Object>, u32)>,
    /// How many were left when settled ones were last removed.
    unsettled: usize,
}

/// The clients of a working set, by number. Numbers begin at 1.
#[derive(Default)]
pub(super) struct Clients {
    last: u32,
    hints: HashMap<u32, Arc<Hints>>,
}

impl Hints {
    /// Records pages that a client has hinted.
    pub(super) fn note(&self, object: &Arc<Object>, pages: &[u32], client: u32) {
        if pages.is_empty() {
            return;
        }
        let mut hinted = lock(&self.pages);
        hinted.pages.extend(pages.iter().map(|&page| (object.clone(), page)));
        if hinted.pages.len() > 2 * hinted.unsettled + 256 {
            hinted.pages.retain(|(object, page)| match &*object.slot(*page) {
                Slot::Loading => true,
                Slot::Resident(resident) => resident.hint_mark().client() == Some(client),
                Slot::Absent | Slot::Failed(_) => false,
            });
            hinted.unsettled = hinted.pages.len();
        }
    }

    /// Ends an era; returns the pages that were hinted in it.
    pub(super) fn take_back(&self) -> Vec<(Arc<Object>, u32)> {
        self.era.fetch_add(1, Ordering::Relaxed);
        std::mem::take(&mut lock(&self.pages).pages)
    }
}

impl Clients {
    /// Registers a new client; returns its number.
    pub(super) fn enter(&mut self, hints: &Arc<Hints>) -> u32 {
        // Client numbers have 31 bits: the last bit of a word tells hints that were read from
        // others.
        self.last = self.last % (u32::MAX >> 1) + 1;
        self.hints.insert(self.last, hints.clone());
        self.last
    }

    /// Removes a client.
    pub(super) fn leave(&mut self, client: u32) {
        self.hints.remove(&client);
    }

    /// Number of clients.
    pub(super) fn len(&self) -> usize {
        self.hints.len()
    }

    /// The hints of one client.
    pub(super) fn hints_of(&self, client: u32) -> Option<&Arc<Hints>> {
        self.hints.get(&client)
    }
}
