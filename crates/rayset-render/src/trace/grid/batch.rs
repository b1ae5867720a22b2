//! Samples of one brick, evaluated many at a time.
//!
//! Reading is compiled for each kind of voxel, arithmetic once for all.

use fearless_simd::f32x16;
use fearless_simd::prelude::*;

use super::places::{OfSamples, Places};
use super::shape::BrickShape;
use super::voxels::{Voxel, with_voxel};
use crate::field::BLOCK_SAMPLES;
use rayset_files::grid::format::VoxelKind;

/// Samples that are evaluated together.
pub(super) const BATCH: usize = 32;
/// Groups of samples that are evaluated together.
pub(super) const BATCH_GROUPS: usize = BATCH / BLOCK_SAMPLES;

/// One number for each sample of a batch.
pub(super) type Row = [f32; BATCH];

// Loops instead of closures: closures are not always inlined where vector code requires it.

/// The cells of a batch of samples.
pub(super) struct Cells {
    /// Index of the first voxel of each in the brick.
    voxel: [u16; BATCH],
    /// How far into it each sample lies.
    pub(super) within: [Row; 3],
}

impl Cells {
    /// Those of some groups of samples.
    #[inline(always)]
    pub(super) fn of_groups(places: &Places, groups: &[u8; BATCH_GROUPS]) -> Self {
        let mut cells = Self { voxel: [0; BATCH], within: [[0.0; BATCH]; 3] };
        for (i, &group) in groups.iter().enumerate() {
            cells.voxel.as_chunks_mut().0[i] = places.voxel[usize::from(group)];
            for (row, within) in cells.within.iter_mut().zip(&places.within) {
                row.as_chunks_mut().0[i] = within[usize::from(group)];
            }
        }
        cells
    }

    /// Those of some samples.
    #[inline(always)]
    pub(super) fn of_samples(places: &Places, samples: &[u16; BATCH]) -> Self {
        let mut cells = Self { voxel: [0; BATCH], within: [[0.0; BATCH]; 3] };
        for (i, &at) in samples.iter().enumerate() {
            cells.voxel[i] = at_sample(&places.voxel, at);
            for (row, within) in cells.within.iter_mut().zip(&places.within) {
                row[i] = at_sample(within, at);
            }
        }
        cells
    }
}

/// What belongs to the sample `at`, which is lane · 32 + sample.
#[inline(always)]
pub(super) fn at_sample<T: Copy>(of_samples: &OfSamples<T>, at: u16) -> T {
    let of_samples = of_samples.as_flattened();
    of_samples[usize::from(at) % of_samples.len()]
}

/// The voxels of a brick.
#[derive(Clone, Copy)]
pub(super) struct Brick<'a> {
    pub(super) kind: VoxelKind,
    pub(super) shape: BrickShape,
    pub(super) voxels: &'a [u8],
}

/// Numbers of pairs of voxels, neighbours along x: a row for each place relative to a cell.
pub(super) type Pairs<const ROWS: usize> = [[Row; 2]; ROWS];

/// Where pairs lie, in voxels from the voxel `before` voxels in front of a cell's first.
struct Window<const ROWS: usize> {
    before: usize,
    offsets: [usize; ROWS],
    /// The largest of `offsets`.
    farthest: usize,
}

/// The numbers of voxels around a batch of samples.
pub(super) struct Around {
    /// Of the corners of cells: pairs that follow each other along y, then along z.
    pub(super) corners: Pairs<4>,
    /// Of the voxels within one of the corners along an axis, in the order that [`gradients`]
    /// takes.
    pub(super) surroundings: Pairs<16>,
}

impl Around {
    pub(super) fn new() -> Self {
        Self { corners: [[[0.0; BATCH]; 2]; 4], surroundings: [[[0.0; BATCH]; 2]; 16] }
    }

