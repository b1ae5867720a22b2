//! The layout of grid files: the section `GRID`, as [`GridHeader`], and the contents of the pages.
//!
//! A brick holds all voxels that samples in its cells need, including those shared with
//! neighbouring bricks, so that a sample reads a single page. Numbers are little-endian. The
//! surrounding container format is in [`rayset_store::container`].

use super::labels::GridLabels;
use rayset_base::geometry::{DAffine3, DVec3};
use rayset_base::numbers::Stored;
use rayset_store::container::{
    BLOCK_BYTES, BRICK_SHAPE, FileHeader, Identity, Metadata, OpenError, OpenFile, PAGE_HEAD_BYTES, Reader,
    SectionKind, Writer,
};

/// The first eight bytes of every grid file.
pub const MAGIC: [u8; 8] = *b"RAYGRID\n";
/// Size of a page in bytes.
pub const PAGE_BYTES: usize = 32 << 10;
/// Value ranges in a page.
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
    /// IEEE 754 single precision.
    F32,
}

impl VoxelKind {
    /// The type in which numbers of a file are stored. Integers of 32 bits and more and double
    /// precision are rounded to single precision.
    #[doc(hidden)]
    #[must_use]
    pub fn of(stored: Stored) -> Self {
        match stored {
            Stored::U8 => Self::U8,
            Stored::I8 | Stored::I16 => Self::I16,
            Stored::U16 => Self::U16,
            _ => Self::F32,
        }
    }

    /// Every kind.
    pub const ALL: &[Self] = &[Self::U8, Self::I16, Self::U16, Self::F32];

    /// Size of a voxel in bytes.
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

    /// Voxels along an edge of a brick that is a cube: as many as fit in a page.
    #[must_use]
    pub const fn brick_voxels(self) -> usize {
        match self {
            Self::U8 => 31,
            Self::I16 | Self::U16 => 25,
            Self::F32 => 20,
        }
    }

    /// Cells along an edge of a brick that is a cube; the additional voxel on either side is for
    /// gradients.
    #[must_use]
    pub fn brick_cells(self) -> u64 {
        self.brick_voxels() as u64 - 3
    }

    /// Decodes a voxel from little-endian bytes.
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

/// Voxels along the edges of the bricks of a grid. They are cubes unless the grid is so thin that
/// bricks of another shape need at most half as many pages.
pub fn brick_shape(size: [u64; 3], kind: VoxelKind) -> [u64; 3] {
    let cube = [kind.brick_voxels() as u64; 3];
    // A brick that reaches from end to end has two voxels beyond the grid.
    let whole = size.map(|n| n.saturating_add(2));
    let long: Vec<usize> = (0..3).filter(|&axis| whole[axis] > cube[axis]).collect();
    let across: u64 = (0..3).filter(|axis| !long.contains(axis)).map(|axis| whole[axis]).product();
    let room = ((PAGE_BYTES - PAGE_HEAD_BYTES) / kind.bytes()) as u64 / across;
    let mut shape = whole;
    match long[..] {
        [axis] => shape[axis] = room.min(whole[axis]),
        [a, b] => {
            let (short, other) = if whole[a] <= whole[b] { (a, b) } else { (b, a) };
            shape[short] = room.isqrt().min(whole[short]);
            shape[other] = (room / shape[short]).min(whole[other]);
        }
        _ => return cube,
    }
    let pages = |shape| bricks_of(size, shape).iter().product::<u64>();
    if 2 * pages(shape) <= pages(cube) { shape } else { cube }
}

/// Bricks along each axis.
fn bricks_of(size: [u64; 3], brick_voxels: [u64; 3]) -> [u64; 3] {
    std::array::from_fn(|axis| (size[axis] - 1).div_ceil(brick_voxels[axis] - 3))
}

/// The header of a grid file.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(not(feature = "internals"), non_exhaustive)]
pub struct GridHeader {
    /// Distinguishes the file from others. Zero during the build, because it depends on all voxels.
    pub identity: Identity,
    /// Voxels along each axis, at least 2.
    pub size: [u64; 3],
    /// How they are stored.
    pub kind: VoxelKind,
    /// Voxels along the edges of a brick.
    pub brick_voxels: [u64; 3],
    /// Smallest and largest value, as stored.
    pub range: (f32, f32),
    /// A value is `scale`·stored + `offset`.
    pub scale: f64,
    /// See `scale`.
    pub offset: f64,
    /// Transforms voxel coordinates (voxel centres at integers) to the space of the file that the
    /// grid was made from.
    pub space_from_voxel: DAffine3,
    /// Size of the whole file in bytes.
    pub file_bytes: u64,
    /// What its reader chose and knows of the volume
    /// ([`VolumeSource::about`](crate::grid::VolumeSource::about)), sorted.
    pub sources: Vec<String>,
    /// The direction in the space of the file that is up, of length one; `None` if its format does
    /// not say.
    pub up: Option<DVec3>,
    /// The direction in which one looks at the front, of length one: a patient is seen from the
    /// front. `None` if the format does not say.
    pub facing: Option<DVec3>,
    /// The values of its voxels, where they are few and whole.
    #[doc(hidden)]
    pub labels: GridLabels,
}

impl GridHeader {
    /// Bricks along each axis.
    #[must_use]
    pub fn bricks(&self) -> [u64; 3] {
        bricks_of(self.size, self.brick_voxels)
    }

