//! The head that every page starts with, and its checksum.

use super::checksum_around;
use super::identity::Identity;

/// Size of the head of a page in bytes.
pub const PAGE_HEAD_BYTES: usize = 32;
/// Where in the head its checksum is, which all other bytes of the page have.
pub const PAGE_CHECKSUM_AT: usize = 4;

/// The kind of a page.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum PageKind {
    /// Node records.
    Octree,
    /// Runs of points.
    Points,
    /// What stands for the points of cells.
    Aggregates,
    /// A brick of a grid.
    Voxels,
    /// Value ranges of bricks.
    Ranges,
}

impl PageKind {
    /// The number that denotes the kind in a page head.
    #[must_use]
    pub fn code(self) -> u32 {
        match self {
            Self::Octree => 0x4e4f_4445,
            Self::Points => 0x5054_5330,
            Self::Aggregates => 0x4147_4752,
            Self::Voxels => 0x564f_5845,
            Self::Ranges => 0x5241_4e47,
        }
    }
}

/// The head of a page.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PageHead {
    /// Kind of page.
    pub kind: PageKind,
    /// Number of the page, so that a page in the wrong place is detected.
    pub page: u32,
    /// Number of records (nodes, runs, bricks, ranges) in the page.
    pub records: u32,
    /// Bytes in use, including the head; the rest is zero.
    pub used_bytes: u32,
}

impl PageHead {
    /// Writes the head, with the checksum over the identity of the file and the whole page.
    ///
    /// Panics if the page is shorter than [`PAGE_HEAD_BYTES`].
    pub fn seal(&self, page: &mut [u8], identity: Identity) {
        let fields = [self.kind.code(), 0, self.page, self.records, self.used_bytes, 0, 0, 0];
        for (place, field) in page.chunks_exact_mut(4).zip(fields) {
            place.copy_from_slice(&field.to_le_bytes());
        }
        let checksum = checksum_around(identity.seed(), page, PAGE_CHECKSUM_AT);
        page[PAGE_CHECKSUM_AT..PAGE_CHECKSUM_AT + 4].copy_from_slice(&checksum.to_le_bytes());
    }

    /// Checks a page's checksum, kind, number and bytes in use, and returns its head.
    ///
    /// Panics if the page is shorter than [`PAGE_HEAD_BYTES`].
    ///
    /// # Errors
    /// [`PageError`], which says which of them is wrong.
    pub fn check(
        page_bytes: &[u8],
        kind: PageKind,
        page: u32,
        identity: Identity,
    ) -> Result<Self, PageError> {
        let found = stored_page_checksum(page_bytes);
        let expected = checksum_around(identity.seed(), page_bytes, PAGE_CHECKSUM_AT);
        if found != expected {
            return Err(PageError::Checksum { found, expected });
        }
        let field = |at: usize| {
            let b = &page_bytes[at..at + 4];
            u32::from_le_bytes([b[0], b[1], b[2], b[3]])
        };
        let (code, number, records, used_bytes) = (field(0), field(8), field(12), field(16));
        if code != kind.code() || number != page {
            return Err(PageError::Misplaced { number });
        }
        if (used_bytes as usize) < PAGE_HEAD_BYTES || used_bytes as usize > page_bytes.len() {
            return Err(PageError::Content { what: "more bytes in use than the page has" });
        }
        Ok(Self { kind, page, records, used_bytes })
    }
}

/// The checksum stored in a sealed page.
#[must_use]
pub fn stored_page_checksum(page: &[u8]) -> u32 {
    let b = &page[PAGE_CHECKSUM_AT..PAGE_CHECKSUM_AT + 4];
    u32::from_le_bytes([b[0], b[1], b[2], b[3]])
}

/// Why the bytes of a page cannot be used.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[non_exhaustive]
pub enum PageError {
    /// The checksum over the file's identity and the page differs.
    #[error(
        "checksum {found:08x} where {expected:08x} was expected; the page is damaged, or of another file that \
         was written over this one"
    )]
    Checksum {
        /// The stored checksum.
        found: u32,
        /// The computed checksum.
        expected: u32,
    },
    /// An undamaged page of this file, but of another kind or from another place.
    #[error("page {number} of another kind or place stands here")]
    Misplaced {
        /// The page number in its head.
        number: u32,
    },
    /// Inconsistent contents, although the checksum is right.
    #[error("{what}")]
    Content {
        /// What is wrong.
        what: &'static str,
    },
}
