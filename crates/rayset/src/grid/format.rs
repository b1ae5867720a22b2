//! The first 4096 bytes of a grid file, and what its pages hold.
//!
//! A brick holds the voxels that samples in its cells need, those of the neighbouring bricks included, so that a sample
//! reads one page. Numbers are little-endian.

use crate::geometry::{DAffine3, DVec3};
use crate::octree::format::{
    BLOCK_BYTES, CHECKSUM_AT, FIELDS_AT, HeaderError, PAGE_HEAD_BYTES, Reader, VERSION_AT, Writer,
    block_checksum,
};

/// First eight bytes of every file.
pub const MAGIC: [u8; 8] = *b"RAYGRID\n";
/// Version of the layout.
pub const VERSION: u32 = 1;
/// Bytes of a page.
pub const PAGE_BYTES: usize = 32 << 10;
/// Ranges in a page.
pub const RANGES_PER_PAGE: u64 = ((PAGE_BYTES - PAGE_HEAD_BYTES) / 8) as u64;

/// How a voxel is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VoxelKind {
    /// Unsigned, 8 bits.
    U8,
    /// Signed, 16 bits.
    I16,
    /// Unsigned, 16 bits.
    U16,
    /// Single precision.
    F32,
}

impl VoxelKind {
    /// Every kind.
    pub const ALL: [Self; 4] = [Self::U8, Self::I16, Self::U16, Self::F32];

    /// Bytes of a voxel.
    #[must_use]
    pub fn bytes(self) -> usize {
        match self {
            Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::F32 => 4,
        }
    }

    /// Its name on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        ["u8", "i16", "u16", "f32"][self as usize]
    }

    /// Voxels along an edge of a brick: as many as a page holds.
    #[must_use]
    pub fn brick_voxels(self) -> usize {
        match self {
            Self::U8 => 31,
            Self::I16 | Self::U16 => 25,
            Self::F32 => 20,
        }
    }

    /// Cells between voxels that a brick is for; a voxel on either side is for gradients.
    #[must_use]
    pub fn brick_cells(self) -> u64 {
        self.brick_voxels() as u64 - 3
    }

    /// The number that little-endian bytes stand for.
    #[must_use]
    pub fn value(self, bytes: &[u8]) -> f32 {
        match self {
            Self::U8 => f32::from(bytes[0]),
            Self::I16 => f32::from(i16::from_le_bytes([bytes[0], bytes[1]])),
            Self::U16 => f32::from(u16::from_le_bytes([bytes[0], bytes[1]])),
            Self::F32 => f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]),
        }
    }
}

/// What the header says.
#[derive(Clone, Debug, PartialEq)]
pub struct GridHeader {
    /// Voxels along each axis, at least 2.
    pub size: [u64; 3],
    /// How they are stored.
    pub kind: VoxelKind,
    /// Smallest and largest value, as stored.
    pub range: (f32, f32),
    /// A value is `scale`·stored + `offset`.
    pub scale: f64,
    /// See `scale`.
    pub offset: f64,
    /// From voxel coordinates (voxel centres are whole numbers) to the space of the file it was made from.
    pub space_from_voxel: DAffine3,
    /// Bytes of the whole file.
    pub file_bytes: u64,
}

impl GridHeader {
    /// Bricks along each axis.
    #[must_use]
    pub fn bricks(&self) -> [u64; 3] {
        self.size.map(|n| (n - 1).div_ceil(self.kind.brick_cells()))
    }

    /// Pages that hold bricks; they come first, x fastest.
    #[must_use]
    pub fn brick_pages(&self) -> u64 {
        self.bricks().iter().product()
    }

    /// Pages that hold ranges of bricks; they follow.
    #[must_use]
    pub fn range_pages(&self) -> u64 {
        self.brick_pages().div_ceil(RANGES_PER_PAGE)
    }

    /// All pages.
    #[must_use]
    pub fn pages(&self) -> u64 {
        self.brick_pages() + self.range_pages()
    }

    /// Where a page starts.
    #[must_use]
    pub fn page_offset(&self, page: u64) -> u64 {
        BLOCK_BYTES as u64 + page * PAGE_BYTES as u64
    }

    /// Bytes that a file of so many pages has.
    #[must_use]
    pub fn expected_file_bytes(&self) -> u64 {
        self.page_offset(self.pages()) + BLOCK_BYTES as u64
    }

    /// The value that a stored number stands for.
    #[must_use]
    pub fn value(&self, stored: f64) -> f64 {
        self.scale * stored + self.offset
    }

    /// Smallest and largest value.
    #[must_use]
    pub fn value_range(&self) -> (f64, f64) {
        let (a, b) = (self.value(f64::from(self.range.0)), self.value(f64::from(self.range.1)));
        (a.min(b), a.max(b))
    }

    /// The header as a block.
    #[must_use]
    pub fn encode(&self) -> [u8; BLOCK_BYTES] {
        let mut block = [0; BLOCK_BYTES];
        block[..MAGIC.len()].copy_from_slice(&MAGIC);
        block[VERSION_AT..VERSION_AT + 4].copy_from_slice(&VERSION.to_le_bytes());
        let mut w = Writer { bytes: &mut block, at: FIELDS_AT };
        w.u32(PAGE_BYTES as u32);
        w.u32(self.kind as u32);
        self.size.into_iter().for_each(|n| w.u64(n));
        w.u64(self.file_bytes);
        w.f32(self.range.0);
        w.f32(self.range.1);
        w.f64(self.scale);
        w.f64(self.offset);
        self.space_from_voxel.to_cols_array().into_iter().for_each(|v| w.f64(v));
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
        let (found, expected) = (r.u32(), block_checksum(block, CHECKSUM_AT));
        if found != expected {
            return Err(HeaderError::Checksum { at: CHECKSUM_AT as u64, found, expected });
        }
        let at = r.at as u64;
        let wrong = |what| Err(HeaderError::Field { at, what });
        let (page_bytes, kind) = (r.u32(), r.u32());
        let Some(&kind) = VoxelKind::ALL.get(kind as usize).filter(|_| page_bytes as usize == PAGE_BYTES)
        else {
            return wrong("the size of a page or the kind of voxels is unknown");
        };
        let size: [u64; 3] = std::array::from_fn(|_| r.u64());
        let header = Self {
            size,
            kind,
            file_bytes: r.u64(),
            range: (r.f32(), r.f32()),
            scale: r.f64(),
            offset: r.f64(),
            space_from_voxel: DAffine3::from_cols_array(&std::array::from_fn(|_| r.f64())),
        };
        if size.iter().any(|n| !(2..=1 << 24).contains(n)) || header.pages() > u64::from(u32::MAX) {
            return wrong("a grid has 2 to 16777216 voxels along an axis, and at most 4294967295 pages");
        }
        if header.file_bytes != header.expected_file_bytes() {
            return wrong("the length of the file does not fit its grid");
        }
        let determinant = header.space_from_voxel.matrix3.determinant();
        let finite =
            header.space_from_voxel.is_finite() && header.scale.is_finite() && header.offset.is_finite();
        if !finite || determinant == 0.0 || !header.range.0.is_finite() || !header.range.1.is_finite() {
            return wrong("a number of the grid is not finite, or its axes are not independent");
        }
        Ok(header)
    }

    /// Voxel coordinates of the last voxel.
    #[must_use]
    pub fn last_voxel(&self) -> DVec3 {
        DVec3::from_array(self.size.map(|n| (n - 1) as f64))
    }
}
