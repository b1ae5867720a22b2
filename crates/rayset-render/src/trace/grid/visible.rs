//! Which parts of a brick show anything through the opacity rule: cubes of 4 × 4 × 4 cells.

use super::opacity::{Opacities, Values};
use super::shape::{BLOCK_CELLS, BrickShape};
use super::voxels::Voxel;
use rayset_files::grid::format::VoxelKind;

/// Most blocks along an edge of a brick.
const MOST_BLOCKS: usize = 7;
/// A power of two that the words of [`Blocks`] fit in.
const WORDS: usize = (MOST_BLOCKS * MOST_BLOCKS * MOST_BLOCKS).div_ceil(64).next_power_of_two();
/// Bricks whose blocks are remembered. A packet meets few bricks, and its neighbours the same ones.
const REMEMBERED: usize = 512;

/// A bit for each block of a brick, x fastest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Blocks([u64; WORDS]);

impl Blocks {
    pub(super) const ALL: Self = Self([u64::MAX; WORDS]);
    pub(super) const NONE: Self = Self([0; WORDS]);

    #[inline(always)]
    pub(super) fn has(&self, number: u16) -> bool {
        self.0[usize::from(number) / 64 % WORDS] >> (number % 64) & 1 == 1
    }

    /// Adds a block. Bricks that are not cubes may have more blocks than there are bits; some then
    /// share one.
    #[inline(always)]
    fn add(&mut self, number: usize) {
        self.0[number / 64 % WORDS] |= 1 << (number % 64);
    }

    /// The blocks of a brick that is no cube that show anything.
    pub(super) fn of_cuboid<V: Voxel>(
        shape: BrickShape,
        brick: &[u8],
        values: &Values,
        opacities: &Opacities,
    ) -> Self {
        let mut blocks = Self([0; _]);
        let (y_stride, z_stride) = shape.strides();
        let count = [0, 1, 2].map(|axis| shape.blocks(axis));
        for number in 0..count.iter().product() {
            let block = [number % count[0], number / count[0] % count[1], number / count[0] / count[1]];
            // The corners of its cells, of which the last of the brick are one voxel before its
            // end.
            let corners = |axis: usize| {
                let first = 1 + block[axis] * BLOCK_CELLS;
                first..(first + CORNERS).min(shape.voxels(axis) - 1)
            };
            let (mut low, mut high) = (f32::INFINITY, f32::NEG_INFINITY);
            for z in corners(2) {
                for y in corners(1) {
                    for x in corners(0) {
                        let at = (z * z_stride + y * y_stride + x) * V::BYTES;
                        let voxel = V::number(V::stored(&brick[at..at + V::BYTES]));
                        (low, high) = (low.min(voxel), high.max(voxel));
                    }
                }
            }
            if opacities.shows(low - values.base, high - values.base) {
                blocks.add(number);
            }
        }
        blocks
    }

    /// The blocks of a brick that is a cube that show anything.
    #[inline(always)]
    pub(super) fn of<V: Voxel>(brick: &[u8], values: &Values, opacities: &Opacities) -> Self {
        let mut blocks = Self([0; _]);
        let (n, side) = (V::SIDE, blocks_of::<V>());
        let mut layers = Layers::<V>::new();
        for z in 0..side {
            layers.merge(brick, first_corner::<V>(z));
            for y in 0..side {
                for x in 0..side {
                    let (low, high) = layers.range(first_corner::<V>(y) * n + first_corner::<V>(x));
                    if opacities.shows(low - values.base, high - values.base) {
                        let number = (z * side + y) * side + x;
                        blocks.add(number);
                    }
                }
            }
        }
        blocks
    }
}

/// Blocks along an edge of a brick of a kind of voxel.
pub(super) const fn blocks_of<V: Voxel>() -> usize {
    (V::SIDE - 3).div_ceil(BLOCK_CELLS)
}

/// Voxels at the corners of the cells of a block, along one axis.
const CORNERS: usize = BLOCK_CELLS + 1;

/// The first of them; the last block, which may have fewer cells, has some of the one before it.
#[inline(always)]
fn first_corner<V: Voxel>(block: usize) -> usize {
    (1 + block * BLOCK_CELLS).min(V::SIDE - 1 - CORNERS)
}

/// Most voxels in a layer of a brick.
const MOST_IN_LAYER: usize = VoxelKind::U8.brick_voxels() * VoxelKind::U8.brick_voxels();

/// The least and the largest stored numbers of a layer of blocks: for each place of a layer of
/// voxels, of the cube of [`CORNERS`]³ voxels that begins there. They are found for all places, by
/// vectors, though few are needed.
struct Layers<V: Voxel> {
    low: [V::Stored; MOST_IN_LAYER],
    high: [V::Stored; MOST_IN_LAYER],
}

impl<V: Voxel> Layers<V> {
    #[inline(always)]
    fn new() -> Self {
        Self { low: [V::Stored::default(); MOST_IN_LAYER], high: [V::Stored::default(); MOST_IN_LAYER] }
    }

