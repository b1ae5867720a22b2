//! The points that may reach a box, and the sums of their kernels at places in it.
//!
//! Points are added one after another to the places that they may reach: places are kept by the
//! cells of a grid, in rows, so that those of a row follow each other, and many are looked at with
//! one instruction. The order of a sum is that of the points, and nothing is fused, so its bits are
//! the same with every set of instructions.
//!
//! A thread uses one again and again: what it takes is large, and clearing it is not free.

use std::ops::Range;

use super::points::Points;
use fearless_simd::{Level, Select, Simd, SimdBase, SimdFloat, SimdFrom, dispatch, f64x8};
use rayset_base::geometry::{Aabb, DMat3, DVec3};
use rayset_base::kernel::Kernel;

/// Most cells of a grid along an axis.
const MOST_CELLS: f64 = 32.0;
/// Cells in a radius.
const CELLS_OF_RADIUS: f64 = 1.0;
/// Places that are looked at together.
const TOGETHER: usize = 8;
/// By how much what a point reaches is taken to be larger: more than what is rounded.
const MARGIN: f64 = 1e-9;

/// The points that may reach a box. Positions are relative to its corner.
#[derive(Default)]
pub(super) struct NearPoints {
    corner: DVec3,
    far_corner: DVec3,
    points: Vec<NearPoint>,
    /// The maps to the unit ball; of balls none.
    maps: Vec<DMat3>,
    grid: Grid,
    places: Places,
}

/// A point, for its kernel.
#[derive(Clone, Copy)]
struct NearPoint {
    position: DVec3,
    weight: f64,
    radius: f64,
    /// The square of the inverse of its radius.
    inverse_squared: f64,
    /// Half the edges of the smallest box around it.
    half: DVec3,
}

/// Cells that a box is divided into.
#[derive(Default)]
struct Grid {
    /// Cells along each axis, their edges, and cells in a unit of length.
    cells: [usize; 3],
    edges: DVec3,
    per_unit: DVec3,
    /// For each cell, where its places begin; and where those of the last end.
    first: Vec<u32>,
}

/// Places, by the cells that they are in.
#[derive(Default)]
struct Places {
    /// Relative to the corner of the box. More than there are: [`TOGETHER`] are read at a time.
    coordinates: [Vec<f64>; 3],
    densities: Vec<f64>,
    /// Where each place has come to, in the order in which they were given.
    order: Vec<u32>,
}

impl NearPoints {
    /// Begins with no points and another box.
    pub(super) fn begin(&mut self, bounds: &Aabb) {
        (self.corner, self.far_corner) = (bounds.min, bounds.max);
        self.points.clear();
        self.maps.clear();
    }

    pub(super) fn len(&self) -> usize {
        self.points.len()
    }

    /// Takes those points that may reach the box.
    pub(super) fn take(&mut self, points: &Points) {
        for index in 0..points.len() {
            let (position, radius) = (points.position[index], points.radius[index]);
            let distance_squared = (position.clamp(self.corner, self.far_corner) - position).length_squared();
            if distance_squared < radius * radius && points.weight[index] != 0.0 {
                self.push(points, index);
            }
        }
    }

    fn push(&mut self, points: &Points, index: usize) {
        let radius = points.radius[index];
        let inverse = radius.recip();
        self.maps.extend(points.unit_from_local(index));
        let half = points.shape.get(index).map_or(DVec3::ONE, |shape| shape.half_extent()) * radius;
        self.points.push(NearPoint {
            position: points.position[index] - self.corner,
            weight: points.weight[index],
            radius,
            inverse_squared: inverse * inverse,
            half,
        });
    }

    /// The sums over all points at places in the box, in the order of the points.
    pub(super) fn sum(&mut self, kernel: Kernel, places: &[DVec3], out: &mut [f64]) {
        self.sum_with(Level::new(), kernel, places, out);
    }

    fn sum_with(&mut self, level: Level, kernel: Kernel, places: &[DVec3], out: &mut [f64]) {
        let size = self.far_corner - self.corner;
        let inverse: f64 = self.points.iter().map(|point| point.radius.recip()).sum();
        let typical_radius = self.points.len() as f64 / inverse;
        self.grid.divide(size, (typical_radius / CELLS_OF_RADIUS).max(size.max_element() / MOST_CELLS));
        self.places.sort(places.iter().map(|&place| place - self.corner), &mut self.grid);
        match kernel {
            Kernel::Wyvill => dispatch!(level, simd => self.add_points(simd, Wyvill)),
            Kernel::CubicSpline => dispatch!(level, simd => self.add_points(simd, CubicSpline)),
            kernel => dispatch!(level, simd => self.add_points(simd, kernel)),
        }
        for (density, &at) in out.iter_mut().zip(&self.places.order) {
            *density = self.places.densities[at as usize];
        }
    }

    #[inline(always)]
    fn add_points<S: Simd>(&mut self, simd: S, kernel: impl Kernels) {
        let Self { points, maps, grid, places, .. } = self;
        for (number, point) in points.iter().enumerate() {
            let map = maps.get(number);
            grid.each_row_of(
                point,
                #[inline(always)]
                |row| places.add(simd, row, (point, map), kernel),
            );
        }
    }
}

