//! Out-of-core estimation of radii from the local spacing, for points that have none.
//!
//! The octree is subdivided until a cell holds at most 1024 points. In each cell, the distance to the eighth nearest
//! neighbour is measured for up to 64 of its points; 1.5 times the median is the radius of all points of the cell, so that
//! about twenty supports overlap on a surface. A cell of fewer than 32 points gives no reliable measurement, so its points
//! get the geometric mean of all measured radii. The result depends on the points alone.

use super::context::Context;
use super::control::Stage;
use super::error::{BuildError, Quantity};
use super::ingest::{Ingested, LIMIT};
use super::partition::{Assemble, Pack, Partition, Region, Sorted};
use super::plan::Cell;
use super::record::{self, KeyMaker};
use crate::cancel::CancelToken;
use crate::geometry::curve::MAX_LEVEL;
use crate::spill::SpillWriter;

const CELL_POINTS: usize = 1024;
const LEAST_POINTS: usize = 32;
const PROBES: usize = 64;
const NEIGHBOUR: usize = 8;
const RADII_PER_DISTANCE: f64 = 1.5;

/// Rewrites all records, each with a radius.
pub(super) fn assign_radii(context: &Context<'_>, ingested: Ingested) -> Result<Ingested, BuildError> {
    // Owner cells do not matter yet: with a tiny radius, points are sorted by their Hilbert codes alone.
    let keys = KeyMaker { root: ingested.root, radius: Some(f32::MIN_POSITIVE) };
    let stride = ingested.layout.stride();
    let partition = Partition::new(context, stride, keys, ingested.count, Stage::Spacing);
    let mut radii = Radii::new(context, ingested.auto_scale)?;
    let measure = Measure { cancel: context.control.cancel.clone() };
    partition.run(Region::all(&ingested.spill, ingested.count), &measure, &mut radii)?;
    radii.finish(context, ingested)
}

/// Radii of a stretch of points (zero if unknown), and the records themselves.
pub(super) struct Measured {
    records: Vec<u8>,
    radii: Vec<f32>,
    stride: usize,
}

struct Measure {
    cancel: CancelToken,
}

impl Measure {
    fn visit(&self, level: u32, records: Sorted<'_>, out: &mut Vec<f32>) {
        if records.len() > CELL_POINTS && level < MAX_LEVEL {
            let (_, children) = records.split(level);
            children.into_iter().for_each(|child| self.visit(level + 1, child, out));
            return;
        }
        let measured = records.len() >= LEAST_POINTS && !self.cancel.is_cancelled();
        let radius = if measured { median_distance(records) } else { None };
        let radius = radius.map_or(0.0, |d| (d * RADII_PER_DISTANCE) as f32);
        out.resize(out.len() + records.len(), radius);
    }

    fn copy(records: Sorted<'_>, radii: Vec<f32>) -> Measured {
        let stride = if records.len() > 0 { records.record(0).len() } else { 0 };
        let mut bytes = Vec::with_capacity(records.len() * stride);
        (0..records.len()).for_each(|i| bytes.extend_from_slice(records.record(i)));
        Measured { records: bytes, radii, stride }
    }
}

/// The median, over a sample of the points, of the distance to the eighth nearest neighbour; `None` if it is zero or not
/// finite.
fn median_distance(records: Sorted<'_>) -> Option<f64> {
    let n = records.len();
    // Cells at the deepest level may hold any number of nearly coincident points: a sample of them suffices.
    let step = n.div_ceil(CELL_POINTS);
    let points: Vec<[f64; 3]> = (0..n).step_by(step).map(|i| record::position(records.record(i))).collect();
    let mut distances = Vec::with_capacity(PROBES);
    let probes = points.len().min(PROBES);
    for probe in 0..probes {
        let p = points[probe * points.len() / probes];
        let mut nearest = [f64::INFINITY; NEIGHBOUR + 1];
        for q in &points {
            let d2 = (p[0] - q[0]).powi(2) + (p[1] - q[1]).powi(2) + (p[2] - q[2]).powi(2);
            if d2 < nearest[NEIGHBOUR] {
                let at = nearest.partition_point(|&d| d <= d2);
                nearest.copy_within(at..NEIGHBOUR, at + 1);
                nearest[at] = d2;
            }
        }
        distances.push(nearest[NEIGHBOUR].sqrt());
    }
    distances.sort_unstable_by(f64::total_cmp);
    Some(distances[distances.len() / 2]).filter(|&d| d > 0.0 && d.is_finite())
}

impl Pack for Measure {
    type Piece = Measured;

    fn subtree(&self, cell: Cell, records: Sorted<'_>) -> Measured {
        let mut radii = Vec::with_capacity(records.len());
        self.visit(cell.level, records, &mut radii);
        Self::copy(records, radii)
    }

