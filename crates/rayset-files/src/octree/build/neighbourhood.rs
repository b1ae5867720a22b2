//! The shapes of points from where their neighbours lie.
//!
//! On a surface the sixteen nearest neighbours lie about a plane: the point becomes a disc in that
//! plane. Along a wire they lie about a line: it becomes a rod. Where they lie all around, as in
//! leaves, it becomes a small ball. Between these, shapes change without a jump.
//!
//! Where a file says which way its surface faces, a point is a [`disc`] that faces there.
//!
//! With σ₁ ≥ σ₂ ≥ σ₃ the deviations of the neighbours along the axes of their covariance, what is
//! flat has a small σ₃/σ₂, and what is thin a small σ₂/σ₁. Constants were chosen by measurement
//! (docs/benchmarks.md, "Automatic radii and shapes").

use crate::octree::shape::StoredShape;
use rayset_base::geometry::{DMat3, DQuat, DVec3, Shape, eigenvectors};

/// Up to this σ₃/σ₂, places are flat: of a plane whose noise is half the distance between points,
/// most have less.
const FLAT: f64 = 0.6;
/// From here on points are scattered. Of those at random in space, four in five lie between.
const SCATTERED: f64 = 0.9;
/// Up to this, places count as those of a surface where it is asked whether a cloud has any: of
/// points at random in space, one in a hundred has less.
const OF_SURFACE: f64 = 0.45;
/// Up to this σ₂/σ₁, places are on a wire.
const THIN: f64 = 0.25;

/// Half the thickness of a disc, and the width of the thinnest rod, as parts of the radius.
const DISC_THICKNESS: f64 = 0.15;
const ROD_WIDTH: f64 = 0.25;
/// Half the thickness of what stands for a scattered point.
const SCATTERED_THICKNESS: f64 = 0.6;

/// Radii of discs and of scattered points, of a point that would have the radius 1 as a ball: they
/// are 1.15 and 0.7 of the distance to the eighth neighbour.
const DISC_RADIUS: f64 = 1.15 / 0.85;
const SCATTERED_RADIUS: f64 = 0.7 / 0.85;

/// The shape that neighbours suggest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Suggested {
    pub(super) shape: StoredShape,
    /// Whether it is that of a surface or a wire.
    pub(super) is_flat: bool,
}

impl Suggested {
    /// Where there are too few neighbours to tell.
    pub(super) const NOTHING: Self = Self { shape: StoredShape::BALL, is_flat: false };

    /// By the vectors from a point to its neighbours, itself included.
    pub(super) fn by_neighbours(offsets: &[[f32; 3]]) -> Self {
        let offsets = offsets.iter().map(|offset| (1.0, DVec3::from_array(offset.map(f64::from))));
        let Some((variances, axes)) = covariance(offsets) else { return Self::NOTHING };
        let deviations = variances.to_array().map(f64::sqrt);
        Self::by_deviations(deviations, DQuat::from_mat3(&axes).normalize())
    }

    fn by_deviations([first, second, third]: [f64; 3], rotation: DQuat) -> Self {
        let (thin, flat) = (second / first, if second > 0.0 { third / second } else { 0.0 });
        let between = |a: f64, b: f64, part: f64| a + (b - a) * part;
        let scattered = ((flat - FLAT) / (SCATTERED - FLAT)).clamp(0.0, 1.0);
        let thickness = between(DISC_THICKNESS, SCATTERED_THICKNESS, scattered);
        let wide = (thin / THIN).min(1.0);
        let ratios = [1.0, thickness].map(|ratio| between(ROD_WIDTH, ratio, wide));
        let shape = StoredShape::encode(&Shape { rotation, ratios });
        Self { shape, is_flat: flat <= OF_SURFACE || wide < 1.0 }
    }
}

/// The variances of weighted places about their mean along three axes, the largest first, as parts
/// of their sum; and the axes. `None` if they are all in one place, or too far apart for numbers.
pub(super) fn covariance(places: impl Iterator<Item = (f64, DVec3)> + Clone) -> Option<(DVec3, DMat3)> {
    let whole: f64 = places.clone().map(|(weight, _)| weight).sum();
    let mean = places.clone().map(|(weight, place)| place * weight).sum::<DVec3>() / whole;
    let mut covariance = DMat3::ZERO;
    for (weight, place) in places {
        let v = place - mean;
        covariance += DMat3::from_cols(v * v.x, v * v.y, v * v.z) * weight;
    }
    // Relative to the trace, so that squares of squares stay in the range of numbers.
    let trace = covariance.x_axis.x + covariance.y_axis.y + covariance.z_axis.z;
    if !(trace > f64::MIN_POSITIVE && trace.is_finite()) {
        return None;
    }
    let (variances, axes) = eigenvectors(&(covariance * (1.0 / trace)));
    Some((variances.max(DVec3::ZERO), axes))
}

