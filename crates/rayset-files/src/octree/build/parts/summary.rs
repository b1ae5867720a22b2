//! What a part of `read` says of its records, as JSON; floating-point numbers as their bits, so
//! that they stay what they are.

use super::super::depths::{ColorValues, Depths};
use super::super::distinct::Distinct;
use super::super::error::Skipped;
use super::super::options::{BuildOptions, InvalidPolicy, Precision};
use super::super::record::RecordLayout;
use super::super::shapes_of::ShapesOf;
use super::super::survey::{Form, Totals};
use crate::points::{ColumnInfo, ColumnType};
use rayset_base::geometry::{Aabb, DVec3};
use rayset_store::container::{Metadata, RecordSum};

/// The totals of a part's records, and everything else that later steps need to know.
#[derive(Clone, Debug, PartialEq, serde::Deserialize, serde::Serialize)]
pub(super) struct Summary {
    /// Resources, by which the records are divided so that each of the parts can hold its own.
    pub(super) memory_bytes: u64,
    pub(super) threads: usize,
    pub(super) choices: Choices,
    form: StoredForm,
    totals: StoredTotals,
}

/// The options that later steps need, besides resources.
#[derive(Clone, Debug, PartialEq, serde::Deserialize, serde::Serialize)]
pub(super) struct Choices {
    /// 0 for exact positions.
    precision: u64,
    page_bytes: Option<u32>,
    render_memory: Option<u64>,
    skip_all: bool,
    length_scale: u64,
    weight_scale: u64,
}

#[derive(Clone, Debug, PartialEq, serde::Deserialize, serde::Serialize)]
struct StoredForm {
    has_radius: bool,
    has_shape: bool,
    has_weight: bool,
    has_color: bool,
    harmonics: u8,
    attributes: Vec<StoredColumn>,
    radius: Option<u32>,
    auto_scale: u64,
    /// The number of what shapes are measured of.
    shapes_of: usize,
    weight: u32,
    weights_add: bool,
    pages_depend_on: String,
    crs: String,
    sources: Vec<String>,
    up: Option<[u64; 3]>,
    step: Option<[u64; 3]>,
}

#[derive(Clone, Debug, PartialEq, serde::Deserialize, serde::Serialize)]
struct StoredColumn {
    name: String,
    /// The name of its type.
    kind: String,
    unit: String,
    is_class: bool,
}

#[derive(Clone, Debug, PartialEq, serde::Deserialize, serde::Serialize)]
struct StoredTotals {
    records: u64,
    count: u64,
    sum: [u64; 3],
    /// [`Distinct::to_text`].
    distinct: String,
    skipped: [u64; 3],
    beyond: [(u64, u64); 4],
    bounds: [u64; 6],
    radius_range: (u32, u32),
    weight_range: (u32, u32),
    shapes: u64,
    depths: StoredDepths,
    attribute_ranges: Vec<(u64, u64)>,
}

/// What is known of colours; of each source that states no depth its number, type, largest value,
/// whether it has fractions, and its number of points.
#[derive(Clone, Debug, PartialEq, serde::Deserialize, serde::Serialize)]
struct StoredDepths {
    guessed: Vec<(u32, u8, u32, bool, u64)>,
    intensities: Vec<(u16, u64)>,
    plain: u64,
    has_stated: bool,
}

impl StoredDepths {
    fn of(depths: &Depths) -> Self {
        let guessed = depths.guessed.iter().map(|(number, seen)| {
            (*number, seen.family, seen.largest.to_bits(), seen.has_fractions, seen.points)
        });
        Self {
            guessed: guessed.collect(),
            intensities: depths.intensities.iter().map(|(bucket, points)| (*bucket, *points)).collect(),
            plain: depths.plain,
            has_stated: depths.has_stated,
        }
    }

    fn restored(&self) -> Depths {
        let guessed = self.guessed.iter().map(|&(number, family, largest, has_fractions, points)| {
            (number, ColorValues { family, largest: f32::from_bits(largest), has_fractions, points })
        });
        Depths {
            guessed: guessed.collect(),
            intensities: self.intensities.iter().copied().collect(),
            plain: self.plain,
            has_stated: self.has_stated,
        }
    }
}

impl Summary {
    pub(super) fn new(options: &BuildOptions, form: &Form, totals: &Totals) -> Self {
        Self {
            memory_bytes: options.memory_bytes,
            threads: options.threads.max(1),
            choices: Choices::of(options),
            form: StoredForm::of(form),
            totals: StoredTotals::of(totals),
        }
    }

    /// The form of the records; `None` if it makes no sense.
    pub(super) fn form(&self) -> Option<Form> {
        self.form.restored()
    }

    pub(super) fn totals(&self) -> Totals {
        self.totals.restored()
    }
}

impl Choices {
    fn of(options: &BuildOptions) -> Self {
        Self {
            precision: if let Precision::Relative(p) = options.precision { p.to_bits() } else { 0 },
            page_bytes: options.page_bytes,
            render_memory: options.render_memory,
            skip_all: options.invalid == InvalidPolicy::SkipAll,
            length_scale: options.length_scale.to_bits(),
            weight_scale: options.weight_scale.to_bits(),
        }
    }

