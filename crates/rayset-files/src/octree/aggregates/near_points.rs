//! The points that may reach a box, and which of them may reach which cell of a grid over it.
//!
//! A thread uses one again and again: what it takes is large, and clearing it is not free.

use super::points::Points;
use rayset_base::geometry::{Aabb, DMat3, DVec3};

/// Most entries of points in cells.
const MOST_ENTRIES: u32 = 1 << 18;
/// Most cells of a grid along an axis.
const MOST_CELLS: f64 = 24.0;
/// Entries that are looked at together.
const TOGETHER: usize = 8;

/// The points that may reach a box. Positions are relative to its corner.
#[derive(Default)]
pub(super) struct NearPoints {
    corner: DVec3,
    far_corner: DVec3,
    points: Vec<NearPoint>,
    /// Radii, and half the edges of the smallest boxes around points.
    extents: Vec<(f64, DVec3)>,
    /// The maps to the unit ball; of balls none.
    maps: Vec<DMat3>,
    grid: Grid,
    /// Where the next entries of cells go, while they are found.
    next: Vec<u32>,
    entries: Entries,
}

/// A point, for its kernel.
#[derive(Clone, Copy)]
struct NearPoint {
    position: DVec3,
    weight: f64,
    /// The square of the inverse of its radius.
    inverse_squared: f64,
}

/// Cells that a box is divided into.
#[derive(Default)]
struct Grid {
    /// Cells along each axis, and cells in a unit of length.
    cells: [usize; 3],
    per_unit: DVec3,
    /// For each cell, where its entries begin; and where those of the last end. Each cell has a
    /// multiple of [`TOGETHER`].
    first: Vec<u32>,
}

/// For cells of the grid, the points that may reach them, in their order.
#[derive(Default)]
struct Entries {
    /// Numbers of points; any for what fills up a cell.
    of: Vec<u32>,
    /// Relative to the corner of the box.
    position: [Vec<f32>; 3],
    /// The square of a radius, larger by more than what is rounded; negative for what fills up a
    /// cell.
    reach_squared: Vec<f32>,
}

impl NearPoints {
    /// Begins with no points and another box.
    pub(super) fn begin(&mut self, bounds: &Aabb) {
        (self.corner, self.far_corner) = (bounds.min, bounds.max);
        self.points.clear();
        self.extents.clear();
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
            inverse_squared: inverse * inverse,
        });
        self.extents.push((radius, half));
    }

    /// Finds which points may reach which cell.
    pub(super) fn divide_among_cells(&mut self) {
        let size = self.far_corner - self.corner;
        let count = self.points.len().max(1) as f64;
        let mean = self.extents.iter().map(|(radius, _)| radius).sum::<f64>() / count;
        let mut edge = mean.max(size.max_element() / MOST_CELLS);
        self.count_entries(size, edge);
        while self.grid.entries() > MOST_ENTRIES && self.grid.cells != [1; 3] {
            edge *= 2.0;
            self.count_entries(size, edge);
        }
        let Self { points, extents, grid, next, entries, .. } = self;
        entries.make_room(grid.entries() as usize);
        // Coordinates are rounded to parts of the box, and to parts of their own.
        let rounding = 4.0 * f64::from(f32::EPSILON) * (size.max_element() + 4.0 * mean);
        next.clone_from(&grid.first);
        for (at, (point, (radius, half))) in points.iter().zip(extents.iter()).enumerate() {
            let reach = radius * (1.0 + 1e-5) + rounding;
            let reach_squared = (reach * reach) as f32;
            let place = point.position.to_array().map(|v| v as f32);
            grid.each_cell_of(point.position, *half, |cell| {
                let to = next[cell] as usize;
                next[cell] += 1;
                entries.of[to] = at as u32;
                (0..3).for_each(|axis| entries.position[axis][to] = place[axis]);
                entries.reach_squared[to] = reach_squared;
            });
        }
        // What fills up cells is never near.
        for (cell, &end) in next.iter().enumerate().take(grid.first.len() - 1) {
            entries.reach_squared[end as usize..grid.first[cell + 1] as usize].fill(-1.0);
        }
    }

    /// Divides the box into cells of about an edge, and counts the points that may reach each.
    fn count_entries(&mut self, size: DVec3, edge: f64) {
        let Self { points, extents, grid, .. } = self;
        grid.divide(size, edge);
        let mut first = std::mem::take(&mut grid.first);
        first.clear();
        first.resize(grid.cells.iter().product::<usize>() + 1, 0_u32);
        for (point, (_, half)) in points.iter().zip(extents.iter()) {
            grid.each_cell_of(point.position, *half, |cell| first[cell + 1] += 1);
        }
        for cell in 1..first.len() {
            first[cell] = first[cell - 1] + first[cell].next_multiple_of(TOGETHER as u32);
        }
        grid.first = first;
    }

    /// The sums over all points at places in the box, in the order of the points.
    pub(super) fn sum(&self, places: &[DVec3], kernel: impl Fn(f64) -> f64, out: &mut [f64]) {
        for (place, density) in places.iter().zip(out) {
            let place = *place - self.corner;
            let rounded = place.to_array().map(|v| v as f32);
            *density = 0.0;
            for first in self.grid.entries_at(place).step_by(TOGETHER) {
                let mut near = self.entries.near(first, rounded);
                while near != 0 {
                    let at = first + near.trailing_zeros() as usize;
                    near &= near - 1;
                    let number = self.entries.of[at] as usize;
                    let square = self.square(number, place);
                    if square < 1.0 {
                        *density += self.points[number].weight * kernel(square);
                    }
                }
            }
        }
    }

    /// x² of a place in a point, relative to the corner.
    #[inline(always)]
    fn square(&self, number: usize, place: DVec3) -> f64 {
        let point = &self.points[number];
        let offset = place - point.position;
        match self.maps.get(number) {
            Some(map) => (*map * offset).length_squared(),
            None => offset.length_squared() * point.inverse_squared,
        }
    }
}

