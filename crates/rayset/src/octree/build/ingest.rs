//! The first pass: every record is read once, checked, and written to a temporary file with what later passes need.

use super::record::RecordLayout;
use super::{BuildError, BuildOptions, Context, InvalidPolicy, Rule, Skipped, Stage};
use crate::geometry::{Aabb, DVec3};
use crate::octree::page::RootCell;
use crate::points::{ColorDepth, PointBatch, PointSource};
use crate::spill::{Spill, SpillWriter};

/// Points read at a time.
const BATCH_POINTS: usize = 16 << 10;
/// Largest coordinate, radius and weight; 1 over it is the smallest radius. Squares of these fit an `f32`.
const LIMIT: f64 = 1e18;

/// The records, and what the first pass learnt about them.
pub(super) struct Ingested {
    pub(super) spill: Spill,
    pub(super) layout: RecordLayout,
    pub(super) count: u64,
    pub(super) skipped: Skipped,
    pub(super) bounds: Aabb,
    pub(super) root: RootCell,
    /// The radius that all points share; `None` where records have their own, or are to get one.
    pub(super) radius: Option<f32>,
    pub(super) radius_range: (f32, f32),
    pub(super) radius_sum: f64,
    /// Factor on radii that are still to be measured.
    pub(super) auto_scale: f64,
    pub(super) weight: f32,
    pub(super) weight_range: (f32, f32),
    /// Factor that takes the colours of the records to 0–1.
    pub(super) color_scale: f32,
    pub(super) attribute_ranges: Vec<(String, f32, f32)>,
}

/// Which columns of the sources make which columns of a record.
struct Columns {
    layout: RecordLayout,
    /// Names without repetition: what the sources are asked for.
    names: Vec<String>,
    /// For each column of a record, its place in `names`.
    from: Vec<usize>,
    radius_scale: f64,
    weight_scale: f64,
}

