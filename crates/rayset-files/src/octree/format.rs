//! The metadata of a cloud file, as [`Header`]: the sections `CLOU` (numbers), `COLS` (columns) and
//! `META` (text).
//!
//! `docs/format.md` describes the same tables in prose. The surrounding container format is in
//! [`rayset_store::container`].

use super::aggregates::header::AggregateHeader;
use super::harmonics::{self, MOST_DEGREE};
use super::layout::{ColumnLayout, NodeRef, RUN_HEAD_BYTES, RUN_POINTS, RootCell, nodes_per_page};
use crate::points::ColumnType;
use rayset_base::geometry::{Aabb, DVec3};
use rayset_store::container::{
    BLOCK_BYTES, FileHeader, FileKind, HARMONICS, Identity, OpenError, OpenFile, PAGE_HEAD_BYTES, Reader,
    SHAPE, SectionKind, Writer,
};

/// The first eight bytes of every cloud file.
pub const MAGIC: [u8; 8] = *b"RAYSET\r\n";
/// Largest number of attribute columns.
pub const MAX_ATTRIBUTES: usize = 32;
/// Largest length of an attribute's name, and of its unit, in bytes.
pub const NAME_BYTES: usize = 64;

/// Limits on the radii and weights in a file, slightly wider than those of [`super::build`] because
/// values are rounded.
const LARGEST: f32 = 1.000_001e18;
const LEAST_RADIUS: f32 = 0.999_999e-18;

/// A value that all points share, or one per point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Column {
    /// The value of every point.
    Constant(f32),
    /// Each point has its own value, within these bounds.
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

    /// The column of values multiplied by a factor above 0.
    #[doc(hidden)]
    pub fn scaled(self, factor: f32) -> Self {
        match self {
            Self::Constant(v) => Self::Constant(v * factor),
            Self::Varying { min, max } => Self::Varying { min: min * factor, max: max * factor },
        }
    }

    /// Whether each point stores its own value.
    #[must_use]
    pub fn is_stored(self) -> bool {
        matches!(self, Self::Varying { .. })
    }
}

/// A stored attribute: a column with a name and a type.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(not(feature = "internals"), non_exhaustive)]
pub struct AttributeInfo {
    /// Name, at most 64 bytes.
    pub name: String,
    /// Type of the numbers.
    pub kind: ColumnType,
    /// Unit as named by the source, at most 64 bytes; empty if it names none.
    pub unit: String,
    /// Whether the numbers are class labels, which must not be interpolated.
    pub is_class: bool,
    /// Smallest finite value, rounded to `f64`.
    pub min: f64,
    /// Largest finite value, rounded to `f64`.
    pub max: f64,
}

/// The header of a cloud file.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(not(feature = "internals"), non_exhaustive)]
pub struct Header {
    /// Distinguishes the file from others.
    pub identity: Identity,
    /// Size of a page in bytes, a multiple of 4096.
    pub page_bytes: u32,
    /// Number of pages that hold points; they come first.
    pub point_pages: u32,
    /// Number of pages that hold nodes; they follow the point pages.
    pub node_pages: u32,
    /// Size of the whole file in bytes.
    pub file_bytes: u64,
    /// Number of points stored.
    pub points: u64,
    /// Number of input records that were skipped as invalid.
    pub skipped: u64,
    /// Number of nodes of the octree.
    pub nodes: u64,
    /// The root node, in the last node page. Meaningless if there are no points.
    #[doc(hidden)]
    pub root: NodeRef,
    /// Smallest corner of the root cell, world space.
    pub root_min: DVec3,
    /// Edge length of the root cell, a power of two, world space.
    pub root_size: f64,
    /// Bounds of the stored positions, world space.
    pub bounds: Aabb,
    /// Radius of influence, world space.
    pub radius: Column,
    /// Mean radius.
    pub radius_mean: f64,
    /// Radii are those that are stored, times this: 1, unless
    /// [`Cloud::with_radius_scale`](crate::Cloud::with_radius_scale) made it another.
    pub radius_scale: f32,
    /// Weight.
    pub weight: Column,
    /// Largest distance between a stored position and the original one, world space.
    pub position_error: f64,
    /// The same as a fraction of the point's own radius, of points with shapes of the shortest
    /// semi-axis.
    pub position_error_radii: f64,
    /// Whether points have colours.
    pub has_color: bool,
    /// Degree of the spherical harmonics by which colours change with the direction, 0 to 3.
    pub harmonics: u8,
    /// The least and the largest of the points' details, world space, if each stores a shape;
    /// `None` if all points are balls. See [`details`](Self::details).
    pub shape: Option<(f32, f32)>,
    /// Attribute columns.
    pub attributes: Vec<AttributeInfo>,
    /// Number of bytes of the file that hold the data of points.
    pub point_data_bytes: u64,
    /// Default memory budget for rendering, in bytes; 0 if none is stored.
    pub render_memory: u64,
    /// The coordinate reference system of the positions, as given by the sources; empty if unknown.
    pub crs: String,
    /// Descriptions of the sources, sorted.
    pub sources: Vec<String>,
    /// The direction that is up by the custom of the sources, of length one; `None` if they have
    /// none, or differ.
    pub up: Option<DVec3>,
    /// The step of the coordinates of the sources along each axis, the largest of several: no
    /// digits below it are known. `None` if they do not say.
    pub step: Option<[f64; 3]>,
    /// Points of the sources that were equal to others in everything, and became one with them, of
    /// the sum of their weights.
    pub copies: u64,
    /// The aggregates, if the file has any.
    #[doc(hidden)]
    pub aggregates: Option<AggregateHeader>,
    /// The layout of the columns of a run, derived from the columns.
    #[doc(hidden)]
    pub columns: ColumnLayout,
}

