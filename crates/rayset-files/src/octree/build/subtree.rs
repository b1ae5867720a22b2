//! Converts sorted records in memory to encoded runs and draft nodes, in several threads at once.

use super::depths::Scale;
use super::options::Precision;
use super::pieces::Pack;
use super::plan::{Cell, LEAF_POINTS};
use super::record::{self, KeyMaker, RecordLayout};
use super::sorted::Sorted;
use super::survey::Survey;
use crate::octree::layout::{RUN_POINTS, RootCell};
use crate::octree::page::RunHead;
use crate::octree::run_encoder::{RunColumns, encode_run};
use crate::octree::shape::StoredShape;
use rayset_base::cancel::CancelToken;
use rayset_base::geometry::curve::MAX_LEVEL;
use rayset_base::geometry::{Aabb, DVec3};

/// The totals and bounds of a set of points, for node records and the header.
#[derive(Clone, Copy, Debug)]
pub(super) struct Summary {
    pub(super) influence: Aabb,
    pub(super) points: u64,
    pub(super) weight_sum: f64,
    pub(super) radius_sum: f64,
    /// Sums of |weight| · (position − root corner), and of |weight|.
    pub(super) moment: DVec3,
    pub(super) mass: f64,
    pub(super) detail_min: f32,
    pub(super) detail_max: f32,
    pub(super) radius_max: f32,
    pub(super) position_error: f64,
    pub(super) position_error_radii: f64,
}

impl Summary {
    pub(super) const EMPTY: Self = Self {
        influence: Aabb::EMPTY,
        points: 0,
        weight_sum: 0.0,
        radius_sum: 0.0,
        moment: DVec3::ZERO,
        mass: 0.0,
        detail_min: f32::INFINITY,
        detail_max: 0.0,
        radius_max: 0.0,
        position_error: 0.0,
        position_error_radii: 0.0,
    };

    pub(super) fn merge(&mut self, other: &Self) {
        self.influence = self.influence.union(other.influence);
        self.points += other.points;
        self.weight_sum += other.weight_sum;
        self.radius_sum += other.radius_sum;
        self.moment += other.moment;
        self.mass += other.mass;
        self.detail_min = self.detail_min.min(other.detail_min);
        self.detail_max = self.detail_max.max(other.detail_max);
        self.radius_max = self.radius_max.max(other.radius_max);
        self.position_error = self.position_error.max(other.position_error);
        self.position_error_radii = self.position_error_radii.max(other.position_error_radii);
    }
}

/// A run, and the range of its data in the piece.
#[derive(Clone, Debug)]
pub(super) struct DraftRun {
    pub(super) head: RunHead,
    pub(super) data: std::ops::Range<usize>,
    pub(super) summary: Summary,
}

/// A node whose runs have not been placed in pages yet.
#[derive(Clone, Debug)]
pub(super) struct DraftNode {
    pub(super) level: u32,
    /// The node's own runs, as a range of those of the piece.
    pub(super) own: std::ops::Range<usize>,
    /// Octant and index in the piece of each child, in ascending order; children come before their
    /// parents.
    pub(super) children: Vec<(u8, usize)>,
    pub(super) summary: Summary,
}

/// The runs and nodes made from a stretch of records; the last node, if any, is the root.
#[derive(Clone, Debug, Default)]
pub(super) struct Piece {
    pub(super) data: Vec<u8>,
    pub(super) runs: Vec<DraftRun>,
    pub(super) nodes: Vec<DraftNode>,
}

/// Encodes runs and drafts nodes.
pub(super) struct Packer {
    keys: KeyMaker,
    root: RootCell,
    layout: RecordLayout,
    store_radius: bool,
    store_weight: bool,
    store_shape: bool,
    weight: f32,
    /// How colours become 0 to 1, by depth.
    color_scales: Vec<Scale>,
    precision: f64,
    cancel: CancelToken,
}

impl Packer {
    /// If `cancel` is cancelled, the packed pieces are incomplete and must not be used.
    pub(super) fn new(survey: &Survey, precision: Precision, cancel: &CancelToken) -> Self {
        let (radius, weight) = survey.columns();
        Self {
            keys: survey.keys(),
            root: survey.root,
            layout: survey.layout.clone(),
            store_radius: radius.is_stored(),
            store_weight: weight.is_stored(),
            store_shape: survey.has_shapes,
            weight: survey.weight,
            color_scales: survey.depths.scales(),
            precision: if let Precision::Relative(p) = precision { p } else { 0.0 },
            cancel: cancel.clone(),
        }
    }

    /// Drafts a node and everything below it; returns its index in the piece.
    fn draft(&self, level: u32, records: Sorted<'_>, piece: &mut Piece) -> usize {
        let (own, below) = if records.len() as u64 <= LEAF_POINTS || level == MAX_LEVEL {
            (records, None)
        } else {
            let (own, children) = records.split(level);
            (own, Some(children))
        };
        // A node's own runs come before those of its children.
        let first = piece.runs.len();
        self.encode_runs(own, piece);
        let own = first..piece.runs.len();
        let mut summary = Summary::EMPTY;
        piece.runs[own.clone()].iter().for_each(|r| summary.merge(&r.summary));
        let mut children = Vec::new();
        for (octant, child) in below.iter().flatten().enumerate().filter(|(_, c)| c.len() > 0) {
            let index = self.draft(level + 1, *child, piece);
            summary.merge(&piece.nodes[index].summary);
            children.push((octant as u8, index));
        }
        piece.nodes.push(DraftNode { level, own, children, summary });
        piece.nodes.len() - 1
    }