    /// Reads the stored numbers of the corners of cells, less `base`.
    #[inline(always)]
    pub(super) fn read_corners<S: Simd>(&mut self, simd: S, brick: Brick<'_>, cells: &Cells, base: f32) {
        let (y, z) = brick.shape.strides();
        let window = Window { before: 0, offsets: [0, y, z, z + y], farthest: z + y };
        brick.read(simd, cells, base, &window, &mut self.corners);
    }

    /// Reads the stored numbers of what surrounds cells, less `base`.
    #[inline(always)]
    pub(super) fn read_surroundings<S: Simd>(&mut self, simd: S, brick: Brick<'_>, cells: &Cells, base: f32) {
        let (y, z) = brick.shape.strides();
        // From one voxel before the cell along z. Rows of four voxels through the cell, as pairs
        // before and behind the middle of the row, for y and z of 0 and 1; then pairs beside the
        // cell: y of −1 and 2 at z of 0 and 1, z of −1 and 2 at y of 0 and 1.
        let before = [z - 1, z + y - 1, 2 * z - 1, 2 * z + y - 1];
        let beside_y = [z - y, z + 2 * y, 2 * z - y, 2 * z + 2 * y];
        let beside_z = [0, 3 * z, y, y + 3 * z];
        let mut offsets = [0; 16];
        for row in 0..4 {
            (offsets[row], offsets[4 + row]) = (before[row], before[row] + 2);
            (offsets[8 + row], offsets[12 + row]) = (beside_y[row], beside_z[row]);
        }
        let window = Window { before: z, offsets, farthest: y + 3 * z };
        brick.read(simd, cells, base, &window, &mut self.surroundings);
    }
}

impl Brick<'_> {
    /// Reads the pairs of a window of each cell, less `base`.
    #[inline(always)]
    fn read<S: Simd, const ROWS: usize>(
        self,
        simd: S,
        cells: &Cells,
        base: f32,
        window: &Window<ROWS>,
        pairs: &mut Pairs<ROWS>,
    ) {
        with_voxel!(self.kind, V => simd.vectorize(
            #[inline(always)]
            || read::<V, ROWS>(self.voxels, cells, base, window, pairs),
        ));
    }
}

/// Reads pairs as [`Brick::read`] does.
#[inline(always)]
fn read<V: Voxel, const ROWS: usize>(
    voxels: &[u8],
    cells: &Cells,
    base: f32,
    window: &Window<ROWS>,
    pairs: &mut Pairs<ROWS>,
) {
    let mut stored = [[V::Pair::default(); BATCH]; ROWS];
    for (i, &voxel) in cells.voxel.iter().enumerate() {
        let from = usize::from(voxel).wrapping_sub(window.before).wrapping_mul(V::BYTES);
        // One test for each cell: its pairs then need none.
        let around = &voxels[from..][..(window.farthest + 2) * V::BYTES];
        for (row, offset) in stored.iter_mut().zip(window.offsets) {
            row[i] = V::pair(around, offset);
        }
    }
    for ([low, high], stored) in pairs.iter_mut().zip(&stored) {
        for i in 0..BATCH {
            let [a, b] = V::numbers(stored[i]);
            (low[i], high[i]) = (a - base, b - base);
        }
    }
}

// Vectors are written out: what is left to the compiler becomes, across rows, loads and stores of
// single numbers.

/// Vectors of a row.
#[inline(always)]
fn vectors<S: Simd>(simd: S, row: &Row) -> [f32x16<S>; BATCH / 16] {
    let [a, b] = row.as_chunks::<16>().0 else { unreachable!("a row has as many numbers") };
    [f32x16::from_slice(simd, a), f32x16::from_slice(simd, b)]
}

#[inline(always)]
fn row<S: Simd>(vectors: [f32x16<S>; BATCH / 16]) -> Row {
    let mut row = [0.0; BATCH];
    for (out, vector) in row.as_chunks_mut::<16>().0.iter_mut().zip(vectors) {
        vector.store_slice(out);
    }
    row
}