/// The role of a column of the file, and its number there.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Role {
    Radius = 0,
    Weight = 1,
    Color = 2,
    Attribute = 3,
    Shape = 4,
    Harmonics = 5,
}

impl Role {
    const ALL: [Self; 6] =
        [Self::Radius, Self::Weight, Self::Color, Self::Attribute, Self::Shape, Self::Harmonics];

    /// Its place in the order of the columns of a run.
    fn place(self) -> u8 {
        match self {
            Self::Radius => 0,
            Self::Weight => 1,
            Self::Color => 2,
            Self::Harmonics => 3,
            Self::Shape => 4,
            Self::Attribute => 5,
        }
    }
}

const STORED: u8 = 1;
const CLASSES: u8 = 2;

impl Header {
    /// The number of the attribute that a name stands for: a stored one by its index, otherwise a
    /// coordinate, `x`, `y`, and `z` or `height`, by its axis and the number of stored attributes.
    #[must_use]
    pub fn attribute_number(&self, name: &str) -> Option<usize> {
        let axis = || match name {
            "x" => Some(0),
            "y" => Some(1),
            "z" | "height" => Some(2),
            _ => None,
        };
        let stored = self.attributes.iter().position(|attribute| attribute.name == name);
        stored.or_else(|| axis().map(|axis| self.attributes.len() + axis))
    }

    /// The least and the greatest value of the attribute with this
    /// [number](Self::attribute_number).
    ///
    /// Panics if there is none of this number.
    #[must_use]
    pub fn attribute_range(&self, number: usize) -> (f64, f64) {
        match self.attributes.get(number) {
            Some(attribute) => (attribute.min, attribute.max),
            None => {
                let axis = number - self.attributes.len();
                (self.bounds.min[axis], self.bounds.max[axis])
            }
        }
    }

    /// The root cell.
    #[doc(hidden)]
    #[must_use]
    pub fn root_cell(&self) -> RootCell {
        RootCell { min: self.root_min, size: self.root_size }
    }

    /// Offset of a page in the file.
    #[must_use]
    pub fn page_offset(&self, page: u32) -> u64 {
        BLOCK_BYTES as u64 + u64::from(page) * u64::from(self.page_bytes)
    }

    /// Number of all pages.
    #[must_use]
    pub fn pages(&self) -> u32 {
        self.point_pages + self.node_pages + self.aggregates.as_ref().map_or(0, |a| a.pages)
    }

    /// The least and the largest detail of the points: of balls the radius, of ellipsoids twice the
    /// shortest semi-axis if that is less; world space.
    #[must_use]
    pub fn details(&self) -> (f32, f32) {
        self.shape.unwrap_or((self.radius.min(), self.radius.max()))
    }

    /// The layout of the columns of a run, up to and including the first `attributes` attributes.
    #[doc(hidden)]
    #[must_use]
    pub fn column_layout(&self, attributes: usize) -> ColumnLayout {
        let layout = self.layout_before_shape();
        let layout = if self.shape.is_some() { layout.with_shape() } else { layout };
        self.attributes[..attributes].iter().fold(layout, |l, a| l.with(a.kind.bytes()))
    }