    fn encode_runs(&self, records: Sorted<'_>, piece: &mut Piece) {
        let mut columns = Columns::default();
        let mut start = 0;
        while start < records.len() && !self.cancel.is_cancelled() {
            let end = records.len().min(start + RUN_POINTS);
            self.gather(records.slice(start..end), &mut columns);
            let run = self.encode_run(&columns, piece);
            piece.runs.push(run);
            start = end;
        }
    }

    fn gather(&self, records: Sorted<'_>, columns: &mut Columns) {
        let layout = &self.layout;
        columns.clear(layout.attributes.len());
        for i in 0..records.len() {
            let r = records.record(i);
            columns.position.push(record::position(r));
            columns.radius.push(self.keys.radius(r));
            columns.weight.push(if layout.has_weight {
                record::float(r, layout.weight_at())
            } else {
                self.weight
            });
            if layout.has_color {
                let (color, depth) = record::color(r, layout.color_at());
                let (factor, offset) = self.color_scales.get(depth as usize).copied().unwrap_or_default();
                // NaN becomes 0, by the cast.
                columns
                    .color
                    .push(color.map(|v| ((v * factor + offset).clamp(0.0, 1.0) * 255.0).round() as u8));
            }
            columns.harmonics.extend_from_slice(&r[layout.harmonics()]);
            if self.store_shape {
                columns.shape.push(record::shape(r, layout.shape_at()));
            }
            for (index, column) in columns.attributes.iter_mut().enumerate() {
                let at = layout.attribute_at(index);
                column.extend_from_slice(&r[at..at + layout.attributes[index].bytes()]);
            }
        }
    }

    fn encode_run(&self, columns: &Columns, piece: &mut Piece) -> DraftRun {
        let attributes: Vec<&[u8]> = columns.attributes.iter().map(Vec::as_slice).collect();
        let run = RunColumns {
            position: &columns.position,
            radius: &columns.radius,
            store_radius: self.store_radius,
            weight: self.store_weight.then_some(columns.weight.as_slice()),
            color: self.layout.has_color.then_some(columns.color.as_slice()),
            harmonics: &columns.harmonics,
            shape: self.store_shape.then_some(columns.shape.as_slice()),
            attributes: &attributes,
        };
        let start = piece.data.len();
        let encoded = encode_run(&run, self.root, self.precision, &mut piece.data);
        let mut summary = Summary {
            points: columns.position.len() as u64,
            position_error: encoded.position_error,
            position_error_radii: encoded.position_error_radii,
            ..Summary::EMPTY
        };
        for (i, ((p, &r), &w)) in
            columns.position.iter().zip(&columns.radius).zip(&columns.weight).enumerate()
        {
            let (p, w) = (DVec3::from_array(*p), f64::from(w));
            let (half, detail) = match run.shape {
                None => (DVec3::splat(f64::from(r)), r),
                Some(shapes) => (shapes[i].half_extent(r), shapes[i].detail(r)),
            };
            let reach = half + encoded.position_error;
            summary.influence = summary.influence.union(Aabb::new(p - reach, p + reach));
            summary.weight_sum += w;
            summary.radius_sum += f64::from(r);
            summary.moment += (p - self.root.min) * w.abs();
            summary.mass += w.abs();
            summary.detail_min = summary.detail_min.min(detail);
            summary.detail_max = summary.detail_max.max(detail);
            summary.radius_max = summary.radius_max.max(r);
        }
        DraftRun { head: encoded.head, data: start..piece.data.len(), summary }
    }
}

impl Pack for Packer {
    type Piece = Piece;

    fn subtree(&self, cell: Cell, records: Sorted<'_>) -> Piece {
        let mut piece = Piece::default();
        self.draft(cell.level, records, &mut piece);
        piece
    }

    fn own(&self, records: Sorted<'_>) -> Piece {
        let mut piece = Piece::default();
        self.encode_runs(records, &mut piece);
        piece
    }
}

/// The columns of a run; the buffers are reused.
#[derive(Default)]
struct Columns {
    position: Vec<[f64; 3]>,
    radius: Vec<f32>,
    weight: Vec<f32>,
    color: Vec<[u8; 3]>,
    harmonics: Vec<u8>,
    shape: Vec<StoredShape>,
    /// Each in its own type, little-endian.
    attributes: Vec<Vec<u8>>,
}

impl Columns {
    fn clear(&mut self, attributes: usize) {
        self.position.clear();
        self.radius.clear();
        self.weight.clear();
        self.color.clear();
        self.harmonics.clear();
        self.shape.clear();
        self.attributes.resize_with(attributes, Vec::new);
        self.attributes.iter_mut().for_each(Vec::clear);
    }
}
