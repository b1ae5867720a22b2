//! Point pages: runs of at most 128 points, each with its own frame, tight bounds and columns.
//!
//! A run stores positions as offsets from its own corner, in steps that are a power of two, so that
//! decoding to coordinates about the run's centre is exact in `f32` for the usual 16-bit encoding.

use super::format::Header;
use super::harmonics;
use super::layout::{ColumnLayout, RUN_HEAD_BYTES, RUN_POINTS, RootCell};
use super::shape::{SHAPE_COLUMNS, StoredShape};
use rayset_base::geometry::{Aabb, DVec3};
use rayset_store::container::{PAGE_HEAD_BYTES, PageError, PageHead, PageKind};

/// Run corners lie on a lattice of this many steps along the root cell's edge.
pub(super) const ORIGIN_STEPS: f64 = 16_777_216.0;
/// Negated exponent of the coarsest step, which is `root_size · 2^-COARSEST_STEP`.
pub(super) const COARSEST_STEP: i32 = 15;
/// Number of step codes, which have seven bits in the record.
pub(super) const STEP_CODES: i32 = 128;

/// How a run stores its positions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    /// Three columns of 16-bit offsets.
    U16,
    /// Three columns of 32-bit offsets.
    U32,
    /// Three columns of `f64` world coordinates: exact.
    F64,
    /// Three columns of 24-bit offsets, of points with shapes, whose thinnest axes need finer
    /// steps.
    U24,
}

impl Encoding {
    /// That of the lowest two bits.
    #[inline]
    fn from_code(code: u16) -> Self {
        [Self::U16, Self::U32, Self::F64, Self::U24][usize::from(code & 3)]
    }

    fn code(self) -> u16 {
        match self {
            Self::U16 => 0,
            Self::U32 => 1,
            Self::F64 => 2,
            Self::U24 => 3,
        }
    }

    /// Number of steps in one unit of a run's extent.
    #[inline]
    pub(super) fn extent_steps(self) -> f64 {
        match self {
            Self::U32 => 16_777_216.0,
            Self::U24 => 65_536.0,
            Self::U16 | Self::F64 => 256.0,
        }
    }

    /// Bytes of one point's position.
    #[must_use]
    #[inline]
    pub fn position_bytes(self) -> usize {
        match self {
            Self::U16 => 6,
            Self::U24 => 9,
            Self::U32 => 12,
            Self::F64 => 24,
        }
    }
}

/// A run's record, decoded. Its place in the page is set when the run is placed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RunHead {
    /// Corner, in units of the root cell's edge / 2²⁴.
    pub(super) origin: [u32; 3],
    /// Edge lengths of the position bounds, in units of 2⁸ steps (2¹⁶ for the 24-bit encoding, 2²⁴
    /// for the 32-bit one), rounded up.
    pub(super) extent: [u8; 3],
    pub(super) radius_max: u16,
    pub(super) count: u8,
    pub(super) encoding: Encoding,
    pub(super) step_code: u8,
    /// Start of the run's data in its page, in units of four bytes.
    pub(super) offset_words: u16,
}

/// 2^−(COARSEST_STEP + code), constructed from its bits because it is needed for every run near a
/// ray.
#[inline]
pub(super) fn step_fraction(code: u8) -> f64 {
    f64::from_bits((1023 - COARSEST_STEP as u64 - u64::from(code)) << 52)
}

