//! The shapes of particles of a fluid, from where their neighbours lie: flat along the surface of
//! the fluid, long in threads and thin in sheets, balls inside.
//!
//! After Yu & Turk, *Reconstructing Surfaces of Particle-Based Fluids Using Anisotropic Kernels*
//! (2013), section 4.2: the covariance of the neighbours about their weighted mean, of weights
//! 1 − (d/h)³, has the variances λ₁ ≥ λ₂ ≥ λ₃, and the semi-axes of a particle follow them, none
//! shorter than a quarter of the longest. There neighbours are those within a distance, and all
//! particles are moved toward their means. Here neighbours are the 32 nearest, the farthest of
//! which is at h, so that nothing is to be chosen. Variances that differ little, as those of few
//! neighbours do by chance, make balls. Particles stay where they are, and each keeps its volume,
//! about.

use super::neighbourhood::{Suggested, covariance};
use crate::octree::shape::StoredShape;
use rayset_base::geometry::{DQuat, DVec3, Shape};

/// No semi-axis is shorter than this part of the longest, which has it at this λₖ/λ₁.
const LEAST_RATIO: f64 = 0.25;

/// From this λₖ/λ₁ on an axis is as long as the longest. Inside a fluid the median of λ₃/λ₁ is 0.52
/// if particles are at random, 0.65 on a lattice from which they are moved by 0.3 spacings, 0.85 by
/// 0.1; on its surface 0.28, 0.36 and 0.39.
const BALL: f64 = 0.65;

/// The most by which a radius grows to keep the volume of its ball.
const MOST_GROWTH: f64 = 1.6;

/// The radius of a particle of a shape, of one that would have the radius 1 as a ball: it has the
/// same volume, so far as it does not grow too long.
pub(super) fn radius_of(shape: StoredShape) -> f64 {
    shape.decode().volume().cbrt().recip().min(MOST_GROWTH)
}

/// The shape that neighbours suggest, itself among them, the nearest first.
pub(super) fn by_neighbours(offsets: &[[f32; 3]]) -> Suggested {
    let offsets = || offsets.iter().map(|offset| DVec3::from_array(offset.map(f64::from)));
    let farthest = offsets().map(DVec3::length).fold(0.0, f64::max);
    let weighted = offsets().map(|offset| (1.0 - (offset.length() / farthest).powi(3), offset));
    let Some((variances, axes)) = covariance(weighted) else { return Suggested::NOTHING };
    let ratio = |variance: f64| {
        let part = (variance / variances.x - LEAST_RATIO) / (BALL - LEAST_RATIO);
        LEAST_RATIO + (1.0 - LEAST_RATIO) * part.clamp(0.0, 1.0)
    };
    let rotation = DQuat::from_mat3(&axes).normalize();
    let shape = Shape { rotation, ratios: [ratio(variances.y), ratio(variances.z)] };
    let stored = if shape.is_ball() { StoredShape::BALL } else { StoredShape::encode(&shape) };
    Suggested { shape: stored, is_flat: true }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The particles of a lattice nearest to the origin, as far as they are in the fluid.
    fn near(is_fluid: impl Fn(DVec3) -> bool) -> Vec<[f32; 3]> {
        // Sheared, so that few are equally near.
        let place = |i: i32| DVec3::new(f64::from(i % 11), f64::from(i / 11 % 11), f64::from(i / 121)) - 5.0;
        let all = (0..11 * 11 * 11).map(place);
        let mut all: Vec<DVec3> =
            all.filter(|&p| is_fluid(p)).map(|p| p + 0.1 * DVec3::new(p.z, p.x, p.y)).collect();
        all.sort_by(|a, b| a.length_squared().total_cmp(&b.length_squared()));
        all[..33].iter().map(|p| p.as_vec3().to_array()).collect()
    }

    #[test]
    fn particles_are_balls_inside_flat_on_the_surface_flatter_in_a_sheet_and_long_in_a_thread() {
        assert_eq!(by_neighbours(&near(|_| true)).shape, StoredShape::BALL);
        let surface = by_neighbours(&near(|p| p.z <= 0.0)).shape.decode();
        assert!(surface.ratios[0] > 0.9 && (0.3..0.6).contains(&surface.ratios[1]), "{surface:?}");
        assert!((surface.rotation * DVec3::Z).z.abs() > 0.95);
        let sheet = by_neighbours(&near(|p| p.z == 0.0)).shape.decode();
        assert!(sheet.ratios[0] > 0.9 && sheet.ratios[1] < 0.26, "{sheet:?}");
        let thread = by_neighbours(&near(|p| p.x.abs() <= 1.0 && p.y == 0.0)).shape.decode();
        assert!(thread.ratios[0] < 0.5 && (thread.rotation * DVec3::X).z.abs() > 0.9, "{thread:?}");
        assert_eq!(by_neighbours(&[[0.0; 3]; 33]), Suggested::NOTHING);
        let half = StoredShape::encode(&Shape { rotation: DQuat::IDENTITY, ratios: [1.0, 0.5] });
        assert!((radius_of(half).powi(3) - 2.0).abs() < 1e-3 && radius_of(StoredShape::BALL) == 1.0);
    }
}
