//! Clusters of points of a run, in single precision: their places, shapes and masses. Which points
//! are a cluster is said in [`crate::lod`].

use super::run::DecodedRun;
use crate::lod::ClusterCells;
use rayset_base::geometry::DVec3;
use rayset_files::octree::layout::RUN_POINTS;

type Column = [f32; RUN_POINTS];

/// What is known of each point of a run before it becomes part of a cluster.
#[derive(Clone, Debug)]
pub(super) struct Points {
    /// The part of each that is seen as a Gaussian, and the mass of this.
    pub(super) part: Column,
    pub(super) seen: [f64; RUN_POINTS],
    /// The covariance of its mass: xx, yy, zz, xy, xz, yz.
    pub(super) covariance: [Column; 6],
}

/// Clusters, in the order of their points.
#[derive(Clone, Debug)]
pub(super) struct Clusters {
    pub(super) len: usize,
    /// The part of each that is seen, its whole mass, and the area that this takes of the light.
    pub(super) part: Column,
    pub(super) mass: [f64; RUN_POINTS],
    pub(super) cross_section: [f64; RUN_POINTS],
    pub(super) covariance: [Column; 6],
    cells: Cells,
}

/// Sums over the points of a cell, by masses m and the parts q of them that are seen.
#[derive(Clone, Copy, Default)]
struct Sums([f64; SUMS]);

/// Σ m q and Σ m q²; by m q, places relative to a point near them, and what points at these places
/// spread to.
const SUMS: usize = 2 + 3 + 6;

impl Sums {
    #[inline(always)]
    fn add(&mut self, (seen, part): (f64, f32), [x, y, z]: [f64; 3], own: [f32; 6]) {
        let [xx, yy, zz, xy, xz, yz] = own.map(f64::from);
        let second = [x * x + xx, y * y + yy, z * z + zz, x * y + xy, x * z + xz, y * z + yz];
        let [a, b, c, d, e, f] = second;
        let of = [1.0, f64::from(part), x, y, z, a, b, c, d, e, f];
        for (sum, v) in self.0.iter_mut().zip(of) {
            *sum += seen * v;
        }
    }

    #[inline(always)]
    fn join(&mut self, other: &Self) {
        self.0.iter_mut().zip(other.0).for_each(|(sum, v)| *sum += v);
    }
}

/// The points of a run in cells, and in cells of twice the edge: columns of sums.
#[derive(Clone, Debug)]
struct Cells {
    len: usize,
    own: [[f64; RUN_POINTS]; SUMS],
    wider: [[f64; RUN_POINTS]; SUMS],
    /// The point that places are relative to.
    origin: [Column; 3],
    /// The first point of each, and how many cells the wider one has.
    first_point: [u8; RUN_POINTS],
    in_wider: [u8; RUN_POINTS],
}

impl Cells {
    /// Becomes those of a run, by the points with which they begin.
    #[inline(always)]
    fn set(&mut self, run: &DecodedRun, points: &Points, (begin, begin_wider): (u128, u128)) {
        let cells = self;
        cells.len = 0;
        let position = &run.points.position;
        let mut at = 0;
        while at < run.len {
            let (end, origin) =
                (next_bit(begin_wider, at).min(run.len), [0, 1, 2].map(|axis| position[axis][at]));
            let (mut whole, first) = (Sums::default(), cells.len);
            while at < end {
                let (end, mut sums) = (next_bit(begin, at).min(end), Sums::default());
                for i in at..end {
                    let place = [0, 1, 2].map(|axis| f64::from(position[axis][i] - origin[axis]));
                    let own = [0, 1, 2, 3, 4, 5].map(|k| points.covariance[k][i]);
                    sums.add((points.seen[i], points.part[i]), place, own);
                }
                if sums.0[0] > 0.0 {
                    whole.join(&sums);
                    let cell = cells.len;
                    cells.own.iter_mut().zip(sums.0).for_each(|(column, sum)| column[cell] = sum);
                    cells.origin.iter_mut().zip(origin).for_each(|(column, v)| column[cell] = v);
                    cells.first_point[cell] = at as u8;
                    cells.len += 1;
                }
                at = end;
            }
            for cell in first..cells.len {
                cells.wider.iter_mut().zip(whole.0).for_each(|(column, sum)| column[cell] = sum);
                cells.in_wider[cell] = (cells.len - first) as u8;
            }
        }
    }

