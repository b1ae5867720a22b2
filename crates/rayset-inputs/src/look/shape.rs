//! What the shape of points says: on what a thing stands, where its front is, and whether it is a
//! relief or ground.

use rayset::geometry::DVec3;

use super::statistics::{Statistics, range};

/// Cells along the longer side of what is seen from one direction.
const CELLS: f64 = 48.0;

/// A picture of points from one direction: the height of the nearest in each cell, in widths of a
/// cell.
struct Relief {
    columns: usize,
    rows: usize,
    heights: Vec<f64>,
    /// Height of all of it, in widths of a cell.
    depth: f64,
}

impl Relief {
    /// Of points as they are seen against `up`, which points at the eye; `None` of what has no
    /// extent.
    fn of(statistics: &Statistics, up: DVec3, cells: f64) -> Option<Self> {
        let across = up.any_orthonormal_vector();
        let sides = [across, up.cross(across), up];
        let ranges = sides.map(|side| {
            let mut along: Vec<f64> =
                statistics.positions().map(|p| p.dot(side)).filter(|v| v.is_finite()).collect();
            along.sort_by(f64::total_cmp);
            range(&along, 0.002)
        });
        let length = |side: usize| ranges[side].1 - ranges[side].0;
        let cell = length(0).max(length(1)) / cells;
        if !(cell > 0.0 && cell.is_finite()) {
            return None;
        }
        let (columns, rows) = ((length(0) / cell) as usize + 1, (length(1) / cell) as usize + 1);
        let mut heights = vec![f64::NEG_INFINITY; columns * rows];
        for p in statistics.positions() {
            let [x, y, z] = [0, 1, 2].map(|side| (p.dot(sides[side]) - ranges[side].0) / cell);
            if x >= 0.0 && y >= 0.0 && (x as usize) < columns && (y as usize) < rows {
                let height = &mut heights[y as usize * columns + x as usize];
                *height = height.max(z.min(length(2) / cell));
            }
        }
        Some(Self { columns, rows, heights, depth: length(2) / cell })
    }

    /// The height of a cell; `None` of an empty one and outside.
    fn at(&self, x: usize, y: usize) -> Option<f64> {
        let is_within = x < self.columns && y < self.rows;
        let height = is_within.then(|| self.heights[y * self.columns + x])?;
        height.is_finite().then_some(height)
    }

    /// All cells with points: their heights, and those of their four neighbours.
    fn cells(&self) -> impl Iterator<Item = (f64, [Option<f64>; 4])> + '_ {
        let places = (0..self.rows).flat_map(|y| (0..self.columns).map(move |x| (x, y)));
        places.filter_map(|(x, y)| {
            let around = [(x.wrapping_sub(1), y), (x + 1, y), (x, y.wrapping_sub(1)), (x, y + 1)];
            Some((self.at(x, y)?, around.map(|(x, y)| self.at(x, y))))
        })
    }

    /// How uneven it is: how far cells stand out from between their neighbours, in widths of a
    /// cell, on average.
    fn detail(&self) -> f64 {
        let uneven = self.cells().filter_map(|(height, around)| {
            let sum = around.into_iter().sum::<Option<f64>>()?;
            Some((0.25 * sum - height).abs().min(1.0))
        });
        let (count, sum) = uneven.fold((0.0, 0.0), |(count, sum), v| (count + 1.0, sum + v));
        if count > 0.0 { sum / count } else { 0.0 }
    }
}

/// Whether the back of a thing has clearly more detail than its front, so that it is the front: a
/// face, folds, hands.
pub(super) fn is_seen_from_behind(statistics: &Statistics, facing: DVec3) -> bool {
    /// Sides of a thing whose details differ by less are alike.
    const MORE: f64 = 1.15;
    let detail = |toward_eye: DVec3| Relief::of(statistics, toward_eye, CELLS).map_or(0.0, |r| r.detail());
    detail(facing) > MORE * detail(-facing)
}