    /// The layout of the columns before the shapes.
    #[inline]
    pub(super) fn layout_before_shape(&self) -> ColumnLayout {
        let four = [self.radius.is_stored(), self.weight.is_stored(), self.has_color];
        let layout = four.iter().filter(|&&stored| stored).fold(ColumnLayout::default(), |l, _| l.with(4));
        layout.with(harmonics::stored_bytes(self.harmonics))
    }

    /// Encodes the section `CLOU`.
    #[doc(hidden)]
    pub fn encode_numbers(&self) -> Vec<u8> {
        let mut w = Writer::default();
        for count in [self.points, self.skipped, self.nodes, self.point_data_bytes, self.render_memory] {
            w.u64(count);
        }
        w.u32(self.root.page);
        w.u32(u32::from(self.root.index));
        w.vec(self.root_min);
        w.f64(self.root_size);
        w.vec(self.bounds.min);
        w.vec(self.bounds.max);
        w.f64(self.radius_mean);
        w.f64(self.position_error);
        w.f64(self.position_error_radii);
        w.bytes
    }

    /// Encodes the section `COLS`.
    #[doc(hidden)]
    pub fn encode_columns(&self) -> Vec<u8> {
        let shared = |column: Column| AttributeInfo {
            name: String::new(),
            kind: ColumnType::F32,
            unit: String::new(),
            is_class: false,
            min: column.min().into(),
            max: column.max().into(),
        };
        let mut columns = vec![
            (Role::Radius, self.radius.is_stored(), shared(self.radius)),
            (Role::Weight, self.weight.is_stored(), shared(self.weight)),
        ];
        if self.has_color {
            let color = AttributeInfo { kind: ColumnType::U8, max: 255.0, ..shared(Column::Constant(0.0)) };
            columns.push((Role::Color, true, color));
        }
        if self.harmonics > 0 {
            let degree = shared(Column::Constant(self.harmonics.into()));
            columns.push((Role::Harmonics, true, AttributeInfo { kind: ColumnType::U8, ..degree }));
        }
        if let Some((min, max)) = self.shape {
            let details = shared(Column::Varying { min, max });
            columns.push((Role::Shape, true, AttributeInfo { kind: ColumnType::U16, ..details }));
        }
        columns.extend(self.attributes.iter().map(|a| (Role::Attribute, true, a.clone())));
        let mut w = Writer::default();
        w.u32(columns.len() as u32);
        w.u32(0);
        for (role, is_stored, column) in columns {
            let flags = (STORED * u8::from(is_stored)) | (CLASSES * u8::from(column.is_class));
            w.put(&[role as u8, column.kind.code(), flags, 0]);
            w.put(&[column.name.len() as u8, column.unit.len() as u8, 0, 0]);
            w.f64(column.min);
            w.f64(column.max);
            w.put(column.name.as_bytes());
            w.put(column.unit.as_bytes());
            w.pad(8);
        }
        w.bytes
    }

    /// Reads and checks the sections of an open file.
    ///
    /// # Errors
    /// [`OpenError`] if a section is missing, damaged, or has a value out of range.
    #[doc(hidden)]
    pub fn read(file: &mut OpenFile) -> Result<Self, OpenError> {
        let numbers = file.section(SectionKind::CLOUD)?;
        let columns = file.section(SectionKind::COLUMNS)?;
        let words = file.metadata()?;
        let wrong = |what| file.wrong_section(SectionKind::CLOUD, what);
        let mut header = Self::decode_numbers(&numbers, file.header())
            .ok_or_else(|| wrong("the numbers of the cloud end early"))?;
        let in_columns = |what| file.wrong_section(SectionKind::COLUMNS, what);
        header.decode_columns(&columns).map_err(in_columns)?;
        header.columns = header.column_layout(header.attributes.len());
        (header.up, header.step) = (words.up(), words.step());
        header.copies = words.copies;
        (header.crs, header.sources) = (words.crs, words.sources);
        header.check_ranges(file.header()).map_err(wrong)?;
        header.aggregates = header.read_aggregates(file)?;
        Ok(header)
    }