    /// The points from that of a cell on to that of the next.
    fn points(&self, cell: usize, len: usize) -> std::ops::Range<usize> {
        let end = if cell + 1 < self.len { usize::from(self.first_point[cell + 1]) } else { len };
        usize::from(self.first_point[cell])..end
    }
}

/// The first bit behind one that is set.
fn next_bit(bits: u128, at: usize) -> usize {
    if at + 1 < RUN_POINTS { at + 1 + (bits >> (at + 1)).trailing_zeros() as usize } else { RUN_POINTS }
}

impl Clusters {
    /// Becomes those of the points of a run, whose places become those of the clusters, as do the
    /// attributes that are averaged and the labels. Points of different cells, around which a unit
    /// of mass takes different areas of the light, are in different clusters. The cells of clusters
    /// have a corner in common.
    #[inline(always)]
    pub(super) fn set(
        &mut self,
        run: &mut DecodedRun,
        (points, of_mass): (&Points, &[f64; RUN_POINTS]),
        (of, corner): (ClusterCells, DVec3),
        is_averaged: impl Fn(usize) -> bool,
    ) {
        let clusters = self;
        clusters.cells.set(run, points, beginnings(run, (&points.seen, of_mass), (of.edge, corner)));
        let cells = &clusters.cells;
        clusters.len = cells.len;
        let nearer = (1.0 - of.wider).sqrt();
        for i in 0..cells.len {
            let (own_middle, own_covariance, own_mass) = moments(&cells.own, i);
            let (middle, covariance, mass) = moments(&cells.wider, i);
            for axis in 0..3 {
                let place = middle[axis] + nearer * (own_middle[axis] - middle[axis]);
                run.points.position[axis][i] = cells.origin[axis][i] + place as f32;
            }
            for k in 0..6 {
                let mixed = own_covariance[k] + of.wider * (covariance[k] - own_covariance[k]);
                clusters.covariance[k][i] = mixed as f32;
            }
            let mass = own_mass + of.wider * (mass - own_mass);
            clusters.mass[i] = mass;
            clusters.part[i] = (cells.own[0][i] / mass) as f32;
        }
        for cell in 0..cells.len {
            let point = usize::from(cells.first_point[cell]);
            clusters.cross_section[cell] = of_mass[point] * clusters.mass[cell];
        }
        for (_, column) in run.attribute.iter_mut().enumerate().filter(|(channel, _)| is_averaged(*channel)) {
            average(column, cells, points, (run.len, of.wider));
        }
        let len = run.len;
        for column in &mut run.label {
            // That of the most mass: the first of several.
            for cell in 0..cells.len {
                let (range, seen) = (cells.points(cell, len), &points.seen);
                let most =
                    range.clone().fold(range.start, |most, i| if seen[i] > seen[most] { i } else { most });
                column[cell] = column[most];
            }
        }
    }
}

/// The middle of a cell, its covariance, and the mass of which the mean part is seen.
#[inline(always)]
fn moments(sums: &[[f64; RUN_POINTS]; SUMS], i: usize) -> ([f64; 3], [f64; 6], f64) {
    let per_seen = 1.0 / sums[0][i];
    let [x, y, z] = [2, 3, 4].map(|k| sums[k][i] * per_seen);
    let [xx, yy, zz, xy, xz, yz] = [5, 6, 7, 8, 9, 10].map(|k| sums[k][i] * per_seen);
    let covariance = [xx - x * x, yy - y * y, zz - z * z, xy - x * y, xz - x * z, yz - y * z];
    ([x, y, z], covariance, sums[0][i] * (sums[0][i] / sums[1][i]))
}