impl Grid {
    /// Divides a box of a size into cells of about an edge.
    fn divide(&mut self, size: DVec3, edge: f64) {
        self.cells = size
            .to_array()
            .map(|length| ((length / edge) as usize).saturating_add(1).min(MOST_CELLS as usize));
        self.per_unit = DVec3::from_array(std::array::from_fn(|axis| match size[axis] > 0.0 {
            true => self.cells[axis] as f64 / size[axis],
            false => 0.0,
        }));
    }

    /// Number of entries of all cells.
    fn entries(&self) -> u32 {
        self.first.last().copied().unwrap_or(0)
    }

    /// The entries of the cell of a place relative to the corner of the box.
    #[inline(always)]
    fn entries_at(&self, place: DVec3) -> std::ops::Range<usize> {
        let [x, y, z] = self.cell_of(place);
        let cell = (z * self.cells[1] + y) * self.cells[0] + x;
        self.first[cell] as usize..self.first[cell + 1] as usize
    }

    /// Calls `visit` for each cell that a point may reach.
    #[inline(always)]
    fn each_cell_of(&self, position: DVec3, half: DVec3, mut visit: impl FnMut(usize)) {
        let [low, high] = [position - half, position + half].map(|place| self.cell_of(place));
        for z in low[2]..=high[2] {
            for y in low[1]..=high[1] {
                let row = (z * self.cells[1] + y) * self.cells[0];
                (row + low[0]..=row + high[0]).for_each(&mut visit);
            }
        }
    }

    /// The cell of a place relative to the corner of the box, or the nearest.
    #[inline(always)]
    fn cell_of(&self, place: DVec3) -> [usize; 3] {
        let in_cells = place * self.per_unit;
        std::array::from_fn(|axis| (in_cells[axis].max(0.0) as usize).min(self.cells[axis] - 1))
    }
}

impl Entries {
    /// Makes room for a number of entries, whatever they are.
    fn make_room(&mut self, count: usize) {
        if self.of.len() < count {
            grow(&mut self.of, count);
            self.position.iter_mut().for_each(|column| grow(column, count));
            grow(&mut self.reach_squared, count);
        }
    }

    /// Which of the entries from one on may reach a place, a bit for each.
    #[inline(always)]
    fn near(&self, first: usize, place: [f32; 3]) -> u32 {
        let of = |column: &[f32]| -> [f32; TOGETHER] {
            std::array::from_fn(|at| column[first..first + TOGETHER][at])
        };
        let [x, y, z] = self.position.each_ref().map(|column| of(column));
        let reach_squared = of(&self.reach_squared);
        let mut near = 0;
        for at in 0..TOGETHER {
            let (x, y, z) = (x[at] - place[0], y[at] - place[1], z[at] - place[2]);
            near |= u32::from(x * x + y * y + z * z < reach_squared[at]) << at;
        }
        near
    }
}

/// Makes a column so long, and takes no more room than that.
fn grow<T: Clone + Default>(column: &mut Vec<T>, length: usize) {
    column.reserve_exact(length - column.len());
    column.resize(length, T::default());
}
