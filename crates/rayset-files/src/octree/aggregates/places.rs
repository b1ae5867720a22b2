//! Places at which densities are measured: in each point four, which are distributed as its kernel.

use super::points::Points;
use rayset_base::geometry::{DQuat, DVec3, Shape};
use rayset_base::kernel::Kernel;

/// Places in a point.
pub(super) const PLACES: usize = 4;

/// Steps of the integral by which their distances are found.
const STEPS: usize = 4096;

/// The corners of a tetrahedron.
const DIRECTIONS: [DVec3; PLACES] = [
    DVec3::new(1.0, 1.0, 1.0),
    DVec3::new(1.0, -1.0, -1.0),
    DVec3::new(-1.0, 1.0, -1.0),
    DVec3::new(-1.0, -1.0, 1.0),
];

/// The places in a point of radius one at the origin.
#[derive(Clone, Copy, Debug)]
pub(super) struct UnitPlaces([DVec3; PLACES]);

impl UnitPlaces {
    /// One in each quarter of a kernel's mass, by its distance from the centre.
    pub(super) fn new(kernel: Kernel) -> Self {
        let mass = |step: usize| {
            let x = (step as f64 + 0.5) / STEPS as f64;
            x * x * kernel.value(x * x)
        };
        let total: f64 = (0..STEPS).map(mass).sum();
        let distance = |quarter: usize| {
            let wanted = total * (quarter as f64 + 0.5) / PLACES as f64;
            let mut sum = 0.0;
            let steps = (0..STEPS).take_while(|&step| {
                sum += mass(step);
                sum < wanted
            });
            (steps.count() as f64 + 0.5) / STEPS as f64
        };
        Self(std::array::from_fn(|quarter| DIRECTIONS[quarter] / 3_f64.sqrt() * distance(quarter)))
    }

    /// Appends the places of a point, turned by a rotation that follows from its position.
    pub(super) fn append(&self, points: &Points, index: usize, places: &mut Vec<DVec3>) {
        let (center, radius) = (points.position[index], points.radius[index]);
        let turn = rotation_of(center);
        let axes = points.shape.get(index).map(Shape::semi_axes);
        places.extend(self.0.map(|place| {
            let turned = turn * place * radius;
            center + axes.map_or(turned, |axes| axes * turned)
        }));
    }
}

/// A rotation, different for different positions.
fn rotation_of(position: DVec3) -> DQuat {
    let mixed = position.to_array().iter().fold(0, |hash: u64, v| mix(hash ^ v.to_bits()));
    let component = |at: u32| f64::from((mixed >> (16 * at)) as u16) - 32_767.5;
    DQuat::from_array(std::array::from_fn(|at| component(at as u32))).normalize()
}

/// The finaliser of SplitMix64 (Steele, Lea, Flood 2014).
fn mix(v: u64) -> u64 {
    let v = v.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let v = (v ^ v >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let v = (v ^ v >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    v ^ v >> 31
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_spread_as_the_kernel_spreads_a_point() {
        for &kernel in Kernel::OF_DENSITIES {
            let UnitPlaces(places) = UnitPlaces::new(kernel);
            let variance =
                places.iter().map(|place| place.length_squared()).sum::<f64>() / PLACES as f64 / 3.0;
            assert!((variance / kernel.variance() - 1.0).abs() < 0.08, "{kernel}: {variance}");
            let mean = places.iter().sum::<DVec3>() / PLACES as f64;
            assert!(mean.length() < 0.2, "{kernel}: {mean}");
        }
    }

    #[test]
    fn points_at_different_places_are_measured_in_different_directions() {
        let (a, b) = (rotation_of(DVec3::new(1.0, 2.0, 3.0)), rotation_of(DVec3::new(1.0, 2.0, 3.000_001)));
        assert!(a.dot(b).abs() < 0.99 && (a.length() - 1.0).abs() < 1e-12);
        assert_eq!(a, rotation_of(DVec3::new(1.0, 2.0, 3.0)));
        assert!(rotation_of(DVec3::ZERO).is_finite());
    }
}
