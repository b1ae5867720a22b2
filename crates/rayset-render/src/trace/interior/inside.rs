//! The votes of a lattice once they are counted, without those that are the same in all of a block
//! of cells.

use super::lattice::{Lattice, Votes};

/// Edge of a block of cells.
const EDGE: usize = 8;
const CELLS: usize = EDGE * EDGE * EDGE;
/// Entries from this on are of blocks whose cells differ.
const MIXED: u32 = 256;

/// Votes for each cell of a lattice. Most blocks are wholly inside or wholly outside.
pub(super) struct Inside {
    pub(super) lattice: Lattice,
    /// Number of blocks along each axis.
    blocks: [usize; 3],
    /// For each block, the votes of all its cells, or [`MIXED`] and its place among the blocks
    /// whose cells differ.
    entries: Vec<u32>,
    mixed: Vec<u8>,
}

impl Inside {
    /// Those that have been counted. Takes [`bytes_of`](Self::bytes_of) besides the votes.
    pub(super) fn of(votes: &Votes) -> Self {
        let blocks = blocks_of(&votes.lattice);
        let mut mixed = Vec::with_capacity(mixed_blocks(votes) * CELLS);
        let entries = each_block(blocks)
            .map(|block| match uniform(votes, block) {
                Some(vote) => u32::from(vote),
                None => {
                    let place = (mixed.len() / CELLS) as u32;
                    mixed.extend(cells(block).map(|cell| votes.of(within(&votes.lattice, cell))));
                    MIXED + place
                }
            })
            .collect();
        Self { lattice: votes.lattice, blocks, entries, mixed }
    }

    pub(super) fn of_cell(&self, cell: [usize; 3]) -> u8 {
        let [x, y, z] = cell.map(|i| i / EDGE);
        let entry = self.entries[(z * self.blocks[1] + y) * self.blocks[0] + x];
        if entry < MIXED {
            return entry as u8;
        }
        let [x, y, z] = cell.map(|i| i % EDGE);
        self.mixed[(entry - MIXED) as usize * CELLS + (z * EDGE + y) * EDGE + x]
    }

    /// Bytes of what is kept of some votes.
    pub(super) fn bytes_of(votes: &Votes) -> u64 {
        Self::bytes(&votes.lattice, mixed_blocks(votes))
    }

    /// An upper bound on the bytes for a lattice.
    pub(super) fn most_bytes(lattice: &Lattice) -> u64 {
        Self::bytes(lattice, blocks_of(lattice).iter().product())
    }

    fn bytes(lattice: &Lattice, mixed: usize) -> u64 {
        let blocks: usize = blocks_of(lattice).iter().product();
        (size_of::<Self>() + blocks * size_of::<u32>() + mixed * CELLS) as u64
    }
}

fn blocks_of(lattice: &Lattice) -> [usize; 3] {
    lattice.size.map(|n| n.div_ceil(EDGE))
}

fn each_block([width, height, depth]: [usize; 3]) -> impl Iterator<Item = [usize; 3]> {
    (0..width * height * depth).map(move |i| [i % width, i / width % height, i / width / height])
}

/// The cells of a block, x fastest. Some may lie beyond the lattice.
fn cells(block: [usize; 3]) -> impl Iterator<Item = [usize; 3]> {
    let place = |i: usize| [i % EDGE, i / EDGE % EDGE, i / EDGE / EDGE];
    (0..CELLS).map(move |i| std::array::from_fn(|axis| block[axis] * EDGE + place(i)[axis]))
}

/// The nearest cell that lies in the lattice.
fn within(lattice: &Lattice, cell: [usize; 3]) -> [usize; 3] {
    std::array::from_fn(|axis| cell[axis].min(lattice.size[axis] - 1))
}

/// The votes of all cells of a block, if they are the same.
fn uniform(votes: &Votes, block: [usize; 3]) -> Option<u8> {
    let of = |cell| votes.of(within(&votes.lattice, cell));
    let first = of(block.map(|i| i * EDGE));
    cells(block).all(|cell| of(cell) == first).then_some(first)
}

fn mixed_blocks(votes: &Votes) -> usize {
    each_block(blocks_of(&votes.lattice)).filter(|&block| uniform(votes, block).is_none()).count()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rayset_base::geometry::{Aabb, DVec3};

    #[test]
    fn every_cell_has_the_votes_that_were_counted() {
        let bounds = Aabb::new(DVec3::ZERO, DVec3::new(160.0, 38.0, 42.0));
        let votes = Votes::new(Lattice::over(&bounds, 160).expect("a box has a lattice"));
        for (y, z) in (0..38).flat_map(|y| (6..42).map(move |z| (y, z))) {
            votes.add_line(0, [0, y, z], &[2.0 + y as f64 / 3.0, 151.5], &mut Vec::new());
        }
        let kept = Inside::of(&votes);
        let [width, height, depth] = votes.lattice.size;
        for cell in (0..width * height * depth).map(|i| [i % width, i / width % height, i / width / height]) {
            assert_eq!(kept.of_cell(cell), votes.of(cell), "{cell:?}");
        }
        let bytes = size_of::<Inside>() + 4 * kept.entries.len() + kept.mixed.len();
        assert_eq!(Inside::bytes_of(&votes), bytes as u64);
        assert!(2 * Inside::bytes_of(&votes) < Inside::most_bytes(&votes.lattice));
    }
}