impl RunHead {
    /// Reads the record from its 18 bytes.
    #[inline]
    pub fn decode(bytes: &[u8]) -> Self {
        let u16_at = |at: usize| u16::from_le_bytes([bytes[at], bytes[at + 1]]);
        let u24_at = |at: usize| u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], 0]);
        let packed = u16_at(14);
        Self {
            origin: [u24_at(0), u24_at(3), u24_at(6)],
            extent: [bytes[9], bytes[10], bytes[11]],
            radius_max: u16_at(12),
            count: (packed & 0x7f) as u8 + 1,
            encoding: Encoding::from_code(packed >> 7),
            step_code: (packed >> 9) as u8,
            offset_words: u16_at(16),
        }
    }

    /// Writes the record into its 18 bytes.
    pub fn encode(&self, bytes: &mut [u8]) {
        for axis in 0..3 {
            bytes[3 * axis..3 * axis + 3].copy_from_slice(&self.origin[axis].to_le_bytes()[..3]);
            bytes[9 + axis] = self.extent[axis];
        }
        let packed = u16::from(self.count - 1) | self.encoding.code() << 7 | u16::from(self.step_code) << 9;
        bytes[12..14].copy_from_slice(&self.radius_max.to_le_bytes());
        bytes[14..16].copy_from_slice(&packed.to_le_bytes());
        bytes[16..18].copy_from_slice(&self.offset_words.to_le_bytes());
    }

    /// The same record with its data at another place in the page, in units of four bytes.
    pub fn placed_at(self, words: usize) -> Self {
        Self { offset_words: words as u16, ..self }
    }

    /// Where its data are in the page, in units of four bytes.
    #[inline]
    pub fn place(&self) -> usize {
        usize::from(self.offset_words)
    }

    /// Number of points, 1 to 128.
    #[must_use]
    #[expect(clippy::len_without_is_empty, reason = "a run holds at least one point")]
    #[inline]
    pub fn len(&self) -> usize {
        usize::from(self.count)
    }

    /// How positions are stored.
    #[must_use]
    #[inline]
    pub fn encoding(&self) -> Encoding {
        self.encoding
    }

    /// An upper bound on the radii of the run, at most 1/128 above the largest.
    #[must_use]
    #[inline]
    pub fn radius_max(&self) -> f32 {
        f32::from_bits(u32::from(self.radius_max) << 16)
    }

    /// The record of a run whose radii are multiplied by a factor above 0.
    #[inline]
    fn with_radii_scaled(self, factor: f32) -> Self {
        Self {
            radius_max: round_up_to_16_bits((self.radius_max() * factor).clamp(f32::MIN_POSITIVE, 1e30)),
            ..self
        }
    }

    /// Length of one offset step, world space.
    #[must_use]
    #[inline]
    pub fn step(&self, root: RootCell) -> f64 {
        root.size * step_fraction(self.step_code)
    }

    /// The box that contains the run's positions.
    #[must_use]
    #[inline]
    pub fn position_bounds(&self, root: RootCell) -> Aabb {
        let min = root.min + DVec3::from_array(self.origin.map(f64::from)) * (root.size / ORIGIN_STEPS);
        let unit = self.step(root) * self.encoding.extent_steps();
        Aabb::new(min, min + DVec3::from_array(self.extent.map(f64::from)) * unit)
    }

    /// Size of the run's data in bytes.
    #[must_use]
    #[inline]
    pub fn data_bytes(&self, columns: ColumnLayout) -> usize {
        (self.len() * self.encoding.position_bytes()).next_multiple_of(4) + columns.run_bytes(self.len())
    }
}

/// The upper half of a positive `f32`, rounded up.
pub(super) fn round_up_to_16_bits(v: f32) -> u16 {
    let bits = v.to_bits();
    ((bits >> 16) + u32::from(bits & 0xffff != 0)) as u16
}

/// A point page whose records have been checked.
#[derive(Clone, Copy, Debug)]
pub struct PointPage<'a> {
    bytes: &'a [u8],
    runs: usize,
    columns: ColumnLayout,
    radius_scale: f32,
}

impl<'a> PointPage<'a> {
    /// Checks a page: its head, and that every run lies within it.
    ///
    /// # Errors
    /// [`PageError`], which says what is wrong.
    pub fn check(bytes: &'a [u8], page: u32, header: &Header) -> Result<Self, PageError> {
        let head = PageHead::check(bytes, PageKind::Points, page, header.identity)?;
        let page = Self::trusted(bytes, header);
        debug_assert_eq!(page.runs, head.records as usize);
        if PAGE_HEAD_BYTES + page.runs * RUN_HEAD_BYTES > bytes.len() {
            return Err(PageError::Content { what: "more runs than fit the page" });
        }
        for index in 0..page.runs {
            let at = PAGE_HEAD_BYTES + index * RUN_HEAD_BYTES;
            let run = RunHead::decode(&bytes[at..at + RUN_HEAD_BYTES]);
            if run.encoding == Encoding::U24 && header.shape.is_none() {
                return Err(PageError::Content { what: "a run of an encoding for points with shapes" });
            }
            let start = 4 * usize::from(run.offset_words);
            if start < PAGE_HEAD_BYTES + page.runs * RUN_HEAD_BYTES {
                return Err(PageError::Content { what: "a run whose data begin within the records" });
            }
            if start + run.data_bytes(page.columns) > head.used_bytes as usize {
                return Err(PageError::Content { what: "a run that ends beyond the page" });
            }
            if !(run.radius_max().is_finite() && run.radius_max() > 0.0) {
                return Err(PageError::Content {
                    what: "a run whose largest radius is not a positive number",
                });
            }
        }
        Ok(page)
    }

    /// A page that has already passed [`check`](Self::check).
    #[must_use]
    pub fn trusted(bytes: &'a [u8], header: &Header) -> Self {
        let runs = u32::from_le_bytes([bytes[12], bytes[13], bytes[14], bytes[15]]) as usize;
        Self { bytes, runs, columns: header.columns, radius_scale: header.radius_scale }
    }

    /// Number of runs.
    #[must_use]
    #[inline]
    pub fn len(&self) -> usize {
        self.runs
    }

