//! The first pass: every record is read once, checked, and written to a temporary file with the
//! data that later passes need.

use super::columns::{ColorOrigin, Columns};
use super::context::Context;
use super::control::Stage;
use super::error::{BuildError, Quantity};
use super::neighbourhood::disc;
use super::options::{BuildOptions, InvalidPolicy};
use super::survey::{Form, LIMIT, Survey, Totals};
use crate::octree::harmonics::{CHANNELS, CONSTANT, encode, stored_bytes};
use crate::octree::shape::StoredShape;
use crate::points::{PointBatch, PointSource, ReadError, ShapeOrigin, Values};
use rayset_base::geometry::{DQuat, DVec3, Shape};
use rayset_store::spill::{Spill, SpillWriter};

/// Number of points read at a time.
const BATCH_POINTS: usize = 16 << 10;

/// The records, and what is known of them.
pub(super) struct Ingested {
    pub(super) spill: Spill,
    pub(super) survey: Survey,
}

pub(super) fn run(
    context: &Context<'_>,
    sources: Vec<Box<dyn PointSource + '_>>,
) -> Result<Ingested, BuildError> {
    let (form, columns) = Form::choose(context.options, &sources)?;
    let mut writer = SpillWriter::new(context.spill()?, 1 << 20);
    let stretches: Vec<_> = sources.into_iter().enumerate().map(Stretch::whole).collect();
    let mut reader = Reader::new(context, &columns, &stretches);
    for stretch in stretches {
        let (input, mark) = (stretch.input, writer.mark());
        let read = reader
            .read(stretch, &mut |record| writer.push(record).map_err(context.io("write temporary files in")));
        match (read, context.control.leaves_out) {
            (Err(BuildError::Read(error)), Some(leaves_out)) if leaves_out(input, &error) => {
                // As if it had not been there: pages must not depend on how far it could be read.
                writer.rewind(mark);
            }
            (read, _) => read?,
        }
    }
    let totals = reader.totals;
    totals.refuse_unusable(context.options)?;
    let spill = writer.finish().map_err(context.io("write temporary files in"))?;
    Ok(Ingested { spill, survey: Survey::new(&form, &totals) })
}

/// Consecutive records of a source.
pub(super) struct Stretch<'s> {
    /// The number of the source, from 0.
    pub(super) input: usize,
    pub(super) source: Box<dyn PointSource + 's>,
    pub(super) first: u64,
    /// One past the last; `None` for all that there are.
    pub(super) end: Option<u64>,
}

impl<'s> Stretch<'s> {
    /// All records of a source.
    pub(super) fn whole((input, source): (usize, Box<dyn PointSource + 's>)) -> Self {
        Self { input, source, first: 0, end: None }
    }

    /// The number of its records, as far as the source says.
    fn count_hint(&self) -> Option<u64> {
        self.end.or_else(|| self.source.count_hint()).map(|end| end.saturating_sub(self.first))
    }
}

/// Reads and checks records and hands on those that are valid, encoded; returns their totals.
#[cfg(feature = "parts")]
pub(super) fn read(
    context: &Context<'_>,
    columns: &Columns,
    stretches: Vec<Stretch<'_>>,
    mut write: impl FnMut(&[u8]) -> Result<(), BuildError>,
) -> Result<Totals, BuildError> {
    let mut reader = Reader::new(context, columns, &stretches);
    for stretch in stretches {
        reader.read(stretch, &mut write)?;
    }
    Ok(reader.totals)
}

/// Reads one source after another.
struct Reader<'a> {
    context: &'a Context<'a>,
    tally: Tally<'a>,
    /// Over all sources that have been read to their end.
    totals: Totals,
    batch: PointBatch,
    /// Records of all sources, as far as they say; 0 if one of them does not.
    records_hint: u64,
}

