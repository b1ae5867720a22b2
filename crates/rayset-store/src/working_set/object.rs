//! Objects and the states of their pages.
//!
//! The states of a page, all under the lock of its own slot:
//!
//! ```text
//!            miss, hint              read and checked, made
//!   Absent ─────────────▶ Loading ──────────────────────────▶ Resident
//!     ▲  ▲                 │   │                                 │
//!     │  └── no room, ─────┘   └─ damaged, unreadable,           │
//!     │      given up             maker panicked ──▶ Failed      │
//!     └──────────────────────────── evicted ─────────────────────┘
//! ```

use std::ops::Range;
use std::sync::Arc;
use std::time::Duration;

use super::source::{Kind, PageFault, PageSource};
use crate::storage::PageBuffer;
use crate::storage::transport::Transport;
use rayset_base::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use rayset_base::sync::{Mutex, MutexGuard, lock_counting};

/// A page in memory. It is retained as long as anything but its slot refers to it; references are
/// only added under the lock of the slot.
pub(super) struct Resident {
    pub(super) buffer: PageBuffer,
    /// Identifies this stay in memory, so that entries of an earlier stay can be told apart.
    pub(super) serial: u32,
    pub(super) last_use: AtomicU64,
    /// The client that requested it last.
    pub(super) user: AtomicU32,
    /// It is unlikely to be needed again: evicted first.
    pub(super) retired: AtomicBool,
    /// Rays that have been looked ahead at will come to it: evicted after all that are not kept.
    pub(super) kept: AtomicBool,
    /// Why it was loaded, or hinted at when it was there already, as long as nobody has been handed
    /// the page since: see [`HintMark`].
    pub(super) hint: AtomicU32,
}

/// The decoded value of [`Resident::hint`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum HintMark {
    None,
    /// Hinted by this client when it was resident already.
    Kept(u32),
    /// Read for a hint of this client.
    Read(u32),
    /// Read for a request that has not been served yet. Serving it is no second use: the page is as
    /// old as its entry in the eviction queue says.
    Requested,
}

impl HintMark {
    pub(super) fn word(self) -> u32 {
        match self {
            Self::None => 0,
            Self::Kept(client) => client << 1,
            Self::Read(client) => client << 1 | 1,
            Self::Requested => 1,
        }
    }

    pub(super) fn of(word: u32) -> Self {
        match (word >> 1, word & 1) {
            (0, 0) => Self::None,
            (0, _) => Self::Requested,
            (client, 0) => Self::Kept(client),
            (client, _) => Self::Read(client),
        }
    }

    pub(super) fn client(self) -> Option<u32> {
        match self {
            Self::None | Self::Requested => None,
            Self::Kept(client) | Self::Read(client) => Some(client),
        }
    }
}

impl Resident {
    /// When it was last used. Later than any use if it is kept, and the later the earlier it was
    /// used: rays come last to what was entered last.
    pub(super) fn age(&self) -> u64 {
        const LATER: u64 = u64::MAX - 1;
        let last_use = self.last_use.load(Ordering::Relaxed);
        if self.kept.load(Ordering::Relaxed) { LATER.saturating_sub(last_use) } else { last_use }
    }

    pub(super) fn hint_mark(&self) -> HintMark {
        HintMark::of(self.hint.load(Ordering::Relaxed))
    }
}

pub(super) enum Slot {
    Absent,
    Loading,
    Resident(Arc<Resident>),
    /// Boxed, because slots are many and faults are few.
    Failed(Box<PageFault>),
}

/// An object of a working set: its source and the state of each of its pages.
pub struct Object {
    pub(super) source: Arc<dyn PageSource>,
    /// Empty if the source has its pages in memory.
    slots: Vec<Mutex<Slot>>,
    /// For each page, the period of the statistics in which it was last read.
    touched: Vec<AtomicU32>,
    in_place: Option<InPlace>,
    /// What the storage brings to be read with; `None` if its pages are read as local files are.
    transport: Option<Arc<dyn Transport>>,
    /// The usual time of a read in nanoseconds, a moving average; 0 if nothing has been read.
    latency: AtomicU64,
    /// How often a thread had to wait for a lock of the working set.
    lock_waits: Arc<AtomicU64>,
}

/// Memory that contains pages.
type Memory = Arc<dyn AsRef<[u8]> + Send + Sync>;

/// A page that is used in place, in memory that holds it permanently.
pub(super) struct PageInPlace {
    memory: Memory,
    range: Range<usize>,
}

impl PageInPlace {
    pub(super) fn bytes(&self) -> &[u8] {
        // The range may have become invalid, if the memory has changed its length.
        (*self.memory).as_ref().get(self.range.clone()).unwrap_or(&[])
    }
}

/// Pages that lie in memory and are used in place.
struct InPlace {
    memory: Memory,
    /// Whether each page has been checked.
    checked: Vec<AtomicBool>,
}

impl std::fmt::Debug for Object {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Object").field("name", &self.source.name()).finish_non_exhaustive()
    }
}

