//! The first pass: every record is read once, checked, and written to a temporary file with the data that later passes need.

use super::columns::{Columns, radius_rule, weight_rule};
use super::context::Context;
use super::control::Stage;
use super::depths::Depths;
use super::error::{BuildError, Quantity, Skipped};
use super::options::{BuildOptions, InvalidPolicy, Rule};
use super::record::{self, RecordLayout};
use crate::container::{Identity, Metadata, RecordSum};
use crate::geometry::{Aabb, DVec3};
use crate::octree::format::AttributeInfo;
use crate::octree::layout::RootCell;
use crate::points::{PointBatch, PointSource, ReadError, Values};
use crate::spill::{Spill, SpillWriter};

/// Number of points read at a time.
const BATCH_POINTS: usize = 16 << 10;
/// Largest absolute coordinate, radius and weight; its reciprocal is the smallest radius. Their squares are in the range of
/// `f32`.
pub(super) const LIMIT: f64 = 1e18;

/// The records, and the results of the first pass.
pub(super) struct Ingested {
    pub(super) spill: Spill,
    pub(super) layout: RecordLayout,
    pub(super) identity: Identity,
    pub(super) metadata: Metadata,
    pub(super) count: u64,
    pub(super) skipped: Skipped,
    pub(super) bounds: Aabb,
    pub(super) root: RootCell,
    /// The radius that all points share; `None` if each record has its own, or one is still to be measured.
    pub(super) radius: Option<f32>,
    pub(super) radius_range: (f32, f32),
    /// Scale factor for radii that are still to be measured.
    pub(super) auto_scale: f64,
    pub(super) weight: f32,
    pub(super) weight_range: (f32, f32),
    pub(super) depths: Depths,
    pub(super) attributes: Vec<AttributeInfo>,
}

pub(super) fn run(
    context: &Context<'_>,
    sources: Vec<Box<dyn PointSource + '_>>,
) -> Result<Ingested, BuildError> {
    let options = context.options;
    let (radius_rule, weight_rule) = (radius_rule(options, &sources), weight_rule(options, &sources));
    let columns = Columns::choose(options, &radius_rule, &weight_rule, &sources)?;
    let metadata = describe(&sources);
    let mut writer = SpillWriter::new(context.spill()?, 1 << 20);
    let mut tally = Tally::new(options, &columns);
    let total = sources.iter().map(|s| s.count_hint()).sum::<Option<u64>>().unwrap_or(0);
    let mut batch = PointBatch::default();
    let mut record = Vec::with_capacity(columns.layout.stride());
    let mut done = 0;
    for (input, mut source) in sources.into_iter().enumerate() {
        let selection: Vec<usize> = columns.names.iter().filter_map(|n| source.schema().find(n)).collect();
        source.select(&selection);
        source.watch(&context.control.cancel);
        tally.depth = Depths::number(source.schema());
        let mut index = 0;
        loop {
            match source.fill(&mut batch, BATCH_POINTS) {
                Err(ReadError::Cancelled) if context.is_cancelled() => return Err(BuildError::Cancelled),
                filled => filled?,
            }
            if batch.is_empty() {
                break;
            }
            let whole = |values: &Values| values.len() == batch.len();
            if batch.columns.len() != selection.len() || !batch.columns.iter().all(whole) {
                let (columns, selected) = (batch.columns.len(), selection.len());
                return Err(BuildError::Source { input: input + 1, columns, selected });
            }
            for i in 0..batch.len() {
                match tally.check(&batch, i, &mut record) {
                    Ok(()) => writer.push(&record).map_err(context.io("write temporary files in"))?,
                    Err(what) if options.invalid == InvalidPolicy::Reject => {
                        let index = index + i as u64;
                        return Err(BuildError::InvalidRecord { input: input + 1, index, what });
                    }
                    Err(_) => {}
                }
            }
            index += batch.len() as u64;
            done += batch.len() as u64;
            context.check()?;
            context.progress(Stage::Read, done, total);
        }
    }
    tally.refuse_unusable(done)?;
    let radius =
        if let Rule::Number(r) = radius_rule { Some((r * options.radius_scale) as f32) } else { None };
    let range = radius.map_or(tally.radius_range, |r| (r, r));
    Ok(Ingested {
        spill: writer.finish().map_err(context.io("write temporary files in"))?,
        identity: tally.sum.identity(&pages_depend_on(options, &radius_rule, &weight_rule, &columns)),
        metadata,
        count: tally.count,
        skipped: tally.skipped,
        bounds: tally.bounds,
        root: root_cell(&tally.bounds, f64::from(range.1)),
        radius,
        radius_range: range,
        auto_scale: options.radius_scale,
        weight: if let Rule::Number(w) = weight_rule { (w * options.weight_scale) as f32 } else { 1.0 },
        weight_range: tally.weight_range,
        depths: tally.depths,
        attributes: (columns.infos.iter().zip(&tally.attribute_ranges))
            .map(|(info, &(min, max))| AttributeInfo {
                name: info.name.clone(),
                kind: info.kind,
                unit: info.unit.clone(),
                is_class: info.is_class,
                min: if min <= max { min } else { 0.0 },
                max: if min <= max { max } else { 0.0 },
            })
            .collect(),
        layout: columns.layout,
    })
}

