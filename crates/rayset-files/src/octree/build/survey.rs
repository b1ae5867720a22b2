//! What is known of all records before they are sorted: what options and schemas decide, totals
//! over the valid records, and what follows from both.
//!
//! Totals of parts of the records are merged to those of all, whatever the parts: every one of them
//! is a sum of integers, a smallest or a largest number.

use super::columns::{Columns, radius_rule, weight_rule};
use super::depths::Depths;
use super::distinct::{self, Distinct};
use super::error::{BuildError, Quantity, Skipped};
use super::options::{BuildOptions, InvalidPolicy, Rule};
use super::record::{self, KeyMaker, RecordLayout};
use super::shapes_of::ShapesOf;
use crate::octree::format::{AttributeInfo, Column};
use crate::octree::harmonics::stored_bytes;
use crate::octree::layout::{ColumnLayout, RootCell};
use crate::points::{ColumnInfo, PointSource};
use rayset_base::geometry::{Aabb, DVec3};
use rayset_store::container::{HARMONICS, Identity, Metadata, RecordSum, SHAPE, StreamHash};

/// Largest absolute coordinate, radius and weight; its reciprocal is the smallest radius. Their
/// squares are in the range of `f32`.
pub(super) const LIMIT: f64 = 1e18;

/// What options and schemas decide before any record is read.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Form {
    pub(super) layout: RecordLayout,
    pub(super) attributes: Vec<ColumnInfo>,
    /// The radius that all points share; `None` if each record has its own, or one is still to be
    /// measured.
    pub(super) radius: Option<f32>,
    /// Scale factor for radii that are still to be measured.
    pub(super) auto_scale: f64,
    /// What shapes are still to be measured of, with the radii.
    pub(super) shapes_of: ShapesOf,
    pub(super) weight: f32,
    /// Whether copies may become one point, whose weight is the sum of theirs: not if it is so of
    /// any source that they may not.
    pub(super) weights_add: bool,
    /// Everything besides the records on which pages depend.
    pub(super) pages_depend_on: String,
    pub(super) metadata: Metadata,
}

