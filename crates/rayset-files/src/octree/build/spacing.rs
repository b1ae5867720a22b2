//! Out-of-core estimation of radii from the local spacing, for points that have none, and of their
//! shapes.
//!
//! The radius of a ball is 0.85 times the distance to its eighth nearest neighbour; what is no ball
//! has a multiple of it, by its shape (`neighbourhood`). Stray points,
//! which are much farther from others than is usual in the cloud, get the median radius: see
//! [`Typical`]. Points that coincide are one place (`curve`).
//!
//! Records are first sorted along the Hilbert curve, with a box around every few hundred. Then they
//! are loaded again a block at a time: neighbours are looked for in the block, and after that in
//! the records elsewhere whose boxes are near enough (`neighbours`). Where so many records share a
//! Hilbert code that the curve says nothing of their places, boxes would be of no use: they have
//! one radius, by the number of their places and their extent ([`Crowd`]). Other neighbours are
//! exact, and the rest are counts of them, so the result depends on the points alone.

use super::context::Context;
use super::control::Stage;
use super::copies;
use super::curve::{Boxes, Curve, GRAIN, Sketch, most_boxes};
use super::error::BuildError;
use super::ingest::Ingested;
use super::neighbourhood::OfPlace;
use super::partition::Partition;
use super::pieces::{Assemble, Copy};
use super::plan::Cell;
use super::record::{self, SHAPE_BYTES};
use super::region::Region;
use super::shapes_of::ShapesOf;
use super::survey::{LIMIT, Settled, Survey};
use super::typical::{Measured, Typical};
use crate::octree::shape::StoredShape;
use rayset_store::spill::SpillWriter;

/// Bytes of the position of a record, after which its radius is.
const POSITION: usize = 24;
/// Position and radius of a record, after which its shape is.
const HEAD: usize = 28;

/// Rewrites all records, each with a radius and perhaps a shape, in the order of the curve; equal
/// ones as one if they are many.
pub(super) fn assign_radii(context: &Context<'_>, ingested: Ingested) -> Result<Ingested, BuildError> {
    let Ingested { spill, survey } = ingested;
    let (keys, stride) = (survey.curve_keys(), survey.layout.stride());
    let partition = Partition::new(context, stride, keys, survey.count, Stage::Spacing).in_passes(2);
    let mut writer = CurveWriter {
        context,
        sketch: Sketch::new(keys, GRAIN, most_boxes(context.options.memory_bytes)),
        writer: SpillWriter::new(context.spill()?, 1 << 20),
        stride,
        room: survey.layout.with_measures(survey.shapes_of.are_measured()).stride() - stride,
    };
    partition.run(Region::all(&spill, survey.count), &Copy, &mut writer)?;
    drop(spill);
    let CurveWriter { mut sketch, writer, .. } = writer;
    sketch.end_crowd();
    let copies = sketch.copies;
    let spill = writer.finish().map_err(context.io("write temporary files in"))?;
    let mut boxes = Boxes::default();
    boxes.push(&sketch.boxes, sketch.grain, sketch.count);
    let layout = survey.layout.with_measures(survey.shapes_of.are_measured());
    let shapes_of = survey.shapes_of;
    let curve = Curve { spill: &spill, stride: layout.stride(), crowds: sketch.crowds, boxes, shapes_of };
    let store =
        |block: &std::ops::Range<u64>, places: &[OfPlace]| store(context, &curve, &survey, block, places);
    let (scale, all) = (survey.auto_scale, 0..survey.count);
    let measured = curve.measure(context, scale, &all, store, |_| Ok(()))?;
    measured.check_range(context.options.length_scale, &survey)?;
    let settled = settle(context, &curve, &survey, &measured)?;
    let measured = Ingested { spill, survey: survey.with_measures(settled) };
    if measured.survey.merges(copies) {
        return copies::merge(context, measured);
    }
    Ok(measured)
}

/// Writes sorted records, each with room for what is measured.
struct CurveWriter<'a> {
    context: &'a Context<'a>,
    sketch: Sketch,
    writer: SpillWriter,
    stride: usize,
    /// Bytes of what is measured.
    room: usize,
}

impl CurveWriter<'_> {
    fn take(&mut self, records: &[u8]) -> Result<(), BuildError> {
        for record in records.chunks_exact(self.stride) {
            self.sketch.follow(record);
            let io = self.context.io("write temporary files in");
            self.writer.push(&record[..POSITION]).map_err(&io)?;
            self.writer.push(&[0; 4 + SHAPE_BYTES][..self.room]).map_err(&io)?;
            self.writer.push(&record[POSITION..]).map_err(&io)?;
        }
        Ok(())
    }
}