    /// Finds those of the cubes that begin in a layer.
    #[inline(always)]
    fn merge(&mut self, brick: &[u8], first: usize) {
        let count = V::SIDE * V::SIDE;
        let (low, high) = (&mut self.low[..count], &mut self.high[..count]);
        for layer in 0..CORNERS {
            let voxels = &brick[(first + layer) * count * V::BYTES..][..count * V::BYTES];
            for i in 0..count {
                let number = V::stored(&voxels[i * V::BYTES..(i + 1) * V::BYTES]);
                low[i] = if layer == 0 { number } else { V::least(low[i], number) };
                high[i] = if layer == 0 { number } else { V::largest(high[i], number) };
            }
        }
        for stride in [V::SIDE, 1] {
            // Of two, of four, and of five that follow each other.
            for ahead in [1, 2, 1] {
                let ahead = ahead * stride;
                for i in 0..count - ahead {
                    low[i] = V::least(low[i], low[i + ahead]);
                    high[i] = V::largest(high[i], high[i + ahead]);
                }
            }
        }
    }

    /// That of the cube that begins at a place.
    #[inline(always)]
    fn range(&self, at: usize) -> (f32, f32) {
        (V::number(self.low[at]), V::number(self.high[at]))
    }
}

/// The blocks of the bricks that a thread has met last.
pub(super) struct KnownBlocks(Vec<(u64, Blocks)>);

impl KnownBlocks {
    pub(super) const BYTES: usize = REMEMBERED * size_of::<(u64, Blocks)>();

    pub(super) fn new() -> Self {
        Self(Vec::new())
    }

    /// The blocks of a brick with a number that no other brick of the scene has; `None` if they are
    /// not known.
    #[inline(always)]
    pub(super) fn get(&self, number: u64) -> Option<&Blocks> {
        let known = self.0.get(number as usize % REMEMBERED)?;
        (known.0 == number).then_some(&known.1)
    }

    /// Remembers the blocks of a brick, in the place of others.
    pub(super) fn insert(&mut self, number: u64, blocks: Blocks) {
        if self.0.is_empty() {
            self.0.resize(REMEMBERED, (u64::MAX, Blocks::NONE));
        }
        self.0[number as usize % REMEMBERED] = (number, blocks);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::OpacityRule;
    use crate::trace::grid::voxels::with_voxel;
    use rayset_files::grid::format::VoxelKind;

    /// The block of a cell.
    fn number<V: Voxel>(cell: [u32; 3]) -> u16 {
        let [x, y, z] = cell.map(|c| c as usize / BLOCK_CELLS);
        ((z * blocks_of::<V>() + y) * blocks_of::<V>() + x) as u16
    }

    fn a_voxel_shows_in_the_blocks_of_its_cells<V: Voxel>(kind: VoxelKind) {
        let rule = OpacityRule::Curve(vec![(100.0, 0.0), (120.0, 1.0)]);
        let values = Values::new(&crate::trace::grid::volume::tests::header([200; 3], kind), &rule);
        let opacities = Opacities::new(&rule, &values, 1.0);
        let n = V::SIDE;
        let cells = n - 3;
        for voxel in [[1, 1, 1], [4, 5, 6], [n - 2, 7, n - 2], [0, 3, 3], [9, n - 1, 5], [5, 5, 5]] {
            let mut brick = vec![0_u8; n * n * n * kind.bytes()];
            let at = ((voxel[2] * n + voxel[1]) * n + voxel[0]) * kind.bytes();
            let stored: Vec<u8> = match kind {
                VoxelKind::U8 => vec![110],
                VoxelKind::I16 => 110_i16.to_le_bytes().to_vec(),
                VoxelKind::U16 => 110_u16.to_le_bytes().to_vec(),
                VoxelKind::F32 => 110_f32.to_le_bytes().to_vec(),
            };
            brick[at..at + stored.len()].copy_from_slice(&stored);
            let blocks = Blocks::of::<V>(&brick, &values, &opacities);
            for z in 0..cells as u32 {
                for y in 0..cells as u32 {
                    for x in 0..cells as u32 {
                        // The voxel is a corner of this cell.
                        let corner = [x, y, z]
                            .iter()
                            .zip(voxel)
                            .all(|(&c, v)| c as usize + 1 == v || c as usize + 2 == v);
                        if corner {
                            assert!(blocks.has(number::<V>([x, y, z])), "{voxel:?} in {x} {y} {z}");
                        }
                        // Nothing shows a block away.
                        let far = [x, y, z]
                            .iter()
                            .zip(voxel)
                            .any(|(&c, v)| (c as usize + 1).abs_diff(v) > 1 + BLOCK_CELLS);
                        if far {
                            assert!(!blocks.has(number::<V>([x, y, z])), "{voxel:?} in {x} {y} {z}");
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn a_block_shows_if_a_corner_of_its_cells_does() {
        for &kind in VoxelKind::ALL {
            with_voxel!(kind, V => a_voxel_shows_in_the_blocks_of_its_cells::<V>(kind));
        }
    }

    #[test]
    fn the_blocks_of_a_brick_are_known_until_another_takes_their_place() {
        let mut known = KnownBlocks::new();
        assert!(known.get(3).is_none() && known.get(u64::MAX).is_none());
        known.insert(3, Blocks::ALL);
        known.insert(4, Blocks::NONE);
        assert_eq!((known.get(3), known.get(4)), (Some(&Blocks::ALL), Some(&Blocks::NONE)));
        assert!(known.get(5).is_none());
        known.insert(3 + REMEMBERED as u64, Blocks::NONE);
        assert!(known.get(3).is_none() && known.get(4).is_some());
    }
}