impl Form {
    /// The form of the records of all `sources`, and the columns from which they are made.
    pub(super) fn choose(
        options: &BuildOptions,
        sources: &[Box<dyn PointSource + '_>],
    ) -> Result<(Self, Columns), BuildError> {
        let (radius, weight) = (radius_rule(options, sources), weight_rule(options, sources));
        let columns = Columns::choose(options, &radius, &weight, sources)?;
        let form = Self {
            layout: columns.layout.clone(),
            attributes: columns.infos.clone(),
            radius: if let Rule::Number(r) = radius { Some((r * options.radius_scale) as f32) } else { None },
            auto_scale: options.radius_scale,
            shapes_of: columns.shapes_of,
            weight: if let Rule::Number(w) = weight { (w * options.weight_scale) as f32 } else { 1.0 },
            weights_add: sources.iter().all(|source| source.schema().weights_add),
            pages_depend_on: pages_depend_on(options, &radius, &weight, &columns),
            metadata: describe(sources, options.length_scale),
        };
        Ok((form, columns))
    }
}

/// The definition of automatic radii, which `spacing` measures: clouds of another one have another
/// identity.
const AUTO_RADII: &str = ", 0.85 of the eighth neighbour";

/// The same of the shapes of a fluid.
const FLUID_SHAPES: &str = ", shapes of a fluid by thirty-two";

/// The same of automatic shapes, without normals and with them.
const AUTO_SHAPES: &str = ", shapes by sixteen";
const SHAPES_BY_NORMALS: &str = ", shapes by normals or sixteen";

/// Everything besides the records on which pages depend, so that files that differ in it have
/// different identities.
fn pages_depend_on(options: &BuildOptions, radius: &Rule, weight: &Rule, columns: &Columns) -> String {
    let definition = if *radius == Rule::Auto { AUTO_RADII } else { "" };
    let shapes = match (columns.layout.has_shape, columns.shapes_of) {
        (_, ShapesOf::Fluid) => FLUID_SHAPES,
        (true, ShapesOf::Surfaces) => SHAPES_BY_NORMALS,
        (true, ShapesOf::Nothing) => " shapes",
        (false, ShapesOf::Surfaces) => AUTO_SHAPES,
        (false, ShapesOf::Nothing) => "",
    };
    let harmonics = match columns.layout.harmonics {
        0 => String::new(),
        degree => format!(" harmonics of degree {degree}"),
    };
    format!(
        "radius {radius:?}{definition} {:?} weight {weight:?} {:?} precision {:?} page {:?} color {} columns {:?}{shapes}{harmonics}",
        options.radius_scale,
        options.weight_scale,
        options.precision,
        options.page_bytes,
        columns.layout.has_color,
        columns.infos,
    )
}

/// The descriptions of the sources, their reference system and what is up if they all have the
/// same, and the step of their coordinates.
fn describe(sources: &[Box<dyn PointSource + '_>], length_scale: f64) -> Metadata {
    let crs = sources.first().map_or("", |s| s.schema().crs.as_str());
    let shared = sources.iter().all(|s| s.schema().crs == crs);
    let described = sources.iter().map(|s| s.schema().description.clone()).filter(|d| !d.is_empty());
    let up = sources.first().and_then(|s| s.schema().up);
    let up = up.filter(|_| sources.iter().all(|s| s.schema().up == up)).map(|up| up.to_array());
    let steps = sources.iter().map(|s| s.schema().step.map(|step| step.map(|v| v * length_scale.abs())));
    let step = steps.reduce(Metadata::common_step).flatten();
    Metadata { up, step, ..Metadata::new(if shared { crs } else { "" }, described.collect()) }
}

/// Totals over records.
#[derive(Clone, Debug)]
pub(super) struct Totals {
    /// Number of all records, valid or not.
    pub(super) records: u64,
    /// Number of valid records; the following are of these.
    pub(super) count: u64,
    pub(super) sum: RecordSum,
    pub(super) distinct: Distinct,
    pub(super) skipped: Skipped,
    /// Finite numbers out of range: their count, and the value farthest out of range.
    pub(super) beyond: [(u64, f64); Quantity::ALL.len()],
    pub(super) bounds: Aabb,
    pub(super) radius_range: (f32, f32),
    pub(super) weight_range: (f32, f32),
    /// Records whose shape is not a ball; those with normals, if shapes are measured.
    pub(super) shapes: u64,
    pub(super) depths: Depths,
    pub(super) attribute_ranges: Vec<(f64, f64)>,
}

pub(super) const NO_RANGE: (f32, f32) = (f32::INFINITY, f32::NEG_INFINITY);

fn union(a: (f32, f32), b: (f32, f32)) -> (f32, f32) {
    (a.0.min(b.0), a.1.max(b.1))
}

impl Totals {
    pub(super) fn none(attributes: usize) -> Self {
        Self {
            records: 0,
            count: 0,
            sum: RecordSum::default(),
            distinct: Distinct::default(),
            skipped: Skipped::default(),
            beyond: Quantity::ALL.map(|_| (0, 0.0)),
            bounds: Aabb::EMPTY,
            radius_range: NO_RANGE,
            weight_range: NO_RANGE,
            shapes: 0,
            depths: Depths::default(),
            attribute_ranges: vec![(f64::INFINITY, f64::NEG_INFINITY); attributes],
        }
    }

    /// Includes a valid record.
    pub(super) fn include(&mut self, layout: &RecordLayout, p: DVec3, record: &[u8]) {
        self.count += 1;
        self.distinct.include(self.sum.include(record));
        self.bounds.include(p);
        if layout.has_radius {
            let radius = record::radius(record);
            self.radius_range = union(self.radius_range, (radius, radius));
        }
        if layout.has_weight {
            let weight = record::float(record, layout.weight_at());
            self.weight_range = union(self.weight_range, (weight, weight));
        }
        let mut at = layout.attribute_at(0);
        for (kind, range) in layout.attributes.iter().zip(&mut self.attribute_ranges) {
            let v = kind.decode(&record[at..]);
            at += kind.bytes();
            if v.is_finite() {
                *range = (range.0.min(v), range.1.max(v));
            }
        }
    }

    /// Counts a number that is out of range.
    pub(super) fn note(&mut self, quantity: Quantity, value: f64) {
        self.note_all(quantity, 1, value);
    }

    /// Counts numbers that are out of range, of which `value` is the farthest.
    fn note_all(&mut self, quantity: Quantity, more: u64, value: f64) {
        let (count, farthest) = &mut self.beyond[quantity as usize];
        *farthest = match quantity {
            _ if *count == 0 => value,
            Quantity::SmallRadius => farthest.min(value),
            _ => farthest.max(value),
        };
        *count += more;
    }

    /// Includes other records.
    pub(super) fn merge(&mut self, other: &Self) {
        self.records += other.records;
        self.count += other.count;
        self.sum.merge(other.sum);
        self.distinct.merge(&other.distinct);
        self.skipped.position += other.skipped.position;
        self.skipped.radius += other.skipped.radius;
        self.skipped.weight += other.skipped.weight;
        for quantity in Quantity::ALL {
            let (count, farthest) = other.beyond[quantity as usize];
            if count > 0 {
                self.note_all(quantity, count, farthest);
            }
        }
        self.bounds = self.bounds.union(other.bounds);
        self.radius_range = union(self.radius_range, other.radius_range);
        self.weight_range = union(self.weight_range, other.weight_range);
        self.shapes += other.shapes;
        self.depths.merge(&other.depths);
        for (range, other) in self.attribute_ranges.iter_mut().zip(&other.attribute_ranges) {
            *range = (range.0.min(other.0), range.1.max(other.1));
        }
    }

    /// Numbers out of range are probably valid data in unsuitable units, so they are an error. An
    /// input with records, none of which is valid, is also an error.
    pub(super) fn refuse_unusable(&self, options: &BuildOptions) -> Result<(), BuildError> {
        if options.invalid != InvalidPolicy::SkipAll {
            for quantity in Quantity::ALL {
                let (count, farthest) = self.beyond[quantity as usize];
                if count > 0 {
                    let present = match quantity {
                        Quantity::Weight => options.weight_scale,
                        _ => options.length_scale,
                    };
                    let (records, factor) = (self.records, quantity.factor(farthest, present));
                    return Err(BuildError::OutOfRange { quantity, count, records, farthest, factor });
                }
            }
        }
        if self.count == 0 && self.records > 0 {
            return Err(BuildError::NothingValid { records: self.records, skipped: self.skipped });
        }
        Ok(())
    }
}

/// What is left when copies are merged.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Merged {
    pub(super) points: u64,
    pub(super) weight_range: (f32, f32),
}

/// What is known of radii and shapes once they are measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Settled {
    pub(super) radius_range: (f32, f32),
    /// Whether a point is no ball.
    pub(super) has_shapes: bool,
}