/// The disc that faces along a normal of any length; `None` if that has no direction.
pub(super) fn disc(normal: DVec3) -> Option<StoredShape> {
    // Divided first, because squares of numbers that are small or large enough are 0 or infinite.
    let largest = normal.abs().max_element();
    let normal = (normal / largest).normalize();
    if !(largest > 0.0 && normal.is_finite()) {
        return None;
    }
    // Either end of it says the same, and is to be stored the same: the last of its components that
    // is not zero is positive. Half way between z and itself is the axis about which half a turn
    // takes one to the other.
    let last = normal.to_array().into_iter().rev().find(|v| *v != 0.0);
    let up = if last.is_some_and(|v| v < 0.0) { -normal } else { normal };
    let half = (up + DVec3::Z).normalize();
    let rotation = DQuat::from_xyzw(half.x, half.y, half.z, 0.0);
    Some(StoredShape::encode(&Shape { rotation, ratios: [1.0, DISC_THICKNESS] }))
}

/// What the neighbours of a place say of its points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct OfPlace {
    /// The radius that a ball would have; 0 where they suggest none.
    pub(super) radius: f64,
    pub(super) suggested: Suggested,
}

impl OfPlace {
    /// A ball.
    pub(super) fn ball(radius: f64) -> Self {
        Self { radius, suggested: Suggested::NOTHING }
    }
}

/// The radius of a point of a suggested shape, of one that would have the radius 1 as a ball.
pub(super) fn radius_of(shape: StoredShape) -> f64 {
    if shape == StoredShape::BALL {
        return 1.0;
    }
    let [_, shortest] = shape.decode().ratios;
    let scattered = (shortest - DISC_THICKNESS) / (SCATTERED_THICKNESS - DISC_THICKNESS);
    DISC_RADIUS + (SCATTERED_RADIUS - DISC_RADIUS) * scattered.clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points about the origin on a lattice of these spacings, the sixteen nearest and itself.
    fn lattice(spacings: [f64; 3], rotation: DQuat) -> Vec<[f32; 3]> {
        let mut all: Vec<DVec3> = (0..21 * 21 * 21)
            .map(|i| DVec3::new(f64::from(i % 21), f64::from(i / 21 % 21), f64::from(i / 441)) - 10.0)
            .map(|p| p * DVec3::from_array(spacings))
            .collect();
        all.sort_by(|a, b| a.length_squared().total_cmp(&b.length_squared()));
        all[..17].iter().map(|&p| (rotation * p).as_vec3().to_array()).collect()
    }

    #[test]
    fn surfaces_become_discs_in_their_plane_wires_rods_and_scattered_points_small_balls() {
        let rotation = DQuat::from_xyzw(0.3, -0.2, 0.5, 0.8).normalize();
        let of = |spacings| {
            let suggested = Suggested::by_neighbours(&lattice(spacings, rotation));
            (suggested, suggested.shape.decode())
        };
        let (disc, shape) = of([1.0, 1.1, 100.0]);
        let normal = shape.rotation * DVec3::Z;
        assert!(normal.dot(rotation * DVec3::Z).abs() > 0.999_99 && disc.is_flat);
        assert!(shape.ratios[0] == 1.0 && (shape.ratios[1] / DISC_THICKNESS - 1.0).abs() < 1e-3);
        assert!((radius_of(disc.shape) / DISC_RADIUS - 1.0).abs() < 1e-3);
        let (rod, shape) = of([1.0, 100.0, 90.0]);
        assert!((shape.rotation * DVec3::X).dot(rotation * DVec3::X).abs() > 0.999_99 && rod.is_flat);
        assert!(shape.ratios.iter().all(|ratio| (ratio / ROD_WIDTH - 1.0).abs() < 1e-3));
        let (ball, shape) = of([1.0, 1.1, 1.05]);
        assert!(!ball.is_flat && shape.ratios[0] == 1.0 && shape.ratios[1] > 0.5);
        assert!(radius_of(ball.shape) < 0.95);
        assert_eq!(radius_of(StoredShape::BALL), 1.0);
    }

    #[test]
    fn discs_face_along_normals_of_any_length() {
        for normal in [
            [0.0, 0.0, 1.0],
            [0.0, 0.0, -1e-300],
            [3e200, 0.0, 0.0],
            [0.2, -0.7, 0.0],
            [0.6, -0.5, -0.3],
            [0.1, 0.2, -9.0],
        ] {
            let normal = DVec3::from_array(normal);
            let Shape { rotation, ratios } = disc(normal).unwrap().decode();
            let direction = (normal / normal.abs().max_element()).normalize();
            assert!((rotation * DVec3::Z).dot(direction).abs() > 1.0 - 1e-7, "{normal}");
            assert!(ratios[0] == 1.0 && (ratios[1] / DISC_THICKNESS - 1.0).abs() < 1e-3);
            assert_eq!(disc(normal), disc(-normal), "{normal}");
        }
        for normal in [[0.0; 3], [f64::NAN, 0.0, 1.0], [f64::INFINITY, 0.0, 0.0]] {
            assert_eq!(disc(DVec3::from_array(normal)), None);
        }
    }

    #[test]
    fn points_in_one_place_or_far_out_of_range_suggest_nothing() {
        assert_eq!(Suggested::by_neighbours(&[[0.0; 3]; 17]), Suggested::NOTHING);
        assert_eq!(Suggested::by_neighbours(&[[f32::INFINITY; 3]; 17]), Suggested::NOTHING);
    }
}