    /// Options with these choices, and the resources of others.
    pub(super) fn with_resources(&self, resources: &BuildOptions) -> BuildOptions {
        let precision = match self.precision {
            0 => Precision::Exact,
            bits => Precision::Relative(f64::from_bits(bits)),
        };
        BuildOptions {
            precision,
            page_bytes: self.page_bytes,
            render_memory: self.render_memory,
            invalid: if self.skip_all { InvalidPolicy::SkipAll } else { InvalidPolicy::Skip },
            length_scale: f64::from_bits(self.length_scale),
            weight_scale: f64::from_bits(self.weight_scale),
            memory_bytes: resources.memory_bytes,
            threads: resources.threads,
            temp_dir: resources.temp_dir.clone(),
            ..BuildOptions::default()
        }
    }
}

impl StoredForm {
    fn of(form: &Form) -> Self {
        let column = |info: &ColumnInfo| StoredColumn {
            name: info.name.clone(),
            kind: info.kind.name().to_owned(),
            unit: info.unit.clone(),
            is_class: info.is_class,
        };
        Self {
            has_radius: form.layout.has_radius,
            has_shape: form.layout.has_shape,
            has_weight: form.layout.has_weight,
            has_color: form.layout.has_color,
            harmonics: form.layout.harmonics,
            attributes: form.attributes.iter().map(column).collect(),
            radius: form.radius.map(f32::to_bits),
            auto_scale: form.auto_scale.to_bits(),
            shapes_of: form.shapes_of as usize,
            weight: form.weight.to_bits(),
            weights_add: form.weights_add,
            pages_depend_on: form.pages_depend_on.clone(),
            crs: form.metadata.crs.clone(),
            sources: form.metadata.sources.clone(),
            up: form.metadata.up.map(|up| up.map(f64::to_bits)),
            step: form.metadata.step.map(|step| step.map(f64::to_bits)),
        }
    }

    fn restored(&self) -> Option<Form> {
        let column = |column: &StoredColumn| {
            let kind = *ColumnType::ALL.iter().find(|kind| kind.name() == column.kind)?;
            let (name, unit) = (column.name.clone(), column.unit.clone());
            Some(ColumnInfo { name, kind, unit, is_class: column.is_class })
        };
        let attributes = self.attributes.iter().map(column).collect::<Option<Vec<_>>>()?;
        let layout = RecordLayout {
            has_radius: self.has_radius,
            has_shape: self.has_shape,
            has_weight: self.has_weight,
            has_color: self.has_color,
            harmonics: self.harmonics,
            attributes: attributes.iter().map(|info| info.kind).collect(),
        };
        let [up, step] = [self.up, self.step].map(|vector| vector.map(|v| v.map(f64::from_bits)));
        Some(Form {
            layout,
            attributes,
            radius: self.radius.map(f32::from_bits),
            auto_scale: f64::from_bits(self.auto_scale),
            shapes_of: *ShapesOf::ALL.get(self.shapes_of)?,
            weight: f32::from_bits(self.weight),
            weights_add: self.weights_add,
            pages_depend_on: self.pages_depend_on.clone(),
            metadata: Metadata { up, step, ..Metadata::new(&self.crs, self.sources.clone()) },
        })
    }
}

impl StoredTotals {
    fn of(totals: &Totals) -> Self {
        let (min, max) = (totals.bounds.min.to_array(), totals.bounds.max.to_array());
        let bits = |(a, b): (f32, f32)| (a.to_bits(), b.to_bits());
        Self {
            records: totals.records,
            count: totals.count,
            sum: totals.sum.to_words(),
            distinct: totals.distinct.to_text(),
            skipped: [totals.skipped.position, totals.skipped.radius, totals.skipped.weight],
            beyond: totals.beyond.map(|(count, farthest)| (count, farthest.to_bits())),
            bounds: [min[0], min[1], min[2], max[0], max[1], max[2]].map(f64::to_bits),
            radius_range: bits(totals.radius_range),
            weight_range: bits(totals.weight_range),
            shapes: totals.shapes,
            depths: StoredDepths::of(&totals.depths),
            attribute_ranges: (totals.attribute_ranges.iter())
                .map(|(min, max)| (min.to_bits(), max.to_bits()))
                .collect(),
        }
    }

    fn restored(&self) -> Totals {
        let [a, b, c, d, e, f] = self.bounds.map(f64::from_bits);
        let floats = |(a, b): (u32, u32)| (f32::from_bits(a), f32::from_bits(b));
        let [position, radius, weight] = self.skipped;
        Totals {
            records: self.records,
            count: self.count,
            sum: RecordSum::from_words(self.sum),
            distinct: Distinct::from_text(&self.distinct),
            skipped: Skipped { position, radius, weight },
            beyond: self.beyond.map(|(count, farthest)| (count, f64::from_bits(farthest))),
            bounds: Aabb { min: DVec3::new(a, b, c), max: DVec3::new(d, e, f) },
            radius_range: floats(self.radius_range),
            weight_range: floats(self.weight_range),
            shapes: self.shapes,
            depths: self.depths.restored(),
            attribute_ranges: (self.attribute_ranges.iter())
                .map(|&(min, max)| (f64::from_bits(min), f64::from_bits(max)))
                .collect(),
        }
    }
}