pub(super) fn run(context: &Context<'_>, sources: Vec<Box<dyn PointSource>>) -> Result<Ingested, BuildError> {
    let options = context.options;
    let radius_rule = radius_rule(options, &sources);
    let columns = choose_columns(options, &radius_rule, &sources)?;
    let mut writer = SpillWriter::new(context.spill()?, 1 << 20);
    let mut tally = Tally::new(&columns.layout);
    let total = sources.iter().map(|s| s.count_hint()).sum::<Option<u64>>().unwrap_or(0);
    let mut color_depth = ColorDepth::Unit;
    let mut batch = PointBatch::default();
    let mut record = Vec::with_capacity(columns.layout.stride());
    let mut done = 0;
    for (input, mut source) in sources.into_iter().enumerate() {
        let selection: Vec<usize> = columns.names.iter().filter_map(|n| source.schema().find(n)).collect();
        source.select(&selection);
        color_depth = source.schema().color_depth;
        let mut index = 0;
        loop {
            source.fill(&mut batch, BATCH_POINTS)?;
            if batch.is_empty() {
                break;
            }
            for i in 0..batch.len() {
                match tally.check(&columns, &batch, i, &mut record) {
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
            context.progress.update(Stage::Read, done, total);
        }
    }
    let radius = match radius_rule {
        Rule::Number(r) => Some(r as f32),
        _ => None,
    };
    let range = if let Some(r) = radius { (r, r) } else { tally.radius_range };
    Ok(Ingested {
        spill: writer.finish().map_err(context.io("write temporary files in"))?,
        count: tally.count,
        skipped: tally.skipped,
        bounds: tally.bounds,
        root: root_cell(&tally.bounds, f64::from(range.1)),
        radius,
        radius_range: range,
        radius_sum: radius.map_or(tally.radius_sum, |r| f64::from(r) * tally.count as f64),
        auto_scale: if let Rule::Auto { scale } = radius_rule { scale } else { 1.0 },
        weight: if let Some(Rule::Number(w)) = options.weight { w as f32 } else { 1.0 },
        weight_range: tally.weight_range,
        color_scale: color_scale(color_depth, tally.color_max),
        attribute_ranges: (options.attributes.iter().cloned().zip(&tally.attribute_ranges))
            .map(|(name, &(min, max))| if min <= max { (name, min, max) } else { (name, 0.0, 0.0) })
            .collect(),
        layout: columns.layout,
    })
}

fn radius_rule(options: &BuildOptions, sources: &[Box<dyn PointSource>]) -> Rule {
    let all_have = |name: &str| sources.iter().all(|s| s.schema().find(name).is_some());
    match &options.radius {
        Some(rule) => rule.clone(),
        None if all_have("radius") => Rule::Attribute { name: "radius".into(), scale: 1.0 },
        None => Rule::Auto { scale: 1.0 },
    }
}

fn choose_columns(
    options: &BuildOptions,
    radius: &Rule,
    sources: &[Box<dyn PointSource>],
) -> Result<Columns, BuildError> {
    let all_have = |name: &str| sources.iter().all(|s| s.schema().find(name).is_some());
    let mut names = Vec::new();
    let mut radius_scale = 1.0;
    if let Rule::Attribute { name, scale } = radius {
        names.push(name.clone());
        radius_scale = *scale;
    }
    let (mut weight_scale, mut has_weight) = (1.0, false);
    match &options.weight {
        Some(Rule::Attribute { name, scale }) => {
            names.push(name.clone());
            (weight_scale, has_weight) = (*scale, true);
        }
        None if all_have("weight") => {
            names.push("weight".into());
            has_weight = true;
        }
        _ => {}
    }
    let has_color = options.keep_color && ["red", "green", "blue"].iter().all(|c| all_have(c));
    if has_color {
        names.extend(["red", "green", "blue"].map(str::to_owned));
    }
    names.extend(options.attributes.iter().cloned());
    for (input, source) in sources.iter().enumerate() {
        for name in &names {
            if source.schema().find(name).is_none() {
                let available = source.schema().names().collect::<Vec<_>>().join(", ");
                let available = if available.is_empty() { "x, y, z only".to_owned() } else { available };
                return Err(BuildError::NoSuchColumn { input: input + 1, name: name.clone(), available });
            }
        }
    }
    let layout = RecordLayout {
        has_radius: matches!(radius, Rule::Attribute { .. }),
        has_weight,
        has_color,
        attributes: options.attributes.len(),
    };
    let mut unique: Vec<String> = Vec::new();
    let mut from = Vec::new();
    for name in names {
        let place = unique.iter().position(|u| *u == name).unwrap_or(unique.len());
        if place == unique.len() {
            unique.push(name);
        }
        from.push(place);
    }
    Ok(Columns { layout, names: unique, from, radius_scale, weight_scale })
}

/// Running totals over the valid records.
struct Tally {
    count: u64,
    skipped: Skipped,
    bounds: Aabb,
    radius_range: (f32, f32),
    radius_sum: f64,
    weight_range: (f32, f32),
    color_max: f32,
    attribute_ranges: Vec<(f32, f32)>,
}

const NO_RANGE: (f32, f32) = (f32::INFINITY, f32::NEG_INFINITY);

fn extend(range: &mut (f32, f32), v: f32) {
    range.0 = range.0.min(v);
    range.1 = range.1.max(v);
}

impl Tally {
    fn new(layout: &RecordLayout) -> Self {
        Self {
            count: 0,
            skipped: Skipped::default(),
            bounds: Aabb::EMPTY,
            radius_range: NO_RANGE,
            radius_sum: 0.0,
            weight_range: NO_RANGE,
            color_max: 0.0,
            attribute_ranges: vec![NO_RANGE; layout.attributes],
        }
    }

    /// Checks record `i` of a batch; counts it, and encodes it into `record` if it is valid.
    fn check(
        &mut self,
        columns: &Columns,
        batch: &PointBatch,
        i: usize,
        record: &mut Vec<u8>,
    ) -> Result<(), String> {
        let layout = &columns.layout;
        let p = batch.position[i];
        if !p.iter().all(|v| v.abs() <= LIMIT) {
            self.skipped.position += 1;
            return Err(format!("position {p:?} is not finite or exceeds {LIMIT:e}"));
        }
        record.clear();
        p.iter().for_each(|v| record.extend_from_slice(&(v + 0.0).to_le_bytes()));
        let mut next = 0;
        let mut value = || {
            next += 1;
            batch.columns[columns.from[next - 1]].get(i) as f32
        };
        if layout.has_radius {
            let r = (f64::from(value()) * columns.radius_scale) as f32;
            if !(f64::from(r) >= 1.0 / LIMIT && f64::from(r) <= LIMIT) {
                self.skipped.radius += 1;
                return Err(format!("radius {r} is not between {:e} and {LIMIT:e}", 1.0 / LIMIT));
            }
            record.extend_from_slice(&r.to_le_bytes());
        }
        if layout.has_weight {
            let w = (f64::from(value()) * columns.weight_scale) as f32;
            if !(f64::from(w).abs() <= LIMIT) {
                self.skipped.weight += 1;
                return Err(format!("weight {w} is not finite or exceeds {LIMIT:e}"));
            }
            record.extend_from_slice(&w.to_le_bytes());
        }
        for _ in 0..3 * usize::from(layout.has_color) + layout.attributes {
            let v = value();
            record.extend_from_slice(&v.to_le_bytes());
        }
        self.include(layout, DVec3::from_array(p), record);
        Ok(())
    }

    fn include(&mut self, layout: &RecordLayout, p: DVec3, record: &[u8]) {
        use super::record::column;
        self.count += 1;
        self.bounds.include(p);
        if layout.has_radius {
            let r = column(record, 0);
            extend(&mut self.radius_range, r);
            self.radius_sum += f64::from(r);
        }
        if layout.has_weight {
            extend(&mut self.weight_range, column(record, layout.weight_column()));
        }
        if layout.has_color {
            for channel in 0..3 {
                self.color_max = self.color_max.max(column(record, layout.color_column() + channel));
            }
        }
        for index in 0..layout.attributes {
            let v = column(record, layout.attribute_column(index));
            if v.is_finite() {
                extend(&mut self.attribute_ranges[index], v);
            }
        }
    }
}

fn color_scale(depth: ColorDepth, max: f32) -> f32 {
    match depth {
        ColorDepth::Unit => 1.0,
        ColorDepth::Byte => 1.0 / 255.0,
        ColorDepth::Word => 1.0 / 65535.0,
        ColorDepth::Guess if max <= 1.0 => 1.0,
        ColorDepth::Guess if max <= 255.0 => 1.0 / 255.0,
        ColorDepth::Guess => 1.0 / 65535.0,
    }
}

/// The root cell: a power of two that holds all positions, on a lattice on which run corners are exact.
pub(super) fn root_cell(bounds: &Aabb, radius_max: f64) -> RootCell {
    if bounds.is_empty() {
        return RootCell { min: DVec3::ZERO, size: 1.0 };
    }
    let reach = bounds.min.abs().max_element().max(bounds.max.abs().max_element());
    let extent = bounds.size().max_element();
    let radius = if radius_max.is_finite() && radius_max > 0.0 { radius_max.min(1e18) } else { 0.0 };
    // Not so small that steps of 2⁻³² of it would fall below the resolution of an f64 at that distance.
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
