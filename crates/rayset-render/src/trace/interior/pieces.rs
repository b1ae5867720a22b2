//! Leaving out what is too small to be the inside of anything: cells in crevices, which rays along
//! two axes mistake.

use super::lattice::Votes;

/// Pieces of fewer cells than this share of all cells inside are left out.
const SMALLEST: f64 = 1e-3;
/// Pieces are left as they are if there is more than one run for this many cells: it bounds the
/// memory.
const CELLS_PER_RUN: usize = 32;

/// Bytes for the pieces of a lattice of so many cells.
pub(super) fn bytes(cells: u64) -> u64 {
    // The last row that is looked at may have more runs; and there are two lists of rows.
    cells / CELLS_PER_RUN as u64 * size_of::<Run>() as u64 + (1 << 16)
}

/// Cells inside that follow each other along x.
#[derive(Clone, Copy, Debug)]
struct Run {
    first: u16,
    end: u16,
    /// The index of another run of the same piece; of its first run, its own.
    parent: u32,
    /// Of the first run of a piece: its number of cells.
    cells: u32,
}

/// Takes away the votes of the cells of small pieces. A cell is inside from `least` votes on; cells
/// are in one piece if they share a face.
pub(super) fn drop_small(votes: &Votes, least: u8) {
    let [width, height, depth] = votes.lattice.size;
    let most = votes.lattice.cells() / CELLS_PER_RUN;
    // Memory that is not written to does not count.
    let mut runs: Vec<Run> = Vec::with_capacity(most + width / 2 + 1);
    // Where the runs of the rows of this layer and of the one before begin.
    let (mut layer, mut before) = (vec![0; height + 1], vec![0; height + 1]);
    for z in 0..depth {
        for y in 0..height {
            layer[y] = runs.len();
            add_row(&mut runs, width, |x| votes.of([x, y, z]) >= least);
            if runs.len() > most {
                return;
            }
            let own = layer[y];
            if y > 0 {
                join(&mut runs, layer[y - 1]..own, own);
            }
            if z > 0 {
                join(&mut runs, before[y]..before[y + 1], own);
            }
        }
        layer[height] = runs.len();
        std::mem::swap(&mut layer, &mut before);
    }
    let all: u64 = runs
        .iter()
        .enumerate()
        .filter(|(i, run)| run.parent as usize == *i)
        .map(|(_, run)| u64::from(run.cells))
        .sum();
    let smallest = (all as f64 * SMALLEST) as u32;
    let mut next = 0;
    for z in 0..depth {
        for y in 0..height {
            // The runs of the row, in the order in which they were found.
            let mut x = 0;
            while x < width {
                if votes.of([x, y, z]) < least {
                    x += 1;
                    continue;
                }
                let piece = root(&runs, next);
                let run = runs[next];
                if runs[piece].cells < smallest {
                    (run.first..run.end).for_each(|x| votes.clear([usize::from(x), y, z]));
                }
                (x, next) = (usize::from(run.end), next + 1);
            }
        }
    }
}

/// Appends the runs of a row.
fn add_row(runs: &mut Vec<Run>, width: usize, is_inside: impl Fn(usize) -> bool) {
    let mut x = 0;
    while x < width {
        let first = x;
        while x < width && is_inside(x) {
            x += 1;
        }
        if x > first {
            let parent = runs.len() as u32;
            runs.push(Run { first: first as u16, end: x as u16, parent, cells: (x - first) as u32 });
        }
        x += 1;
    }
}

/// Joins the runs of a row with the last row, from `own` on, where they touch.
fn join(runs: &mut [Run], row: std::ops::Range<usize>, own: usize) {
    let (mut a, mut b) = (row.start, own);
    while a < row.end && b < runs.len() {
        if runs[a].first < runs[b].end && runs[b].first < runs[a].end {
            unite(runs, a, b);
        }
        if runs[a].end < runs[b].end { a += 1 } else { b += 1 }
    }
}

/// The first run of a run's piece.
fn root(runs: &[Run], mut run: usize) -> usize {
    while runs[run].parent as usize != run {
        run = runs[run].parent as usize;
    }
    run
}

fn unite(runs: &mut [Run], a: usize, b: usize) {
    let (a, b) = (root(runs, a), root(runs, b));
    if a == b {
        return;
    }
    // The larger piece takes the smaller one, so that ways to the first run stay short.
    let (large, small) = if runs[a].cells >= runs[b].cells { (a, b) } else { (b, a) };
    runs[small].parent = large as u32;
    runs[large].cells += runs[small].cells;
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trace::interior::lattice::{Lattice, VOTE};
    use rayset_base::geometry::{Aabb, DVec3};

    /// A cube of 32 cells a side with boxes of cells inside.
    fn with_boxes(boxes: &[[(usize, usize); 3]]) -> Votes {
        let bounds = Aabb::new(DVec3::ZERO, DVec3::splat(32.0));
        let votes = Votes::new(Lattice::over(&bounds, 32).expect("a cube has a lattice"));
        for [xs, ys, zs] in boxes {
            for (y, z) in (zs.0..zs.1).flat_map(|z| (ys.0..ys.1).map(move |y| (y, z))) {
                votes.add_line(0, [0, y, z], &[xs.0 as f64, xs.1 as f64], &mut Vec::new());
            }
        }
        votes
    }

    fn inside(votes: &Votes) -> usize {
        let cells = (0..32).flat_map(|z| (0..32).flat_map(move |y| (0..32).map(move |x| [x, y, z])));
        cells.filter(|&cell| votes.of(cell) >= VOTE).count()
    }

    #[test]
    fn small_pieces_go_and_large_ones_and_what_touches_them_stay() {
        let large = [(2, 20), (2, 20), (2, 20)];
        let beside = [(24, 27), (24, 27), (24, 27)];
        // A speck that touches the large piece by one face, along each axis, belongs to it.
        let touching = [[(20, 21), (5, 6), (5, 6)], [(5, 6), (20, 21), (5, 6)], [(5, 6), (5, 6), (20, 21)]];
        let votes =
            with_boxes(&[large, beside, touching[0], touching[1], touching[2], [(30, 31), (3, 4), (3, 4)]]);
        let (before, body) = (inside(&votes), 18 * 18 * 18 + 3);
        assert_eq!(before, body + 27 + 1);
        drop_small(&votes, VOTE);
        assert_eq!(inside(&votes), body + 27);
    }

    #[test]
    fn branches_that_meet_later_are_one_piece() {
        // Two pillars that a lintel joins in the last layer, and a speck.
        let votes = with_boxes(&[
            [(2, 4), (2, 4), (0, 31)],
            [(20, 22), (20, 22), (0, 31)],
            [(2, 22), (2, 22), (31, 32)],
            [(10, 11), (10, 11), (10, 11)],
        ]);
        let before = inside(&votes);
        drop_small(&votes, VOTE);
        assert_eq!(inside(&votes), before, "a speck of one of 648 cells is more than a thousandth");
    }

    #[test]
    fn more_runs_than_there_is_memory_for_stay_as_they_are() {
        // Every second column of a cube, in every row: 16 runs a row.
        let columns: Vec<_> = (0..16).map(|i| [(2 * i, 2 * i + 1), (0, 32), (0, 32)]).collect();
        let votes = with_boxes(&columns);
        let before = inside(&votes);
        drop_small(&votes, VOTE);
        assert_eq!(inside(&votes), before);
    }
}
