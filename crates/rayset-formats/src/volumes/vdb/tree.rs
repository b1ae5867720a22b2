//! Where the nodes and leaves of a tree are in the file, and which voxels it may hold.

use super::stream::{Stream, Wrong};
use super::values::{Coding, Decoder, is_on, skip};

/// Voxels along an edge of a leaf.
pub(super) const LEAF: i64 = 8;
const LEAF_MASK_BYTES: usize = 64;
/// Tiles along an edge of a node, as a power of two: of an upper and of a lower one.
const UPPER_LOG2: u32 = 5;
const LOWER_LOG2: u32 = 4;
/// Voxels along an edge of a lower and of an upper node.
const LOWER: i64 = LEAF << LOWER_LOG2;
const UPPER: i64 = LOWER << UPPER_LOG2;

/// The voxels from `low` to `high`, both included.
#[derive(Clone, Copy)]
pub(super) struct Bounds {
    pub(super) low: [i64; 3],
    pub(super) high: [i64; 3],
}

impl Bounds {
    pub(super) const EMPTY: Self = Self { low: [i64::MAX; 3], high: [i64::MIN; 3] };

    /// A cube of voxels.
    pub(super) fn cube(low: [i64; 3], edge: i64) -> Self {
        Self { low, high: low.map(|v| v + edge - 1) }
    }

    pub(super) fn and(self, other: Self) -> Self {
        Self {
            low: std::array::from_fn(|a| self.low[a].max(other.low[a])),
            high: std::array::from_fn(|a| self.high[a].min(other.high[a])),
        }
    }

    pub(super) fn is_empty(&self) -> bool {
        (0..3).any(|a| self.low[a] > self.high[a])
    }

    fn extend(&mut self, other: Self) {
        self.low = std::array::from_fn(|a| self.low[a].min(other.low[a]));
        self.high = std::array::from_fn(|a| self.high[a].max(other.high[a]));
    }
}

/// A leaf or a node: the voxel at its lowest corner, and its offset in the file.
#[derive(Clone, Copy)]
pub(super) struct Block {
    pub(super) origin: [i32; 3],
    pub(super) at: u64,
}

impl Block {
    fn low(&self) -> [i64; 3] {
        self.origin.map(i64::from)
    }
}

/// A region of one value.
pub(super) struct Tile {
    pub(super) bounds: Bounds,
    pub(super) value: [u8; 8],
}

/// The levels of nodes.
#[derive(Clone, Copy)]
enum Level {
    Upper,
    Lower,
}

impl Level {
    fn log2(self) -> u32 {
        match self {
            Self::Upper => UPPER_LOG2,
            Self::Lower => LOWER_LOG2,
        }
    }

    /// Voxels along an edge of a tile.
    fn tile(self) -> i64 {
        match self {
            Self::Upper => LOWER,
            Self::Lower => LEAF,
        }
    }

    fn mask_bytes(self) -> usize {
        (1 << (3 * self.log2())) / 8
    }

    /// The lowest corner of a tile, counted with z fastest.
    fn corner(self, low: [i64; 3], tile: usize) -> [i64; 3] {
        let log2 = self.log2();
        let along = |axis: u32| (tile >> ((2 - axis) * log2) & ((1 << log2) - 1)) as i64;
        [0, 1, 2].map(|axis: usize| low[axis] + along(axis as u32) * self.tile())
    }
}

/// The index of a tree.
pub(super) struct Tree {
    pub(super) coding: Coding,
    /// The box of all active voxels.
    pub(super) active: Bounds,
    /// All of these are sorted by their places along x, so that those in a slab are found without
    /// looking at others.
    tiles: Vec<Tile>,
    upper: Vec<Block>,
    lower: Vec<Block>,
    leaves: Vec<Block>,
}

/// Those of `sorted` cubes, whose lowest voxels along x are given by `low`, that may meet a region.
fn along_x<T>(sorted: &[T], low: impl Fn(&T) -> i64, edge: i64, region: Bounds) -> &[T] {
    let first = sorted.partition_point(|one| low(one) + edge - 1 < region.low[0]);
    let end = sorted.partition_point(|one| low(one) <= region.high[0]);
    &sorted[first..end.max(first)]
}

