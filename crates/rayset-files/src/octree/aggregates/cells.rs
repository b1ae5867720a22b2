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

/// How many cells are below another, and the number of the first among those of its level.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Cells {
    pub(super) count: u8,
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
    /// Cells of at most so many points are not divided.
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
    pub(super) fn divide(&self, level: u32) -> (Moments, Cells, RecordsByLevel) {
        let mut records = RecordsByLevel::default();
        let codes = codes(&self.points.position, self.maker.root, level);
        let (moments, cells) = self.cell(&codes, 0..codes.len(), (level, level), &mut records);
        (moments, cells, records)
    }

    /// The moments of those points of a cell whose radius is no larger than its edge, and what
    /// records it has below it. Levels are its own and that of the leaf.
    fn cell(
        &self,
        codes: &[u64],
        range: Range<usize>,
        (level, of_leaf): (u32, u32),
        records: &mut RecordsByLevel,
    ) -> (Moments, Cells) {
        let mut moments = Moments::none(&self.maker.carried);
        let edge = self.maker.edge(level);
        let deepest = MAX_LEVEL.min(of_leaf + MOST_LEVELS_BELOW);
        if level == deepest || range.len() <= self.few {
            self.add(range, (0.0, edge), &mut moments);
            return (moments, Cells::default());
        }
        let shift = 3 * (MAX_LEVEL - level - 1);
        let mut count = 0_u8;
        let mut siblings = Vec::new();
        let mut start = range.start;
        while start < range.end {
            let cell = codes[start] >> shift;
            let end = start + codes[start..range.end].partition_point(|code| code >> shift <= cell);
            let (below, cells) = self.cell(codes, start..end, (level + 1, of_leaf), records);
            moments.merge(&below);
            if let Some(mut aggregate) = below.aggregate(self.densities) {
                (aggregate.cells, aggregate.first_child) = (cells.count, cells.first);
                aggregate.first_point = start as u16;
                aggregate.more_points = (end - start - 1) as u16;
                count += 1;
                self.maker.encode(&aggregate, &below, level + 1, &mut siblings);
            }
            start = end;
        }
        self.add(range, (0.5 * edge, edge), &mut moments);
        let first = records.append((level - of_leaf) as usize, &siblings, self.maker.record_bytes());
        (moments, Cells { count, first })
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

/// The places along the curve of the points of a leaf, whose level is given, none before that of
/// the point before it. What is stored of a position may lie a little outside the cell that the
/// position was in: outside the leaf it counts as at its border, and where it is out of order, as
/// the point before it.
fn codes(positions: &[DVec3], root: RootCell, level: u32) -> Vec<u64> {
    let cells = f64::from(1_u32 << MAX_LEVEL);
    let places: Vec<[u32; 3]> = positions
        .iter()
        .map(|position| {
            let place = (*position - root.min) * (cells / root.size);
            place.to_array().map(|v| v.clamp(0.0, cells - 1.0) as u32)
        })
        .collect();
    let shift = MAX_LEVEL - level;
    let leaf = majority(places.iter().map(|place| place.map(|v| v >> shift)));
    let codes: Vec<u64> = places
        .iter()
        .map(|place| {
            let within = std::array::from_fn(|axis| {
                let first = leaf[axis] << shift;
                place[axis].clamp(first, first + ((1 << shift) - 1))
            });
            hilbert(within)
        })
        .collect();
    in_order(codes)
}

/// The value that more than half of all are, or some value (Boyer, Moore 1981).
fn majority(values: impl Iterator<Item = [u32; 3]>) -> [u32; 3] {
    let vote = |(value, votes): ([u32; 3], u32), next: [u32; 3]| match votes {
        0 => (next, 1),
        _ if next == value => (value, votes + 1),
        _ => (value, votes - 1),
    };
    values.fold(([0; 3], 0), vote).0
}

/// Numbers of which as many as may be stay (the longest ascending subsequence, by Fredman 1975).
/// Each other becomes the one before it.
fn in_order(mut numbers: Vec<u64>) -> Vec<u64> {
    if numbers.is_sorted() {
        return numbers;
    }
    // For each length, where the subsequence ends whose last number is least; and for each number,
    // what comes before it.
    let mut ends: Vec<usize> = Vec::new();
    let mut before = vec![usize::MAX; numbers.len()];
    for at in 0..numbers.len() {
        let length = ends.partition_point(|&end| numbers[end] <= numbers[at]);
        if length > 0 {
            before[at] = ends[length - 1];
        }
        if length == ends.len() {
            ends.push(at);
        } else {
            ends[length] = at;
        }
    }
    let mut stays = vec![false; numbers.len()];
    let mut at = ends.last().copied().unwrap_or(usize::MAX);
    while at != usize::MAX {
        stays[at] = true;
        at = before[at];
    }
    let mut last = stays.iter().position(|&stays| stays).map_or(0, |first| numbers[first]);
    for (number, stays) in numbers.iter_mut().zip(stays) {
        if stays {
            last = *number;
        }
        *number = last;
    }
    numbers
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_few_numbers_out_of_order_move_no_others(
            mut numbers in prop::collection::vec(0..1000_u64, 1..60),
            outliers in prop::collection::vec((any::<prop::sample::Index>(), any::<u64>()), 0..4),
        ) {
            numbers.sort_unstable();
            let mut mixed = numbers.clone();
            outliers.iter().for_each(|(at, value)| mixed[at.index(numbers.len())] = *value);
            let ordered = in_order(mixed.clone());
            prop_assert!(ordered.is_sorted());
            let moved = ordered.iter().zip(&mixed).filter(|(a, b)| a != b).count();
            prop_assert!(moved <= outliers.len(), "{mixed:?} became {ordered:?}");
        }
    }

    #[test]
    fn points_beside_their_leaf_are_at_its_border() {
        let root = RootCell { min: DVec3::ZERO, size: 8.0 };
        // A leaf of the level 3 from 1 to 2; one point is rounded below it.
        let positions = [1.1, 1.2, 0.999_999, 1.3].map(|x| DVec3::new(x, 1.5, 1.5));
        let codes = codes(&positions, root, 3);
        assert!(codes.is_sorted());
        assert!(codes.iter().all(|code| code >> (3 * 17) == codes[0] >> (3 * 17)), "in other leaves");
    }
}
