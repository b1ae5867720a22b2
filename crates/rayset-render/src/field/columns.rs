//! Points by columns, as they are tested against rays: those of a run, or the ones among them that
//! are near some rays. And which columns of attributes come with them.

use fearless_simd::f32x8;
use fearless_simd::prelude::*;
use rayset_base::bytes::list_bytes;
use rayset_files::octree::layout::RUN_POINTS;

/// Points that are tested together.
pub(super) const CHUNK_POINTS: usize = 8;
/// Chunks of a whole run.
pub(super) const CHUNKS: usize = RUN_POINTS / CHUNK_POINTS;

/// Up to 128 points stored by columns, in the order of the file.
#[derive(Clone, Debug)]
pub(super) struct PointColumns {
    /// Relative to the centre of the run.
    pub(super) position: [[f32; RUN_POINTS]; 3],
    pub(super) radius: [f32; RUN_POINTS],
    pub(super) inverse_radius: [f32; RUN_POINTS],
    /// Infinite for what fills up the last chunk, which so reaches no sample.
    pub(super) inverse_radius_squared: [f32; RUN_POINTS],
    /// Weights, multiplied by the kernel's normalisation if it is requested.
    pub(super) weight: [f32; RUN_POINTS],
    /// The number of each point in its run.
    pub(super) number: [u8; RUN_POINTS],
    /// Of ellipsoids the columns of the map that takes each to the unit ball, infinite for what
    /// fills up the last chunk; none for balls.
    pub(super) map: Vec<[f32; RUN_POINTS]>,
}

/// Columns of the map that takes an ellipsoid to the unit ball: element j of row i is in column
/// 3·i + j.
pub(super) const MAP_COLUMNS: usize = 9;

/// Most bytes of the map besides the columns themselves.
pub(super) const MAP_BYTES: usize = MAP_COLUMNS * size_of::<[f32; RUN_POINTS]>();

impl Default for PointColumns {
    /// All points of a run, whose columns are to be filled in.
    fn default() -> Self {
        Self {
            position: [[0.0; RUN_POINTS]; 3],
            radius: [0.0; RUN_POINTS],
            inverse_radius: [0.0; RUN_POINTS],
            inverse_radius_squared: [0.0; RUN_POINTS],
            weight: [0.0; RUN_POINTS],
            number: std::array::from_fn(|i| i as u8),
            map: Vec::new(),
        }
    }
}

impl PointColumns {
    /// Becomes those of a run's points whose bits are set, which are balls. Returns a bit for each
    /// chunk that they take.
    #[inline(always)]
    pub(super) fn select(&mut self, run: &Self, points: [u64; 2]) -> u64 {
        let mut len = 0;
        for (half, mut points) in points.into_iter().enumerate() {
            while points != 0 {
                let i = (64 * half + points.trailing_zeros() as usize) & (RUN_POINTS - 1);
                points &= points - 1;
                let to = len & (RUN_POINTS - 1);
                self.position[0][to] = run.position[0][i];
                self.position[1][to] = run.position[1][i];
                self.position[2][to] = run.position[2][i];
                self.radius[to] = run.radius[i];
                self.inverse_radius[to] = run.inverse_radius[i];
                self.inverse_radius_squared[to] = run.inverse_radius_squared[i];
                self.weight[to] = run.weight[i];
                self.number[to] = i as u8;
                len += 1;
            }
        }
        let chunks = len.div_ceil(CHUNK_POINTS);
        self.inverse_radius_squared[len..CHUNK_POINTS * chunks].fill(f32::INFINITY);
        (1 << chunks) - 1
    }
}

/// The attributes that a cloud's field carries besides the density. Their channels are numbered in
/// this order.
#[derive(Clone, Debug, PartialEq, Eq, Default)]
pub struct AttributeColumns {
    /// The points' colour: three channels, decoded to linear light.
    pub color: bool,
    /// Whether that is left in display values instead.
    pub color_as_displayed: bool,
    /// Numbers of attributes that are averaged, one channel each:
    /// [`Header::attribute_number`](rayset_files::octree::format::Header::attribute_number).
    pub scalars: Vec<usize>,
    /// Numbers of attributes of class labels, of which samples have that of the point that
    /// contributes most.
    pub labels: Vec<usize>,
}

impl AttributeColumns {
    /// Bytes that they take besides themselves.
    pub(crate) fn bytes(&self) -> usize {
        list_bytes(&self.scalars) + list_bytes(&self.labels)
    }

    /// Number of channels.
    #[must_use]
    pub fn channels(&self) -> usize {
        self.first_scalar() + self.scalars.len()
    }

    /// The channel of the first scalar.
    #[must_use]
    pub fn first_scalar(&self) -> usize {
        if self.color { 3 } else { 0 }
    }
}

/// Eight chunks of a column.
#[inline(always)]
pub(super) fn chunks_of<S: Simd>(simd: S, column: &[f32; RUN_POINTS], group: usize) -> [f32x8<S>; 8] {
    let mut chunks = [f32x8::splat(simd, 0.0); 8];
    let column = &column[64 * group..64 * group + 64];
    for chunk in 0..8 {
        chunks[chunk] = f32x8::from_slice(simd, &column[8 * chunk..8 * chunk + 8]);
    }
    chunks
}

/// The largest element of each of eight vectors, or the smallest.
#[inline(always)]
pub(super) fn fold<S: Simd, const LARGEST: bool>(v: [f32x8<S>; 8]) -> f32x8<S> {
    let quarters = [
        fold_pairs::<S, LARGEST>(v[0], v[1]),
        fold_pairs::<S, LARGEST>(v[2], v[3]),
        fold_pairs::<S, LARGEST>(v[4], v[5]),
        fold_pairs::<S, LARGEST>(v[6], v[7]),
    ];
    fold_pairs::<S, LARGEST>(
        fold_pairs::<S, LARGEST>(quarters[0], quarters[1]),
        fold_pairs::<S, LARGEST>(quarters[2], quarters[3]),
    )
}

/// The larger element of each pair of neighbours in two vectors, or the smaller.
#[inline(always)]
fn fold_pairs<S: Simd, const LARGEST: bool>(a: f32x8<S>, b: f32x8<S>) -> f32x8<S> {
    let (even, odd) = (a.unzip_low(b), a.unzip_high(b));
    if LARGEST { even.max(odd) } else { even.min(odd) }
}