impl Tree {
    /// Reads through a tree, which begins at the stream's place.
    pub(super) fn index(stream: &mut Stream, coding: Coding) -> Result<Self, Wrong> {
        let mut tree = Self {
            coding,
            active: Bounds::EMPTY,
            tiles: Vec::new(),
            upper: Vec::new(),
            lower: Vec::new(),
            leaves: Vec::new(),
        };
        if stream.u32()? != 1 {
            return Err(stream.wrong("a tree of several buffers, as no program writes any more"));
        }
        tree.root(stream)?;
        for leaf in &mut tree.leaves {
            leaf.at = stream.at();
            let active: [u8; LEAF_MASK_BYTES] = stream.array()?;
            skip(stream, &tree.coding, &active)?;
        }
        // In the order of the file where they have one place: what comes last counts.
        tree.tiles.sort_by_key(|tile| tile.bounds.low[0]);
        tree.upper.sort_by_key(|node| node.origin[0]);
        tree.lower.sort_by_key(|node| node.origin[0]);
        tree.leaves.sort_unstable_by_key(|leaf| leaf.origin);
        Ok(tree)
    }

    /// Bytes of the index.
    pub(super) fn memory_bytes(&self) -> u64 {
        let blocks = self.upper.capacity() + self.lower.capacity() + self.leaves.capacity();
        (blocks * size_of::<Block>() + self.tiles.capacity() * size_of::<Tile>()) as u64
    }

    fn root(&mut self, stream: &mut Stream) -> Result<(), Wrong> {
        let width = self.coding.width;
        stream.fill(&mut self.coding.background[..width])?;
        let (tiles, children) = (stream.u32()?, stream.u32()?);
        for _ in 0..tiles {
            let low = corner_of_upper(stream)?.map(i64::from);
            let mut value = [0; 8];
            stream.fill(&mut value[..width])?;
            let bounds = Bounds::cube(low, UPPER);
            if stream.u8()? != 0 {
                self.active.extend(bounds);
            }
            self.tiles.push(Tile { bounds, value });
        }
        for _ in 0..children {
            let origin = corner_of_upper(stream)?;
            let node = Block { origin, at: stream.at() };
            self.upper.push(node);
            self.node(stream, Level::Upper, node.low())?;
        }
        Ok(())
    }

    /// Reads through a node and what is below it.
    fn node(&mut self, stream: &mut Stream, level: Level, low: [i64; 3]) -> Result<(), Wrong> {
        let (children, active) = masks(stream, level)?;
        skip(stream, &self.coding, &active)?;
        for tile in 0..8 * children.len() {
            let low = level.corner(low, tile);
            // Every corner is one of 32 bits: that of the upper node is a multiple of its edge.
            let origin = low.map(|v| v as i32);
            match level {
                _ if !is_on(&children, tile) => {
                    if is_on(&active, tile) {
                        self.active.extend(Bounds::cube(low, level.tile()));
                    }
                }
                Level::Upper => {
                    self.lower.push(Block { origin, at: stream.at() });
                    self.node(stream, Level::Lower, low)?;
                }
                Level::Lower => {
                    let active: [u8; LEAF_MASK_BYTES] = stream.array()?;
                    self.active.extend(bounds_of_leaf(low, &active));
                    self.leaves.push(Block { origin, at: 0 });
                }
            }
        }
        Ok(())
    }

