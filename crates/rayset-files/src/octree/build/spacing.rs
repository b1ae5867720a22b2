//! Out-of-core estimation of radii from the local spacing, for points that have none.
//!
//! The radius of a point is 0.85 times the distance to its eighth nearest neighbour. Stray points,
//! which are much farther from others than is usual in the cloud, get the median radius: see
//! [`Typical`]. Points that coincide are one place (`curve`).
//!
//! Records are first sorted along the Hilbert curve, with a box around every few hundred. Then they
//! are loaded again a block at a time: neighbours are looked for in the block, and after that in
//! the records elsewhere whose boxes are near enough (`neighbours`). Where so many records share a
//! Hilbert code that the curve says nothing of their places, boxes would be of no use: they have
//! one radius, by the number of their places and their extent ([`Crowd`]). Other distances are
//! exact, and the rest are counts of them, so the result depends on the points alone.

use super::context::Context;
use super::control::Stage;
use super::copies;
use super::curve::{Boxes, Curve, GRAIN, Sketch, most_boxes};
use super::error::BuildError;
use super::ingest::Ingested;
use super::partition::Partition;
use super::pieces::{Assemble, Copy};
use super::plan::Cell;
use super::record;
use super::region::Region;
use super::survey::LIMIT;
use super::typical::{Measured, Typical};
use rayset_store::spill::SpillWriter;

/// Bytes of the position of a record, after which its radius is.
const POSITION: usize = 24;
/// Position and radius of a record.
const HEAD: usize = 28;

/// Rewrites all records, each with a radius, in the order of the curve; equal ones as one if they
/// are many.
pub(super) fn assign_radii(context: &Context<'_>, ingested: Ingested) -> Result<Ingested, BuildError> {
    let Ingested { spill, survey } = ingested;
    let (keys, stride) = (survey.curve_keys(), survey.layout.stride());
    let partition = Partition::new(context, stride, keys, survey.count, Stage::Spacing).in_passes(2);
    let mut writer = CurveWriter {
        context,
        sketch: Sketch::new(keys, GRAIN, most_boxes(context.options.memory_bytes)),
        writer: SpillWriter::new(context.spill()?, 1 << 20),
        stride,
    };
    partition.run(Region::all(&spill, survey.count), &Copy, &mut writer)?;
    drop(spill);
    let CurveWriter { mut sketch, writer, .. } = writer;
    sketch.end_crowd();
    let copies = sketch.copies;
    let spill = writer.finish().map_err(context.io("write temporary files in"))?;
    let mut boxes = Boxes::default();
    boxes.push(&sketch.boxes, sketch.grain, sketch.count);
    let stride = survey.layout.with_radius().stride();
    let curve = Curve { spill: &spill, stride, crowds: sketch.crowds, boxes };
    let store = |block: &std::ops::Range<u64>, radii: &[f64]| store(context, &curve, block, radii);
    let measured = curve.measure(context, survey.auto_scale, &(0..survey.count), store, |_| Ok(()))?;
    measured.check_range(context.options.length_scale, &survey)?;
    let radius_range = settle(context, &curve, survey.count, &measured, &measured.typical(&survey))?;
    let measured = Ingested { spill, survey: survey.with_measured_radii(radius_range) };
    if copies::are_many(copies, measured.survey.count) {
        return copies::merge(context, measured);
    }
    Ok(measured)
}

/// Writes sorted records, each with room for a radius.
struct CurveWriter<'a> {
    context: &'a Context<'a>,
    sketch: Sketch,
    writer: SpillWriter,
    stride: usize,
}

impl CurveWriter<'_> {
    fn take(&mut self, records: &[u8]) -> Result<(), BuildError> {
        for record in records.chunks_exact(self.stride) {
            self.sketch.follow(record);
            let io = self.context.io("write temporary files in");
            self.writer.push(&record[..POSITION]).map_err(&io)?;
            self.writer.push(&[0; 4]).map_err(&io)?;
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

/// Stores the radii of a block.
fn store(
    context: &Context<'_>,
    curve: &Curve<'_>,
    block: &std::ops::Range<u64>,
    radii: &[f64],
) -> Result<(), BuildError> {
    let mut bytes = Vec::new();
    curve.read(context, block, &mut bytes)?;
    for (record, &radius) in bytes.chunks_exact_mut(curve.stride).zip(radii) {
        record[POSITION..HEAD].copy_from_slice(&stored(radius).to_le_bytes());
    }
    // Others may read these records meanwhile, but only their positions, which stay as they are.
    let at = block.start * curve.stride as u64;
    curve.spill.write_at(&bytes, at).map_err(context.io("rewrite temporary files in"))
}

/// Gives the typical radius to records that have none, or one beyond the limit; returns the range
/// of all radii.
fn settle(
    context: &Context<'_>,
    curve: &Curve<'_>,
    count: u64,
    measured: &Measured,
    typical: &Typical,
) -> Result<(f32, f32), BuildError> {
    if let Some(range) = measured.unchanged(typical) {
        return Ok(range);
    }
    let mut range = (f32::INFINITY, 0.0_f32);
    let mut bytes = Vec::new();
    for first in (0..count).step_by(8192) {
        curve.read(context, &(first..(first + 8192).min(count)), &mut bytes)?;
        let mut changed = false;
        for record in bytes.chunks_exact_mut(curve.stride) {
            let measured = record::radius(record);
            let radius = typical.settled(measured);
            if radius != measured {
                record[POSITION..HEAD].copy_from_slice(&radius.to_le_bytes());
                changed = true;
            }
            range = (range.0.min(radius), range.1.max(radius));
        }
        if changed {
            let at = first * curve.stride as u64;
            curve.spill.write_at(&bytes, at).map_err(context.io("rewrite temporary files in"))?;
        }
    }
    Ok(range)
}
