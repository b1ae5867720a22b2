//! The first 4096 bytes of a cloud file, its footer, and the head that every page shares.
//!
//! Offsets are named constants built by addition; `docs/format.md` shows the same table in prose. All numbers are
//! little-endian.

use crate::geometry::{Aabb, DVec3};

/// First eight bytes of every file.
pub const MAGIC: [u8; 8] = *b"RAYSET\r\n";
/// Version of the layout that this code writes, and the only one it reads.
pub const VERSION: u32 = 1;
/// Bytes of the header and of the footer; also the alignment of every page.
pub const BLOCK_BYTES: usize = 4096;
/// Largest number of attribute columns.
pub const MAX_ATTRIBUTES: usize = 32;
/// Bytes of an attribute's name in the header, padded with zeros.
pub const NAME_BYTES: usize = 32;
/// Bytes of the head of a page.
pub const PAGE_HEAD_BYTES: usize = 32;

/// Whether all points share a value or each has its own.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Column {
    /// The value of every point.
    Constant(f32),
    /// Each point has its own, within these bounds.
    Varying {
        /// Smallest value.
        min: f32,
        /// Largest value.
        max: f32,
    },
}

impl Column {
    /// Smallest value.
    #[must_use]
    pub fn min(self) -> f32 {
        match self {
            Self::Constant(v) => v,
            Self::Varying { min, .. } => min,
        }
    }

    /// Largest value.
    #[must_use]
    pub fn max(self) -> f32 {
        match self {
            Self::Constant(v) => v,
            Self::Varying { max, .. } => max,
        }
    }

    /// Whether each point stores its own value.
    #[must_use]
    pub fn is_stored(self) -> bool {
        matches!(self, Self::Varying { .. })
    }
}

/// A stored attribute: an `f32` column with a name.
#[derive(Clone, Debug, PartialEq)]
pub struct AttributeInfo {
    /// Name, at most [`NAME_BYTES`] bytes.
    pub name: String,
    /// Smallest finite value.
    pub min: f32,
    /// Largest finite value.
    pub max: f32,
}

/// Where a node's record is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct NodeRef {
    /// Number among the node pages, which follow the point pages.
    pub page: u32,
    /// Index of the record in the page.
    pub index: u16,
}

/// What the header says.
#[derive(Clone, Debug, PartialEq)]
pub struct Header {
    /// Bytes of a page, a multiple of [`BLOCK_BYTES`].
    pub page_bytes: u32,
    /// Pages that hold points; they come first.
    pub point_pages: u32,
    /// Pages that hold nodes; they follow.
    pub node_pages: u32,
    /// Bytes of the whole file.
    pub file_bytes: u64,
    /// Points stored.
    pub points: u64,
    /// Records of the input that were invalid and skipped.
    pub skipped: u64,
    /// Nodes of the octree.
    pub nodes: u64,
    /// The root node, in the last node page. Meaningless where there are no points.
    pub root: NodeRef,
    /// Smallest corner of the root cell, world space.
    pub root_min: DVec3,
    /// Edge of the root cell, a power of two, world space.
    pub root_size: f64,
    /// Tight bounds of the stored positions, world space.
    pub bounds: Aabb,
    /// Radius of influence, world space.
    pub radius: Column,
    /// Mean radius.
    pub radius_mean: f64,
    /// Weight.
    pub weight: Column,
    /// Largest distance between a stored position and the one that was read, world space.
    pub position_error: f64,
    /// The same as a fraction of the point's own radius.
    pub position_error_radii: f64,
    /// Whether points carry a colour.
    pub has_color: bool,
    /// Attribute columns.
    pub attributes: Vec<AttributeInfo>,
    /// Bytes of the file that hold points' own data.
    pub point_data_bytes: u64,
    /// Memory to render with unless the user says otherwise; 0 where none was stored.
    pub render_memory: u64,
}