impl Settled {
    /// That of no records.
    pub(super) const NONE: Self = Self { radius_range: NO_RANGE, has_shapes: false };
}

/// What is known of all records.
#[derive(Clone, Debug)]
pub(super) struct Survey {
    pub(super) layout: RecordLayout,
    pub(super) identity: Identity,
    pub(super) metadata: Metadata,
    pub(super) count: u64,
    /// Whether many records may be copies of others.
    pub(super) may_have_copies: bool,
    weights_add: bool,
    pub(super) skipped: Skipped,
    pub(super) bounds: Aabb,
    pub(super) root: RootCell,
    /// The radius that all points share; `None` if each record has its own, or one is still to be
    /// measured.
    pub(super) radius: Option<f32>,
    pub(super) radius_range: (f32, f32),
    /// Scale factor for radii that are still to be measured.
    pub(super) auto_scale: f64,
    /// What shapes are still to be measured of, with the radii.
    pub(super) shapes_of: ShapesOf,
    /// Records that are discs by their normals, if shapes are measured.
    pub(super) normals: u64,
    pub(super) weight: f32,
    pub(super) weight_range: (f32, f32),
    /// Whether shapes are stored: of balls alone they are not.
    pub(super) has_shapes: bool,
    pub(super) depths: Depths,
    pub(super) attributes: Vec<AttributeInfo>,
}

impl Survey {
    pub(super) fn new(form: &Form, totals: &Totals) -> Self {
        let radius_range = form.radius.map_or(totals.radius_range, |r| (r, r));
        Self {
            layout: form.layout.clone(),
            identity: totals.sum.identity(&form.pages_depend_on),
            metadata: form.metadata.clone(),
            count: totals.count,
            may_have_copies: form.weights_add && totals.distinct.may_have_many_copies(totals.count),
            weights_add: form.weights_add,
            skipped: totals.skipped,
            bounds: totals.bounds,
            root: root_cell(&totals.bounds, f64::from(radius_range.1)),
            radius: form.radius,
            radius_range,
            auto_scale: form.auto_scale,
            shapes_of: form.shapes_of,
            normals: if form.shapes_of.are_measured() { totals.shapes } else { 0 },
            weight: form.weight,
            weight_range: totals.weight_range,
            has_shapes: totals.shapes > 0 && !form.shapes_of.are_measured(),
            depths: totals.depths.clone(),
            attributes: (form.attributes.iter().zip(&totals.attribute_ranges))
                .map(|(info, &(min, max))| AttributeInfo {
                    name: info.name.clone(),
                    kind: info.kind,
                    unit: info.unit.clone(),
                    is_class: info.is_class,
                    min: if min <= max { min } else { 0.0 },
                    max: if min <= max { max } else { 0.0 },
                })
                .collect(),
        }
    }

    /// The same once every record has what is measured of it.
    pub(super) fn with_measures(self, settled: Settled) -> Self {
        let layout = self.layout.with_measures(self.shapes_of.are_measured());
        let has_shapes = self.has_shapes || settled.has_shapes;
        Self { layout, radius: None, radius_range: settled.radius_range, has_shapes, ..self }
    }

