//! The steps that measure radii and find copies: a stretch of the curve is sorted, its radii are
//! measured with the neighbours in all stretches, and they are settled by what is usual in the
//! whole cloud.

use std::io::{BufReader, BufWriter, Read, Write};

use super::super::context::Context;
use super::super::control::Stage;
use super::super::copies::Merger;
use super::super::curve::{Boxes, Crowd, Curve, GRAIN, Sketch, most_boxes};
use super::super::error::BuildError;
use super::super::neighbourhood::OfPlace;
use super::super::pieces::{Assemble, Copy};
use super::super::plan::Cell;
use super::super::record::{RecordLayout, SHAPE_BYTES};
use super::super::spacing::{Settling, keep_shape, stored};
use super::super::survey::{Merged, NO_RANGE, Settled, Survey};
use super::super::typical::Measured;
use super::divide::{self, Counted};
use super::exchange::{DataFile, Part};
use super::job::Job;
use super::step::BuildStep;
use super::work::{self, Records, Sorting};
use crate::octree::shape::StoredShape;
use rayset_base::geometry::{Aabb, DVec3};
use rayset_store::container::record_hash;
use rayset_store::output::OutputWriter;
use rayset_store::spill::{Joined, Spill};

const BUFFER_BYTES: usize = 1 << 20;
/// Number of records that are read at a time.
const CHUNK_RECORDS: usize = 8192;
/// Bytes of the position of a record, after which its radius is.
const POSITION: usize = 24;

/// The order of the curve.
pub(super) fn curve_sorting(survey: &Survey) -> Sorting {
    Sorting {
        keys: survey.curve_keys(),
        records: survey.count,
        stride: survey.layout.stride(),
        stage: Stage::Spacing,
        count: BuildStep::SpacingCount,
        scatter: BuildStep::SpacingScatter,
    }
}

/// Writes sorted records, and keeps boxes and crowds of them.
struct CurveWriter<'a> {
    context: &'a Context<'a>,
    data: &'a DataFile,
    output: BufWriter<OutputWriter>,
    sketch: Sketch,
    stride: usize,
    /// The sum of the hashes of the records.
    sum: u64,
    total: u64,
}

impl Assemble<Vec<u8>> for CurveWriter<'_> {
    fn open(&mut self, _: Cell) {}

    fn own(&mut self, records: Vec<u8>) -> Result<(), BuildError> {
        for record in records.chunks_exact(self.stride) {
            self.sketch.follow(record);
            self.sum = self.sum.wrapping_add(record_hash(record));
        }
        self.context.progress(Stage::Spacing, self.sketch.count, self.total);
        self.output.write_all(&records).map_err(|e| self.data.failed(e))
    }

    fn subtree(&mut self, _: Cell, records: Vec<u8>) -> Result<(), BuildError> {
        self.own(records)
    }

    fn close(&mut self) -> Result<(), BuildError> {
        Ok(())
    }
}

/// Sorts the stretch of a part.
pub(super) fn sort(job: &Job<'_>) -> Result<(), BuildError> {
    let data = job.create_data()?;
    let destination = data.destination.clone();
    let context = job.context(&destination);
    let survey = &job.overview.survey;
    let sorting = curve_sorting(survey);
    // The same for all parts, so that all boxes together have room in the memory of any.
    let most = most_boxes(job.overview.memory_bytes) as u64;
    let mut grain = GRAIN;
    while survey.count / grain > most {
        grain *= 2;
    }
    let mut writer = CurveWriter {
        context: &context,
        data: &data,
        output: BufWriter::with_capacity(BUFFER_BYTES, data.writer_at(0)?),
        sketch: Sketch::new(sorting.keys, grain, usize::MAX),
        stride: sorting.stride,
        sum: 0,
        total: survey.count / u64::from(job.exchange.parts),
    };
    work::order(job, &context, &sorting, &Copy, &mut writer)?;
    let CurveWriter { mut output, mut sketch, sum, .. } = writer;
    output.flush().map_err(|e| data.failed(e))?;
    drop(output);
    sketch.end_crowd();
    let bytes = sketch.count * sorting.stride as u64;
    job.publish(Some((data, bytes)), &encode(&sketch, sum))
}

fn corners(bounds: &Aabb) -> [u64; 6] {
    let (min, max) = (bounds.min.to_array(), bounds.max.to_array());
    [min[0], min[1], min[2], max[0], max[1], max[2]].map(f64::to_bits)
}