impl Object {
    pub(super) fn new(source: Arc<dyn PageSource>, lock_waits: Arc<AtomicU64>) -> Self {
        let pages = source.pages() as usize;
        let storage = source.storage();
        let in_place = storage
            .memory()
            .map(|memory| InPlace { memory, checked: (0..pages).map(|_| AtomicBool::new(false)).collect() });
        let counted = if in_place.is_some() { 0 } else { pages };
        Self {
            source,
            slots: (0..counted).map(|_| Mutex::new(Slot::Absent)).collect(),
            touched: (0..counted).map(|_| AtomicU32::new(0)).collect(),
            in_place,
            transport: storage.transport(),
            latency: AtomicU64::new(0),
            lock_waits,
        }
    }

    /// What the storage brings to be read with; `None` if its pages are read as local files are.
    pub(super) fn transport(&self) -> Option<&dyn Transport> {
        self.transport.as_deref()
    }

    /// Whether its pages come from so far away that many should be under way at a time.
    pub fn is_remote(&self) -> bool {
        self.transport.as_ref().is_some_and(|transport| transport.is_remote())
    }

    /// The usual time from asking for a page until it is there; zero if nothing has been read.
    pub fn latency(&self) -> Duration {
        let measured = self.transport.as_ref().and_then(|transport| transport.latency());
        measured.unwrap_or_else(|| Duration::from_nanos(self.latency.load(Ordering::Relaxed)))
    }

    /// A read took so long. Of two that are counted at once one may be lost, which an average does
    /// not notice.
    pub(super) fn took(&self, time: Duration) {
        let time = u64::try_from(time.as_nanos()).unwrap_or(u64::MAX);
        let before = self.latency.load(Ordering::Relaxed);
        let average = if before == 0 { time } else { before - before / 8 + time / 8 };
        self.latency.store(average.max(1), Ordering::Relaxed);
    }

    /// The number of pages.
    pub fn pages(&self) -> u32 {
        self.source.pages()
    }

    /// Bytes that the set itself keeps for every page of an object, resident or not.
    pub(super) const BYTES_A_PAGE: usize = size_of::<Mutex<Slot>>() + size_of::<AtomicU32>();

    /// Bytes of its lists of pages.
    #[cfg(all(test, not(feature = "model")))]
    pub(super) fn bytes_kept(&self) -> usize {
        self.slots.capacity() * size_of::<Mutex<Slot>>() + self.touched.capacity() * size_of::<AtomicU32>()
    }

    pub(super) fn slot(&self, page: u32) -> MutexGuard<'_, Slot> {
        lock_counting(&self.slots[page as usize], &self.lock_waits)
    }

    /// Whether a page can be retained now without waiting.
    #[must_use]
    pub fn is_resident(&self, page: u32) -> bool {
        self.is_in_place() || matches!(&*self.slot(page), Slot::Resident(_))
    }

    /// Whether a page is neither resident nor being loaded.
    #[must_use]
    pub fn is_absent(&self, page: u32) -> bool {
        !self.is_in_place() && matches!(&*self.slot(page), Slot::Absent)
    }

    /// Whether a page is being loaded.
    pub fn is_under_way(&self, page: u32) -> bool {
        !self.is_in_place() && matches!(&*self.slot(page), Slot::Loading)
    }

    /// Whether a page is resident, or can never be.
    pub fn is_settled(&self, page: u32) -> bool {
        self.is_in_place() || matches!(&*self.slot(page), Slot::Resident(_) | Slot::Failed(_))
    }

    pub(super) fn kind(&self, page: u32) -> Kind {
        self.source.kind(page)
    }

    /// Bytes of each of its pages.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.source.page_bytes() as u64
    }

    /// Marks a page as read in a period of the statistics; true the first time.
    pub(super) fn touch(&self, page: u32, period: u32) -> bool {
        self.touched[page as usize].swap(period, Ordering::Relaxed) != period
    }

    /// Whether pages lie in memory permanently and need no working set.
    pub(super) fn is_in_place(&self) -> bool {
        self.in_place.is_some()
    }

    /// A page in place, checked the first time; `None` if pages have to be loaded.
    #[inline]
    pub(super) fn in_place(&self, page: u32) -> Option<Result<PageInPlace, PageFault>> {
        self.in_place.as_ref().map(|in_place| self.page_in_place(in_place, page))
    }

    #[inline(never)]
    fn page_in_place(&self, in_place: &InPlace, page: u32) -> Result<PageInPlace, PageFault> {
        let InPlace { memory, checked } = in_place;
        let start = self.source.offset(page);
        let range = usize::try_from(start).ok().map(|start| start..start + self.source.page_bytes());
        let found =
            range.and_then(|range| (**memory).as_ref().get(range.clone()).map(|bytes| (range, bytes)));
        let damaged =
            |what: String| PageFault::Damaged { name: self.source.name(), page, offset: start, what };
        let Some((range, bytes)) = found else {
            return Err(damaged("the memory ends before the end of the page".into()));
        };
        if !checked[page as usize].load(Ordering::Acquire) {
            if let Err(what) = self.source.check(page, bytes) {
                return Err(damaged(what));
            }
            checked[page as usize].store(true, Ordering::Release);
        }
        Ok(PageInPlace { memory: memory.clone(), range })
    }
}