/// Makes means over cells of a column of points.
fn average(column: &mut Column, cells: &Cells, points: &Points, (len, wider): (usize, f64)) {
    let mut first = 0;
    while first < cells.len {
        let end = first + usize::from(cells.in_wider[first]);
        let mut sums = [0.0; RUN_POINTS];
        let (mut all, seen) = (0.0, cells.wider[0][first]);
        for cell in first..end {
            let sum: f64 = cells.points(cell, len).map(|i| points.seen[i] * f64::from(column[i])).sum();
            sums[cell - first] = sum;
            all += sum;
        }
        for cell in first..end {
            let own = sums[cell - first] / cells.own[0][cell];
            column[cell] = (own + wider * (all / seen - own)) as f32;
        }
        first = end;
    }
}

/// The points with which cells begin, and cells of twice the edge: a bit for each. Of points that
/// are seen, those are together that follow each other. A cell may come again: points lie in the
/// order of their sizes, first.
#[inline(always)]
fn beginnings(
    run: &DecodedRun,
    (seen, of_mass): (&[f64; RUN_POINTS], &[f64; RUN_POINTS]),
    (edge, corner): (f64, DVec3),
) -> (u128, u128) {
    let per_edge = 1.0 / edge;
    let from = ((run.center - corner) * per_edge).to_array();
    let [mut places, mut wider] = [[[0.0; RUN_POINTS]; 3]; 2];
    for axis in 0..3 {
        for i in 0..RUN_POINTS {
            let place = (from[axis] + f64::from(run.points.position[axis][i]) * per_edge).floor();
            (places[axis][i], wider[axis][i]) = (place, (place * 0.5).floor());
        }
    }
    let (mut begin, mut begin_wider, mut before) = (0, 0, None);
    for i in (0..run.len).filter(|&i| seen[i] > 0.0) {
        let differs = |of: &[[f64; RUN_POINTS]; 3], j: usize| (0..3).any(|axis| of[axis][i] != of[axis][j]);
        let is_new = |of| before.is_none_or(|j: usize| differs(of, j) || of_mass[i] != of_mass[j]);
        begin |= u128::from(is_new(&places)) << i;
        begin_wider |= u128::from(is_new(&wider)) << i;
        before = Some(i);
    }
    (begin | begin_wider, begin_wider)
}

impl Default for Points {
    fn default() -> Self {
        Self { part: [0.0; RUN_POINTS], seen: [0.0; RUN_POINTS], covariance: [[0.0; RUN_POINTS]; 6] }
    }
}

impl Default for Clusters {
    fn default() -> Self {
        let cells = Cells {
            len: 0,
            own: [[0.0; RUN_POINTS]; SUMS],
            wider: [[0.0; RUN_POINTS]; SUMS],
            origin: [[0.0; RUN_POINTS]; 3],
            first_point: [0; RUN_POINTS],
            in_wider: [0; RUN_POINTS],
        };
        Self {
            len: 0,
            part: [0.0; RUN_POINTS],
            mass: [0.0; RUN_POINTS],
            cross_section: [0.0; RUN_POINTS],
            covariance: [[0.0; RUN_POINTS]; 6],
            cells,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points that go to and fro between two cells make many clusters of one wider cell.
    #[test]
    fn clusters_have_the_colour_of_their_points_however_often_a_cell_comes_again() {
        let mut run = DecodedRun { len: 40, ..DecodedRun::default() };
        let mut points = Points::default();
        for i in 0..run.len {
            run.points.position[0][i] = if i % 2 == 0 { 0.25 } else { 0.75 };
            (points.part[i], points.seen[i]) = (0.5, 1.0 + i as f64);
            (0..3).for_each(|axis| points.covariance[axis][i] = 0.01);
        }
        run.attribute = vec![[0.7; RUN_POINTS]];
        for wider in [0.0, 0.3] {
            let mut clusters = Clusters::default();
            let cells = ClusterCells { edge: 0.5, wider };
            clusters.set(&mut run, (&points, &[1.0; RUN_POINTS]), (cells, DVec3::ZERO), |_| true);
            assert_eq!(clusters.len, 40);
            assert!(run.attribute[0][..40].iter().all(|color| (color - 0.7).abs() < 1e-6));
            let seen: f64 = (0..40).map(|i| clusters.mass[i] * f64::from(clusters.part[i])).sum();
            assert!((seen / points.seen[..40].iter().sum::<f64>() - 1.0).abs() < 1e-6);
        }
    }
}
