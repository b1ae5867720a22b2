//! Plates that hold ellipsoids: a run of discs on a surface is thin along one direction, which need
//! not be an axis. Rays are tested against points only where they are within their plates.
//!
//! A plate is what lies between two parallel planes: low ≤ n·p ≤ high. With n_k the k-th row of the
//! map A of an ellipsoid (see [`super::shapes`]), a semi-axis is n_k/|n_k|², and the ellipsoid
//! extends from its centre along n to ±√(Σ (n·n_k)²/|n_k|⁴).

use fearless_simd::f32x8;
use fearless_simd::prelude::*;

use super::columns::{CHUNK_POINTS, CHUNKS, MAP_COLUMNS, PointColumns};
use rayset_files::octree::layout::RUN_POINTS;

/// Ellipsoids are taken to be larger by this part: pairs are tested with a slack, too.
const SLACK: f32 = 2e-3;
/// Plates are thicker by this part of the reach of their run, for what is rounded.
const ROUNDED: f32 = 1e-5;

/// A plate that holds all points of a run, and one for each chunk of them; in the coordinates of
/// the run.
#[derive(Clone, Debug, Default)]
pub(super) struct Plates {
    pub(super) of_run: Plate,
    normal: [[f32; CHUNKS]; 3],
    low: [f32; CHUNKS],
    high: [f32; CHUNKS],
}

/// What lies between two parallel planes.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Plate {
    pub(super) normal: [f32; 3],
    pub(super) low: f32,
    pub(super) high: f32,
}

impl Plates {
    /// Becomes those of ellipsoids, of which there are `len`, that reach no farther than
    /// `reach_length` from the centre of the run.
    #[inline(always)]
    pub(super) fn set<S: Simd>(&mut self, simd: S, points: &PointColumns, len: usize, reach_length: f32) {
        let Some(map) = points.map.first_chunk::<MAP_COLUMNS>() else { return };
        let chunks = len.div_ceil(CHUNK_POINTS);
        let mut of_run = [0.0; 3];
        for chunk in 0..chunks {
            let within = (len - CHUNK_POINTS * chunk).min(CHUNK_POINTS);
            let normal = mean_normal([&map[6], &map[7], &map[8]], CHUNK_POINTS * chunk, within);
            let (low, high) = extent(simd, points, map, chunk, normal);
            for axis in 0..3 {
                self.normal[axis][chunk] = normal[axis];
            }
            (self.low[chunk], self.high[chunk]) = (low, high);
            let sign = if dot(normal, of_run) < 0.0 { -1.0 } else { 1.0 };
            of_run = [0, 1, 2].map(|axis| of_run[axis] + sign * normal[axis]);
        }
        self.of_run = Plate { normal: unit(of_run), low: f32::INFINITY, high: f32::NEG_INFINITY };
        for chunk in 0..chunks {
            let (low, high) = extent(simd, points, map, chunk, self.of_run.normal);
            self.of_run.low = self.of_run.low.min(low);
            self.of_run.high = self.of_run.high.max(high);
        }
        let slack = reach_length * ROUNDED;
        self.of_run.low -= slack;
        self.of_run.high += slack;
        for chunk in 0..chunks {
            self.low[chunk] -= slack;
            self.high[chunk] += slack;
        }
    }

    /// The columns of those of chunks.
    pub(super) fn by_chunks(&mut self) -> impl Iterator<Item = &mut [f32; CHUNKS]> {
        self.normal.iter_mut().chain([&mut self.low, &mut self.high])
    }

    /// The ranges of distances in which a ray is within the plates of the eight chunks from `first`
    /// on: from its foot, by the direction and the foot with reversed sign.
    #[inline(always)]
    pub(super) fn ranges<S: Simd>(
        &self,
        simd: S,
        first: usize,
        minus_foot: [f32; 3],
        direction: [f32; 3],
    ) -> (f32x8<S>, f32x8<S>) {
        let range = first..first + 8;
        let normal = [
            f32x8::from_slice(simd, &self.normal[0][range.clone()]),
            f32x8::from_slice(simd, &self.normal[1][range.clone()]),
            f32x8::from_slice(simd, &self.normal[2][range.clone()]),
        ];
        let low = f32x8::from_slice(simd, &self.low[range.clone()]);
        let high = f32x8::from_slice(simd, &self.high[range]);
        let along = weighed(normal, direction);
        crossing(weighed(normal, minus_foot), along, low, high)
    }
}