    /// Whether the page holds no run.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.runs == 0
    }

    /// A run's record. Panics if `index` is not less than [`len`](Self::len).
    #[must_use]
    #[inline]
    pub fn head(&self, index: usize) -> RunHead {
        assert!(index < self.runs, "run {index} of {}", self.runs);
        let at = PAGE_HEAD_BYTES + index * RUN_HEAD_BYTES;
        let head = RunHead::decode(&self.bytes[at..at + RUN_HEAD_BYTES]);
        if self.radius_scale == 1.0 { head } else { head.with_radii_scaled(self.radius_scale) }
    }

    /// A run with its data.
    #[must_use]
    #[inline]
    pub fn run(&self, index: usize) -> Run<'a> {
        let head = self.head(index);
        let start = 4 * usize::from(head.offset_words);
        Run { head, data: &self.bytes[start..start + head.data_bytes(self.columns)] }
    }
}

/// A run and its bytes.
#[derive(Clone, Copy, Debug)]
pub struct Run<'a> {
    /// The record.
    pub head: RunHead,
    data: &'a [u8],
}

impl<'a> Run<'a> {
    #[inline]
    fn words(&self, byte: usize, count: usize) -> impl Iterator<Item = [u8; 4]> + use<'a> {
        self.data[byte..byte + 4 * count].chunks_exact(4).map(|w| [w[0], w[1], w[2], w[3]])
    }

    /// Calls `value(axis, index, coordinate)` with coordinates relative to the centre of the run's
    /// [`position_bounds`](RunHead::position_bounds), exact in `f64` for the integer encodings.
    #[inline(always)]
    fn for_each_offset(&self, root: RootCell, mut value: impl FnMut(usize, usize, f64)) {
        let n = self.head.len();
        let (step, bounds) = (self.head.step(root), self.head.position_bounds(root));
        let half = (bounds.size() * 0.5).to_array();
        for axis in 0..3 {
            match self.head.encoding {
                Encoding::U16 => {
                    let column = &self.data[2 * n * axis..2 * n * (axis + 1)];
                    for (i, b) in column.chunks_exact(2).enumerate() {
                        value(axis, i, f64::from(u16::from_le_bytes([b[0], b[1]])) * step - half[axis]);
                    }
                }
                Encoding::U32 => {
                    for (i, b) in self.words(4 * n * axis, n).enumerate() {
                        value(axis, i, f64::from(u32::from_le_bytes(b)) * step - half[axis]);
                    }
                }
                Encoding::U24 => {
                    let column = &self.data[3 * n * axis..3 * n * (axis + 1)];
                    for (i, b) in column.chunks_exact(3).enumerate() {
                        let offset = u32::from_le_bytes([b[0], b[1], b[2], 0]);
                        value(axis, i, f64::from(offset) * step - half[axis]);
                    }
                }
                Encoding::F64 => {
                    let center = bounds.center()[axis];
                    for (i, b) in self.data[8 * n * axis..8 * n * (axis + 1)].chunks_exact(8).enumerate() {
                        let b = [b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7]];
                        value(axis, i, f64::from_le_bytes(b) - center);
                    }
                }
            }
        }
    }

    /// Decodes coordinates relative to the centre of the run's position bounds, in `f32`, into the
    /// first `len` elements of `out`.
    #[inline(always)]
    pub fn decode_local(&self, root: RootCell, out: &mut [[f32; RUN_POINTS]; 3]) {
        if self.head.encoding == Encoding::U16 {
            // Exact: a 16-bit integer minus half of one needs at most 17 bits, and the step is a
            // power of two.
            let n = self.head.len();
            let step = self.head.step(root) as f32;
            for axis in 0..3 {
                let half = f32::from(self.head.extent[axis]) * 128.0;
                let column = &self.data[2 * n * axis..2 * n * (axis + 1)];
                for (o, b) in out[axis][..n].iter_mut().zip(column.chunks_exact(2)) {
                    *o = (f32::from(u16::from_le_bytes([b[0], b[1]])) - half) * step;
                }
            }
        } else {
            self.for_each_offset(root, |axis, i, v| out[axis][i] = v as f32);
        }
    }

    /// Decodes the same coordinates in `f64`.
    #[inline]
    pub fn decode_local_f64(&self, root: RootCell, out: &mut [[f64; RUN_POINTS]; 3]) {
        self.for_each_offset(root, |axis, i, v| out[axis][i] = v);
    }

    /// The stored positions in world space.
    #[must_use]
    pub fn positions(&self, root: RootCell) -> Vec<DVec3> {
        let mut local = [[0.0; RUN_POINTS]; 3];
        self.decode_local_f64(root, &mut local);
        let center = self.head.position_bounds(root).center();
        (0..self.head.len()).map(|i| center + DVec3::new(local[0][i], local[1][i], local[2][i])).collect()
    }

    #[inline]
    fn column_start(&self) -> usize {
        (self.head.len() * self.head.encoding.position_bytes()).next_multiple_of(4)
    }

    #[inline]
    fn f32_column(&self, column: usize) -> impl Iterator<Item = f32> + use<'a> {
        let n = self.head.len();
        self.words(self.column_start() + 4 * n * column, n).map(f32::from_le_bytes)
    }

    /// The stored radii, scaled as the header says, if it says that there are any.
    #[inline]
    pub fn radii(&self, header: &Header) -> Option<impl Iterator<Item = f32> + use<'a>> {
        let scale = header.radius_scale;
        header.radius.is_stored().then(|| self.f32_column(0).map(move |radius| radius * scale))
    }

    /// The stored weights, if the header says that there are any.
    #[inline]
    pub fn weights(&self, header: &Header) -> Option<impl Iterator<Item = f32> + use<'a>> {
        header.weight.is_stored().then(|| self.f32_column(usize::from(header.radius.is_stored())))
    }

    /// The display-encoded (sRGB) colours, if the header says that there are any.
    #[inline]
    pub fn colors(&self, header: &Header) -> Option<impl Iterator<Item = [u8; 3]> + use<'a>> {
        let column = usize::from(header.radius.is_stored()) + usize::from(header.weight.is_stored());
        let n = self.head.len();
        header
            .has_color
            .then(|| self.words(self.column_start() + 4 * n * column, n).map(|w| [w[0], w[1], w[2]]))
    }

    /// The bytes of the coefficients of all points, [so many](harmonics::stored_bytes) of each, if
    /// the header says that there are any.
    #[inline]
    pub fn harmonics(&self, header: &Header) -> Option<&'a [u8]> {
        if header.harmonics == 0 {
            return None;
        }
        let n = self.head.len();
        let end = self.column_start() + header.layout_before_shape().run_bytes(n);
        Some(&self.data[end - n * harmonics::stored_bytes(header.harmonics)..end])
    }

    /// The shapes, if the header says that there are any.
    #[inline]
    pub fn shapes(&self, header: &Header) -> Option<impl Iterator<Item = StoredShape> + use<'a>> {
        header.shape?;
        let (n, data) = (self.head.len(), self.data);
        let column_bytes = (2 * n).next_multiple_of(4);
        let first = self.column_start() + header.layout_before_shape().run_bytes(n);
        let word = move |column: usize, i: usize| {
            let at = first + column_bytes * column + 2 * i;
            u16::from_le_bytes([data[at], data[at + 1]])
        };
        Some((0..n).map(move |i| StoredShape(std::array::from_fn(|column| word(column, i)))))
    }

    /// Reads the shapes by columns, into the first `len` elements of each of `out`, if the header
    /// says that there are any. Returns whether it does.
    #[inline]
    pub fn shape_words(&self, header: &Header, out: &mut [[u16; RUN_POINTS]; SHAPE_COLUMNS]) -> bool {
        if header.shape.is_none() {
            return false;
        }
        let n = self.head.len();
        let (column_bytes, first) =
            ((2 * n).next_multiple_of(4), self.column_start() + header.layout_before_shape().run_bytes(n));
        for (column, out) in out.iter_mut().enumerate() {
            let start = first + column_bytes * column;
            let words = self.data[start..start + 2 * n].chunks_exact(2);
            out.iter_mut().zip(words).for_each(|(o, w)| *o = u16::from_le_bytes([w[0], w[1]]));
        }
        true
    }

    /// The details of the points, if the header says that they are no balls.
    #[inline]
    pub fn details(&self, header: &Header) -> Option<impl Iterator<Item = f32> + use<'a>> {
        let shapes = self.shapes(header)?;
        let mut radii = self.radii(header);
        let shared = header.radius.min();
        Some(shapes.map(move |shape| {
            let radius = radii.as_mut().map_or(Some(shared), Iterator::next);
            shape.detail(radius.unwrap_or(shared))
        }))
    }

    /// An attribute column, by its index in the header, rounded to `f32`.
    #[inline]
    pub fn attribute(&self, header: &Header, index: usize) -> impl Iterator<Item = f32> + use<'a> {
        let kind = header.attributes[index].kind;
        self.attribute_bytes(header, index).chunks_exact(kind.bytes()).map(move |b| kind.decode(b) as f32)
    }

    /// The bytes of an attribute column, by its index in the header: values of its own type,
    /// little-endian.
    #[must_use]
    #[inline]
    pub fn attribute_bytes(&self, header: &Header, index: usize) -> &'a [u8] {
        let n = self.head.len();
        let start = self.column_start() + header.column_layout(index).run_bytes(n);
        &self.data[start..start + n * header.attributes[index].kind.bytes()]
    }
}

#[cfg(test)]
mod tests;