/// Why bytes are no header.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[non_exhaustive]
pub enum HeaderError {
    /// The magic number differs.
    #[error("byte 0: not a file of this kind (no `RAYSET` signature of a cloud, or `RAYGRID` of a grid)")]
    Magic,
    /// Another version of the layout.
    #[error("byte 8: format version {found}, this program reads version {VERSION}; build the cloud again")]
    Version {
        /// The version found.
        found: u32,
    },
    /// The checksum over the block differs.
    #[error("byte {at}: checksum {found:08x} where {expected:08x} was expected; the block is damaged")]
    Checksum {
        /// Offset of the checksum.
        at: u64,
        /// Stored.
        found: u32,
        /// Computed.
        expected: u32,
    },
    /// A field out of its range, in a block whose checksum is right.
    #[error("byte {at}: {what}")]
    Field {
        /// Offset of the field.
        at: u64,
        /// What is wrong with it.
        what: &'static str,
    },
}

pub(crate) const VERSION_AT: usize = MAGIC.len();
pub(crate) const CHECKSUM_AT: usize = VERSION_AT + 4;
pub(crate) const FIELDS_AT: usize = CHECKSUM_AT + 4;

/// Writes fields one after another.
pub(crate) struct Writer<'a> {
    pub(crate) bytes: &'a mut [u8],
    pub(crate) at: usize,
}

impl Writer<'_> {
    pub(crate) fn put(&mut self, bytes: &[u8]) {
        self.bytes[self.at..self.at + bytes.len()].copy_from_slice(bytes);
        self.at += bytes.len();
    }
    pub(crate) fn u32(&mut self, v: u32) {
        self.put(&v.to_le_bytes());
    }
    pub(crate) fn u64(&mut self, v: u64) {
        self.put(&v.to_le_bytes());
    }
    pub(crate) fn f32(&mut self, v: f32) {
        self.put(&v.to_le_bytes());
    }
    pub(crate) fn f64(&mut self, v: f64) {
        self.put(&v.to_le_bytes());
    }
    pub(crate) fn vec(&mut self, v: DVec3) {
        v.to_array().into_iter().for_each(|x| self.f64(x));
    }
}

/// Reads fields one after another; the caller hands it a whole block, so it cannot run out.
pub(crate) struct Reader<'a> {
    pub(crate) bytes: &'a [u8],
    pub(crate) at: usize,
}

impl Reader<'_> {
    pub(crate) fn take<const N: usize>(&mut self) -> [u8; N] {
        let mut out = [0; N];
        out.copy_from_slice(&self.bytes[self.at..self.at + N]);
        self.at += N;
        out
    }
    pub(crate) fn u32(&mut self) -> u32 {
        u32::from_le_bytes(self.take())
    }
    pub(crate) fn u64(&mut self) -> u64 {
        u64::from_le_bytes(self.take())
    }
    pub(crate) fn f32(&mut self) -> f32 {
        f32::from_le_bytes(self.take())
    }
    pub(crate) fn f64(&mut self) -> f64 {
        f64::from_le_bytes(self.take())
    }
    pub(crate) fn vec(&mut self) -> DVec3 {
        DVec3::new(self.f64(), self.f64(), self.f64())
    }
}

impl Header {
    /// Offset of a page in the file.
    #[must_use]
    pub fn page_offset(&self, page: u32) -> u64 {
        BLOCK_BYTES as u64 + u64::from(page) * u64::from(self.page_bytes)
    }

    /// All pages.
    #[must_use]
    pub fn pages(&self) -> u32 {
        self.point_pages + self.node_pages
    }

    /// Bytes that the file must have.
    #[must_use]
    pub fn expected_file_bytes(&self) -> u64 {
        2 * BLOCK_BYTES as u64 + u64::from(self.pages()) * u64::from(self.page_bytes)
    }

    /// Bytes that one point takes in a page besides its position: radius, weight, colour, attributes.
    #[must_use]
    pub fn column_bytes(&self) -> usize {
        4 * usize::from(self.radius.is_stored())
            + 4 * usize::from(self.weight.is_stored())
            + 4 * usize::from(self.has_color)
            + 4 * self.attributes.len()
    }