    /// Cells along the edges of a brick; the additional voxel on either side is for gradients.
    #[must_use]
    pub fn brick_cells(&self) -> [u64; 3] {
        self.brick_voxels.map(|n| n - 3)
    }

    /// Bytes of the voxels of a brick.
    #[doc(hidden)]
    pub fn brick_bytes(&self) -> usize {
        self.brick_voxels.iter().product::<u64>() as usize * self.kind.bytes()
    }

    /// Whether bricks are cubes of as many voxels as fit in a page.
    #[doc(hidden)]
    pub fn has_cubes(&self) -> bool {
        self.brick_voxels == [self.kind.brick_voxels() as u64; 3]
    }

    /// Number of pages that hold bricks; they come first, x fastest.
    #[must_use]
    pub fn brick_pages(&self) -> u64 {
        self.bricks().iter().product()
    }

    /// Number of pages that hold the ranges of bricks; they follow the bricks.
    #[must_use]
    pub fn range_pages(&self) -> u64 {
        self.brick_pages().div_ceil(RANGES_PER_PAGE)
    }

    /// Number of all pages.
    #[must_use]
    pub fn pages(&self) -> u64 {
        self.brick_pages() + self.range_pages()
    }

    /// The offset of a page in the file, in bytes.
    #[must_use]
    pub fn page_offset(&self, page: u64) -> u64 {
        BLOCK_BYTES as u64 + page * PAGE_BYTES as u64
    }

    /// The value of a stored number, with scale and offset applied.
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

    /// Encodes the section `GRID`.
    #[doc(hidden)]
    pub fn encode(&self) -> Vec<u8> {
        let mut w = Writer::default();
        w.u32(self.kind as u32);
        w.u32(0);
        self.size.into_iter().for_each(|n| w.u64(n));
        w.f64(self.range.0.into());
        w.f64(self.range.1.into());
        w.f64(self.scale);
        w.f64(self.offset);
        self.space_from_voxel.to_cols_array().into_iter().for_each(|v| w.f64(v));
        if !self.has_cubes() {
            self.brick_voxels.into_iter().for_each(|n| w.u32(n as u32));
        }
        w.bytes
    }

    /// The contents of the section `META`.
    #[doc(hidden)]
    pub fn metadata(&self) -> Metadata {
        let mut features = std::collections::BTreeMap::new();
        if !self.has_cubes() {
            features.insert(BRICK_SHAPE.trailing_zeros().to_string(), "brick-shape".to_owned());
        }
        Metadata {
            features,
            required_features: if self.has_cubes() { 0 } else { BRICK_SHAPE },
            up: self.up.map(|v| v.to_array()),
            facing: self.facing.map(|v| v.to_array()),
            ..Metadata::new("", self.sources.clone())
        }
    }

