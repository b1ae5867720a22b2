//! Voxels as they are stored in bricks, read one by one or in pairs of neighbours along x.

use rayset_files::grid::format::VoxelKind;

/// A kind of voxel. Pairs are kept as they are stored until many of them can be converted at once.
pub(super) trait Voxel: Copy {
    /// Voxels along an edge of a brick.
    const SIDE: usize;
    /// Bytes of one voxel.
    const BYTES: usize;
    /// Two neighbours as they are stored.
    type Pair: Copy + Default;
    /// The voxels with indices `at` and `at + 1` among some of a brick.
    fn pair(brick: &[u8], at: usize) -> Self::Pair;
    /// Their stored numbers.
    fn numbers(pair: Self::Pair) -> [f32; 2];
    /// A voxel in the type that it is stored in.
    type Stored: Copy + Default;
    fn stored(bytes: &[u8]) -> Self::Stored;
    fn least(a: Self::Stored, b: Self::Stored) -> Self::Stored;
    fn largest(a: Self::Stored, b: Self::Stored) -> Self::Stored;
    fn number(stored: Self::Stored) -> f32;
}

/// The part of [`Voxel`] that is the same for all types but for their names.
macro_rules! stored {
    ($type:ty) => {
        const BYTES: usize = size_of::<$type>();
        type Stored = $type;

        #[inline(always)]
        fn stored(voxel: &[u8]) -> $type {
            <$type>::from_le_bytes(bytes(voxel, 0))
        }

        #[inline(always)]
        fn least(a: $type, b: $type) -> $type {
            a.min(b)
        }

        #[inline(always)]
        fn largest(a: $type, b: $type) -> $type {
            a.max(b)
        }

        #[inline(always)]
        fn number(stored: $type) -> f32 {
            stored.into()
        }
    };
}

#[derive(Clone, Copy)]
pub(super) struct U8;
#[derive(Clone, Copy)]
pub(super) struct U16;
#[derive(Clone, Copy)]
pub(super) struct I16;
#[derive(Clone, Copy)]
pub(super) struct F32;

/// `N` bytes of a brick.
#[inline(always)]
fn bytes<const N: usize>(brick: &[u8], at: usize) -> [u8; N] {
    let mut bytes = [0; N];
    bytes.copy_from_slice(&brick[at..at + N]);
    bytes
}

impl Voxel for U8 {
    stored!(u8);

    const SIDE: usize = VoxelKind::U8.brick_voxels();
    type Pair = u32;

    #[inline(always)]
    fn pair(brick: &[u8], at: usize) -> u32 {
        u32::from(u16::from_le_bytes(bytes(brick, at)))
    }

    #[inline(always)]
    fn numbers(pair: u32) -> [f32; 2] {
        [(pair & 0xff) as i32 as f32, (pair >> 8) as i32 as f32]
    }
}

impl Voxel for U16 {
    stored!(u16);

    const SIDE: usize = VoxelKind::U16.brick_voxels();
    type Pair = u32;

    #[inline(always)]
    fn pair(brick: &[u8], at: usize) -> u32 {
        u32::from_le_bytes(bytes(brick, 2 * at))
    }

    #[inline(always)]
    fn numbers(pair: u32) -> [f32; 2] {
        [(pair & 0xffff) as i32 as f32, (pair >> 16) as i32 as f32]
    }
}

impl Voxel for I16 {
    stored!(i16);

    const SIDE: usize = VoxelKind::I16.brick_voxels();
    type Pair = u32;

    #[inline(always)]
    fn pair(brick: &[u8], at: usize) -> u32 {
        u32::from_le_bytes(bytes(brick, 2 * at))
    }

    #[inline(always)]
    fn numbers(pair: u32) -> [f32; 2] {
        [((pair << 16) as i32 >> 16) as f32, (pair as i32 >> 16) as f32]
    }
}

impl Voxel for F32 {
    stored!(f32);

    const SIDE: usize = VoxelKind::F32.brick_voxels();
    type Pair = u64;

    #[inline(always)]
    fn pair(brick: &[u8], at: usize) -> u64 {
        u64::from_le_bytes(bytes(brick, 4 * at))
    }

    #[inline(always)]
    fn numbers(pair: u64) -> [f32; 2] {
        [f32::from_bits(pair as u32), f32::from_bits((pair >> 32) as u32)]
    }
}

/// Calls a generic function with the type of a [`VoxelKind`].
macro_rules! with_voxel {
    ($kind:expr, $V:ident => $call:expr) => {
        match $kind {
            VoxelKind::U8 => {
                type $V = $crate::trace::grid::voxels::U8;
                $call
            }
            VoxelKind::I16 => {
                type $V = $crate::trace::grid::voxels::I16;
                $call
            }
            VoxelKind::U16 => {
                type $V = $crate::trace::grid::voxels::U16;
                $call
            }
            VoxelKind::F32 => {
                type $V = $crate::trace::grid::voxels::F32;
                $call
            }
        }
    };
}
pub(super) use with_voxel;

#[cfg(test)]
mod tests {
    use super::*;

    fn pairs_of<V: Voxel>(kind: VoxelKind) {
        let brick: Vec<u8> = (0..64_u32).map(|i| (i * 37 + 11) as u8 & 0x7f | (i as u8 & 2) << 6).collect();
        for at in 0..64 / kind.bytes() - 1 {
            let one = |at: usize| kind.value(&brick[at * kind.bytes()..]);
            assert_eq!(
                V::numbers(V::pair(&brick, at)).map(f32::to_bits),
                [one(at), one(at + 1)].map(f32::to_bits)
            );
        }
    }

    #[test]
    fn pairs_hold_the_same_numbers_as_voxels_one_by_one() {
        for &kind in VoxelKind::ALL {
            with_voxel!(kind, V => pairs_of::<V>(kind));
        }
    }
}