/// Whether points are the relief of a thing, as a face is, seen along an axis: its middle stands
/// out from an edge that is steep and low all around, toward `up` or away from it, which is
/// returned. Ground has edges of any height.
pub(super) fn relief(statistics: &Statistics, up: DVec3) -> Option<DVec3> {
    /// Cells along the longer side: each has several points of a sample.
    const COARSE: f64 = 24.0;
    /// Ground is flatter, by its height over its longer side.
    const LEAST: f64 = 0.15;
    /// How much higher the middle is than the edge, on average, and how high it is, of the whole
    /// height.
    const ABOVE: f64 = 0.2;
    const HIGH: f64 = 0.45;
    [up, -up].into_iter().find(|&toward| {
        let Some(relief) = Relief::of(statistics, toward, COARSE) else { return false };
        let (mut edge, mut inner) = ((0.0, 0.0), (0.0, 0.0));
        for (height, around) in relief.cells() {
            let of = if around.iter().all(Option::is_some) { &mut inner } else { &mut edge };
            *of = (of.0 + 1.0, of.1 + height / relief.depth);
        }
        let mean = |(count, sum): (f64, f64)| if count > 0.0 { sum / count } else { 0.0 };
        let filled = (edge.0 + inner.0) / (relief.columns * relief.rows) as f64;
        // Of a round thing; tiles of ground fill their corners.
        relief.depth > LEAST * COARSE
            && filled < 0.95
            && mean(inner) > HIGH
            && mean(inner) - mean(edge) > ABOVE
    })
}

/// How well a thing would stand with an axis up: the part of its footprint that what it touches the
/// ground with spans; 0 if it would fall over.
pub(super) fn stance(statistics: &Statistics, up: DVec3) -> f64 {
    /// What lies within this part of the height above the lowest place touches the ground.
    const TOUCHES: f64 = 0.02;
    let across = up.any_orthonormal_vector();
    let sides = [across, up.cross(across)];
    let positions: Vec<DVec3> = statistics.positions().filter(|p| p.is_finite()).collect();
    let mut heights: Vec<f64> = positions.iter().map(|p| p.dot(up)).collect();
    heights.sort_by(f64::total_cmp);
    let (low, high) = range(&heights, 0.002);
    let flat = |p: &DVec3| sides.map(|side| p.dot(side));
    let touching: Vec<[f64; 2]> =
        positions.iter().filter(|p| p.dot(up) < low + TOUCHES * (high - low)).map(flat).collect();
    let hull = hull(touching);
    let area = |corners: &[[f64; 2]]| {
        let pairs = corners.iter().zip(corners.iter().cycle().skip(1));
        0.5 * pairs.map(|(a, b)| a[0] * b[1] - a[1] * b[0]).sum::<f64>()
    };
    let count = positions.len().max(1) as f64;
    let middle =
        positions.iter().map(flat).fold([0.0, 0.0], |m, p| [m[0] + p[0] / count, m[1] + p[1] / count]);
    let stands = hull.len() > 2
        && hull
            .iter()
            .zip(hull.iter().cycle().skip(1))
            .all(|(a, b)| (b[0] - a[0]) * (middle[1] - a[1]) - (b[1] - a[1]) * (middle[0] - a[0]) >= 0.0);
    let footprint = sides.map(|side| {
        let along = positions.iter().map(|p| p.dot(side));
        let (low, high) = along.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        high - low
    });
    let whole = footprint[0] * footprint[1];
    if stands && whole > 0.0 { area(&hull) / whole } else { 0.0 }
}

/// The convex hull of points, counterclockwise (Andrew's monotone chain).
fn hull(mut points: Vec<[f64; 2]>) -> Vec<[f64; 2]> {
    points.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    points.dedup();
    let turns_left = |a: [f64; 2], b: [f64; 2], c: [f64; 2]| {
        (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) > 0.0
    };
    let chain = |points: &mut dyn Iterator<Item = [f64; 2]>| {
        let mut chain: Vec<[f64; 2]> = Vec::new();
        for p in points {
            while let [.., a, b] = chain[..]
                && !turns_left(a, b, p)
            {
                chain.pop();
            }
            chain.push(p);
        }
        chain.pop();
        chain
    };
    let mut lower = chain(&mut points.iter().copied());
    lower.extend(chain(&mut points.iter().rev().copied()));
    lower
}