/// The definition of automatic radii, which `spacing` measures: clouds of another one have another identity.
const AUTO_RADII: &str = ", 0.85 of the eighth neighbour";

/// Everything besides the records on which pages depend, so that files that differ in it have different identities.
fn pages_depend_on(options: &BuildOptions, radius: &Rule, weight: &Rule, columns: &Columns) -> String {
    let definition = if *radius == Rule::Auto { AUTO_RADII } else { "" };
    format!(
        "radius {radius:?}{definition} {:?} weight {weight:?} {:?} precision {:?} page {:?} color {} columns {:?}",
        options.radius_scale,
        options.weight_scale,
        options.precision,
        options.page_bytes,
        columns.layout.has_color,
        columns.infos,
    )
}

/// The descriptions of the sources, and their reference system and what is up if they all have the same.
fn describe(sources: &[Box<dyn PointSource + '_>]) -> Metadata {
    let crs = sources.first().map_or("", |s| s.schema().crs.as_str());
    let shared = sources.iter().all(|s| s.schema().crs == crs);
    let described = sources.iter().map(|s| s.schema().description.clone()).filter(|d| !d.is_empty());
    let up = sources.first().and_then(|s| s.schema().up);
    let up = up.filter(|_| sources.iter().all(|s| s.schema().up == up));
    Metadata { up, ..Metadata::new(if shared { crs } else { "" }, described.collect()) }
}

/// Running totals over the valid records.
struct Tally<'a> {
    options: &'a BuildOptions,
    columns: &'a Columns,
    sum: RecordSum,
    count: u64,
    skipped: Skipped,
    /// Finite numbers out of range: their count, and the value farthest out of range.
    beyond: [(u64, f64); Quantity::ALL.len()],
    bounds: Aabb,
    radius_range: (f32, f32),
    weight_range: (f32, f32),
    /// The colour depth of the current source.
    depth: u8,
    depths: Depths,
    attribute_ranges: Vec<(f64, f64)>,
}

const NO_RANGE: (f32, f32) = (f32::INFINITY, f32::NEG_INFINITY);

fn extend(range: &mut (f32, f32), v: f32) {
    range.0 = range.0.min(v);
    range.1 = range.1.max(v);
}

impl<'a> Tally<'a> {
    fn new(options: &'a BuildOptions, columns: &'a Columns) -> Self {
        Self {
            options,
            columns,
            sum: RecordSum::default(),
            count: 0,
            skipped: Skipped::default(),
            beyond: Quantity::ALL.map(|_| (0, 0.0)),
            bounds: Aabb::EMPTY,
            radius_range: NO_RANGE,
            weight_range: NO_RANGE,
            depth: 0,
            depths: Depths::default(),
            attribute_ranges: vec![(f64::INFINITY, f64::NEG_INFINITY); columns.infos.len()],
        }
    }

