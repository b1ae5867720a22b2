//! Splats as wide as a filter makes them.
//!
//! A renderer of splats projects the covariance of each to the picture and adds v square pixels to
//! it. Here the same is done in space, where splats are cut and lit: to the covariance Σ of a splat
//! s²·1 is added, where s is √v times the edge of a pixel at the splat. Projected along any ray,
//! that adds s² to the covariance across it, so its α is that of the renderer; its axes stay. With
//! E = ln(512·o) of an opacity o, its semi-axes r·aₖ are √(2E) deviations long, and become
//! √((r·aₖ)² + 2E·s²).
//!
//! So that a splat smaller than a pixel does not take more than its share of it, the `mip` filter
//! multiplies its opacity by √(det P/det P′), with P the covariance across the ray before and P′
//! after: with A the map that takes the splat to the unit ball and t the direction of the ray,
//! det P is in proportion to |A t|²/det A².

use super::columns::{MAP_COLUMNS, PointColumns};
use super::footprints::{Footprints, dot};
use super::run::DecodedRun;
use super::sight::Sight;
use super::simd::{SimdLevel, dispatch};
use super::splat_filter::SplatFilter;
use crate::math::ln;
use rayset_files::octree::layout::RUN_POINTS;

impl DecodedRun {
    /// Widens splats by what a filter adds to each where it is. Returns the least detail of those
    /// of a run that has shapes: twice the shortest semi-axis, or the longest.
    // Compiled apart: most runs are of no splats.
    #[inline(never)]
    pub(super) fn widen(&mut self, filter: SplatFilter, sight: &Sight, simd: SimdLevel) -> f64 {
        dispatch!(simd.level(), _simd => {
            let added = Footprints::new(sight, sight.pixel * filter.variance().sqrt(), self);
            let compensates = filter == SplatFilter::Mip;
            if self.points.map.is_empty() {
                widen_balls(&added, compensates, &mut self.points);
                f64::INFINITY
            } else {
                let detail = widen_ellipsoids(&added, compensates, &mut self.points);
                f64::from(detail[..self.len].iter().copied().fold(f32::INFINITY, f32::min))
            }
        })
    }
}

/// The largest factor on the square of a semi-axis.
const WIDEST: f32 = 1e30;
/// The least factor on the square of a radius as its splat becomes less opaque. What would be less
/// absorbs hardly more than what is cut off, and is gone.
const LEAST_KEPT: f32 = 1.0 / 64.0;

/// The factor on the square of a semi-axis to which this part of it is added.
#[inline(always)]
fn wider_by(part: f32) -> f32 {
    // Not a number of nothing on what is too thin for its square, which `max` leaves out.
    (1.0 + part.max(0.0)).min(WIDEST)
}

/// What is left of the extent of a splat when half the logarithm of the area across a ray has grown
/// by `grown`; and the factor on the square of its radius.
#[inline(always)]
fn compensated(extent: f32, grown: f32) -> (f32, f32) {
    // Not a number of what absorbs nothing, which `max` leaves out.
    let kept = ((extent - grown.max(0.0)) / extent).max(0.0);
    (if kept >= LEAST_KEPT { extent * kept } else { 0.0 }, kept.max(LEAST_KEPT))
}

// Loops over plain columns, without branches: the compiler makes vectors of them.

#[inline(always)]
fn widen_balls(added: &Footprints, compensates: bool, points: &mut PointColumns) {
    for i in 0..RUN_POINTS {
        let (extent, inverse) = (points.weight[i], points.inverse_radius[i]);
        let wider = wider_by(2.0 * extent * added.squared[i] * inverse * inverse);
        let (left, kept) = if compensates { compensated(extent, ln(wider)) } else { (extent, 1.0) };
        let radius = points.radius[i] * (wider * kept).sqrt();
        points.radius[i] = radius;
        points.inverse_radius[i] = 1.0 / radius;
        points.weight[i] = left;
    }
}

/// Returns the detail of each.
#[inline(always)]
fn widen_ellipsoids(added: &Footprints, compensates: bool, points: &mut PointColumns) -> [f32; RUN_POINTS] {
    let mut detail = [f32::INFINITY; RUN_POINTS];
    let Some(map) = points.map.first_chunk_mut::<MAP_COLUMNS>() else { return detail };
    for i in 0..RUN_POINTS {
        let rows = [0, 3, 6].map(|row| [map[row][i], map[row + 1][i], map[row + 2][i]]);
        // Of each semi-axis, one by its square.
        let inverse = rows.map(|row| dot(row, row));
        let extent = points.weight[i];
        let wider = inverse.map(|inverse| wider_by(2.0 * extent * added.squared[i] * inverse));
        let (left, kept) = if compensates {
            let toward = [0, 1, 2].map(|axis| added.toward[axis][i]);
            let along = rows.map(|row| dot(row, toward) * dot(row, toward));
            let before = along[0] + along[1] + along[2];
            let after = along[0] / wider[0] + along[1] / wider[1] + along[2] / wider[2];
            // One by one: their product may be no number.
            let grown = ln(wider[0]) + ln(wider[1]) + ln(wider[2]) + ln(after / before);
            compensated(extent, 0.5 * grown)
        } else {
            (extent, 1.0)
        };
        for (row, wider) in wider.into_iter().enumerate() {
            let shrinks = 1.0 / (wider * kept).sqrt();
            for axis in 0..3 {
                map[3 * row + axis][i] = rows[row][axis] * shrinks;
            }
        }
        let radius = points.radius[i] * (wider[0] * kept).sqrt();
        points.radius[i] = radius;
        points.inverse_radius[i] = 1.0 / radius;
        points.weight[i] = left;
        detail[i] = radius.min(2.0 * (wider[2] * kept / inverse[2]).sqrt());
    }
    detail
}
