//! The first and the last block of a file: its kind, its identity, its features, and where its
//! sections are.

use super::bytes::{Reader, Writer};
use super::checksum_around;
use super::identity::Identity;

/// Version of the layout that this code writes, and the only one it reads.
pub const VERSION: u32 = 2;
/// Size of the header and of the footer in bytes; also the alignment of sections and pages.
pub const BLOCK_BYTES: usize = 4096;
/// Largest page size in bytes, so that run offsets fit their field.
pub const MAX_PAGE_BYTES: usize = 256 << 10;
/// Largest number of sections that the directory can hold.
pub const MAX_SECTIONS: usize = (BLOCK_BYTES - DIRECTORY_AT) / SECTION_BYTES;

const VERSION_AT: usize = 8;
pub(super) const CHECKSUM_AT: usize = VERSION_AT + 4;
const IDENTITY_AT: usize = CHECKSUM_AT + 4;
const REQUIRED_AT: usize = IDENTITY_AT + 16;
const OPTIONAL_AT: usize = REQUIRED_AT + 8;
const FILE_BYTES_AT: usize = OPTIONAL_AT + 8;
const PAGE_BYTES_AT: usize = FILE_BYTES_AT + 8;
const SECTION_COUNT_AT: usize = PAGE_BYTES_AT + 4;
pub(super) const DIRECTORY_AT: usize = SECTION_COUNT_AT + 4;
pub(super) const SECTION_BYTES: usize = 32;

/// The required feature of grids whose bricks are not cubes.
pub const BRICK_SHAPE: u64 = 1;

/// The required feature of clouds whose points have shapes.
pub const SHAPE: u64 = 1;
/// The feature, required of readers, of a cloud whose colours change with the direction, by
/// spherical harmonics.
pub const HARMONICS: u64 = 2;

/// What a file holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum FileKind {
    /// Points and their octree.
    Cloud,
    /// Voxels.
    Grid,
}

impl FileKind {
    /// The first eight bytes of every file of this kind.
    #[must_use]
    pub fn magic(self) -> [u8; 8] {
        match self {
            Self::Cloud => *b"RAYSET\r\n",
            Self::Grid => *b"RAYGRID\n",
        }
    }

    /// The kind whose magic number a file starts with, if any.
    #[must_use]
    pub fn of(start: &[u8]) -> Option<Self> {
        [Self::Cloud, Self::Grid].into_iter().find(|kind| start.starts_with(&kind.magic()))
    }

    /// What it is called in messages.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Cloud => "cloud",
            Self::Grid => "grid",
        }
    }
}

/// What a section holds, as a four-letter code.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct SectionKind(pub [u8; 4]);

impl SectionKind {
    /// The numeric header of a cloud.
    pub const CLOUD: Self = Self(*b"CLOU");
    /// Columns of a cloud.
    pub const COLUMNS: Self = Self(*b"COLS");
    /// The numeric header of a grid.
    pub const GRID: Self = Self(*b"GRID");
    /// The values of a grid where they are few and whole, as JSON.
    pub const LABELS: Self = Self(*b"LABL");
    /// Textual descriptions, as JSON.
    pub const META: Self = Self(*b"META");
    /// Pages of points.
    pub const POINTS: Self = Self(*b"PNTS");
    /// Pages of nodes.
    pub const NODES: Self = Self(*b"NODE");
    /// Pages of aggregates.
    pub const AGGREGATES: Self = Self(*b"AGGR");
    /// What a file says of its aggregates.
    pub const AGGREGATE_HEADER: Self = Self(*b"AGGH");
    /// Pages of bricks.
    pub const VOXELS: Self = Self(*b"VOXL");
    /// Pages of the value ranges of bricks.
    pub const RANGES: Self = Self(*b"RNGE");
}

/// An entry of the directory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Section {
    /// What it holds.
    pub kind: SectionKind,
    /// Number of pages; 0 for a section that does not consist of pages.
    pub pages: u32,
    /// Its offset in the file in bytes, a multiple of [`BLOCK_BYTES`].
    pub offset: u64,
    /// Its length in bytes; zeros follow up to the next block.
    pub bytes: u64,
    /// CRC-32C of its bytes; for a section of pages, of the checksums of the pages in order.
    pub checksum: u32,
}

impl Section {
    /// The end of the zero padding behind it; `None` on overflow.
    #[must_use]
    pub fn padded_end(&self) -> Option<u64> {
        self.offset.checked_add(self.bytes)?.checked_next_multiple_of(BLOCK_BYTES as u64)
    }
}