impl Plate {
    /// The ranges of distances in which eight rays are within the plate: from their feet, which
    /// have reversed signs.
    #[inline(always)]
    pub(super) fn ranges<S: Simd>(
        &self,
        simd: S,
        minus_foot: [f32x8<S>; 3],
        direction: [f32x8<S>; 3],
    ) -> (f32x8<S>, f32x8<S>) {
        let (low, high) = (f32x8::splat(simd, self.low), f32x8::splat(simd, self.high));
        crossing(weighed(minus_foot, self.normal), weighed(direction, self.normal), low, high)
    }
}

/// Where rays are between two planes, by the components along their normal of the foot, with
/// reversed sign, and of the direction.
#[inline(always)]
fn crossing<S: Simd>(
    minus_foot: f32x8<S>,
    direction: f32x8<S>,
    low: f32x8<S>,
    high: f32x8<S>,
) -> (f32x8<S>, f32x8<S>) {
    // A ray that is parallel to the planes never crosses them: distances are huge, of opposite
    // signs between them and of the same sign outside.
    let inverse = 1.0 / direction.abs().max(1e-30).copysign(direction);
    let (a, b) = ((low + minus_foot) * inverse, (high + minus_foot) * inverse);
    (a.min(b), a.max(b))
}

#[inline(always)]
fn weighed<S: Simd>(v: [f32x8<S>; 3], by: [f32; 3]) -> f32x8<S> {
    let simd = v[0].simd;
    let [x, y, z] = [f32x8::splat(simd, by[0]), f32x8::splat(simd, by[1]), f32x8::splat(simd, by[2])];
    v[2].mul_add(z, v[1].mul_add(y, v[0] * x))
}

/// The mean of the shortest axes of some points, of length one: thin points count for more.
#[inline(always)]
fn mean_normal(row: [&[f32; RUN_POINTS]; 3], first: usize, count: usize) -> [f32; 3] {
    let of = |i: usize| [row[0][i], row[1][i], row[2][i]];
    let reference = of(first);
    let mut sum = [0.0; 3];
    for i in first..first + count {
        let axis = of(i);
        let sign = if dot(axis, reference) < 0.0 { -1.0 } else { 1.0 };
        sum = [sum[0] + sign * axis[0], sum[1] + sign * axis[1], sum[2] + sign * axis[2]];
    }
    unit(sum)
}

/// A vector of length one, whatever the length is.
#[inline(always)]
fn unit(v: [f32; 3]) -> [f32; 3] {
    let largest = v[0].abs().max(v[1].abs()).max(v[2].abs());
    if !(f32::MIN_POSITIVE..f32::INFINITY).contains(&largest) {
        return [0.0, 0.0, 1.0];
    }
    let v = v.map(|c| c / largest);
    let per_length = 1.0 / dot(v, v).sqrt();
    v.map(|c| c * per_length)
}