impl Assemble<Vec<u8>> for CurveWriter<'_> {
    fn open(&mut self, _: Cell) {}

    fn own(&mut self, piece: Vec<u8>) -> Result<(), BuildError> {
        self.take(&piece)
    }

    fn subtree(&mut self, _: Cell, piece: Vec<u8>) -> Result<(), BuildError> {
        self.take(&piece)
    }

    fn close(&mut self) -> Result<(), BuildError> {
        Ok(())
    }
}

/// A measured radius within the range of those that are stored; 0 where none is known.
pub(super) fn stored(radius: f64) -> f32 {
    if radius > 0.0 { radius.clamp(1.0 / LIMIT, LIMIT) as f32 } else { 0.0 }
}

/// Stores what was measured of a block.
fn store(
    context: &Context<'_>,
    curve: &Curve<'_>,
    survey: &Survey,
    block: &std::ops::Range<u64>,
    places: &[OfPlace],
) -> Result<(), BuildError> {
    let mut bytes = Vec::new();
    curve.read(context, block, &mut bytes)?;
    for (record, place) in bytes.chunks_exact_mut(curve.stride).zip(places) {
        record[POSITION..HEAD].copy_from_slice(&stored(place.radius).to_le_bytes());
        if survey.shapes_of.are_measured() {
            keep_shape(record, place.suggested.shape, survey);
        }
    }
    // Others may read these records meanwhile, but only their positions, which stay as they are.
    let at = block.start * curve.stride as u64;
    curve.spill.write_at(&bytes, at).map_err(context.io("rewrite temporary files in"))
}

/// Stores the shape that the neighbours of a record suggest, unless its normal has decided already.
pub(super) fn keep_shape(record: &mut [u8], suggested: StoredShape, survey: &Survey) {
    let stored = &mut record[HEAD..HEAD + SHAPE_BYTES];
    if !survey.layout.has_shape || *stored == StoredShape::BALL.to_bytes() {
        stored.copy_from_slice(&suggested.to_bytes());
    }
}

/// Gives all records the radii and shapes that they keep.
fn settle(
    context: &Context<'_>,
    curve: &Curve<'_>,
    survey: &Survey,
    measured: &Measured,
) -> Result<Settled, BuildError> {
    let mut settling = Settling::new(survey, measured);
    if let Some(settled) = settling.as_measured(measured) {
        return Ok(settled);
    }
    let mut bytes = Vec::new();
    for first in (0..survey.count).step_by(8192) {
        curve.read(context, &(first..(first + 8192).min(survey.count)), &mut bytes)?;
        let mut changed = false;
        for record in bytes.chunks_exact_mut(curve.stride) {
            changed |= settling.settle(record);
        }
        if changed {
            let at = first * curve.stride as u64;
            curve.spill.write_at(&bytes, at).map_err(context.io("rewrite temporary files in"))?;
        }
    }
    Ok(settling.settled)
}

/// Decides which radii and shapes records keep, when those of all are measured: typical radii where
/// none is known, or one beyond the limit; and no shapes in a cloud without surfaces.
pub(super) struct Settling {
    typical: Typical,
    shapes_of: ShapesOf,
    /// Whether what was measured is kept.
    keeps_shapes: bool,
    /// What is known of the records so far.
    pub(super) settled: Settled,
}

impl Settling {
    pub(super) fn new(survey: &Survey, measured: &Measured) -> Self {
        Self {
            typical: measured.typical(survey),
            shapes_of: survey.shapes_of,
            keeps_shapes: survey.shapes_of == ShapesOf::Fluid || measured.has_surfaces(survey.normals),
            settled: Settled::NONE,
        }
    }

    /// What is known of all records if they keep what was measured.
    fn as_measured(&self, measured: &Measured) -> Option<Settled> {
        let radius_range = measured.unchanged(&self.typical).filter(|_| !self.shapes_of.are_measured())?;
        Some(Settled { radius_range, has_shapes: false })
    }

    /// Settles a record, behind whose position stand what was measured of it; returns whether it
    /// changes.
    pub(super) fn settle(&mut self, record: &mut [u8]) -> bool {
        let measured = record::radius(record);
        let (mut radius, mut shape) = (self.typical.settled(measured), StoredShape::BALL);
        if self.shapes_of.are_measured() {
            let measured_shape = record::shape(record, HEAD);
            if self.keeps_shapes {
                (radius, shape) = self.typical.settled_with_shape(measured, measured_shape, self.shapes_of);
            }
            record[HEAD..HEAD + SHAPE_BYTES].copy_from_slice(&shape.to_bytes());
        }
        record[POSITION..HEAD].copy_from_slice(&radius.to_le_bytes());
        let range = &mut self.settled.radius_range;
        *range = (range.0.min(radius), range.1.max(radius));
        self.settled.has_shapes |= shape != StoredShape::BALL;
        self.shapes_of.are_measured() || radius != measured
    }
}