/// The contents of the first block of a file.
#[derive(Clone, Debug, PartialEq)]
pub struct FileHeader {
    /// What the file holds.
    pub kind: FileKind,
    /// Distinguishes the file from others.
    pub identity: Identity,
    /// Features that a reader must know to understand the file, one per bit.
    pub required_features: u64,
    /// Features that a reader may ignore, one per bit.
    pub optional_features: u64,
    /// Size of the whole file in bytes.
    pub file_bytes: u64,
    /// Size of every page in bytes, a multiple of [`BLOCK_BYTES`] up to [`MAX_PAGE_BYTES`].
    pub page_bytes: u32,
    /// Sections, in the order of their offsets.
    pub sections: Vec<Section>,
}

/// Why a header, a footer or a section is invalid.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[non_exhaustive]
pub enum HeaderError {
    /// The magic number is unknown.
    #[error(
        "byte 0: neither a cloud nor a grid of rayset; `rayset build` makes these from points and volumes"
    )]
    Magic,
    /// A file of the other kind.
    #[error("byte 0: a {} where a {} was expected", found.name(), expected.name())]
    OtherKind {
        /// What it is.
        found: FileKind,
        /// What was expected.
        expected: FileKind,
    },
    /// Another version of the layout.
    #[error(
        "byte {VERSION_AT}: format version {found}, this program reads version {VERSION}; build the file again"
    )]
    Version {
        /// The version found.
        found: u32,
    },
    /// A required feature that this version does not know.
    #[error(
        "byte {REQUIRED_AT}: the file needs the feature {name}, which this program does not know; use a newer one"
    )]
    Feature {
        /// The name that the file gives the feature, or its bit.
        name: String,
    },
    /// The checksum of a block or section differs.
    #[error("byte {at}: checksum {found:08x} where {expected:08x} was expected; the file is damaged")]
    Checksum {
        /// Offset of what was checked.
        at: u64,
        /// The stored checksum.
        found: u32,
        /// The computed checksum.
        expected: u32,
    },
    /// A field is out of range although the checksum of its block is right.
    #[error("byte {at}: {what}")]
    Field {
        /// Offset of the field.
        at: u64,
        /// What is wrong with it.
        what: &'static str,
    },
}

impl FileHeader {
    /// Encodes the header as a block.
    ///
    /// Panics if there are more than [`MAX_SECTIONS`] sections.
    #[must_use]
    pub fn encode(&self) -> [u8; BLOCK_BYTES] {
        let mut w = Writer::default();
        w.put(&self.kind.magic());
        w.u32(VERSION);
        w.u32(0);
        w.put(&self.identity.0);
        w.u64(self.required_features);
        w.u64(self.optional_features);
        w.u64(self.file_bytes);
        w.u32(self.page_bytes);
        w.u32(self.sections.len() as u32);
        for section in &self.sections {
            w.put(&section.kind.0);
            w.u32(section.pages);
            w.u64(section.offset);
            w.u64(section.bytes);
            w.u32(section.checksum);
            w.u32(0);
        }
        let mut block = [0; BLOCK_BYTES];
        block[..w.bytes.len()].copy_from_slice(&w.bytes);
        let checksum = checksum_around(0, &block, CHECKSUM_AT);
        block[CHECKSUM_AT..CHECKSUM_AT + 4].copy_from_slice(&checksum.to_le_bytes());
        block
    }

    /// Decodes and checks the header of a file of the given kind. Required features are checked by
    /// [`check_features`](Self::check_features), once the section with their names can be read.
    ///
    /// # Errors
    /// [`HeaderError`] if the block is not a header of this kind, is of another version, is
    /// damaged, or has a field out of range.
    pub fn decode(block: &[u8; BLOCK_BYTES], kind: FileKind) -> Result<Self, HeaderError> {
        match FileKind::of(block) {
            None => return Err(HeaderError::Magic),
            Some(found) if found != kind => return Err(HeaderError::OtherKind { found, expected: kind }),
            Some(_) => {}
        }
        let mut r = Reader { bytes: block, at: VERSION_AT };
        let short = HeaderError::Field { at: 0, what: "the block is too short" };
        let mut fields = || -> Option<Result<Self, HeaderError>> {
            let version = r.u32()?;
            if version != VERSION {
                return Some(Err(HeaderError::Version { found: version }));
            }
            let (found, expected) = (r.u32()?, checksum_around(0, block, CHECKSUM_AT));
            if found != expected {
                return Some(Err(HeaderError::Checksum { at: 0, found, expected }));
            }
            let mut header = Self {
                kind,
                identity: Identity(r.take()?),
                required_features: r.u64()?,
                optional_features: r.u64()?,
                file_bytes: r.u64()?,
                page_bytes: r.u32()?,
                sections: Vec::new(),
            };
            let count = r.u32()? as usize;
            if count > MAX_SECTIONS {
                let what = "more sections than the block holds";
                return Some(Err(HeaderError::Field { at: SECTION_COUNT_AT as u64, what }));
            }
            for _ in 0..count {
                let (kind, pages) = (SectionKind(r.take()?), r.u32()?);
                let (offset, bytes, checksum) = (r.u64()?, r.u64()?, r.u32()?);
                r.u32()?;
                header.sections.push(Section { kind, pages, offset, bytes, checksum });
            }
            Some(header.check_ranges().map(|()| header))
        };
        fields().unwrap_or(Err(short))
    }