    /// Reads and checks what the file says of its aggregates, if it has any.
    fn read_aggregates(&self, file: &mut OpenFile) -> Result<Option<AggregateHeader>, OpenError> {
        let Some(pages) = file.header().section(SectionKind::AGGREGATES).copied() else { return Ok(None) };
        let bytes = file.section(SectionKind::AGGREGATE_HEADER)?;
        let wrong = |what| file.wrong_section(SectionKind::AGGREGATE_HEADER, what);
        if self.points == 0 {
            return Err(wrong("aggregates of no points"));
        }
        let first_page = self.point_pages + self.node_pages;
        if first_page.checked_add(pages.pages).is_none() || pages.offset != self.page_offset(first_page) {
            return Err(wrong("the pages of aggregates do not follow those of nodes"));
        }
        let record_bytes = AggregateHeader::bytes_of_record(self.has_color, self.attributes.len());
        AggregateHeader::decode(&bytes, pages.pages, (self.page_bytes, record_bytes)).map(Some).map_err(wrong)
    }

    fn decode_numbers(bytes: &[u8], file: &FileHeader) -> Option<Self> {
        let mut r = Reader::new(bytes);
        let pages = |kind| file.section(kind).map_or(0, |s| s.pages);
        Some(Self {
            identity: file.identity,
            page_bytes: file.page_bytes,
            point_pages: pages(SectionKind::POINTS),
            node_pages: pages(SectionKind::NODES),
            file_bytes: file.file_bytes,
            points: r.u64()?,
            skipped: r.u64()?,
            nodes: r.u64()?,
            point_data_bytes: r.u64()?,
            render_memory: r.u64()?,
            root: NodeRef { page: r.u32()?, index: u16::try_from(r.u32()?).ok()? },
            root_min: r.vec()?,
            root_size: r.f64()?,
            bounds: Aabb::new(r.vec()?, r.vec()?),
            radius_mean: r.f64()?,
            radius_scale: 1.0,
            position_error: r.f64()?,
            position_error_radii: r.f64()?,
            radius: Column::Constant(1.0),
            weight: Column::Constant(1.0),
            has_color: false,
            harmonics: 0,
            shape: None,
            attributes: Vec::new(),
            crs: String::new(),
            sources: Vec::new(),
            up: None,
            step: None,
            copies: 0,
            aggregates: None,
            columns: ColumnLayout::default(),
        })
    }

