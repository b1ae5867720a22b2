//! The container format that cloud and grid files share: a header block with a directory of
//! sections, pages, and a footer.
//!
//! Every byte of a file is covered by a CRC-32C. The [`Identity`] of a file is part of the checksum
//! of each of its pages: if an open file is overwritten by another one, the pages of the new file
//! are not mistaken for its own. Unknown sections and optional features are ignored, and unknown
//! required features are an error that names them, so that later writers can extend the format
//! without a new version. `docs/format.md` describes the same tables in prose.

mod bytes;
mod file;
mod header;
mod identity;
mod page;
#[cfg(feature = "internals")]
mod reseal;
mod scattered;
mod write;

pub use self::file::{OpenError, OpenFile, ScanError};
pub use self::header::{
    BLOCK_BYTES, FileHeader, FileKind, Footer, HeaderError, MAX_PAGE_BYTES, MAX_SECTIONS, Section,
    SectionKind, VERSION,
};
pub use self::header::{BRICK_SHAPE, HARMONICS, SHAPE};
pub use self::identity::Identity;
pub use self::page::{PAGE_HEAD_BYTES, PageError, PageHead, PageKind, stored_page_checksum};
#[cfg(feature = "internals")]
pub use self::reseal::reseal;

pub use self::bytes::{Reader, Writer};
pub use self::identity::{RecordSum, StreamHash, record_hash};
pub use self::page::PAGE_CHECKSUM_AT;
pub use self::write::{Metadata, seal_file};

/// Size in bytes of the shortest cloud or grid file: a header and a footer.
pub const LEAST_FILE_BYTES: u64 = 2 * BLOCK_BYTES as u64;

/// CRC-32C of a block without the four bytes of its own checksum, continued from the CRC `seed`.
fn checksum_around(seed: u32, bytes: &[u8], checksum_at: usize) -> u32 {
    let head = crc32c::crc32c_append(seed, &bytes[..checksum_at]);
    crc32c::crc32c_append(head, &bytes[checksum_at + 4..])
}
