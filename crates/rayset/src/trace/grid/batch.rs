//! Samples of one brick, evaluated many at a time.

use super::places::{OfSamples, Places};
use super::shape::BrickShape;
use super::voxels::Voxel;
use crate::field::BLOCK_SAMPLES;

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

/// Pairs of voxels of a batch, as they are stored: one row for each place relative to a cell.
struct Pairs<V: Voxel, const ROWS: usize>([[V::Pair; BATCH]; ROWS]);

impl<V: Voxel, const ROWS: usize> Pairs<V, ROWS> {
    /// Reads pairs at `offsets` voxels (`farthest` is the largest) from the voxel `before` voxels in front of each cell's
    /// first.
    #[inline(always)]
    fn read(brick: &[u8], cells: &Cells, before: usize, offsets: [usize; ROWS], farthest: usize) -> Self {
        let mut rows = [[V::Pair::default(); BATCH]; ROWS];
        for (i, &voxel) in cells.voxel.iter().enumerate() {
            let from = usize::from(voxel).wrapping_sub(before).wrapping_mul(V::BYTES);
            // One test for each cell: its pairs then need none.
            let around = &brick[from..][..(farthest + 2) * V::BYTES];
            for (row, offset) in rows.iter_mut().zip(offsets) {
                row[i] = V::pair(around, offset);
            }
        }
        Self(rows)
    }

    /// A row of pairs as two rows of numbers.
    #[inline(always)]
    fn numbers(&self, row: usize) -> [Row; 2] {
        let (mut low, mut high) = ([0.0; BATCH], [0.0; BATCH]);
        for (i, &pair) in self.0[row].iter().enumerate() {
            [low[i], high[i]] = V::numbers(pair);
        }
        [low, high]
    }
}

#[inline(always)]
fn lerp(a: &Row, b: &Row, f: &Row) -> Row {
    let mut out = [0.0; BATCH];
    for i in 0..BATCH {
        out[i] = a[i] + (b[i] - a[i]) * f[i];
    }
    out
}

#[inline(always)]
fn less(a: &Row, b: &Row) -> Row {
    let mut out = [0.0; BATCH];
    for i in 0..BATCH {
        out[i] = a[i] - b[i];
    }
    out
}

/// What of a voxel is interpolated.
pub(super) trait Quantity {
    /// Of rows of stored numbers, what is interpolated.
    fn of(&self, numbers: [Row; 2]) -> [Row; 2];
}

/// Stored numbers, of which nothing is subtracted.
struct Stored;

impl Quantity for Stored {
    #[inline(always)]
    fn of(&self, numbers: [Row; 2]) -> [Row; 2] {
        numbers
    }
}

/// Stored numbers less one.
struct Less(f32);

impl Quantity for Less {
    #[inline(always)]
    fn of(&self, mut numbers: [Row; 2]) -> [Row; 2] {
        for row in &mut numbers {
            for number in row {
                *number -= self.0;
            }
        }
        numbers
    }
}

/// The stored numbers of the corners of cells less `base`: rows of two that follow each other along x, then along y, then along z.
#[inline(always)]
pub(super) fn corners<V: Voxel, B: BrickShape>(
    shape: B,
    brick: &[u8],
    cells: &Cells,
    base: f32,
) -> [[Row; 2]; 4] {
    let (y, z) = shape.strides::<V>();
    let pairs = Pairs::<V, 4>::read(brick, cells, 0, [0, y, z, z + y], z + y);
    [0, 1, 2, 3].map(|row| Less(base).of(pairs.numbers(row)))
}

/// The trilinear values of a batch, in stored numbers less `base`.
#[inline(always)]
pub(super) fn values<V: Voxel, B: BrickShape>(shape: B, brick: &[u8], cells: &Cells, base: f32) -> Row {
    interpolated::<V, B>(shape, brick, cells, &Less(base))
}