/// Number of records, sum of their hashes, copies, grain, numbers of boxes and crowds; corners of
/// the boxes; range, corners and places of the crowds.
fn encode(sketch: &Sketch, sum: u64) -> Vec<u8> {
    let (boxes, crowds) = (sketch.boxes.len() as u64, sketch.crowds.len() as u64);
    let front = [sketch.count, sum, sketch.copies, sketch.grain, boxes, crowds];
    let boxes = sketch.boxes.iter().flat_map(corners);
    let crowds = sketch.crowds.iter().flat_map(|crowd| {
        let range = [crowd.records.start, crowd.records.end];
        range.into_iter().chain(corners(&crowd.bounds)).chain([crowd.places])
    });
    divide::encode(front.into_iter().chain(boxes).chain(crowds))
}

/// The sorted records of a part, as its payload says.
struct Stretch {
    count: u64,
    sum: u64,
    /// Records that are equal to the one before.
    copies: u64,
    grain: u64,
    boxes: Vec<Aabb>,
    crowds: Vec<Crowd>,
}

impl Stretch {
    fn of(part: &Part) -> Result<Self, BuildError> {
        let numbers = divide::numbers(part, None)?;
        Self::decode(&numbers).ok_or_else(|| part.wrong("its boxes make no sense; run that step again"))
    }

    fn decode(numbers: &[u64]) -> Option<Self> {
        let (&[count, sum, copies, grain, boxes, crowds], rest) = numbers.split_first_chunk()?;
        if grain == 0 || boxes != count.div_ceil(grain) {
            return None;
        }
        let (boxes, rest) = rest.split_at_checked(usize::try_from(boxes).ok()?.checked_mul(6)?)?;
        if rest.len() as u64 != crowds.checked_mul(9)? {
            return None;
        }
        let bounds = |corners: &[u64]| {
            let [a, b, c, d, e, f] = std::array::from_fn(|i| f64::from_bits(corners[i]));
            Aabb { min: DVec3::new(a, b, c), max: DVec3::new(d, e, f) }
        };
        let crowd = |n: &[u64]| Crowd::new(n[0]..n[1], bounds(&n[2..8]), n[8]);
        Some(Self {
            count,
            sum,
            copies,
            grain,
            boxes: boxes.chunks_exact(6).map(bounds).collect(),
            crowds: rest.chunks_exact(9).map(crowd).collect(),
        })
    }
}

/// Measures the radii of the stretch of a part, if they are not given.
pub(super) fn measure(job: &Job<'_>) -> Result<(), BuildError> {
    if !job.overview.survey.measures_radii() {
        job.publish(None, &[])?;
        job.exchange.remove_data(BuildStep::SpacingScatter, job.part);
        return Ok(());
    }
    let data = job.create_data()?;
    let destination = data.destination.clone();
    let context = job.context(&destination);
    let survey = &job.overview.survey;
    let stride = survey.layout.stride();
    let (mut files, mut counts, mut crowds, mut boxes) =
        (Vec::new(), Vec::new(), Vec::new(), Boxes::default());
    job.all(BuildStep::SpacingSort, |part| {
        let stretch = Stretch::of(&part)?;
        let before: u64 = counts.iter().sum();
        let shifted = |crowd: Crowd| {
            let records = crowd.records.start + before..crowd.records.end + before;
            Crowd::new(records, crowd.bounds, crowd.places)
        };
        crowds.extend(stretch.crowds.into_iter().map(shifted));
        boxes.push(&stretch.boxes, stretch.grain, stretch.count);
        files.push(job.exchange.open_data(&part)?);
        counts.push(stretch.count);
        Ok(())
    })?;
    let mut joined = Joined::new(files);
    counts.iter().enumerate().for_each(|(file, &count)| joined.push(file, 0, count * stride as u64));
    let spill = Spill::Joined(joined);
    let curve = Curve { spill: &spill, stride, crowds, boxes, shapes_of: survey.shapes_of };
    let own = job.part as usize - 1;
    let first: u64 = counts[..own].iter().sum();
    let range = first..first + counts[own];
    let mut output = BufWriter::with_capacity(BUFFER_BYTES, data.writer_at(0)?);
    let (scale, nowhere) = (survey.auto_scale, |_: &_, _: &_| Ok(()));
    let (mut checksum, mut bytes) = (0, Vec::new());
    let pass = |places: &[OfPlace]| {
        bytes.clear();
        places.iter().for_each(|place| put_measures(survey, place, &mut bytes));
        checksum = crc32c::crc32c_append(checksum, &bytes);
        output.write_all(&bytes).map_err(|e| data.failed(e))
    };
    let measured = curve.measure(&context, scale, &range, nowhere, pass)?;
    output.flush().map_err(|e| data.failed(e))?;
    drop(output);
    let payload = divide::encode(std::iter::once(u64::from(checksum)).chain(measured.to_words()));
    job.publish(Some((data, measures_bytes(survey) as u64 * counts[own])), &payload)?;
    // All parts have sorted what was scattered to them.
    job.exchange.remove_data(BuildStep::SpacingScatter, job.part);
    Ok(())
}