    /// The header as a block.
    #[must_use]
    pub fn encode(&self) -> [u8; BLOCK_BYTES] {
        let mut block = [0; BLOCK_BYTES];
        block[..MAGIC.len()].copy_from_slice(&MAGIC);
        block[VERSION_AT..VERSION_AT + 4].copy_from_slice(&VERSION.to_le_bytes());
        let mut w = Writer { bytes: &mut block, at: FIELDS_AT };
        w.u32(self.page_bytes);
        w.u32(self.point_pages);
        w.u32(self.node_pages);
        w.u32(self.root.page);
        w.u32(u32::from(self.root.index));
        w.u32(self.attributes.len() as u32);
        w.u32(
            u32::from(self.radius.is_stored())
                | u32::from(self.weight.is_stored()) << 1
                | u32::from(self.has_color) << 2,
        );
        w.u32(0);
        w.u64(self.file_bytes);
        w.u64(self.points);
        w.u64(self.skipped);
        w.u64(self.nodes);
        w.u64(self.point_data_bytes);
        w.u64(self.render_memory);
        w.vec(self.root_min);
        w.f64(self.root_size);
        w.vec(self.bounds.min);
        w.vec(self.bounds.max);
        w.f64(self.radius_mean);
        w.f64(self.position_error);
        w.f64(self.position_error_radii);
        for column in [self.radius, self.weight] {
            w.f32(column.min());
            w.f32(column.max());
        }
        for attribute in &self.attributes {
            let mut name = [0; NAME_BYTES];
            let bytes = attribute.name.as_bytes();
            name[..bytes.len()].copy_from_slice(bytes);
            w.put(&name);
            w.f32(attribute.min);
            w.f32(attribute.max);
        }
        let checksum = block_checksum(&block, CHECKSUM_AT);
        block[CHECKSUM_AT..CHECKSUM_AT + 4].copy_from_slice(&checksum.to_le_bytes());
        block
    }

    /// Reads and checks a header.
    ///
    /// # Errors
    /// [`HeaderError`] where the block is no header, of another version, damaged, or out of range.
    pub fn decode(block: &[u8; BLOCK_BYTES]) -> Result<Self, HeaderError> {
        if block[..MAGIC.len()] != MAGIC {
            return Err(HeaderError::Magic);
        }
        let mut r = Reader { bytes: block, at: VERSION_AT };
        let version = r.u32();
        if version != VERSION {
            return Err(HeaderError::Version { found: version });
        }
        let found = r.u32();
        let expected = block_checksum(block, CHECKSUM_AT);
        if found != expected {
            return Err(HeaderError::Checksum { at: CHECKSUM_AT as u64, found, expected });
        }
        let page_bytes = r.u32();
        let (point_pages, node_pages) = (r.u32(), r.u32());
        let root = NodeRef { page: r.u32(), index: r.u32() as u16 };
        let attribute_count = r.u32() as usize;
        let flags = r.u32();
        r.u32();
        let (file_bytes, points, skipped, nodes) = (r.u64(), r.u64(), r.u64(), r.u64());
        let (point_data_bytes, render_memory) = (r.u64(), r.u64());
        let (root_min, root_size) = (r.vec(), r.f64());
        let bounds = Aabb::new(r.vec(), r.vec());
        let (radius_mean, position_error, position_error_radii) = (r.f64(), r.f64(), r.f64());
        let mut column = |stored: bool| {
            let (min, max) = (r.f32(), r.f32());
            if stored { Column::Varying { min, max } } else { Column::Constant(min) }
        };
        let (radius, weight) = (column(flags & 1 != 0), column(flags & 2 != 0));
        let field = |at: usize, what| HeaderError::Field { at: at as u64, what };
        if attribute_count > MAX_ATTRIBUTES {
            return Err(field(FIELDS_AT + 20, "more than 32 attributes"));
        }
        let mut attributes = Vec::new();
        for _ in 0..attribute_count {
            let at = r.at;
            let name: [u8; NAME_BYTES] = r.take();
            let end = name.iter().position(|&b| b == 0).unwrap_or(NAME_BYTES);
            let name =
                std::str::from_utf8(&name[..end]).map_err(|_| field(at, "an attribute name is not text"))?;
            attributes.push(AttributeInfo { name: name.to_owned(), min: r.f32(), max: r.f32() });
        }
        let header = Self {
            page_bytes,
            point_pages,
            node_pages,
            file_bytes,
            points,
            skipped,
            nodes,
            root,
            root_min,
            root_size,
            bounds,
            radius,
            radius_mean,
            weight,
            position_error,
            position_error_radii,
            has_color: flags & 4 != 0,
            attributes,
            point_data_bytes,
            render_memory,
        };
        header.check_ranges().map(|()| header)
    }

