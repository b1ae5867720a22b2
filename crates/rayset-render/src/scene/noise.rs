//! Clouds of fractal noise.

use super::{Pattern, Procedural, ProceduralSample};
use rayset_base::geometry::{Aabb, DVec3};

/// An ellipsoid filled with fractal noise: octaves of Perlin's gradient noise (2002 form, quintic
/// fade), each with twice the frequency and `roughness` times the strength of the one before. The
/// opacity is above 0 where the sum exceeds a threshold, which rises toward the boundary of the
/// ellipsoid.
#[derive(Clone, Debug, PartialEq)]
pub struct NoiseCloud {
    /// Semi-axes of the ellipsoid, which is centred at the origin.
    pub radii: DVec3,
    /// Size of the coarsest features.
    pub scale: f64,
    /// Number of octaves, 1 to 8.
    pub octaves: u32,
    /// Strength of an octave relative to the one before, 0 to 1.
    pub roughness: f64,
    /// Greatest opacity, 0 to 1.
    pub opacity: f64,
    /// How much of the ellipsoid the noise fills, 0 to 1.
    pub cover: f64,
    /// Seed of the noise.
    pub seed: u32,
    /// The colour.
    pub pattern: Pattern,
}

impl NoiseCloud {
    /// The fractal noise and its gradient, without the ellipsoid's threshold; about −1 to 1.
    fn fractal(&self, p: DVec3) -> (f64, DVec3) {
        let (mut sum, mut gradient) = (0.0, DVec3::ZERO);
        let (mut frequency, mut strength, mut total) = (1.0 / self.scale, 1.0, 0.0);
        for octave in 0..self.octaves {
            let (value, slope) =
                perlin(p * frequency, self.seed.wrapping_add(octave.wrapping_mul(0x9e37_79b9)));
            sum += strength * value;
            gradient += slope * (strength * frequency);
            total += strength;
            frequency *= 2.0;
            strength *= self.roughness;
        }
        (sum / total, gradient / total)
    }
}

impl Procedural for NoiseCloud {
    fn bounds(&self) -> Aabb {
        Aabb::new(-self.radii, self.radii)
    }

    fn detail(&self) -> f64 {
        // Half the size of the finest features.
        0.5 * self.scale / f64::from(1_u32 << (self.octaves - 1).min(7))
    }

    fn uniform_color(&self) -> Option<[f64; 3]> {
        self.pattern.uniform()
    }

    fn attributes(&self) -> &[&str] {
        self.pattern.attributes()
    }

    fn attribute(&self, _index: usize, p: DVec3) -> f32 {
        self.pattern.value(p) as f32
    }

    fn sample(&self, p: DVec3) -> ProceduralSample {
        /// The noise rarely leaves the range ± this.
        const RANGE: f64 = 0.6;
        let q = p / self.radii;
        let outward = q.length_squared();
        if outward >= 1.0 {
            return ProceduralSample {
                implicit: outward,
                gradient: q / self.radii * 2.0,
                ..Default::default()
            };
        }
        let (noise, slope) = self.fractal(p);
        // With a cover of 1 practically all noise exceeds the threshold at the centre; at the
        // boundary of the ellipsoid almost none does.
        let threshold = RANGE * (1.0 - 2.0 * self.cover * (1.0 - outward * outward));
        let threshold_slope = q / self.radii * (RANGE * 8.0 * self.cover * outward);
        let implicit = threshold - noise;
        let opacity = self.opacity * (-implicit / RANGE).clamp(0.0, 1.0);
        let color = if opacity > 0.0 { self.pattern.color(p) } else { [0.0; 3] };
        ProceduralSample { opacity, implicit, gradient: threshold_slope - slope, color }
    }
}

/// Gradient noise at a position, and its gradient.
fn perlin(p: DVec3, seed: u32) -> (f64, DVec3) {
    let cell = p.floor();
    let f = p - cell;
    let fade = |t: f64| t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
    let fade_slope = |t: f64| 30.0 * t * t * (t * (t - 2.0) + 1.0);
    let (u, du) = (f.map(fade), f.map(fade_slope));
    let (mut value, mut slope) = (0.0, DVec3::ZERO);
    for corner in 0..8 {
        let c = DVec3::new(f64::from(corner & 1), f64::from(corner >> 1 & 1), f64::from(corner >> 2 & 1));
        let gradient = corner_gradient(cell + c, seed);
        let ramp = gradient.dot(f - c);
        // Weights of the corner along each axis, and their slopes.
        let w = c * u + (DVec3::ONE - c) * (DVec3::ONE - u);
        let dw = (2.0 * c - DVec3::ONE) * du;
        let weight = w.x * w.y * w.z;
        value += weight * ramp;
        slope += gradient * weight + DVec3::new(dw.x * w.y * w.z, w.x * dw.y * w.z, w.x * w.y * dw.z) * ramp;
    }
    (value, slope)
}

/// One of the twelve directions from the centre of a cube to the middles of its edges, by a hash of
/// the lattice point.
fn corner_gradient(lattice: DVec3, seed: u32) -> DVec3 {
    const A: f64 = 1.0;
    const DIRECTIONS: [[f64; 3]; 12] = [
        [A, A, 0.0],
        [-A, A, 0.0],
        [A, -A, 0.0],
        [-A, -A, 0.0],
        [A, 0.0, A],
        [-A, 0.0, A],
        [A, 0.0, -A],
        [-A, 0.0, -A],
        [0.0, A, A],
        [0.0, -A, A],
        [0.0, A, -A],
        [0.0, -A, -A],
    ];
    let mut h = seed;
    for v in lattice.to_array() {
        h = (h ^ v as i64 as u32).wrapping_mul(0x85eb_ca6b);
        h ^= h >> 13;
        h = h.wrapping_mul(0xc2b2_ae35);
        h ^= h >> 16;
    }
    DVec3::from_array(DIRECTIONS[(h % 12) as usize])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_gradient_of_a_noise_cloud_is_that_of_its_implicit_function(
            seed in any::<u32>(),
            p in prop::array::uniform3(-0.55_f64..0.55),
        ) {
            let cloud = NoiseCloud {
                radii: DVec3::new(1.0, 1.2, 1.4),
                scale: 0.5,
                octaves: 3,
                roughness: 0.5,
                opacity: 0.8,
                cover: 0.6,
                seed,
                pattern: Pattern::Uniform([1.0; 3]),
            };
            let p = DVec3::from_array(p);
            let h = 1e-5;
            let slope = |axis: DVec3| {
                (cloud.sample(p + axis * h).implicit - cloud.sample(p - axis * h).implicit) / (2.0 * h)
            };
            let numeric = DVec3::new(slope(DVec3::X), slope(DVec3::Y), slope(DVec3::Z));
            prop_assert!((cloud.sample(p).gradient - numeric).length() < 1e-3 * (1.0 + numeric.length()));
        }
    }
}