#[inline(always)]
fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// From where to where the points of a chunk extend along a direction.
#[inline(always)]
fn extent<S: Simd>(
    simd: S,
    points: &PointColumns,
    map: &[[f32; RUN_POINTS]; MAP_COLUMNS],
    chunk: usize,
    normal: [f32; 3],
) -> (f32, f32) {
    let range = CHUNK_POINTS * chunk..CHUNK_POINTS * (chunk + 1);
    let column = |columns: &[f32; RUN_POINTS]| f32x8::from_slice(simd, &columns[range.clone()]);
    let mut half_squared = f32x8::splat(simd, 0.0);
    for row in 0..3 {
        let axis = [column(&map[3 * row]), column(&map[3 * row + 1]), column(&map[3 * row + 2])];
        let length_squared = axis[2].mul_add(axis[2], axis[1].mul_add(axis[1], axis[0] * axis[0]));
        let along = weighed(axis, normal) / length_squared;
        half_squared = along.mul_add(along, half_squared);
    }
    let half = half_squared.sqrt() * (1.0 + SLACK);
    // What fills up a chunk has no extent: its map is infinite, and this is not a number.
    let half = half.simd_ge(0.0).select(half, f32x8::splat(simd, 0.0));
    let center = weighed(
        [column(&points.position[0]), column(&points.position[1]), column(&points.position[2])],
        normal,
    );
    ((center - half).reduce_min(), (center + half).reduce_max())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::simd::{SimdLevel, dispatch};
    use proptest::prelude::*;
    use rayset_base::geometry::{DMat3, DQuat, DVec3};

    /// Semi-axes and rotations of ellipsoids, and their centres.
    fn any_points() -> impl Strategy<Value = Vec<(DVec3, DQuat, DVec3)>> {
        let vector = prop::array::uniform3(-1.0..1.0_f64).prop_map(DVec3::from_array);
        let axes = (0.1..2.0_f64, 0.02..1.0_f64, 0.02..1.0_f64);
        let axes = axes.prop_map(|(r, a, b)| DVec3::new(r, r * a.max(b), r * a.min(b)));
        let rotation = prop::array::uniform4(-1.0..1.0_f64).prop_map(|q| DQuat::from_array(q).normalize());
        prop::collection::vec((axes, rotation, vector.prop_map(|v| v * 5.0)), 1..40)
    }

    fn columns(points: &[(DVec3, DQuat, DVec3)]) -> PointColumns {
        let mut columns =
            PointColumns { map: vec![[f32::INFINITY; RUN_POINTS]; MAP_COLUMNS], ..Default::default() };
        for (i, (axes, rotation, center)) in points.iter().enumerate() {
            let map = DMat3::from_diagonal(1.0 / *axes) * DMat3::from_quat(*rotation).transpose();
            for row in 0..3 {
                for axis in 0..3 {
                    columns.map[3 * row + axis][i] = map.row(row)[axis] as f32;
                }
                columns.position[row][i] = center[row] as f32;
            }
        }
        // What fills up the last chunk is where its first point is.
        for axis in 0..3 {
            let first = points.len().next_multiple_of(CHUNK_POINTS) - CHUNK_POINTS;
            let position = columns.position[axis][first];
            columns.position[axis][points.len()..].fill(position);
        }
        columns
    }

    proptest! {
        #[test]
        fn wherever_a_ray_is_within_an_ellipsoid_it_is_within_its_plates(
            points in any_points().prop_filter("a number", |points| {
                points.iter().all(|(_, rotation, _)| rotation.is_finite())
            }),
            which in any::<prop::sample::Index>(),
            place in prop::array::uniform3(-1.0..1.0_f64).prop_map(DVec3::from_array),
            direction in prop::array::uniform3(-1.0..1.0_f64).prop_map(DVec3::from_array),
            back in -9.0..9.0_f64,
        ) {
            prop_assume!(direction.length() > 0.01 && place.length() < 1.0);
            let columns = columns(&points);
            let mut plates = Plates::default();
            let i = which.index(points.len());
            let (axes, rotation, center) = points[i];
            let (position, direction) = (center + rotation * (axes * place), direction.normalize());
            let minus_foot = (direction * back - position).to_array().map(|c| c as f32);
            let to = direction.to_array().map(|c| c as f32);
            let chunk = i / CHUNK_POINTS;
            let ranges = dispatch!(SimdLevel::default().level(), simd => {
                plates.set(simd, &columns, points.len(), 30.0);
                let splat = |v: [f32; 3]| v.map(|c| f32x8::splat(simd, c));
                let of_run = plates.of_run.ranges(simd, splat(minus_foot), splat(to));
                let of_chunk = plates.ranges(simd, chunk / 8 * 8, minus_foot, to);
                [(of_run, 0), (of_chunk, chunk % 8)].map(|((from, to), lane)| {
                    let (mut starts, mut ends) = ([0.0_f32; 8], [0.0_f32; 8]);
                    from.store_slice(&mut starts);
                    to.store_slice(&mut ends);
                    (starts[lane], ends[lane])
                })
            });
            for (from, to) in ranges {
                // What is rounded in the distance itself, as blocks have a slack for it.
                prop_assert!(f64::from(from) <= back + 1e-5 && back - 1e-5 <= f64::from(to), "{from} {to} {back}");
            }
        }
    }

    #[test]
    fn plates_of_discs_on_a_tilted_plane_are_as_thin_as_the_discs() {
        let (tilt, axes) = (DQuat::from_rotation_x(0.7), DVec3::new(1.0, 1.0, 0.1));
        let on_plane = |i: usize| tilt * DVec3::new((i % 5) as f64, (i / 5) as f64, 0.0);
        let points: Vec<_> =
            (0..21).map(|i| (axes, tilt * DQuat::from_rotation_z(i as f64), on_plane(i))).collect();
        let mut plates = Plates::default();
        dispatch!(SimdLevel::default().level(), simd => plates.set(simd, &columns(&points), points.len(), 10.0));
        let Plate { low, high, .. } = plates.of_run;
        let thickness = [(low, high), (plates.low[0], plates.high[0]), (plates.low[2], plates.high[2])];
        for (low, high) in thickness {
            assert!((0.2..0.202).contains(&(high - low)), "{low} to {high}");
        }
    }
}