    fn check_ranges(&self) -> Result<(), HeaderError> {
        let field = |at: usize, what| Err(HeaderError::Field { at: at as u64, what });
        let page_bytes = self.page_bytes as usize;
        if page_bytes == 0 || !page_bytes.is_multiple_of(BLOCK_BYTES) || page_bytes > MAX_PAGE_BYTES {
            return field(FIELDS_AT, "the page size is no multiple of 4096 up to 262144");
        }
        if self.point_pages.checked_add(self.node_pages).is_none() {
            return field(FIELDS_AT + 4, "more than 4294967295 pages");
        }
        if self.expected_file_bytes() != self.file_bytes {
            return field(FIELDS_AT + 32, "the file length does not follow from the number of pages");
        }
        if self.points > 0 && self.root.page >= self.node_pages {
            return field(FIELDS_AT + 12, "the root is in no node page");
        }
        let finite = self.root_min.is_finite()
            && self.root_size.is_finite()
            && self.root_size > 0.0
            && (self.points == 0 || (self.bounds.min.is_finite() && self.bounds.max.is_finite()))
            && self.radius.min() > 0.0
            && self.radius.max() < f32::INFINITY
            && self.weight.min().is_finite()
            && self.weight.max().is_finite();
        if finite { Ok(()) } else { field(FIELDS_AT + 80, "bounds, radii or weights are not finite") }
    }
}

/// Largest page, so that run offsets fit their field.
pub const MAX_PAGE_BYTES: usize = 256 << 10;

/// CRC-32C of a block with the four bytes of its checksum left out.
#[must_use]
pub fn block_checksum(bytes: &[u8], checksum_at: usize) -> u32 {
    let head = crc32c::crc32c(&bytes[..checksum_at]);
    crc32c::crc32c_append(head, &bytes[checksum_at + 4..])
}

/// What kind of page it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum PageKind {
    /// Node records.
    Octree,
    /// Runs of points.
    Points,
    /// A brick of a grid.
    Voxels,
    /// Value ranges of bricks.
    Ranges,
}

impl PageKind {
    /// The number that stands for the kind in a page head.
    #[must_use]
    pub fn code(self) -> u32 {
        match self {
            Self::Octree => 0x4e4f_4445,
            Self::Points => 0x5054_5330,
            Self::Voxels => 0x564f_5845,
            Self::Ranges => 0x5241_4e47,
        }
    }
}

/// The head that every page starts with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PageHead {
    /// Kind of page.
    pub kind: PageKind,
    /// Number of the page, so that a page in the wrong place is noticed.
    pub page: u32,
    /// Records (nodes or runs) in the page.
    pub records: u32,
    /// Bytes in use, the head included; the rest is zero.
    pub used_bytes: u32,
}

const PAGE_CHECKSUM_AT: usize = 4;

impl PageHead {
    /// Writes the head and, over the whole page, its checksum.
    pub fn seal(&self, page: &mut [u8]) {
        let mut w = Writer { bytes: page, at: 0 };
        w.u32(self.kind.code());
        w.u32(0);
        w.u32(self.page);
        w.u32(self.records);
        w.u32(self.used_bytes);
        w.put(&[0; PAGE_HEAD_BYTES - 20]);
        let checksum = block_checksum(page, PAGE_CHECKSUM_AT);
        page[PAGE_CHECKSUM_AT..PAGE_CHECKSUM_AT + 4].copy_from_slice(&checksum.to_le_bytes());
    }