    fn decode_columns(&mut self, bytes: &[u8]) -> Result<(), &'static str> {
        const EARLY: &str = "the list of columns ends early";
        let mut r = Reader::new(bytes);
        let count = r.u32().ok_or(EARLY)?;
        r.u32().ok_or(EARLY)?;
        let mut seen: Option<Role> = None;
        let (mut has_radius, mut has_weight) = (false, false);
        for _ in 0..count {
            let [role, kind, flags, _]: [u8; 4] = r.take().ok_or(EARLY)?;
            let [name, unit, _, _]: [u8; 4] = r.take().ok_or(EARLY)?;
            let (min, max) = (r.f64().ok_or(EARLY)?, r.f64().ok_or(EARLY)?);
            let mut text = |length: u8| {
                let bytes = r.slice(length.into()).ok_or(EARLY)?;
                std::str::from_utf8(bytes).map(str::to_owned).map_err(|_| "the name of a column is no text")
            };
            let (name, unit) = (text(name)?, text(unit)?);
            r.at = r.at.next_multiple_of(8).min(bytes.len());
            let role = *Role::ALL.get(usize::from(role)).ok_or("a column for an unknown purpose")?;
            let kind = *ColumnType::ALL.get(usize::from(kind)).ok_or("a column of an unknown type")?;
            let is_stored = flags & STORED != 0;
            // The columns of a run are stored in this order, and the code that locates them relies
            // on it.
            if seen.is_some_and(|before| {
                before.place() > role.place() || (before == role && role != Role::Attribute)
            }) {
                return Err(
                    "the columns are not in the order radius, weight, colour, harmonics, shape, attributes",
                );
            }
            seen = Some(role);
            if !(min <= max) {
                return Err("the smallest value of a column exceeds the largest");
            }
            let expected = match role {
                Role::Radius | Role::Weight => ColumnType::F32,
                Role::Color | Role::Harmonics => ColumnType::U8,
                Role::Shape => ColumnType::U16,
                Role::Attribute => kind,
            };
            let may_be_shared = matches!(role, Role::Radius | Role::Weight);
            if kind != expected || (!is_stored && !may_be_shared) {
                return Err(
                    "a column of a type, or shared by all points, where its purpose does not allow it",
                );
            }
            if name.len() > NAME_BYTES || unit.len() > NAME_BYTES {
                return Err("the name or unit of a column has more than 64 bytes");
            }
            let shared = match is_stored {
                true => Column::Varying { min: min as f32, max: max as f32 },
                false => Column::Constant(min as f32),
            };
            match role {
                Role::Radius => (self.radius, has_radius) = (shared, true),
                Role::Weight => (self.weight, has_weight) = (shared, true),
                Role::Color => self.has_color = is_stored,
                Role::Harmonics if !(min == max && (1.0..=f64::from(MOST_DEGREE)).contains(&min)) => {
                    return Err("harmonics of another degree than 1, 2 or 3");
                }
                Role::Harmonics => self.harmonics = min as u8,
                Role::Shape => self.shape = Some((min as f32, max as f32)),
                Role::Attribute if self.attributes.iter().any(|a| a.name == name) => {
                    return Err("two attributes of one name");
                }
                Role::Attribute => {
                    let is_class = flags & CLASSES != 0;
                    self.attributes.push(AttributeInfo { name, kind, unit, is_class, min, max });
                }
            }
            if self.attributes.len() > MAX_ATTRIBUTES {
                return Err("more than 32 attributes");
            }
        }
        if has_radius && has_weight { Ok(()) } else { Err("the columns of radius and weight are missing") }
    }

    fn check_ranges(&self, file: &FileHeader) -> Result<(), &'static str> {
        debug_assert_eq!(file.kind, FileKind::Cloud);
        if self.shape.is_some() != (file.required_features & SHAPE != 0) {
            return Err("shapes of points without the feature that they require, or the reverse");
        }
        if (self.harmonics > 0) != (file.required_features & HARMONICS != 0) {
            return Err("harmonics without the feature that they require, or the reverse");
        }
        if self.harmonics > 0 && !self.has_color {
            return Err("harmonics of points without colours");
        }
        let in_place = |kind, first_page: u32| {
            file.section(kind).is_none_or(|s| s.offset == self.page_offset(first_page))
        };
        if self.point_pages.checked_add(self.node_pages).is_none() {
            return Err("more than 4294967295 pages");
        }
        if !in_place(SectionKind::POINTS, 0) || !in_place(SectionKind::NODES, self.point_pages) {
            return Err("the pages of points and of nodes do not stand first, one behind the other");
        }
        if self.points > 0 && self.root.page >= self.node_pages {
            return Err("the root is in no node page");
        }
        // The cost of traversing the tree is bounded by these numbers, so they must not exceed what
        // the pages can hold.
        let runs_in_page = (self.page_bytes as usize - PAGE_HEAD_BYTES) / RUN_HEAD_BYTES;
        if self.points > u64::from(self.point_pages) * (runs_in_page * RUN_POINTS) as u64 {
            return Err("more points than the pages can hold");
        }
        if self.nodes > u64::from(self.node_pages) * nodes_per_page(self.page_bytes as usize) as u64 {
            return Err("more nodes than the pages can hold");
        }
        let power_of_two = self.root_size.to_bits().trailing_zeros() >= 52;
        if !power_of_two {
            return Err("the edge of the root cell is no power of two");
        }
        let errors = [self.position_error, self.position_error_radii];
        if !errors.iter().all(|e| (0.0..f64::INFINITY).contains(e)) {
            return Err("the largest error of positions is no number");
        }
        let ordered = (0..3).all(|axis| self.bounds.min[axis] <= self.bounds.max[axis]);
        if !ordered {
            return Err("the smallest coordinate exceeds the largest");
        }
        let finite = self.root_min.is_finite()
            && self.root_size.is_finite()
            && self.root_size > 0.0
            && (self.points == 0 || (self.bounds.min.is_finite() && self.bounds.max.is_finite()))
            && self.radius.min() >= LEAST_RADIUS
            && self.radius.max() <= LARGEST
            && self.radius_mean > 0.0
            && self.radius_mean.is_finite()
            && self.weight.min() >= -LARGEST
            && self.weight.max() <= LARGEST
            && self.shape.is_none_or(|(least, most)| least > 0.0 && most <= self.radius.max());
        if !finite {
            return Err("bounds, radii or weights are out of their ranges");
        }
        if self.attributes.iter().any(|a| !a.min.is_finite() || !a.max.is_finite()) {
            return Err("the range of an attribute is not finite");
        }
        Ok(())
    }
}