/// The trilinear values of a quantity.
#[inline(always)]
pub(super) fn interpolated<V: Voxel, B: BrickShape>(
    shape: B,
    brick: &[u8],
    cells: &Cells,
    quantity: &impl Quantity,
) -> Row {
    let (y, z) = shape.strides::<V>();
    let pairs = Pairs::<V, 4>::read(brick, cells, 0, [0, y, z, z + y], z + y);
    let [fx, fy, fz] = &cells.within;
    let mut along_x = [[0.0; BATCH]; 4];
    for (row, out) in along_x.iter_mut().enumerate() {
        let [a, b] = quantity.of(pairs.numbers(row));
        *out = lerp(&a, &b, fx);
    }
    let low = lerp(&along_x[0], &along_x[1], fy);
    let high = lerp(&along_x[2], &along_x[3], fy);
    lerp(&low, &high, fz)
}

/// The gradients of a batch in stored numbers a voxel: half the difference of the trilinear values one voxel on either
/// side, with the weights of the same cell.
#[inline(always)]
pub(super) fn gradients<V: Voxel, B: BrickShape>(shape: B, brick: &[u8], cells: &Cells) -> [Row; 3] {
    gradients_of::<V, B>(shape, brick, cells, &Stored)
}

/// The gradients of a quantity, as [`gradients`] are those of stored numbers.
#[inline(always)]
pub(super) fn gradients_of<V: Voxel, B: BrickShape>(
    shape: B,
    brick: &[u8],
    cells: &Cells,
    quantity: &impl Quantity,
) -> [Row; 3] {
    let (y, z) = shape.strides::<V>();
    let f = &cells.within;
    // From one voxel before the cell along z. Rows of four voxels through the cell, as pairs before and behind the middle of
    // the row, for y and z of 0 and 1; then pairs beside the cell: y of −1 and 2 at z of 0 and 1, z of −1 and 2 at y of 0 and 1.
    let before = [z - 1, z + y - 1, 2 * z - 1, 2 * z + y - 1];
    let beside_y = [z - y, z + 2 * y, 2 * z - y, 2 * z + 2 * y];
    let beside_z = [0, 3 * z, y, y + 3 * z];
    let mut offsets = [0; 16];
    for row in 0..4 {
        (offsets[row], offsets[4 + row]) = (before[row], before[row] + 2);
        (offsets[8 + row], offsets[12 + row]) = (beside_y[row], beside_z[row]);
    }
    let pairs = Pairs::<V, 16>::read(brick, cells, z, offsets, y + 3 * z);
    let (mut along_x, mut through, mut outer) = ([[0.0; BATCH]; 4], [[0.0; BATCH]; 4], [[0.0; BATCH]; 8]);
    for row in 0..4 {
        let ([a, b], [c, d]) = (quantity.of(pairs.numbers(row)), quantity.of(pairs.numbers(4 + row)));
        along_x[row] = lerp(&less(&c, &a), &less(&d, &b), &f[0]);
        through[row] = lerp(&b, &c, &f[0]);
    }
    for row in 0..4 {
        let ([a, b], [c, d]) = (quantity.of(pairs.numbers(8 + row)), quantity.of(pairs.numbers(12 + row)));
        outer[row] = lerp(&a, &b, &f[0]);
        outer[4 + row] = lerp(&c, &d, &f[0]);
    }
    let dx = lerp(&lerp(&along_x[0], &along_x[1], &f[1]), &lerp(&along_x[2], &along_x[3], &f[1]), &f[2]);
    let dy = lerp(
        &lerp(&less(&through[1], &outer[0]), &less(&outer[1], &through[0]), &f[1]),
        &lerp(&less(&through[3], &outer[2]), &less(&outer[3], &through[2]), &f[1]),
        &f[2],
    );
    let dz = lerp(
        &lerp(&less(&through[2], &outer[4]), &less(&through[3], &outer[6]), &f[1]),
        &lerp(&less(&outer[5], &through[0]), &less(&outer[7], &through[1]), &f[1]),
        &f[2],
    );
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
    use crate::grid::format::VoxelKind;
    use crate::trace::grid::shape::Cube;
    use crate::trace::grid::voxels::with_voxel;

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
        let values = values::<V, Cube>(Cube, &bytes, &cells, 3.0);
        let gradients = gradients::<V, Cube>(Cube, &bytes, &cells);
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