    /// Checks a page's checksum, kind and number and returns its head.
    ///
    /// # Errors
    /// [`PageError`] that says which of them is wrong.
    pub fn check(page_bytes: &[u8], kind: PageKind, page: u32) -> Result<Self, PageError> {
        let mut r = Reader { bytes: page_bytes, at: 0 };
        let (code, found) = (r.u32(), r.u32());
        let expected = block_checksum(page_bytes, PAGE_CHECKSUM_AT);
        if found != expected {
            return Err(PageError::Checksum { found, expected });
        }
        let (number, records, used_bytes) = (r.u32(), r.u32(), r.u32());
        if code != kind.code() || number != page {
            return Err(PageError::Misplaced { number });
        }
        if (used_bytes as usize) < PAGE_HEAD_BYTES || used_bytes as usize > page_bytes.len() {
            return Err(PageError::Content { what: "more bytes in use than the page has" });
        }
        Ok(Self { kind, page, records, used_bytes })
    }
}

/// Why the bytes of a page cannot be used.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[non_exhaustive]
pub enum PageError {
    /// The checksum over the page differs.
    #[error("checksum {found:08x} where {expected:08x} was expected; the page is damaged")]
    Checksum {
        /// Stored.
        found: u32,
        /// Computed.
        expected: u32,
    },
    /// A whole page, in the wrong place.
    #[error("page {number} of another kind or place stands here")]
    Misplaced {
        /// The number that the page gives itself.
        number: u32,
    },
    /// Records that contradict themselves, under a right checksum.
    #[error("{what}")]
    Content {
        /// What is wrong.
        what: &'static str,
    },
}

/// The last block of a file: a digest of what stands before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Footer {
    /// CRC-32C over the checksums of all pages, in order.
    pub digest: u32,
    /// The header's checksum, which ties the two together.
    pub header_checksum: u32,
}

const FOOTER_MAGIC: [u8; 8] = *b"TESYAR\r\n";

impl Footer {
    /// The footer that belongs to an encoded header.
    #[must_use]
    pub fn new(header: &[u8; BLOCK_BYTES], digest: u32) -> Self {
        Self { digest, header_checksum: Reader { bytes: header, at: CHECKSUM_AT }.u32() }
    }

    /// The footer as a block.
    #[must_use]
    pub fn encode(&self) -> [u8; BLOCK_BYTES] {
        let mut block = [0; BLOCK_BYTES];
        let mut w = Writer { bytes: &mut block, at: 0 };
        w.put(&FOOTER_MAGIC);
        w.u32(VERSION);
        w.u32(0);
        w.u32(self.digest);
        w.u32(self.header_checksum);
        let checksum = block_checksum(&block, CHECKSUM_AT);
        block[CHECKSUM_AT..CHECKSUM_AT + 4].copy_from_slice(&checksum.to_le_bytes());
        block
    }

    /// Reads and checks a footer; `at` is its offset in the file, for messages.
    ///
    /// # Errors
    /// [`HeaderError`] where the block is damaged or belongs to another header.
    pub fn decode(
        block: &[u8; BLOCK_BYTES],
        header: &[u8; BLOCK_BYTES],
        at: u64,
    ) -> Result<Self, HeaderError> {
        let mut r = Reader { bytes: block, at: 0 };
        let (magic, version, found): ([u8; 8], _, _) = (r.take(), r.u32(), r.u32());
        let expected = block_checksum(block, CHECKSUM_AT);
        if found != expected {
            return Err(HeaderError::Checksum { at: at + CHECKSUM_AT as u64, found, expected });
        }
        let footer = Self { digest: r.u32(), header_checksum: r.u32() };
        if magic != FOOTER_MAGIC
            || version != VERSION
            || footer.header_checksum != Self::new(header, 0).header_checksum
        {
            return Err(HeaderError::Field { at, what: "the footer does not belong to the header" });
        }
        Ok(footer)
    }
}

/// The checksum that a sealed page carries.
#[must_use]
pub fn stored_page_checksum(page: &[u8]) -> u32 {
    Reader { bytes: page, at: PAGE_CHECKSUM_AT }.u32()
}
