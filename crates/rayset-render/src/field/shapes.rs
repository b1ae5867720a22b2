//! Shapes of points, decoded by columns for the inner loop: of each point the map A/r that takes
//! its ellipsoid to the unit ball (see [`Shape::unit_from_local`]), of which distances are then
//! those of the kernel.

use super::columns::{CHUNK_POINTS, MAP_COLUMNS};
use super::run::{DecodedRun, RunDecoder, WideRun, normalised_weight};
use super::simd::{SimdLevel, dispatch};
use rayset_base::geometry::Shape;
use rayset_files::octree::format::Header;
use rayset_files::octree::layout::RUN_POINTS;
use rayset_files::octree::page::Run;
use rayset_files::octree::shape::{SHAPE_COLUMNS, StoredShape};

/// Shapes of a run as they are stored, by columns.
type ShapeWords = [[u16; RUN_POINTS]; SHAPE_COLUMNS];

impl RunDecoder {
    /// Decodes shapes, and normalises the weights by them. Returns the least detail.
    // Compiled apart: most clouds are of balls.
    #[inline(never)]
    pub(super) fn decode_shapes(
        &self,
        run: &Run<'_>,
        header: &Header,
        simd: SimdLevel,
        out: &mut DecodedRun,
    ) -> f64 {
        let mut words: ShapeWords = [[0; RUN_POINTS]; SHAPE_COLUMNS];
        run.shape_words(header, &mut words);
        let (n, points) = (out.len, &mut out.points);
        let ratios = dispatch!(simd.level(), _simd =>
            decode(&words, &points.inverse_radius, n, &mut points.map));
        if let Some(factor) = self.normalisation {
            let lengths = points.inverse_radius[..n].iter().zip(&ratios.volume);
            for (w, (inverse, volume)) in points.weight[..n].iter_mut().zip(lengths) {
                *w = normalised_weight(*w, factor, *inverse, *volume);
            }
        }
        let details = points.radius[..n].iter().zip(&ratios.detail).map(|(radius, detail)| radius * detail);
        f64::from(details.fold(f32::INFINITY, f32::min))
    }
}

/// What is known of the shapes of a run besides their maps.
struct Ratios {
    /// The detail of each point as a part of its radius.
    detail: [f32; RUN_POINTS],
    /// The volume of each point as a part of that of its ball.
    volume: [f32; RUN_POINTS],
}

/// Decodes the maps of the points of a run, of which there are `len`, in single precision. What
/// fills up the last chunk has maps that are infinite: it reaches no sample.
// A loop over plain columns, without branches: the compiler makes vectors of it.
#[inline(always)]
fn decode(
    words: &ShapeWords,
    inverse_radius: &[f32; RUN_POINTS],
    len: usize,
    map: &mut Vec<[f32; RUN_POINTS]>,
) -> Ratios {
    map.resize(MAP_COLUMNS, [0.0; RUN_POINTS]);
    let mut ratios = Ratios { detail: [1.0; RUN_POINTS], volume: [1.0; RUN_POINTS] };
    let Some(map): Option<&mut [[f32; RUN_POINTS]; MAP_COLUMNS]> = map.first_chunk_mut() else {
        return ratios;
    };
    for i in 0..RUN_POINTS {
        let ([x, y, z], [a2, a3]) = axes([words[0][i], words[1][i], words[2][i], words[3][i], words[4][i]]);
        let inverse = inverse_radius[i];
        for (row, axis, scale) in [(0, x, inverse), (1, y, inverse / a2), (2, z, inverse / a3)] {
            for j in 0..3 {
                map[3 * row + j][i] = axis[j] * scale;
            }
        }
        ratios.detail[i] = (2.0 * a3).min(1.0);
        ratios.volume[i] = a2 * a3;
    }
    map.iter_mut().for_each(|column| column[len..len.next_multiple_of(CHUNK_POINTS)].fill(f32::INFINITY));
    ratios
}

/// The directions of the semi-axes, and the ratios a₂ and a₃. As [`StoredShape::decode`], in single
/// precision.
#[inline(always)]
fn axes([a, b, c, a2, a3]: [u16; SHAPE_COLUMNS]) -> ([[f32; 3]; 3], [f32; 2]) {
    let largest = u32::from(a >> 15 | b >> 15 << 1);
    let [a, b, c] = [a, b, c].map(StoredShape::component);
    let squares = a * a + b * b + c * c;
    let rest = (1.0 - squares).max(0.0).sqrt();
    let [x, y, z, w] = [0_u32, 1, 2, 3].map(|number| match number.wrapping_sub(largest) & 3 {
        0 => rest,
        1 => a,
        2 => b,
        _ => c,
    });
    // Two, unless the words are of no rotation.
    let twice = 2.0 / (squares + rest * rest);
    let (x2, y2, z2) = (x * twice, y * twice, z * twice);
    let (xx, xy, xz, xw) = (x * x2, x * y2, x * z2, w * x2);
    let (yy, yz, yw) = (y * y2, y * z2, w * y2);
    let (zz, zw) = (z * z2, w * z2);
    let axes = [
        [1.0 - (yy + zz), xy + zw, xz - yw],
        [xy - zw, 1.0 - (xx + zz), yz + xw],
        [xz + yw, yz - xw, 1.0 - (xx + yy)],
    ];
    let [a2, a3] = [a2, a3].map(StoredShape::ratio);
    (axes, [a2, a3.min(a2)])
}

impl WideRun {
    /// Takes the maps of the points of a run as they are in single precision: no more than that is
    /// known of points that were widened.
    pub(super) fn take_maps(&mut self, map: &[[f32; RUN_POINTS]], len: usize) {
        self.map.clear();
        let Some(map) = map.first_chunk::<MAP_COLUMNS>() else { return };
        self.map.extend((0..len).map(|i| map.each_ref().map(|column| f64::from(column[i]))));
    }

    /// Decodes the maps of the points of a run in double precision, of points with these radii.
    pub(super) fn decode_maps(&mut self, run: &Run<'_>, header: &Header, radii: &[f32; RUN_POINTS]) {
        self.map.clear();
        let shapes = run.shapes(header).into_iter().flatten().map(StoredShape::decode);
        self.map.extend(shapes.zip(radii).map(|(shape, radius)| precise_map(&shape, f64::from(*radius))));
    }
}

/// The map of a point in double precision, by rows.
fn precise_map(shape: &Shape, radius: f64) -> [f64; MAP_COLUMNS] {
    let rows = shape.unit_from_local().transpose() * (1.0 / radius);
    rows.to_cols_array()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn columns_of_any_words_are_the_maps_of_their_shapes(
            words in prop::array::uniform5(any::<u16>()),
            radius in 1e-3..1e3_f32,
        ) {
            let shape = StoredShape(words).decode();
            let expected = precise_map(&shape, radius.into());
            let columns = words.map(|word| [word; RUN_POINTS]);
            let mut map = Vec::new();
            let ratios = decode(&columns, &[1.0 / radius; RUN_POINTS], 3, &mut map);
            for (column, expected) in map.iter().zip(expected) {
                let row = 1.0 / (f64::from(radius) * shape.ratios[1]);
                prop_assert!((f64::from(column[2]) - expected).abs() < 1e-6 * row, "{} {expected}", column[2]);
                prop_assert!(column[3..8].iter().all(|v| *v == f32::INFINITY));
            }
            let volume = f64::from(ratios.volume[2]) / shape.volume();
            prop_assert!((volume - 1.0).abs() < 1e-6);
            prop_assert_eq!(radius * ratios.detail[2], StoredShape(words).detail(radius));
        }
    }
}