#[inline(always)]
fn lerp<S: Simd>(simd: S, a: &Row, b: &Row, f: &Row) -> Row {
    let ([a0, a1], [b0, b1], [f0, f1]) = (vectors(simd, a), vectors(simd, b), vectors(simd, f));
    row([a0 + (b0 - a0) * f0, a1 + (b1 - a1) * f1])
}

#[inline(always)]
fn less<S: Simd>(simd: S, a: &Row, b: &Row) -> Row {
    let ([a0, a1], [b0, b1]) = (vectors(simd, a), vectors(simd, b));
    row([a0 - b0, a1 - b1])
}

/// Between the differences of pairs of rows, along y, then along z.
#[inline(always)]
fn lerp_less<S: Simd>(simd: S, [a, b, c, d]: [[&Row; 2]; 4], [_, fy, fz]: &[Row; 3]) -> Row {
    let low = lerp(simd, &less(simd, a[0], a[1]), &less(simd, b[0], b[1]), fy);
    let high = lerp(simd, &less(simd, c[0], c[1]), &less(simd, d[0], d[1]), fy);
    lerp(simd, &low, &high, fz)
}

/// The corners of cells among what surrounds them, in the order of [`Around::corners`].
#[inline(always)]
pub(super) fn corners_of(surroundings: &Pairs<16>) -> Pairs<4> {
    // The pair of the middle of each row through the cell: what its first pair ends with, and what
    // its second begins with.
    [0, 1, 2, 3].map(|row| [surroundings[row][1], surroundings[4 + row][0]])
}

/// The trilinear values of a batch.
#[inline(always)]
pub(super) fn trilinear<S: Simd>(simd: S, [a, b, c, d]: &Pairs<4>, [fx, fy, fz]: &[Row; 3]) -> Row {
    let low = lerp(simd, &lerp(simd, &a[0], &a[1], fx), &lerp(simd, &b[0], &b[1], fx), fy);
    let high = lerp(simd, &lerp(simd, &c[0], &c[1], fx), &lerp(simd, &d[0], &d[1], fx), fy);
    lerp(simd, &low, &high, fz)
}

