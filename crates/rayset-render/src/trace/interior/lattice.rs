//! The lattice on which votes for the inside are counted, and the rays that pass through it.

use std::ops::Range;
use std::sync::atomic::{AtomicU8, Ordering};

use rayset_base::geometry::{Aabb, DVec3, Ray};

/// What one of a cell's six rays adds if it votes for all of the cell. Six of them fit a byte.
pub(super) const VOTE: u8 = 40;
/// Edge of a block of the lattice's rays, which are traced as one packet.
pub(super) const BLOCK_RAYS: usize = 8;

/// Cubic cells over a box. Positions *in cells* have their origin in the box's least corner and
/// cells of edge 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Lattice {
    corner: DVec3,
    /// Edge of a cell.
    pub(super) spacing: f64,
    /// Number of cells along each axis.
    pub(super) size: [usize; 3],
}

/// Rays along one axis, through the centres of cells that lie side by side.
#[derive(Clone, Debug)]
pub(super) struct RayBlock {
    pub(super) axis: usize,
    /// Cells across, along the next axis and the one after it.
    across: [Range<usize>; 2],
}

impl Lattice {
    /// A lattice over a box, with `resolution` cells along its longest side; `None` if the box is
    /// empty, without end or a point.
    pub(super) fn over(bounds: &Aabb, resolution: u32) -> Option<Self> {
        if bounds.is_empty() || !bounds.size().is_finite() {
            return None;
        }
        let spacing = bounds.size().max_element() / f64::from(resolution);
        // Coordinates must tell cells apart.
        let farthest = bounds.min.abs().max(bounds.max.abs()).max_element();
        if !(spacing > farthest * 1e-12) {
            return None;
        }
        let size = bounds
            .size()
            .to_array()
            .map(|extent| ((extent / spacing).ceil() as usize).clamp(1, resolution as usize));
        let corner = bounds.center() - DVec3::from_array(size.map(|n| 0.5 * n as f64 * spacing));
        Some(Self { corner, spacing, size })
    }

    pub(super) fn cells(&self) -> usize {
        self.size.iter().product()
    }

    /// A position, in cells.
    pub(super) fn in_cells(&self, p: DVec3) -> DVec3 {
        (p - self.corner) / self.spacing
    }

    /// A box of cells, in the space of the positions.
    pub(super) fn bounds_of(&self, least: DVec3, greatest: DVec3) -> Aabb {
        Aabb::new(self.corner + least * self.spacing, self.corner + greatest * self.spacing)
    }

    pub(super) fn index(&self, [x, y, z]: [usize; 3]) -> usize {
        (z * self.size[1] + y) * self.size[0] + x
    }

    /// All rays: those along x, then along y, then along z.
    pub(super) fn blocks(&self) -> usize {
        (0..3).map(|axis| self.blocks_across(axis).iter().product::<usize>()).sum()
    }

    fn blocks_across(&self, axis: usize) -> [usize; 2] {
        [1, 2].map(|next| self.size[(axis + next) % 3].div_ceil(BLOCK_RAYS))
    }

    /// The block with a number below [`blocks`](Self::blocks).
    pub(super) fn block(&self, mut number: usize) -> RayBlock {
        let mut axis = 0;
        loop {
            let [across, after] = self.blocks_across(axis);
            if number < across * after || axis == 2 {
                let cells = |block: usize, next: usize| {
                    let size = self.size[(axis + next) % 3];
                    (block * BLOCK_RAYS).min(size)..((block + 1) * BLOCK_RAYS).min(size)
                };
                return RayBlock { axis, across: [cells(number % across, 1), cells(number / across, 2)] };
            }
            number -= across * after;
            axis += 1;
        }
    }
}

impl RayBlock {
    /// The first cells on the block's rays.
    pub(super) fn first_cells(&self) -> impl Iterator<Item = [usize; 3]> + '_ {
        let [across, after] = self.across.clone();
        after.flat_map(move |w| across.clone().map(move |v| (v, w))).map(|(v, w)| {
            let mut cell = [0; 3];
            cell[(self.axis + 1) % 3] = v;
            cell[(self.axis + 2) % 3] = w;
            cell
        })
    }

    /// The ray through a first cell's centre. It starts one cell before the lattice.
    pub(super) fn ray(&self, lattice: &Lattice, first: [usize; 3]) -> Ray {
        let mut start = DVec3::from_array(first.map(|i| i as f64 + 0.5));
        start[self.axis] = -1.0;
        Ray { origin: lattice.corner + start * lattice.spacing, direction: DVec3::AXES[self.axis] }
    }
}

/// Votes for each cell of a lattice. Threads add to them in any order: sums of whole numbers are
/// the same.
pub(super) struct Votes {
    pub(super) lattice: Lattice,
    cells: Vec<AtomicU8>,
}

impl Votes {
    pub(super) fn new(lattice: Lattice) -> Self {
        Self { lattice, cells: (0..lattice.cells()).map(|_| AtomicU8::new(0)).collect() }
    }

    pub(super) fn of(&self, cell: [usize; 3]) -> u8 {
        self.cells[self.lattice.index(cell)].load(Ordering::Relaxed)
    }

    /// Whether any cell has so many votes.
    pub(super) fn any(&self, least: u8) -> bool {
        self.cells.iter().any(|votes| votes.load(Ordering::Relaxed) >= least)
    }

    pub(super) fn clear(&self, cell: [usize; 3]) {
        self.cells[self.lattice.index(cell)].store(0, Ordering::Relaxed);
    }