impl<'a> Reader<'a> {
    fn new(context: &'a Context<'a>, columns: &'a Columns, stretches: &[Stretch<'_>]) -> Self {
        let tally = Tally {
            options: context.options,
            columns,
            shape: None,
            harmonics: Vec::new(),
            colors: None,
            totals: Totals::none(columns.attributes.len()),
            record: Vec::with_capacity(columns.layout.stride()),
        };
        let records_hint = stretches.iter().map(Stretch::count_hint).sum::<Option<u64>>().unwrap_or(0);
        let totals = Totals::none(columns.attributes.len());
        Self { context, tally, totals, batch: PointBatch::default(), records_hint }
    }

    /// Reads a stretch and closes its source. Its records count once it has been read to its end.
    fn read(
        &mut self,
        stretch: Stretch<'_>,
        write: &mut impl FnMut(&[u8]) -> Result<(), BuildError>,
    ) -> Result<(), BuildError> {
        self.tally.totals = Totals::none(self.tally.columns.attributes.len());
        self.read_records(stretch, write)?;
        self.totals.merge(&self.tally.totals);
        Ok(())
    }

    fn read_records(
        &mut self,
        mut stretch: Stretch<'_>,
        write: &mut impl FnMut(&[u8]) -> Result<(), BuildError>,
    ) -> Result<(), BuildError> {
        let Self { context, tally, batch, .. } = self;
        let source = &mut stretch.source;
        let selection = tally.columns.selection(source.schema(), stretch.input);
        source.select(&selection.columns);
        (tally.shape, tally.harmonics) = (selection.shape, selection.harmonics);
        tally.colors = selection.colors;
        source.watch(&context.control.cancel);
        if stretch.first > 0 {
            or_cancelled(context, source.skip(stretch.first))?;
        }
        let mut index = stretch.first;
        loop {
            let left = stretch.end.map_or(u64::MAX, |end| end.saturating_sub(index));
            let limit = left.min(BATCH_POINTS as u64) as usize;
            if limit == 0 {
                return Ok(());
            }
            or_cancelled(context, source.fill(batch, limit))?;
            if batch.is_empty() {
                return Ok(());
            }
            check_batch(batch, stretch.input, selection.columns.len())?;
            tally.take(batch, (stretch.input, index), write)?;
            index += batch.len() as u64;
            context.check()?;
            context.progress(Stage::Read, self.totals.records + tally.totals.records, self.records_hint);
        }
    }
}

/// The outcome of a read, where one that was cancelled is a build that was.
fn or_cancelled(context: &Context<'_>, outcome: Result<(), ReadError>) -> Result<(), BuildError> {
    match outcome {
        Err(ReadError::Cancelled) if context.is_cancelled() => Err(BuildError::Cancelled),
        outcome => Ok(outcome?),
    }
}

/// An error if a batch has not the columns that were selected.
fn check_batch(batch: &PointBatch, input: usize, selected: usize) -> Result<(), BuildError> {
    let whole = |values: &Values| values.len() == batch.len();
    if batch.columns.len() == selected && batch.columns.iter().all(whole) {
        return Ok(());
    }
    Err(BuildError::Source { input: input + 1, columns: batch.columns.len(), selected })
}

/// Checks records and encodes those that are valid.
struct Tally<'a> {
    options: &'a BuildOptions,
    columns: &'a Columns,
    /// Where the shapes of the current source come from.
    shape: Option<ShapeOrigin>,
    /// Where the coefficients of its harmonics come from.
    harmonics: Vec<usize>,
    /// Where the colours of the current source come from.
    colors: Option<ColorOrigin>,
    totals: Totals,
    /// The latest record, encoded.
    record: Vec<u8>,
}