/// The gradients of a batch, a voxel: half the difference of the trilinear values one voxel on
/// either side, with the weights of the same cell.
#[inline(always)]
pub(super) fn gradients<S: Simd>(simd: S, surroundings: &Pairs<16>, within: &[Row; 3]) -> [Row; 3] {
    let [fx, fy, fz] = within;
    let (mut along_x, mut through, mut outer) = ([[0.0; BATCH]; 4], [[0.0; BATCH]; 4], [[0.0; BATCH]; 8]);
    for row in 0..4 {
        let ([a, b], [c, d]) = (&surroundings[row], &surroundings[4 + row]);
        along_x[row] = lerp(simd, &less(simd, c, a), &less(simd, d, b), fx);
        through[row] = lerp(simd, b, c, fx);
    }
    for row in 0..8 {
        let [a, b] = &surroundings[8 + row];
        outer[row] = lerp(simd, a, b, fx);
    }
    let low = lerp(simd, &along_x[0], &along_x[1], fy);
    let high = lerp(simd, &along_x[2], &along_x[3], fy);
    let dx = lerp(simd, &low, &high, fz);
    let beside_y = [
        [&through[1], &outer[0]],
        [&outer[1], &through[0]],
        [&through[3], &outer[2]],
        [&outer[3], &through[2]],
    ];
    let dy = lerp_less(simd, beside_y, within);
    let beside_z = [
        [&through[2], &outer[4]],
        [&through[3], &outer[6]],
        [&outer[5], &through[0]],
        [&outer[7], &through[1]],
    ];
    let dz = lerp_less(simd, beside_z, within);
    let mut halves = [dx, dy, dz];
    for row in &mut halves {
        for d in row {
            *d *= 0.5;
        }
    }
    halves
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::field::{SimdLevel, dispatch};
    use crate::trace::grid::volume::tests::header;

    /// Trilinear interpolation by its definition, in `f64`, with the cell moved by some voxels.
    fn moved<V: Voxel>(brick: &[f32], cell: [usize; 3], f: [f32; 3], by: [isize; 3]) -> f64 {
        let n = V::SIDE;
        let mut sum = 0.0;
        for corner in 0..8 {
            let c = [corner & 1, corner >> 1 & 1, corner >> 2 & 1];
            let at: [usize; 3] = std::array::from_fn(|a| (cell[a] + c[a]).wrapping_add_signed(by[a]));
            let weight: f64 =
                (0..3).map(|a| if c[a] == 1 { f64::from(f[a]) } else { 1.0 - f64::from(f[a]) }).product();
            sum += weight * f64::from(brick[(at[2] * n + at[1]) * n + at[0]]);
        }
        sum
    }

    fn check<V: Voxel>(kind: VoxelKind, seed: u64, places: &[([usize; 3], [f32; 3])]) {
        let n = V::SIDE;
        let mut state = seed;
        let bytes: Vec<u8> = (0..n * n * n)
            .flat_map(|_| {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                let number = (state >> 33) as u16;
                match kind {
                    VoxelKind::U8 => vec![number as u8],
                    VoxelKind::I16 | VoxelKind::U16 => number.to_le_bytes().to_vec(),
                    VoxelKind::F32 => (f32::from(number) / 65.0).to_le_bytes().to_vec(),
                }
            })
            .collect();
        let numbers: Vec<f32> = bytes.chunks_exact(kind.bytes()).map(|bytes| kind.value(bytes)).collect();
        let mut of_samples = Places::new();
        let samples: [u16; BATCH] = std::array::from_fn(|i| 61 * i as u16);
        for (i, &at) in samples.iter().enumerate() {
            let (cell, within) = places[i % places.len()];
            let cell = cell.map(|c| 1 + c % (n - 3));
            of_samples.voxel.as_flattened_mut()[usize::from(at)] =
                ((cell[2] * n + cell[1]) * n + cell[0]) as u16;
            for (row, f) in of_samples.within.iter_mut().zip(within) {
                row.as_flattened_mut()[usize::from(at)] = f;
            }
        }
        let cells = Cells::of_samples(&of_samples, &samples);
        let brick = Brick { kind, shape: BrickShape::of(&header([100; 3], kind)), voxels: &bytes };
        let (values, gradients) = dispatch!(SimdLevel::default().level(), simd => {
            let mut around = Around::new();
            around.read_corners(simd, brick, &cells, 3.0);
            around.read_surroundings(simd, brick, &cells, 0.0);
            let Around { corners, surroundings } = &around;
            (trilinear(simd, corners, &cells.within), gradients(simd, surroundings, &cells.within))
        });
        for i in 0..places.len() {
            let (cell, f) = places[i];
            let cell = cell.map(|c| 1 + c % (n - 3));
            let at = |by| moved::<V>(&numbers, cell, f, by);
            let scale = 65536.0;
            assert!((f64::from(values[i]) + 3.0 - at([0; 3])).abs() < 1e-6 * scale, "{kind:?}");
            for axis in 0..3 {
                let by = |d: isize| std::array::from_fn(|a| if a == axis { d } else { 0 });
                let exact = 0.5 * (at(by(1)) - at(by(-1)));
                assert!(
                    (f64::from(gradients[axis][i]) - exact).abs() < 2e-6 * scale,
                    "{kind:?}, axis {axis}"
                );
            }
        }
    }

    proptest! {
        #[test]
        fn values_and_gradients_are_those_of_trilinear_interpolation(
            seed in any::<u64>(),
            places in prop::collection::vec((prop::array::uniform3(0_usize..28), prop::array::uniform3(0.0_f32..=1.0)), BATCH),
        ) {
            for &kind in VoxelKind::ALL {
                with_voxel!(kind, V => check::<V>(kind, seed, &places));
            }
        }
    }
}