/// Bytes of what is measured of a record: its radius, and its shape if that is, too.
fn measures_bytes(survey: &Survey) -> usize {
    match (survey.measures_radii(), survey.shapes_of.are_measured()) {
        (false, _) => 0,
        (true, false) => 4,
        (true, true) => 4 + SHAPE_BYTES,
    }
}

fn put_measures(survey: &Survey, place: &OfPlace, to: &mut Vec<u8>) {
    to.extend_from_slice(&stored(place.radius).to_le_bytes());
    if survey.shapes_of.are_measured() {
        to.extend_from_slice(&place.suggested.shape.to_bytes());
    }
}

/// Makes of a record the `whole` one, which has what was measured of it.
fn with_measures(survey: &Survey, record: &[u8], measures: &[u8], whole: &mut Vec<u8>) {
    let (radius, shape) = measures.split_at(measures.len().min(4));
    whole.clear();
    whole.extend_from_slice(&record[..POSITION]);
    whole.extend_from_slice(radius);
    // Records that bring shapes have them behind their positions.
    let brings_shapes = survey.shapes_of.are_measured() && survey.layout.has_shape;
    whole.extend_from_slice(if brings_shapes { &[] } else { shape });
    whole.extend_from_slice(&record[POSITION..]);
    if brings_shapes {
        keep_shape(whole, StoredShape::from_bytes(std::array::from_fn(|i| shape[i])), survey);
    }
}

/// The checksum of the radii that a part has measured, and their counts.
fn radii(part: &Part) -> Result<(u32, Measured), BuildError> {
    let numbers = divide::numbers(part, None)?;
    let (checksum, measured) = numbers.split_first().unzip();
    let measured = measured.and_then(Measured::from_words);
    let radii = checksum.map(|&checksum| checksum as u32).zip(measured);
    radii.ok_or_else(|| part.wrong("its counts of radii make no sense; run that step again"))
}

/// How records are settled, by what all parts have measured.
fn settling(job: &Job<'_>) -> Result<Settling, BuildError> {
    let mut all = Measured::default();
    job.all(BuildStep::SpacingMeasure, |part| {
        let (_, measured) = radii(&part)?;
        all.merge(&measured);
        Ok(())
    })?;
    all.check_range(job.options.length_scale, &job.overview.survey)?;
    Ok(Settling::new(&job.overview.survey, &all))
}

/// Whether copies are merged: all parts decide alike.
fn merges(job: &Job<'_>) -> Result<bool, BuildError> {
    let mut copies = 0_u64;
    job.all(BuildStep::SpacingSort, |part| {
        copies = copies.saturating_add(Stretch::of(&part)?.copies);
        Ok(())
    })?;
    Ok(job.overview.survey.merges(copies))
}

/// The layout of records with radii, and without copies.
pub(super) fn settled_layout(job: &Job<'_>) -> Result<RecordLayout, BuildError> {
    let layout = job.overview.survey.measured_layout();
    Ok(if merges(job)? { layout.with_weight() } else { layout })
}

/// Writes the records of a part's stretch with their radii, copies merged if they are many, and
/// counts them by octree cells.
pub(super) fn count(job: &Job<'_>, sorting: &Sorting) -> Result<(), BuildError> {
    let mut settling = if job.overview.survey.measures_radii() { Some(settling(job)?) } else { None };
    let merges = merges(job)?;
    let data = job.create_data()?;
    let destination = data.destination.clone();
    let context = job.context(&destination);
    let survey = &job.overview.survey;
    let mut counted = Counted { count: 0, sum: 0, settled: Settled::NONE, weight_range: NO_RANGE };
    let mut merger = Merger::new(&survey.measured_layout(), survey.weight);
    let mut output = BufWriter::with_capacity(BUFFER_BYTES, data.writer_at(0)?);
    let pyramid = divide::pyramid(job);
    let mut whole = Vec::with_capacity(sorting.stride);
    let mut write = |record: &[u8]| {
        counted.count += 1;
        counted.sum = counted.sum.wrapping_add(record_hash(record));
        pyramid.count(&sorting.keys, record);
        output.write_all(record).map_err(|e| data.failed(e))
    };
    settle(job, &context, |record, measures| {
        with_measures(survey, record, measures, &mut whole);
        if let Some(settling) = &mut settling {
            settling.settle(&mut whole);
        }
        if merges { merger.follow(&whole, &mut write) } else { write(&whole) }
    })?;
    merger.end(&mut write)?;
    counted.weight_range = merger.merged.weight_range;
    if let Some(settling) = settling {
        counted.settled = settling.settled;
    }
    output.flush().map_err(|e| data.failed(e))?;
    drop(output);
    let bytes = counted.count * sorting.stride as u64;
    job.publish(Some((data, bytes)), &counted.encode(&pyramid))?;
    // All parts have measured their radii with these.
    job.exchange.remove_data(BuildStep::SpacingSort, job.part);
    job.exchange.remove_data(BuildStep::SpacingMeasure, job.part);
    Ok(())
}

