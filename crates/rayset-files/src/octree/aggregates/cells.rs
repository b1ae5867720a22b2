//! The cells of a leaf: its points are divided by the same curve as nodes are, down to cells of few
//! points. A cell stands for those of its points whose radii are no larger than its edge: others
//! are as large as a pixel where it is, and are seen themselves.

use std::ops::Range;

use super::histogram::Masses;
use super::moments::Moments;
use super::places::PLACES;
use super::points::Points;
use super::records::{RecordMaker, RecordsByLevel};
use crate::octree::layout::RootCell;
use rayset_base::geometry::DVec3;
use rayset_base::geometry::curve::{MAX_LEVEL, hilbert};

/// Cells are at most so many levels below their leaf. It bounds how many records there are of
/// points in tight clumps, each of which would have one at every level.
const MOST_LEVELS_BELOW: u32 = 6;

/// Which children of a cell have records, and the number of the first among those of its level.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Children {
    pub(super) mask: u8,
    pub(super) first: u32,
}

/// The own points of a node, as its record and those of its cells are made of them.
pub(super) struct OwnPoints<'a> {
    pub(super) points: &'a Points,
    /// The half octaves of the densities at the places in each point.
    pub(super) half_octaves: &'a [Option<i32>],
    /// Of all points.
    pub(super) densities: &'a Masses,
    /// Of the kernel.
    pub(super) variance: f64,
    /// Cells of at most so many points have no record.
    pub(super) few: usize,
    pub(super) maker: &'a RecordMaker,
}

impl OwnPoints<'_> {
    /// The moments of all points, as those of the cell of a node at this level.
    pub(super) fn whole(&self, level: u32) -> Moments {
        let mut moments = Moments::none(&self.maker.carried);
        self.add(0..self.points.len(), (0.0, self.maker.edge(level)), &mut moments);
        moments
    }

    /// The same of a leaf, and the records of its cells.
    pub(super) fn divide(&self, level: u32) -> (Moments, Children, RecordsByLevel) {
        let mut records = RecordsByLevel::default();
        let codes = codes(&self.points.position, self.maker.root);
        let (moments, children) = self.cell(&codes, 0..codes.len(), (level, level), &mut records);
        (moments, children, records)
    }

    /// The moments of those points of a cell whose radius is no larger than its edge, and what
    /// records it has below it. Levels are its own and that of the leaf.
    fn cell(
        &self,
        codes: &[u64],
        range: Range<usize>,
        (level, of_leaf): (u32, u32),
        records: &mut RecordsByLevel,
    ) -> (Moments, Children) {
        let mut moments = Moments::none(&self.maker.carried);
        let edge = self.maker.edge(level);
        let deepest = MAX_LEVEL.min(of_leaf + MOST_LEVELS_BELOW);
        if level == deepest || range.len() <= self.few {
            self.add(range, (0.0, edge), &mut moments);
            return (moments, Children::default());
        }
        let shift = 3 * (MAX_LEVEL - level - 1);
        let (mut start, mut mask) = (range.start, 0_u8);
        let mut siblings = Vec::new();
        while start < range.end {
            let rank = codes[start] >> shift;
            let end = start + codes[start..range.end].partition_point(|code| code >> shift <= rank);
            let (below, children) = self.cell(codes, start..end, (level + 1, of_leaf), records);
            moments.merge(&below);
            if below.points > self.few as u64
                && let Some(mut aggregate) = below.aggregate(self.densities)
            {
                (aggregate.child_mask, aggregate.first_child) = (children.mask, children.first);
                aggregate.first_point = start as u16;
                aggregate.more_points = (end - start - 1) as u16;
                mask |= 1 << (rank & 7);
                self.maker.encode(&aggregate, &below, level + 1, &mut siblings);
            }
            start = end;
        }
        self.add(range, (0.5 * edge, edge), &mut moments);
        let first = records.append((level - of_leaf) as usize, &siblings, self.maker.record_bytes());
        (moments, Children { mask, first })
    }

    /// Adds those of some points whose radii are above a length and no more than another.
    fn add(&self, range: Range<usize>, (above, most): (f64, f64), moments: &mut Moments) {
        for index in range {
            let radius = self.points.radius[index];
            if radius > above && radius <= most {
                let half_octaves = &self.half_octaves[PLACES * index..PLACES * (index + 1)];
                moments.add(self.points, index, half_octaves, self.variance);
            }
        }
    }
}

/// The places of points along the curve. What is stored of a position may lie in another cell than
/// the position did, so that none is before that of the point before it.
fn codes(positions: &[DVec3], root: RootCell) -> Vec<u64> {
    let cells = f64::from(1_u32 << MAX_LEVEL);
    let mut last = 0;
    let code = |position: &DVec3| {
        let place = (*position - root.min) * (cells / root.size);
        last = hilbert(place.to_array().map(|v| v.clamp(0.0, cells - 1.0) as u32)).max(last);
        last
    };
    positions.iter().map(code).collect()
}
