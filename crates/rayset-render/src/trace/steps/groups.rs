//! Points of a run that are a detail together.

use std::ops::Range;

use fearless_simd::f64x4;
use fearless_simd::prelude::*;

use super::CloudPlacement;
use crate::field::{SimdLevel, dispatch};
use rayset_base::geometry::{Aabb, DVec3};
use rayset_files::octree::layout::RUN_POINTS;
use rayset_files::octree::page::Run;

/// Points of a run that are a detail together: few enough that their box is not much larger than
/// the spheres in it.
pub(super) const GROUP_POINTS: usize = 16;

const _: () = assert!(RUN_POINTS.is_multiple_of(GROUP_POINTS) && GROUP_POINTS.is_multiple_of(4));

/// The points of a run, in groups; the last one is filled up with its last point.
pub(super) struct RunGroups<'t> {
    cloud: &'t CloudPlacement,
    simd: SimdLevel,
    len: usize,
    /// In the cloud's space.
    position: [[f64; RUN_POINTS]; 3],
    radius: [f64; RUN_POINTS],
    detail: [f64; RUN_POINTS],
}

/// A point of a group, in the cloud's space.
#[derive(Clone, Copy)]
pub(super) struct GroupPoint {
    pub(super) position: DVec3,
    pub(super) radius: f64,
    pub(super) detail: f64,
}

/// A group of points.
pub(super) struct Group<'t> {
    run: &'t RunGroups<'t>,
    /// Numbers of its points in the run.
    numbers: Range<usize>,
    /// The box around the spheres of their radii, in the cloud's space.
    pub(super) bounds: Aabb,
    pub(super) least_detail: f64,
}

impl Group<'_> {
    pub(super) fn largest_radius(&self) -> f64 {
        self.points().map(|point| point.radius).fold(0.0, f64::max)
    }

    pub(super) fn points(&self) -> impl Iterator<Item = GroupPoint> {
        let RunGroups { position: [x, y, z], radius, detail, .. } = self.run;
        self.numbers.clone().map(move |i| {
            let position = DVec3::new(x[i], y[i], z[i]);
            GroupPoint { position, radius: radius[i], detail: detail[i] }
        })
    }
}

impl<'t> RunGroups<'t> {
    pub(super) fn new(cloud: &'t CloudPlacement, simd: SimdLevel) -> Self {
        let radius = [f64::from(cloud.header().radius.min()); RUN_POINTS];
        Self { cloud, simd, len: 0, position: [[0.0; RUN_POINTS]; 3], radius, detail: radius }
    }

    pub(super) fn decode(&mut self, run: &Run<'_>) {
        self.len = run.head.len();
        if let Some(stored) = run.radii(self.cloud.header()) {
            self.radius.iter_mut().zip(stored).for_each(|(radius, stored)| *radius = f64::from(stored));
        }
        run.decode_local_f64(self.cloud.root_cell, &mut self.position);
        let center = run.head.position_bounds(self.cloud.root_cell).center();
        let last_group = self.len..self.len.next_multiple_of(GROUP_POINTS);
        for (column, center) in self.position.iter_mut().zip(center.to_array()) {
            column[..self.len].iter_mut().for_each(|offset| *offset += center);
            let last = column[self.len - 1];
            column[last_group.clone()].fill(last);
        }
        let last = self.radius[self.len - 1];
        self.radius[last_group.clone()].fill(last);
        self.detail = self.radius;
        if let Some(stored) = run.details(self.cloud.header()) {
            self.detail.iter_mut().zip(stored).for_each(|(detail, stored)| *detail = f64::from(stored));
            let last = self.detail[self.len - 1];
            self.detail[last_group].fill(last);
        }
    }

    pub(super) fn each(&self, mut visit: impl FnMut(Group<'_>)) {
        for first in (0..self.len).step_by(GROUP_POINTS) {
            let (bounds, least_detail) = dispatch!(self.simd.level(), simd => self.bounds(simd, first));
            let numbers = first..self.len.min(first + GROUP_POINTS);
            visit(Group { run: self, numbers, bounds, least_detail });
        }
    }

    /// The box around the spheres of the radii of a group, and the least detail.
    #[inline(always)]
    fn bounds<S: Simd>(&self, simd: S, first: usize) -> (Aabb, f64) {
        let of = |column: &[f64; RUN_POINTS], at: usize| f64x4::from_slice(simd, &column[at..at + 4]);
        let mut bounds = Aabb::EMPTY;
        let (least, most) = (f64x4::splat(simd, f64::INFINITY), f64x4::splat(simd, f64::NEG_INFINITY));
        for axis in 0..3 {
            let (mut low, mut high) = (least, most);
            for at in (first..first + GROUP_POINTS).step_by(4) {
                let (position, radius) = (of(&self.position[axis], at), of(&self.radius, at));
                low = low.min_precise(position - radius);
                high = high.max_precise(position + radius);
            }
            (bounds.min[axis], bounds.max[axis]) = (low.reduce_min_precise(), high.reduce_max_precise());
        }
        let details = (first..first + GROUP_POINTS).step_by(4).map(|at| of(&self.detail, at));
        (bounds, details.fold(least, |least, detail| least.min_precise(detail)).reduce_min_precise())
    }
}