    /// The same once copies have been merged, and every point has a weight.
    pub(super) fn with_merged_copies(mut self, merged: Merged) -> Self {
        self.metadata.copies = self.count - merged.points;
        // The same records without it are other pages.
        let mut hash = StreamHash::new("copies merged");
        hash.update(&self.identity.0);
        let (identity, weight_range, count) = (hash.identity(), merged.weight_range, merged.points);
        Self { identity, layout: self.layout.with_weight(), weight_range, count, ..self }
    }

    /// Whether so many records are copies of others that they are merged.
    pub(super) fn merges(&self, copies: u64) -> bool {
        self.weights_add && distinct::are_many(copies, self.count)
    }

    /// Whether radii are still to be measured.
    pub(super) fn measures_radii(&self) -> bool {
        self.radius.is_none() && !self.layout.has_radius
    }

    /// Whether records are first sorted along the curve: neighbours are measured there, and copies
    /// follow each other.
    #[cfg(feature = "parts")]
    pub(super) fn follows_curve(&self) -> bool {
        self.measures_radii() || self.may_have_copies
    }

    /// The layout of records that have what is measured of them, if anything is.
    #[cfg(feature = "parts")]
    pub(super) fn measured_layout(&self) -> RecordLayout {
        if self.measures_radii() {
            self.layout.with_measures(self.shapes_of.are_measured())
        } else {
            self.layout.clone()
        }
    }

    /// The keys by which records are sorted along the curve. Owner cells do not matter yet: with a
    /// tiny radius, points are sorted by their Hilbert codes alone.
    pub(super) fn curve_keys(&self) -> KeyMaker {
        KeyMaker { root: self.root, radius: Some(f32::MIN_POSITIVE) }
    }

    /// The keys by which records are put into file order.
    pub(super) fn keys(&self) -> KeyMaker {
        KeyMaker { root: self.root, radius: self.radius }
    }

    /// The metadata of the file, with the features that its reader must know.
    pub(super) fn stored_metadata(&self) -> Metadata {
        let mut metadata = self.metadata.clone();
        if self.has_shapes {
            metadata.features.insert(SHAPE.trailing_zeros().to_string(), "shape".to_owned());
            metadata.required_features |= SHAPE;
        }
        if self.layout.harmonics > 0 {
            metadata.features.insert(HARMONICS.trailing_zeros().to_string(), "harmonics".to_owned());
            metadata.required_features |= HARMONICS;
        }
        metadata
    }

    /// The columns of radius and weight for the header.
    pub(super) fn columns(&self) -> (Column, Column) {
        let radius = settled(self.radius_range.0, self.radius_range.1);
        let weight = if self.layout.has_weight {
            settled(self.weight_range.0, self.weight_range.1)
        } else {
            Column::Constant(self.weight)
        };
        if self.count == 0 { (Column::Constant(1.0), Column::Constant(1.0)) } else { (radius, weight) }
    }

    /// The layout of the columns of runs.
    pub(super) fn column_layout(&self) -> ColumnLayout {
        let (radius, weight) = self.columns();
        let four = [radius.is_stored(), weight.is_stored(), self.layout.has_color];
        let columns = four.iter().filter(|&&stored| stored).fold(ColumnLayout::default(), |l, _| l.with(4));
        let columns = columns.with(stored_bytes(self.layout.harmonics));
        let columns = if self.has_shapes { columns.with_shape() } else { columns };
        self.layout.attributes.iter().fold(columns, |l, kind| l.with(kind.bytes()))
    }
}

/// The kind of a column with this range: a single value is stored only once.
fn settled(min: f32, max: f32) -> Column {
    if min == max { Column::Constant(min) } else { Column::Varying { min, max } }
}

/// The root cell: a cube that contains all positions, with an edge that is a power of two, on a
/// lattice on which run corners are exact.
pub(super) fn root_cell(bounds: &Aabb, radius_max: f64) -> RootCell {
    if bounds.is_empty() {
        return RootCell { min: DVec3::ZERO, size: 1.0 };
    }
    let reach = bounds.min.abs().max_element().max(bounds.max.abs().max_element());
    let extent = bounds.size().max_element();
    let radius = if radius_max.is_finite() && radius_max > 0.0 { radius_max.min(1e18) } else { 0.0 };
    // Large enough that steps of 2⁻³² of it do not fall below the resolution of an `f64` at that
    // distance from the origin.
    let least = extent.max(radius * 1e-6).max(reach * 2_f64.powi(-20)).max(1e-18);
    let mut size = 2_f64.powi(least.log2().ceil() as i32);
    loop {
        let lattice = size * 2_f64.powi(-10);
        let min = (bounds.min / lattice).floor() * lattice;
        if (bounds.max - min).max_element() < size {
            return RootCell { min, size };
        }
        size *= 2.0;
    }
}