    /// Replaces the votes of each cell by their mean over the three cells along an axis, for each
    /// axis in turn. Cells where lines that lack a crossing meet (at pores, or where two walls of
    /// something thin are one) differ from all around them.
    pub(super) fn smooth(&self) {
        let size = self.lattice.size;
        let mut row = Vec::new();
        for axis in 0..3 {
            let [across, after] = [(axis + 1) % 3, (axis + 2) % 3];
            for (v, w) in (0..size[after]).flat_map(|w| (0..size[across]).map(move |v| (v, w))) {
                let mut cell = [0; 3];
                (cell[across], cell[after]) = (v, w);
                let mut index = |i: usize| {
                    cell[axis] = i;
                    self.lattice.index(cell)
                };
                row.clear();
                row.extend((0..size[axis]).map(|i| u16::from(self.cells[index(i)].load(Ordering::Relaxed))));
                for i in 0..size[axis] {
                    let (before, behind) = (row[i.saturating_sub(1)], row[(i + 1).min(size[axis] - 1)]);
                    let mean = (before + row[i] + behind + 1) / 3;
                    self.cells[index(i)].store(mean as u8, Ordering::Relaxed);
                }
            }
        }
    }

    /// Adds the votes of the two rays that leave each cell of a line in opposite directions.
    /// `crossings` are the places where the line passes through the surface, in cells, ascending;
    /// `row` is scratch memory.
    pub(super) fn add_line(&self, axis: usize, first: [usize; 3], crossings: &[f64], row: &mut Vec<f64>) {
        if crossings.is_empty() {
            return;
        }
        let length = self.lattice.size[axis];
        row.clear();
        row.resize(length, 0.0);
        for behind in 0..=crossings.len() {
            let ahead = crossings.len() - behind;
            let votes = (behind % 2 + ahead % 2) as f64;
            if votes == 0.0 {
                continue;
            }
            let from = if behind == 0 { 0.0 } else { crossings[behind - 1].clamp(0.0, length as f64) };
            let to = crossings.get(behind).map_or(length as f64, |c| c.clamp(0.0, length as f64));
            for (i, sum) in row.iter_mut().enumerate().take(to.ceil() as usize).skip(from as usize) {
                *sum += votes * (to.min(i as f64 + 1.0) - from.max(i as f64)).max(0.0);
            }
        }
        let mut cell = first;
        for (i, votes) in row.iter().enumerate() {
            cell[axis] = i;
            let votes = (votes * f64::from(VOTE)).round() as u8;
            self.cells[self.lattice.index(cell)].fetch_add(votes, Ordering::Relaxed);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn cube(edge: usize) -> Votes {
        let bounds = Aabb::new(DVec3::ZERO, DVec3::splat(edge as f64));
        Votes::new(Lattice::over(&bounds, edge as u32).expect("a cube has a lattice"))
    }

    #[test]
    fn every_ray_of_a_lattice_is_in_one_block() {
        let bounds = Aabb::new(DVec3::ZERO, DVec3::new(20.0, 11.0, 3.0));
        let lattice = Lattice::over(&bounds, 20).expect("a box has a lattice");
        let mut rays: Vec<(usize, [usize; 3])> = (0..lattice.blocks())
            .map(|number| lattice.block(number))
            .flat_map(|block| block.first_cells().map(move |cell| (block.axis, cell)).collect::<Vec<_>>())
            .collect();
        let count = rays.len();
        rays.sort_unstable();
        rays.dedup();
        assert_eq!((count, rays.len()), (11 * 3 + 20 * 3 + 20 * 11, count));
    }

    #[test]
    fn one_cell_that_differs_from_all_around_it_is_smoothed_away() {
        let votes = cube(8);
        votes.add_line(0, [0, 4, 4], &[3.0, 4.0], &mut Vec::new());
        votes.add_line(1, [3, 0, 4], &[4.0, 5.0], &mut Vec::new());
        assert_eq!(votes.of([3, 4, 4]), 4 * VOTE);
        votes.smooth();
        assert!(votes.of([3, 4, 4]) < VOTE, "{}", votes.of([3, 4, 4]));
    }

    proptest! {
        #[test]
        fn a_cell_has_the_votes_of_rays_that_cross_an_odd_number_of_times(
            mut crossings in prop::collection::vec(0_u8..8, 0..7),
        ) {
            crossings.sort_unstable();
            let votes = cube(8);
            let places: Vec<f64> = crossings.iter().map(|&c| f64::from(c)).collect();
            votes.add_line(1, [3, 0, 5], &places, &mut Vec::new());
            for cell in 0..8 {
                let behind = crossings.iter().filter(|&&c| usize::from(c) <= cell).count();
                let expected = behind % 2 + (crossings.len() - behind) % 2;
                prop_assert_eq!(usize::from(votes.of([3, cell, 5])), expected * usize::from(VOTE));
            }
        }

        #[test]
        fn a_cell_that_is_crossed_has_a_share_of_the_votes(from in 0.0_f64..8.0, to in 0.0_f64..8.0) {
            let (from, to) = (from.min(to), from.max(to));
            let votes = cube(8);
            votes.add_line(2, [0, 0, 0], &[from, to], &mut Vec::new());
            let sum: f64 = (0..8).map(|z| f64::from(votes.of([0, 0, z]))).sum();
            prop_assert!((sum / f64::from(2 * VOTE) - (to - from)).abs() < 0.1, "{}", sum);
        }
    }
}