    /// Hands on the tiles in a region, except those of the background value.
    pub(super) fn tiles(
        &self,
        stream: &mut Stream,
        decoder: &mut Decoder,
        region: Bounds,
        mut tile: impl FnMut(Bounds, &[u8]),
    ) -> Result<(), Wrong> {
        let width = self.coding.width;
        for one in along_x(&self.tiles, |tile| tile.bounds.low[0], UPPER, region) {
            tile(one.bounds, &one.value[..width]);
        }
        for (level, nodes) in [(Level::Upper, &self.upper), (Level::Lower, &self.lower)] {
            let edge = level.tile() << level.log2();
            for node in along_x(nodes, |node| i64::from(node.origin[0]), edge, region) {
                if Bounds::cube(node.low(), edge).and(region).is_empty() {
                    continue;
                }
                stream.seek(node.at)?;
                let (children, active) = masks(stream, level)?;
                let values = decoder.read(stream, &self.coding, &active)?;
                for (number, value) in values.chunks_exact(width).enumerate() {
                    if !is_on(&children, number) && value != &self.coding.background[..width] {
                        tile(Bounds::cube(level.corner(node.low(), number), level.tile()), value);
                    }
                }
            }
        }
        Ok(())
    }

    /// Hands on the values of the leaves in a region that is as thick as one leaf along x: 512
    /// each, z fastest.
    pub(super) fn leaves(
        &self,
        stream: &mut Stream,
        decoder: &mut Decoder,
        region: Bounds,
        mut leaf: impl FnMut(Bounds, &[u8]),
    ) -> Result<(), Wrong> {
        let x = region.low[0].div_euclid(LEAF) * LEAF;
        let first = self.leaves.partition_point(|leaf| i64::from(leaf.origin[0]) < x);
        for one in self.leaves[first..].iter().take_while(|leaf| i64::from(leaf.origin[0]) == x) {
            let bounds = Bounds::cube(one.low(), LEAF);
            if bounds.and(region).is_empty() {
                continue;
            }
            stream.seek(one.at)?;
            let active: [u8; LEAF_MASK_BYTES] = stream.array()?;
            leaf(bounds, decoder.read(stream, &self.coding, &active)?);
        }
        Ok(())
    }
}

/// Which tiles of a node are nodes or leaves, and which are active.
fn masks(stream: &mut Stream, level: Level) -> Result<(Vec<u8>, Vec<u8>), Wrong> {
    let (mut children, mut active) = (vec![0; level.mask_bytes()], vec![0; level.mask_bytes()]);
    stream.fill(&mut children)?;
    stream.fill(&mut active)?;
    Ok((children, active))
}

fn corner_of_upper(stream: &mut Stream) -> Result<[i32; 3], Wrong> {
    let at = stream.at();
    let corner = stream.coordinates()?;
    if corner.iter().any(|v| i64::from(*v) % UPPER != 0) {
        return Err(Wrong { at, what: format!("a node at {corner:?}, which are no multiples of {UPPER}") });
    }
    Ok(corner)
}

fn bounds_of_leaf(low: [i64; 3], active: &[u8; LEAF_MASK_BYTES]) -> Bounds {
    let mut bounds = Bounds::EMPTY;
    for (number, byte) in active.iter().enumerate().filter(|(_, byte)| **byte != 0) {
        // A byte is eight voxels along z.
        let (x, y) = (low[0] + number as i64 / LEAF, low[1] + number as i64 % LEAF);
        let (first, last) = (byte.trailing_zeros(), 7 - byte.leading_zeros());
        bounds.extend(Bounds {
            low: [x, y, low[2] + i64::from(first)],
            high: [x, y, low[2] + i64::from(last)],
        });
    }
    bounds
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cubes_that_meet_a_slab_are_found_and_no_others_along_x() {
        let lows = [-16_i64, -8, -8, 0, 8, 8, 24];
        for (low, high) in [(-20, -17), (-16, -16), (-9, -8), (0, 7), (7, 8), (16, 23), (-100, 100), (31, 40)]
        {
            let region = Bounds { low: [low, 0, 0], high: [high, 0, 0] };
            let meets = |cube: &i64| *cube <= high && cube + 7 >= low;
            let expected: Vec<i64> = lows.iter().copied().filter(meets).collect();
            assert_eq!(along_x(&lows, |low| *low, 8, region), expected, "{low} to {high}");
        }
    }
}