/// A kernel, by x².
trait Kernels: Copy {
    fn values<S: Simd>(self, simd: S, squares: f64x8<S>) -> f64x8<S>;
}

/// [`Kernel::Wyvill`], where x² < 1.
#[derive(Clone, Copy)]
struct Wyvill;

impl Kernels for Wyvill {
    #[inline(always)]
    fn values<S: Simd>(self, simd: S, s: f64x8<S>) -> f64x8<S> {
        let of = |v: f64| f64x8::splat(simd, v);
        of(1.0) + s * (of(-22.0 / 9.0) + s * (of(17.0 / 9.0) - s * (of(4.0 / 9.0))))
    }
}

/// [`Kernel::CubicSpline`], where x² < 1.
#[derive(Clone, Copy)]
struct CubicSpline;

impl Kernels for CubicSpline {
    #[inline(always)]
    fn values<S: Simd>(self, simd: S, squares: f64x8<S>) -> f64x8<S> {
        let of = |v: f64| f64x8::splat(simd, v);
        let q = of(2.0) * squares.sqrt();
        let left = of(2.0) - q;
        let inner = of(1.0) - of(1.5) * q * q + of(0.75) * q * q * q;
        q.simd_lt(of(1.0)).select(inner, of(0.25) * (left * left * left))
    }
}

impl Kernels for Kernel {
    #[inline(always)]
    fn values<S: Simd>(self, simd: S, squares: f64x8<S>) -> f64x8<S> {
        let values = <[f64; TOGETHER]>::from(squares).map(|s| if s < 1.0 { self.value(s) } else { 0.0 });
        f64x8::simd_from(simd, values)
    }
}

impl Grid {
    /// Divides a box of a size into cells of about an edge.
    fn divide(&mut self, size: DVec3, edge: f64) {
        self.cells = size
            .to_array()
            .map(|length| ((length / edge) as usize).saturating_add(1).min(MOST_CELLS as usize));
        let cells = DVec3::from_array(self.cells.map(|cells| cells as f64));
        self.edges = size / cells;
        let per_unit = |axis: usize| if size[axis] > 0.0 { cells[axis] / size[axis] } else { 0.0 };
        self.per_unit = DVec3::new(per_unit(0), per_unit(1), per_unit(2));
    }

    fn count(&self) -> usize {
        self.cells.iter().product()
    }

    /// The number of the cell of a place.
    fn number_of(&self, place: DVec3) -> usize {
        let [x, y, z] = self.cell_of(place);
        (z * self.cells[1] + y) * self.cells[0] + x
    }

    /// Calls `visit` with the places of each row of cells that a point may reach.
    #[inline(always)]
    fn each_row_of(&self, point: &NearPoint, mut visit: impl FnMut(Range<usize>)) {
        let NearPoint { position, radius, .. } = *point;
        let half = point.half * (1.0 + MARGIN);
        let reach_squared = radius * radius * (1.0 + 4.0 * MARGIN);
        let [low, high] = [position - half, position + half].map(|place| self.cell_of(place));
        for z in low[2]..=high[2] {
            let of_z = self.distance(2, z, position.z);
            for y in low[1]..=high[1] {
                let row = (z * self.cells[1] + y) * self.cells[0];
                if self.first[row + low[0]] == self.first[row + high[0] + 1] {
                    continue;
                }
                let of_y = self.distance(1, y, position.y);
                let left = reach_squared - (of_z * of_z + of_y * of_y);
                if !(left > 0.0) {
                    continue;
                }
                let half_row = left.sqrt().min(half.x);
                let [from, to] = [-half_row, half_row].map(|x| self.along(0, position.x + x));
                let places = self.first[row + from] as usize..self.first[row + to + 1] as usize;
                if !places.is_empty() {
                    visit(places);
                }
            }
        }
    }

    /// How far a coordinate is from a layer of cells, or a little less.
    #[inline(always)]
    fn distance(&self, axis: usize, layer: usize, v: f64) -> f64 {
        let (low, edge) = (layer as f64 * self.edges[axis], self.edges[axis]);
        let rounding = MARGIN * self.edges[axis] * (self.cells[axis] as f64);
        ((low - v).max(v - (low + edge)) * (1.0 - MARGIN) - rounding).max(0.0)
    }

    /// The cell of a place relative to the corner of the box, or the nearest.
    #[inline(always)]
    fn cell_of(&self, place: DVec3) -> [usize; 3] {
        std::array::from_fn(|axis| self.along(axis, place[axis]))
    }

    #[inline(always)]
    fn along(&self, axis: usize, v: f64) -> usize {
        ((v * self.per_unit[axis]).max(0.0) as usize).min(self.cells[axis] - 1)
    }
}