/// Passes the sorted records of a part's stretch to `visit`, each with what was measured of it.
fn settle(
    job: &Job<'_>,
    context: &Context<'_>,
    mut visit: impl FnMut(&[u8], &[u8]) -> Result<(), BuildError>,
) -> Result<(), BuildError> {
    let (sorted, measured) = (job.own(BuildStep::SpacingSort)?, job.own(BuildStep::SpacingMeasure)?);
    let Stretch { count, sum, .. } = Stretch::of(&sorted)?;
    let stride = job.overview.survey.layout.stride();
    let measures_bytes = measures_bytes(&job.overview.survey);
    let expected = (measures_bytes > 0).then_some(measures_bytes as u64 * count);
    if sorted.head.data_bytes != Some(count * stride as u64) || measured.head.data_bytes != expected {
        return Err(
            measured.wrong("it has not the radii of the records that were sorted; run that step again")
        );
    }
    let buffered = |file| BufReader::with_capacity(BUFFER_BYTES, file);
    let mut records = buffered(job.exchange.open_data(&sorted)?);
    let mut radii = match expected {
        Some(_) => Some(buffered(job.exchange.open_data(&measured)?)),
        None => None,
    };
    let failed = |part: &Part| {
        let path = part.path.with_extension("data");
        move |source| BuildError::Io { action: "read", path: path.clone(), source }
    };
    let (mut some, mut their_measures) = (Vec::new(), Vec::new());
    let (mut found_sum, mut found_checksum) = (0_u64, 0);
    for first in (0..count).step_by(CHUNK_RECORDS) {
        context.check()?;
        context.progress(Stage::Write, first, count);
        let length = (count - first).min(CHUNK_RECORDS as u64) as usize;
        some.resize(length * stride, 0);
        their_measures.resize(length * measures_bytes, 0);
        records.read_exact(&mut some).map_err(failed(&sorted))?;
        if let Some(radii) = &mut radii {
            radii.read_exact(&mut their_measures).map_err(failed(&measured))?;
        }
        found_checksum = crc32c::crc32c_append(found_checksum, &their_measures);
        for (i, record) in some.chunks_exact(stride).enumerate() {
            found_sum = found_sum.wrapping_add(record_hash(record));
            visit(record, &their_measures[measures_bytes * i..measures_bytes * (i + 1)])?;
        }
    }
    let is_whole = expected.is_none() || found_checksum == self::radii(&measured)?.0;
    if found_sum != sum || !is_whole {
        return Err(
            measured.wrong("its data or those that were sorted are damaged: begin again in another folder")
        );
    }
    Ok(())
}

/// The records of a part with their radii.
pub(super) fn settled_records(job: &Job<'_>, stride: usize) -> Result<Records, BuildError> {
    let part = job.own(BuildStep::Count)?;
    let counted = Counted::of(&part)?;
    Records::of(job, &part, (counted.count, counted.sum), stride)
}

/// What is known of all records when they have radii and copies are merged.
pub(super) fn settled_survey(job: &Job<'_>) -> Result<Survey, BuildError> {
    let mut settled = Settled::NONE;
    let mut merged = Merged { points: 0, weight_range: NO_RANGE };
    let join = |a: (f32, f32), b: (f32, f32)| (a.0.min(b.0), a.1.max(b.1));
    job.all(BuildStep::Count, |part| {
        let counted = Counted::of(&part)?;
        settled.radius_range = join(settled.radius_range, counted.settled.radius_range);
        settled.has_shapes |= counted.settled.has_shapes;
        merged.weight_range = join(merged.weight_range, counted.weight_range);
        merged.points = merged.points.saturating_add(counted.count);
        Ok(())
    })?;
    let survey = job.overview.survey.clone();
    let survey = if survey.measures_radii() { survey.with_measures(settled) } else { survey };
    Ok(if merges(job)? { survey.with_merged_copies(merged) } else { survey })
}

/// The number of points that are in the octree.
pub(super) fn points(job: &Job<'_>) -> Result<u64, BuildError> {
    let survey = &job.overview.survey;
    if survey.follows_curve() && merges(job)? { Ok(settled_survey(job)?.count) } else { Ok(survey.count) }
}