    fn own(&self, records: Sorted<'_>) -> Measured {
        // Only reached for more points in a cell of the deepest level than fit in memory.
        Self::copy(records, vec![0.0; records.len()])
    }
}

/// Collects measured records in order.
struct Radii<'a> {
    context: &'a Context<'a>,
    writer: SpillWriter,
    scale: f64,
    log_sum: f64,
    measured: u64,
    unknown: u64,
    /// Smallest and largest of the measured radii.
    least: f64,
    most: f64,
}

impl<'a> Radii<'a> {
    fn new(context: &'a Context<'a>, scale: f64) -> Result<Self, BuildError> {
        let writer = SpillWriter::new(context.spill()?, 1 << 20);
        let (least, most) = (f64::INFINITY, 0.0);
        Ok(Self { context, writer, scale, log_sum: 0.0, measured: 0, unknown: 0, least, most })
    }

    fn take(&mut self, measured: &Measured) -> Result<(), BuildError> {
        let mut last = (0.0_f32, 0.0);
        for (record, &radius) in measured.records.chunks_exact(measured.stride).zip(&measured.radii) {
            let scaled = f64::from(radius) * self.scale;
            if radius > 0.0 {
                self.least = self.least.min(scaled);
                self.most = self.most.max(scaled);
            }
            let scaled = scaled.clamp(0.0, LIMIT) as f32;
            if radius > 0.0 {
                if last.0 != scaled {
                    last = (scaled, f64::from(scaled).ln());
                }
                self.log_sum += last.1;
                self.measured += 1;
            } else {
                self.unknown += 1;
            }
            let io = self.context.io("write temporary files in");
            self.writer.push(&record[..24]).map_err(&io)?;
            self.writer.push(&scaled.to_le_bytes()).map_err(&io)?;
            self.writer.push(&record[24..]).map_err(&io)?;
        }
        Ok(())
    }

    /// Sets the unknown radii, if there are any, and computes the totals.
    fn finish(self, context: &Context<'_>, ingested: Ingested) -> Result<Ingested, BuildError> {
        for (quantity, farthest) in [(Quantity::SmallRadius, self.least), (Quantity::Radius, self.most)] {
            let out = if quantity == Quantity::Radius { farthest > LIMIT } else { farthest < 1.0 / LIMIT };
            if self.measured > 0 && out {
                let (count, records) = (self.measured, ingested.count);
                let factor = quantity.factor(farthest, context.options.length_scale);
                return Err(BuildError::OutOfRange { quantity, count, records, farthest, factor });
            }
        }
        let mean =
            if self.measured > 0 { (self.log_sum / self.measured as f64).exp() } else { fallback(&ingested) };
        let mean = (mean.clamp(1e-18, 1e18)) as f32;
        let layout = ingested.layout.with_radius();
        let stride = layout.stride();
        let any_unknown = self.unknown > 0;
        let io = context.io("rewrite temporary files in");
        let spill = self.writer.finish().map_err(&io)?;
        let mut range = (f32::INFINITY, 0.0_f32);
        let mut buffer = Vec::new();
        let mut first = 0;
        while first < ingested.count {
            context.check()?;
            let count = (ingested.count - first).min(8192);
            buffer.resize(count as usize * stride, 0);
            spill.read_at(&mut buffer, first * stride as u64).map_err(&io)?;
            for record in buffer.chunks_exact_mut(stride) {
                if record::radius(record) <= 0.0 {
                    record[24..28].copy_from_slice(&mean.to_le_bytes());
                }
                let radius = record::radius(record);
                range = (range.0.min(radius), range.1.max(radius));
            }
            if any_unknown {
                spill.write_at(&buffer, first * stride as u64).map_err(&io)?;
            }
            first += count;
        }
        Ok(Ingested { spill, layout, radius: None, radius_range: range, ..ingested })
    }
}

/// The radius for a cloud that is too small or too degenerate to measure: from the spacing of a surface of its extent, so that
/// neighbours touch but do not hide each other, or 1.
fn fallback(ingested: &Ingested) -> f64 {
    let extent = ingested.bounds.size().max_element();
    let spacing = extent / (ingested.count as f64).sqrt().max(1.0);
    let radius = if spacing > 0.0 && spacing.is_finite() { 0.75 * spacing } else { 1.0 };
    radius * ingested.auto_scale
}

impl Assemble<Measured> for Radii<'_> {
    fn open(&mut self, _: Cell) {}

    fn own(&mut self, piece: Measured) -> Result<(), BuildError> {
        self.take(&piece)
    }

    fn subtree(&mut self, _: Cell, piece: Measured) -> Result<(), BuildError> {
        self.take(&piece)
    }

    fn close(&mut self) -> Result<(), BuildError> {
        Ok(())
    }
}