impl Tally<'_> {
    /// Counts the records of a batch, of which the first has this input and index, and hands on
    /// those that are valid.
    fn take(
        &mut self,
        batch: &PointBatch,
        (input, first): (usize, u64),
        write: &mut impl FnMut(&[u8]) -> Result<(), BuildError>,
    ) -> Result<(), BuildError> {
        self.totals.records += batch.len() as u64;
        for i in 0..batch.len() {
            match self.check(batch, i) {
                Ok(()) => write(&self.record)?,
                Err(what) if self.options.invalid == InvalidPolicy::Reject => {
                    return Err(BuildError::InvalidRecord {
                        input: input + 1,
                        index: first + i as u64,
                        what,
                    });
                }
                Err(_) => {}
            }
        }
        Ok(())
    }

    /// Checks and counts record `i` of a batch, and encodes it if it is valid.
    fn check(&mut self, batch: &PointBatch, i: usize) -> Result<(), String> {
        let (columns, totals, record) = (self.columns, &mut self.totals, &mut self.record);
        let p = batch.position[i].map(|v| v * self.options.length_scale);
        if !p.iter().all(|v| v.abs() <= LIMIT) {
            totals.skipped.position += 1;
            if p.iter().all(|v| v.is_finite()) {
                totals.note(Quantity::Position, p.iter().fold(0.0, |far: f64, v| far.max(v.abs())));
            }
            return Err(format!("position {p:?} is not finite or exceeds {LIMIT:e}"));
        }
        record.clear();
        p.iter().for_each(|v| record.extend_from_slice(&(v + 0.0).to_le_bytes()));
        let shape = self.shape.map_or(Some((0.0, StoredShape::BALL)), |origin| shape(batch, origin, i));
        let longest = shape.map_or(f64::NAN, |(longest, _)| longest);
        let given = columns.radius.map(|column| batch.columns[column].get(i));
        if let Some(r) = given.or(columns.radius_is_semi_axis.then_some(longest)) {
            let r = r * self.options.radius_scale * self.options.length_scale;
            if !(1.0 / LIMIT..=LIMIT).contains(&r) {
                totals.skipped.radius += 1;
                if r > 0.0 && r.is_finite() {
                    totals.note(if r > LIMIT { Quantity::Radius } else { Quantity::SmallRadius }, r);
                }
                return Err(format!("radius {r} is not between {:e} and {LIMIT:e}", 1.0 / LIMIT));
            }
            record.extend_from_slice(&(r as f32).to_le_bytes());
        }
        if columns.layout.has_shape {
            let Some((_, shape)) = shape else {
                totals.skipped.radius += 1;
                return Err(
                    "semi-axes that are not all above 0 and finite, or a rotation that is none".into()
                );
            };
            totals.shapes += u64::from(shape != StoredShape::BALL);
            record.extend_from_slice(&shape.to_bytes());
        }
        if let Some(column) = columns.weight {
            let w = batch.columns[column].get(i) * self.options.weight_scale;
            if !(w.abs() <= LIMIT) {
                totals.skipped.weight += 1;
                if w.is_finite() {
                    totals.note(Quantity::Weight, w.abs());
                }
                return Err(format!("weight {w} is not finite or exceeds {LIMIT:e}"));
            }
            record.extend_from_slice(&(w as f32).to_le_bytes());
        }
        if let Some(origin) = &self.colors {
            let number = |column: usize| batch.columns[column].get(i) as f32;
            let color = origin.color.map(|columns| columns.map(number));
            let (color, depth) = match color.filter(|color| color.iter().all(|v| !v.is_nan())) {
                Some(color) => {
                    totals.depths.include(origin.depth, origin.family, color);
                    (color, origin.depth)
                }
                None => {
                    let (depth, value) = totals.depths.include_colorless(origin.intensity.map(number));
                    ([value; 3], depth)
                }
            };
            color.iter().for_each(|v| record.extend_from_slice(&v.to_le_bytes()));
            record.extend_from_slice(&depth.to_le_bytes());
            let coefficients = |place: usize| batch.columns[self.harmonics[place]].get(i);
            if !(0..self.harmonics.len()).all(|place| coefficients(place).is_finite()) {
                totals.skipped.weight += 1;
                return Err("coefficients of colours that are not finite".into());
            }
            let start = record.len();
            append_harmonics(coefficients, self.harmonics.len(), record);
            record.resize(start + stored_bytes(columns.layout.harmonics), 0);
        }
        for (column, info) in columns.attributes.iter().zip(&columns.infos) {
            batch.columns[*column].write_as(i, info.kind, record);
        }
        totals.include(&columns.layout, DVec3::from_array(p), record);
        Ok(())
    }
}

/// Appends the coefficients of harmonics as they are stored, of so many in the order of
/// [`Selection`](super::columns::Selection): first what a colour is besides what its bytes say.
fn append_harmonics(coefficients: impl Fn(usize) -> f64, count: usize, record: &mut Vec<u8>) {
    let Some(others) = count.checked_sub(CHANNELS) else { return };
    for channel in 0..CHANNELS {
        let color = 0.5 + CONSTANT * coefficients(channel);
        record.push(encode(color - (color.clamp(0.0, 1.0) * 255.0).round() / 255.0));
    }
    let per_channel = others / CHANNELS;
    for k in 0..per_channel {
        record
            .extend((0..CHANNELS).map(|channel| encode(coefficients(CHANNELS + channel * per_channel + k))));
    }
}

/// The longest semi-axis and the shape of point `i` of a batch, by semi-axes and rotation; `None`
/// if these are of no ellipsoid. That of a ball has no rotation, so that balls are equal. By a
/// normal it is a disc; a ball if that is none, and it has no semi-axis.
fn shape(batch: &PointBatch, origin: ShapeOrigin, i: usize) -> Option<(f64, StoredShape)> {
    let number = |column: usize| batch.columns[column].get(i);
    let columns = match origin {
        ShapeOrigin::Axes(columns) => columns,
        ShapeOrigin::Normal(columns) => {
            return Some((0.0, disc(DVec3::from_array(columns.map(number))).unwrap_or(StoredShape::BALL)));
        }
    };
    let [a, b, c, x, y, z, w] = columns.map(number);
    let (longest, shape) = Shape::of_semi_axes([a, b, c], DQuat::from_xyzw(x, y, z, w))?;
    let stored = StoredShape::encode(&shape);
    Some((longest, if stored.decode().is_ball() { StoredShape::BALL } else { stored }))
}