    /// Checks and counts record `i` of a batch, and encodes it into `record` if it is valid.
    fn check(&mut self, batch: &PointBatch, i: usize, record: &mut Vec<u8>) -> Result<(), String> {
        let columns = self.columns;
        let p = batch.position[i].map(|v| v * self.options.length_scale);
        if !p.iter().all(|v| v.abs() <= LIMIT) {
            self.skipped.position += 1;
            if p.iter().all(|v| v.is_finite()) {
                self.note(Quantity::Position, p.iter().fold(0.0, |far: f64, v| far.max(v.abs())));
            }
            return Err(format!("position {p:?} is not finite or exceeds {LIMIT:e}"));
        }
        record.clear();
        p.iter().for_each(|v| record.extend_from_slice(&(v + 0.0).to_le_bytes()));
        if let Some(column) = columns.radius {
            let r = batch.columns[column].get(i) * self.options.radius_scale * self.options.length_scale;
            if !(1.0 / LIMIT..=LIMIT).contains(&r) {
                self.skipped.radius += 1;
                if r > 0.0 && r.is_finite() {
                    self.note(if r > LIMIT { Quantity::Radius } else { Quantity::SmallRadius }, r);
                }
                return Err(format!("radius {r} is not between {:e} and {LIMIT:e}", 1.0 / LIMIT));
            }
            record.extend_from_slice(&(r as f32).to_le_bytes());
        }
        if let Some(column) = columns.weight {
            let w = batch.columns[column].get(i) * self.options.weight_scale;
            if !(w.abs() <= LIMIT) {
                self.skipped.weight += 1;
                if w.is_finite() {
                    self.note(Quantity::Weight, w.abs());
                }
                return Err(format!("weight {w} is not finite or exceeds {LIMIT:e}"));
            }
            record.extend_from_slice(&(w as f32).to_le_bytes());
        }
        if let Some(color) = columns.color {
            for column in color {
                let v = batch.columns[column].get(i) as f32;
                self.depths.include(self.depth, v);
                record.extend_from_slice(&v.to_le_bytes());
            }
            record.push(self.depth);
        }
        for (column, info) in columns.attributes.iter().zip(&columns.infos) {
            batch.columns[*column].write_as(i, info.kind, record);
        }
        self.include(DVec3::from_array(p), record);
        Ok(())
    }

    fn note(&mut self, quantity: Quantity, value: f64) {
        let (count, farthest) = &mut self.beyond[quantity as usize];
        let first = *count == 0;
        *count += 1;
        *farthest = match quantity {
            Quantity::SmallRadius if !first => farthest.min(value),
            _ if first => value,
            _ => farthest.max(value),
        };
    }

    fn include(&mut self, p: DVec3, record: &[u8]) {
        let layout = &self.columns.layout;
        self.count += 1;
        self.sum.include(record);
        self.bounds.include(p);
        if layout.has_radius {
            extend(&mut self.radius_range, record::radius(record));
        }
        if layout.has_weight {
            extend(&mut self.weight_range, record::float(record, layout.weight_at()));
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

    /// Numbers out of range are probably valid data in unsuitable units, so they are an error. An input with records, none
    /// of which is valid, is also an error.
    fn refuse_unusable(&self, records: u64) -> Result<(), BuildError> {
        if self.options.invalid != InvalidPolicy::SkipAll {
            for quantity in Quantity::ALL {
                let (count, farthest) = self.beyond[quantity as usize];
                if count > 0 {
                    let present = match quantity {
                        Quantity::Weight => self.options.weight_scale,
                        _ => self.options.length_scale,
                    };
                    let factor = quantity.factor(farthest, present);
                    return Err(BuildError::OutOfRange { quantity, count, records, farthest, factor });
                }
            }
        }
        if self.count == 0 && records > 0 {
            return Err(BuildError::NothingValid { records, skipped: self.skipped });
        }
        Ok(())
    }
}

/// The root cell: a cube that contains all positions, with an edge that is a power of two, on a lattice on which run corners
/// are exact.
pub(super) fn root_cell(bounds: &Aabb, radius_max: f64) -> RootCell {
    if bounds.is_empty() {
        return RootCell { min: DVec3::ZERO, size: 1.0 };
    }
    let reach = bounds.min.abs().max_element().max(bounds.max.abs().max_element());
    let extent = bounds.size().max_element();
    let radius = if radius_max.is_finite() && radius_max > 0.0 { radius_max.min(1e18) } else { 0.0 };
    // Large enough that steps of 2⁻³² of it do not fall below the resolution of an `f64` at that distance from the origin.
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