    /// Checks that the sections follow each other without gaps from the header to the footer, so
    /// that every byte between the two belongs to a section.
    fn check_ranges(&self) -> Result<(), HeaderError> {
        let field = |at: usize, what| Err(HeaderError::Field { at: at as u64, what });
        let page_bytes = self.page_bytes as usize;
        if page_bytes == 0 || !page_bytes.is_multiple_of(BLOCK_BYTES) || page_bytes > MAX_PAGE_BYTES {
            return field(PAGE_BYTES_AT, "the page size is no multiple of 4096 up to 262144");
        }
        let mut end = BLOCK_BYTES as u64;
        for (index, section) in self.sections.iter().enumerate() {
            let at = DIRECTORY_AT + index * SECTION_BYTES;
            if section.offset != end {
                return field(at, "a section does not begin where the one before it ends");
            }
            if section.pages > 0 && section.bytes != u64::from(section.pages) * u64::from(self.page_bytes) {
                return field(at, "the length of a section does not follow from its number of pages");
            }
            if self.sections[..index].iter().any(|s| s.kind == section.kind) {
                return field(at, "two sections of one kind");
            }
            match section.padded_end() {
                Some(padded) if padded <= self.file_bytes => end = padded,
                _ => return field(at, "a section goes beyond the end of the file"),
            }
        }
        if end.checked_add(BLOCK_BYTES as u64) != Some(self.file_bytes) {
            return field(FILE_BYTES_AT, "the file length does not follow from the sections");
        }
        Ok(())
    }

    /// Checks that every required feature is known. `name` returns the name that the file gives to
    /// the feature of a bit.
    ///
    /// # Errors
    /// [`HeaderError::Feature`] for the first unknown feature.
    pub fn check_features(&self, name: impl Fn(u32) -> Option<String>) -> Result<(), HeaderError> {
        let known = if self.kind == FileKind::Grid { BRICK_SHAPE } else { SHAPE | HARMONICS };
        let unknown = self.required_features & !known;
        if unknown == 0 {
            return Ok(());
        }
        let bit = unknown.trailing_zeros();
        let name =
            name(bit).map_or_else(|| format!("number {bit}"), |name| format!("`{}`", name.escape_debug()));
        Err(HeaderError::Feature { name })
    }

    /// The section of the given kind, if the file has one.
    #[must_use]
    pub fn section(&self, kind: SectionKind) -> Option<&Section> {
        self.sections.iter().find(|s| s.kind == kind)
    }
}

/// The last block of a file, which shows that the file is complete.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Footer {
    /// The header's checksum, which ties the footer to the header.
    pub header_checksum: u32,
}

const FOOTER_MAGIC: [u8; 8] = *b"TESYAR\r\n";

impl Footer {
    /// The footer that belongs to an encoded header.
    #[must_use]
    pub fn of(header: &[u8; BLOCK_BYTES]) -> Self {
        let b = &header[CHECKSUM_AT..CHECKSUM_AT + 4];
        Self { header_checksum: u32::from_le_bytes([b[0], b[1], b[2], b[3]]) }
    }

    /// Encodes the footer as a block.
    #[must_use]
    pub fn encode(&self) -> [u8; BLOCK_BYTES] {
        let mut w = Writer::default();
        w.put(&FOOTER_MAGIC);
        w.u32(VERSION);
        w.u32(0);
        w.u32(self.header_checksum);
        let mut block = [0; BLOCK_BYTES];
        block[..w.bytes.len()].copy_from_slice(&w.bytes);
        let checksum = checksum_around(0, &block, CHECKSUM_AT);
        block[CHECKSUM_AT..CHECKSUM_AT + 4].copy_from_slice(&checksum.to_le_bytes());
        block
    }

    /// Checks that a block is the footer that belongs to `header`; `at` is its offset in the file,
    /// for messages.
    ///
    /// # Errors
    /// [`HeaderError`] if the block is damaged or belongs to another header.
    pub fn check(block: &[u8; BLOCK_BYTES], header: &[u8; BLOCK_BYTES], at: u64) -> Result<(), HeaderError> {
        if *block == Self::of(header).encode() {
            return Ok(());
        }
        let b = &block[CHECKSUM_AT..CHECKSUM_AT + 4];
        let found = u32::from_le_bytes([b[0], b[1], b[2], b[3]]);
        let expected = checksum_around(0, block, CHECKSUM_AT);
        if found == expected {
            Err(HeaderError::Field { at, what: "the footer does not belong to the header" })
        } else {
            Err(HeaderError::Checksum { at, found, expected })
        }
    }
}
