//! The sources of a working set's pages, and why a page may be unavailable.

use std::io;
use std::sync::Arc;

use crate::storage::Storage;

/// What a page holds; budgets and statistics are kept by kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Kind {
    /// Nodes of an octree.
    Octree,
    /// Points.
    Points,
    /// What stands for the points of cells.
    Aggregates,
    /// Bricks of a grid.
    Voxels,
    /// Light that reaches places; computed, not read.
    Shadows,
}

/// Number of kinds.
pub(super) const KINDS: usize = 5;

impl Kind {
    /// Every kind.
    pub const ALL: &[Self] = &Self::EACH;

    /// Every kind, as an array.
    pub(super) const EACH: [Self; KINDS] =
        [Self::Octree, Self::Points, Self::Voxels, Self::Shadows, Self::Aggregates];

    pub(super) fn index(self) -> usize {
        match self {
            Self::Octree => 0,
            Self::Points => 1,
            Self::Voxels => 2,
            Self::Shadows => 3,
            Self::Aggregates => 4,
        }
    }

    /// The name used in statistics.
    #[must_use]
    pub fn name(self) -> &'static str {
        ["octree", "points", "voxels", "shadows", "aggregates"][self.index()]
    }
}

/// A source of pages, such as a file.
pub trait PageSource: Send + Sync {
    /// Number of pages.
    fn pages(&self) -> u32;
    /// Bytes of every page.
    fn page_bytes(&self) -> usize;
    /// What a page holds.
    fn kind(&self, page: u32) -> Kind;
    /// Offset of a page in the storage, in bytes.
    fn offset(&self, page: u32) -> u64;
    /// What the pages are read from.
    fn storage(&self) -> Arc<dyn Storage>;
    /// Checks the bytes of a page that has just been read.
    ///
    /// # Errors
    /// What is wrong with the bytes, in words for the user.
    fn check(&self, page: u32, bytes: &[u8]) -> Result<(), String>;
    /// The name of the source in messages.
    fn name(&self) -> String;
}

/// Why a page could not be obtained.
#[derive(Clone, Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PageFault {
    /// The read failed.
    #[error("{name}, byte {offset}: cannot read page {page}: {source}")]
    Read {
        /// The source.
        name: String,
        /// The page.
        page: u32,
        /// Its place.
        offset: u64,
        /// The system's reason.
        r#source: Arc<io::Error>,
    },
    /// The page is damaged.
    #[error("{name}, byte {offset} (page {page}): {what}")]
    Damaged {
        /// The source.
        name: String,
        /// The page.
        page: u32,
        /// Its place.
        offset: u64,
        /// What is wrong.
        what: String,
    },
    /// The function that computes the page panicked.
    #[error("{name}: making page {page} panicked")]
    Panicked {
        /// The source.
        name: String,
        /// The page.
        page: u32,
    },
    /// The page is being computed by a thread that waits itself, and nothing that could end its
    /// wait is in progress.
    #[error("{name}: page {page} is being made by a thread that waits for others that wait for it")]
    Stuck {
        /// The source.
        name: String,
        /// The page.
        page: u32,
    },
    /// The client was cancelled while it waited for the page.
    #[error("cancelled")]
    Cancelled,
    /// Everything in the budget is retained.
    #[error("the budget of {budget} bytes is full of retained pages; at least {needed} bytes are needed")]
    Full {
        /// The budget.
        budget: u64,
        /// The smallest budget that would have sufficed at this moment.
        needed: u64,
    },
}
