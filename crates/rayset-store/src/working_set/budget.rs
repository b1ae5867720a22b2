//! Hard limits, and how much of them is in use.

use std::sync::Arc;

use super::source::{KINDS, Kind};
use rayset_base::sync::atomic::{AtomicBool, Ordering};

/// Hard limits in bytes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Limits {
    /// For all pages together.
    pub(super) total: u64,
    /// For each kind, in the order of [`Kind::ALL`].
    pub(super) by_kind: [u64; KINDS],
}

impl Limits {
    /// A limit for all pages together, and no limits by kind.
    #[must_use]
    pub fn total(bytes: u64) -> Self {
        Self { total: bytes, by_kind: [u64::MAX; KINDS] }
    }

    /// The limit for all pages together.
    pub(super) fn all_kinds(&self) -> u64 {
        self.total
    }

    /// Adds a limit for one kind.
    #[must_use]
    pub fn with_kind(mut self, kind: Kind, bytes: u64) -> Self {
        self.by_kind[kind.index()] = bytes;
        self
    }
}

/// The limit that another page would exceed, and so the pages that have to make room.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Obstacle {
    Total,
    Kind(Kind),
}

impl Obstacle {
    /// The kinds whose pages can make room.
    pub(super) fn kinds(self) -> impl Iterator<Item = Kind> {
        Kind::EACH.into_iter().filter(move |&kind| self == Self::Total || self == Self::Kind(kind))
    }
}

/// Bytes in use: every page counts from the moment its room is reserved.
#[derive(Debug)]
pub(super) struct Budget {
    pub(super) limits: Limits,
    used: u64,
    used_by_kind: [u64; KINDS],
    peak: u64,
    peak_by_kind: [u64; KINDS],
    /// Bytes that are lent as no more than one part in so many of the budget, for each such part.
    lent: Vec<(u64, u64)>,
    /// Whether what is lent now is wanted back.
    due: Arc<AtomicBool>,
}

impl Budget {
    pub(super) fn new(limits: Limits) -> Self {
        let (used_by_kind, peak_by_kind) = ([0; KINDS], [0; KINDS]);
        Self { limits, used: 0, used_by_kind, peak: 0, peak_by_kind, lent: Vec::new(), due: Arc::default() }
    }

    /// Sets new limits. If more is lent than these allow, all of it is wanted back, and counts no
    /// more.
    pub(super) fn set_limits(&mut self, limits: Limits) {
        self.limits = limits;
        if self.lent.iter().any(|&(part, lent)| lent > self.limits.total / part) {
            self.lent.clear();
            std::mem::take(&mut self.due).store(true, Ordering::Relaxed);
        }
    }

    /// Lends bytes, if they are no more than one part in so many of the budget with all that is
    /// lent as such a part already. Returns what says when they are due.
    pub(super) fn lend(&mut self, bytes: u64, part: u64) -> Option<Arc<AtomicBool>> {
        let at = self.lent.iter().position(|(known, _)| *known == part).unwrap_or_else(|| {
            self.lent.push((part, 0));
            self.lent.len() - 1
        });
        let lent = self.lent[at].1.checked_add(bytes).filter(|&lent| lent <= self.limits.total / part)?;
        self.lent[at].1 = lent;
        Some(self.due.clone())
    }

    fn all_lent(&self) -> u64 {
        self.lent.iter().map(|(_, lent)| lent).sum()
    }

    /// Takes back bytes that were lent.
    pub(super) fn take_back(&mut self, (bytes, part): (u64, u64), due: &Arc<AtomicBool>) {
        let of_part = self.lent.iter_mut().find(|(known, _)| *known == part);
        if let Some((_, lent)) = of_part.filter(|_| Arc::ptr_eq(due, &self.due)) {
            *lent -= bytes;
        }
    }

    /// The limit that `bytes` more bytes of a kind would exceed.
    pub(super) fn obstacle(&self, kind: Kind, bytes: u64) -> Option<Obstacle> {
        if self.used + self.all_lent() + bytes > self.limits.total {
            Some(Obstacle::Total)
        } else if self.used_by_kind[kind.index()] + bytes > self.limits.by_kind[kind.index()] {
            Some(Obstacle::Kind(kind))
        } else {
            None
        }
    }

    /// Whether the limits leave room for `bytes` bytes of a kind if nothing else is in memory.
    pub(super) fn could_hold(&self, kind: Kind, bytes: u64) -> bool {
        bytes <= (self.limits.total - self.all_lent()).min(self.limits.by_kind[kind.index()])
    }

    /// A limit that is exceeded now, because the limits have been lowered.
    pub(super) fn excess(&self) -> Option<Obstacle> {
        Kind::EACH.into_iter().find_map(|kind| self.obstacle(kind, 0))
    }

    pub(super) fn take(&mut self, kind: Kind, bytes: u64) {
        self.used += bytes;
        self.used_by_kind[kind.index()] += bytes;
        self.peak = self.peak.max(self.used);
        let peak = &mut self.peak_by_kind[kind.index()];
        *peak = (*peak).max(self.used_by_kind[kind.index()]);
    }

    pub(super) fn give_back(&mut self, kind: Kind, bytes: u64) {
        self.used -= bytes;
        self.used_by_kind[kind.index()] -= bytes;
    }

    pub(super) fn peaks(&self) -> (u64, [u64; KINDS]) {
        (self.peak, self.peak_by_kind)
    }

    /// Bytes in use, by kind.
    pub(super) fn used(&self) -> [u64; KINDS] {
        self.used_by_kind
    }

    pub(super) fn reset_peaks(&mut self) {
        (self.peak, self.peak_by_kind) = (self.used, self.used_by_kind);
    }
}