    /// Reads and checks the sections of an open file.
    ///
    /// # Errors
    /// [`OpenError`] if a section is missing, damaged, or has a number out of range.
    #[doc(hidden)]
    pub fn read(file: &mut OpenFile) -> Result<Self, OpenError> {
        let bytes = file.section(SectionKind::GRID)?;
        let words = file.metadata()?;
        let wrong = |what| file.wrong_section(SectionKind::GRID, what);
        let header = Self::decode(&bytes, file.header())
            .ok_or_else(|| wrong("the numbers of the grid end early, or its kind of voxels is unknown"))?;
        header.check_ranges(file.header()).map_err(wrong)?;
        let labels = match file.header().section(SectionKind::LABELS) {
            Some(_) => GridLabels::decode(&file.section(SectionKind::LABELS)?).ok_or_else(|| {
                file.wrong_section(SectionKind::LABELS, "the list of values is not JSON of the expected form")
            })?,
            None => GridLabels::default(),
        };
        let (up, facing) = (words.up(), words.facing());
        Ok(Self { sources: words.sources, up, facing, labels, ..header })
    }

    fn decode(bytes: &[u8], file: &FileHeader) -> Option<Self> {
        let mut r = Reader::new(bytes);
        let kind = *VoxelKind::ALL.get(r.u32()? as usize)?;
        r.u32()?;
        let size = [r.u64()?, r.u64()?, r.u64()?];
        let range = (r.f64()? as f32, r.f64()? as f32);
        let (scale, offset) = (r.f64()?, r.f64()?);
        let mut columns = [0.0; 12];
        for value in &mut columns {
            *value = r.f64()?;
        }
        let mut brick_voxels = [kind.brick_voxels() as u64; 3];
        if file.required_features & BRICK_SHAPE != 0 {
            for n in &mut brick_voxels {
                *n = r.u32()?.into();
            }
        }
        Some(Self {
            identity: file.identity,
            size,
            kind,
            brick_voxels,
            range,
            scale,
            offset,
            space_from_voxel: DAffine3::from_cols_array(&columns),
            file_bytes: file.file_bytes,
            sources: Vec::new(),
            up: None,
            facing: None,
            labels: GridLabels::default(),
        })
    }

    fn check_ranges(&self, file: &FileHeader) -> Result<(), &'static str> {
        self.check_size()?;
        if file.page_bytes as usize != PAGE_BYTES {
            return Err("the pages of a grid have 32768 bytes");
        }
        let fits = |kind, pages: u64, first: u64| {
            file.section(kind)
                .is_some_and(|s| u64::from(s.pages) == pages && s.offset == self.page_offset(first))
        };
        let bricks = self.brick_pages();
        if !fits(SectionKind::VOXELS, bricks, 0) || !fits(SectionKind::RANGES, self.range_pages(), bricks) {
            return Err("the number of pages does not fit the size of the grid");
        }
        self.check_numbers()
    }

    /// Checks that the numbers of voxels and pages are within the limits of the format.
    #[doc(hidden)]
    pub fn check_size(&self) -> Result<(), &'static str> {
        let most = ((PAGE_BYTES - PAGE_HEAD_BYTES) / self.kind.bytes()) as u64;
        let voxels = self.brick_voxels.iter().try_fold(1_u64, |all, &n| all.checked_mul(n));
        if self.brick_voxels.iter().any(|&n| n < 4) || voxels.is_none_or(|voxels| voxels > most) {
            return Err("a brick has at least 4 voxels along an edge, and no more in all than fit in a page");
        }
        let in_range = self.size.iter().all(|n| (2..=1 << 24).contains(n));
        if !in_range || self.pages() > u64::from(u32::MAX) {
            return Err("a grid has 2 to 16777216 voxels along an axis, and at most 4294967295 pages");
        }
        Ok(())
    }

    /// Checks that the transform, the scale and offset, and the value range are usable.
    #[doc(hidden)]
    pub fn check_numbers(&self) -> Result<(), &'static str> {
        let determinant = self.space_from_voxel.matrix3.determinant();
        let finite = self.space_from_voxel.is_finite()
            && self.space_from_voxel.inverse().is_finite()
            && self.scale.is_finite()
            && self.offset.is_finite();
        if !finite || determinant == 0.0 || !determinant.is_finite() {
            return Err("a number of the grid is not finite, or its axes are not independent");
        }
        if !self.range.0.is_finite() || !self.range.1.is_finite() {
            return Err("the smallest or largest voxel is not a finite number");
        }
        Ok(())
    }

    /// Voxel coordinates of the last voxel.
    #[must_use]
    pub fn last_voxel(&self) -> DVec3 {
        DVec3::from_array(self.size.map(|n| (n - 1) as f64))
    }
}
