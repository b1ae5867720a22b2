//! Points in one place, which are one point to the inner loop: a scanner that stands still stores a
//! place a thousand times.

use std::ops::Range;

use super::columns::PointColumns;
use super::run::{DecodedRun, RunDecoder};
use rayset_files::octree::layout::RUN_POINTS;
use rayset_files::octree::page::Run;

impl RunDecoder {
    /// Whether a run may be in the place of another, which is one point: two runs of one place have
    /// the same bounds.
    pub(super) fn may_join(&self, run: &Run<'_>, other: &DecodedRun) -> bool {
        !self.are_splats && other.len == 1 && {
            let bounds = run.head.position_bounds(self.root);
            bounds.center() == other.center && bounds.size().max_element() == other.size.0
        }
    }
}

impl DecodedRun {
    /// Makes one point of points with one place, one radius and shape, and weights above zero:
    /// their density is one kernel's with the sum of their weights, and their attributes are
    /// averaged by weight, as those of samples are. Not for points with labels, which are not
    /// averaged: each counts by itself.
    #[cold]
    pub(super) fn merge_places(&mut self) {
        let same = self.points.same_as_before();
        let (mut len, mut first) = (0, 0);
        while first < self.len {
            let others = same[first + 1..self.len].iter().take_while(|&&same| same).count();
            self.merge_into(len, first..first + 1 + others);
            (len, first) = (len + 1, first + 1 + others);
        }
        self.len = len;
    }

    /// Point `to`, of which nothing is needed any more, becomes the points of a stretch.
    fn merge_into(&mut self, to: usize, stretch: Range<usize>) {
        let points = &mut self.points;
        let radii = [&mut points.radius, &mut points.inverse_radius];
        for column in points.position.iter_mut().chain(radii).chain(&mut points.map) {
            column[to] = column[stretch.start];
        }
        let weights = &points.weight[stretch.clone()];
        let sum = weights.iter().sum::<f32>();
        for column in &mut self.attribute {
            let values = column[stretch.clone()].iter();
            column[to] = match weights {
                [_] => column[stretch.start],
                _ => values.zip(weights).map(|(value, weight)| value * weight).sum::<f32>() / sum,
            };
        }
        points.weight[to] = sum;
    }

    /// Merges the only point of another run with the only point of this one, in the same way.
    /// Returns whether it has become part of it.
    pub(super) fn join(&mut self, other: &Self) -> bool {
        let is_one_point = |run: &Self| run.len == 1 && run.label.is_empty() && run.wide.is_none();
        let is_one = [&*self, other].into_iter().all(is_one_point)
            && self.center == other.center
            && self
                .points
                .position
                .iter()
                .zip(&other.points.position)
                .all(|(axis, other)| axis[0] == other[0])
            && self.points.radius[0] == other.points.radius[0]
            && self.points.map.iter().zip(&other.points.map).all(|(a, b)| a[0] == b[0])
            && may_merge(self.points.weight[0], other.points.weight[0]);
        if !is_one {
            return false;
        }
        let added = other.points.weight[0];
        self.points.weight[0] += added;
        let part = added / self.points.weight[0];
        for (column, other) in self.attribute.iter_mut().zip(&other.attribute) {
            column[0] += (other[0] - column[0]) * part;
        }
        true
    }
}

impl PointColumns {
    /// For each point whether it may be merged with the one before.
    fn same_as_before(&self) -> [bool; RUN_POINTS] {
        let mut same = [true; RUN_POINTS];
        for column in self.position.iter().chain([&self.radius]).chain(&self.map) {
            for i in 1..RUN_POINTS {
                same[i] &= column[i] == column[i - 1];
            }
        }
        for i in 1..RUN_POINTS {
            same[i] &= may_merge(self.weight[i], self.weight[i - 1]);
        }
        same
    }
}

/// Whether a mean by these weights is one of values between the others.
fn may_merge(a: f32, b: f32) -> bool {
    a > 0.0 && b > 0.0
}