impl Places {
    /// Takes places, without densities yet, and says where those of each cell begin.
    fn sort(&mut self, places: impl ExactSizeIterator<Item = DVec3> + Clone, grid: &mut Grid) {
        let count = places.len();
        self.order.clear();
        self.order.extend(places.clone().map(|place| grid.number_of(place) as u32));
        let mut first = std::mem::take(&mut grid.first);
        first.clear();
        first.resize(grid.count() + 2, 0);
        // Where each cell begins stands one behind it while places are put where they belong.
        self.order.iter().for_each(|&cell| first[cell as usize + 2] += 1);
        (2..first.len()).for_each(|cell| first[cell] += first[cell - 1]);
        self.coordinates.iter_mut().for_each(|column| column.resize(count + TOGETHER, 0.0));
        for (place, order) in places.zip(&mut self.order) {
            let to = &mut first[*order as usize + 1];
            (0..3).for_each(|axis| self.coordinates[axis][*to as usize] = place[axis]);
            *order = *to;
            *to += 1;
        }
        grid.first = first;
        self.densities.clear();
        self.densities.resize(count + TOGETHER, 0.0);
    }

    /// Adds a point to some places that follow each other.
    #[inline(always)]
    fn add<S: Simd>(
        &mut self,
        simd: S,
        places: Range<usize>,
        (point, map): (&NearPoint, Option<&DMat3>),
        kernel: impl Kernels,
    ) {
        let of = |v: f64| f64x8::splat(simd, v);
        let numbers = f64x8::simd_from(simd, std::array::from_fn::<f64, TOGETHER, _>(|at| at as f64));
        let position = point.position.to_array();
        for first in places.clone().step_by(TOGETHER) {
            let all = first..first + TOGETHER;
            let [x, y, z]: [f64x8<S>; 3] = std::array::from_fn(|axis| {
                f64x8::from_slice(simd, &self.coordinates[axis][all.clone()]) - of(position[axis])
            });
            let squares = match map {
                None => (x * x + y * y + z * z) * of(point.inverse_squared),
                Some(map) => {
                    let [x, y, z]: [f64x8<S>; 3] = std::array::from_fn(|row| {
                        x * of(map.x_axis[row]) + y * of(map.y_axis[row]) + z * of(map.z_axis[row])
                    });
                    x * x + y * y + z * z
                }
            };
            let are_in_row = numbers.simd_lt(of((places.end - first) as f64));
            let are_near = squares.simd_lt(of(1.0)) & are_in_row;
            let more = are_near.select(of(point.weight) * kernel.values(simd, squares), of(0.0));
            let densities = &mut self.densities[all];
            (f64x8::from_slice(simd, densities) + more).store_slice(densities);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use rayset_base::geometry::{DQuat, Shape};

    fn cube() -> impl Strategy<Value = DVec3> {
        proptest::array::uniform3(-1.0..1.0).prop_map(DVec3::from_array)
    }

    proptest! {
        #[test]
        fn sums_have_the_bits_of_a_loop_over_all_points_with_any_instructions(
            points in proptest::collection::vec((cube(), -11.0..1.0, 0.1..2.0), 0..60),
            places in proptest::collection::vec(cube(), 1..60),
            are_ellipsoids: bool, is_flat: bool, kernel in proptest::sample::select(Kernel::OF_DENSITIES),
        ) {
            let mut all = Points::default();
            for (position, exponent, weight) in points {
                all.position.push(2.0 * position);
                all.radius.push(10_f64.powf(exponent));
                all.weight.push(weight);
                if are_ellipsoids {
                    let rotation = DQuat::from_scaled_axis(position * 3.0);
                    all.shape.push(Shape { rotation, ratios: [0.7, weight * 0.2] });
                }
            }
            let flat = if is_flat { DVec3::new(1.0, 0.0, 1.0) } else { DVec3::ONE };
            // Some are in points, however small these are.
            let in_point = |(place, at): (&DVec3, usize)| all.position[at] + 0.8 * all.radius[at] * *place;
            let in_points: Vec<DVec3> = places.iter().zip(0..all.len()).map(in_point).collect();
            let places: Vec<DVec3> = places.iter().chain(&in_points).map(|&place| place * flat).collect();
            let bounds = places.iter().fold(Aabb::EMPTY, |all, &place| all.union(Aabb::new(place, place)));
            let mut near = NearPoints::default();
            near.begin(&bounds);
            near.take(&all);
            let brute: Vec<u64> = places.iter().map(|&place| {
                let place = place - near.corner;
                let of = |(number, point): (usize, &NearPoint)| {
                    let offset = place - point.position;
                    let square = near.maps.get(number).map_or_else(
                        || offset.length_squared() * point.inverse_squared,
                        |&map| (map * offset).length_squared(),
                    );
                    (square < 1.0).then(|| point.weight * kernel.value(square))
                };
                near.points.iter().enumerate().filter_map(of).fold(0.0, |sum: f64, more| sum + more).to_bits()
            }).collect();
            for level in [Level::new(), Level::baseline()] {
                let mut sums = vec![f64::NAN; places.len()];
                near.sum_with(level, kernel, &places, &mut sums);
                prop_assert_eq!(&sums.iter().map(|sum| sum.to_bits()).collect::<Vec<_>>(), &brute);
            }
        }
    }
}
