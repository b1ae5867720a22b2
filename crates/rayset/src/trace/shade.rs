//! Shading of samples: Blinn's local model, two-sided, light by light.

use super::bounce::RefractionStates;
use super::composite::{RayState, Shares};
use super::math::power;
use super::node_samples::{Constants, MATERIAL, NodeSamples, each_lane};
use crate::field::{LANES, Packet, SampleRow, Slab};
use crate::geometry::DVec3;
use crate::scene::{Light, LightKind, Lighting};

/// The lights of a scene, and the outputs that all samples share.
pub(super) struct Shader {
    /// `None` if the scene is unlit: samples then show the colours of their transfer functions.
    lights: Option<Vec<Light>>,
    constants: Constants,
}

/// For each light, the fraction of it that reaches each sample; `None` for a light that casts no shadows.
pub(super) type ShadowRows = Vec<Option<Vec<SampleRow>>>;

/// One sample, as a surface to be lit.
struct Surface {
    color: [f32; 3],
    normal: [f32; 3],
    material: [f32; MATERIAL],
    /// Toward the eye.
    view: [f32; 3],
}

impl Shader {
    pub(super) fn new(lighting: &Lighting, constants: Constants) -> Self {
        let lights = match lighting {
            Lighting::Unlit => None,
            Lighting::Lit(lights) => Some(lights.clone()),
        };
        Self { lights, constants }
    }

    /// The colour of all samples, if they share one and are unlit: a ray's colour then follows from its transmittance.
    pub(super) fn flat_color(&self) -> Option<[f32; 3]> {
        self.constants.color.filter(|_| self.lights.is_none())
    }

    /// Adds the light of the contributing samples to their rays.
    #[expect(clippy::too_many_arguments, reason = "one slab of one packet, its light, and where it goes")]
    pub(super) fn shade(
        &self,
        packet: &Packet,
        slab: Slab,
        node: &NodeSamples,
        shares: &Shares,
        shadows: &ShadowRows,
        mut refraction: Option<&mut RefractionStates>,
        states: &mut [RayState; LANES],
    ) {
        each_lane(shares.lanes(), |lane| {
            let mut samples = shares.samples[lane];
            while samples != 0 {
                let j = samples.trailing_zeros() as usize;
                samples &= samples - 1;
                let color = match &self.lights {
                    None => self.constants.color_at(node, lane, j),
                    Some(lights) => {
                        let surface = self.surface(packet, node, lane, j);
                        lit(lights, &surface, shadows, packet, slab, lane, j)
                    }
                };
                let share = shares.share[lane].0[j];
                let mut given = color.map(|v| share * v);
                if let Some(refraction) = &mut refraction {
                    let mirrored = refraction.reflectance(lane, &self.constants.material_at(node, lane, j));
                    if mirrored > 0.0 {
                        let before = refraction.reflect(packet, slab, node, lane, j, share * mirrored, color);
                        given = [0, 1, 2].map(|c| before[c] + (1.0 - mirrored) * given[c]);
                    }
                }
                for channel in 0..3 {
                    states[lane].color[channel] += given[channel];
                }
            }
        });
    }

    /// The outputs that all shaded samples share.
    pub(super) fn constants(&self) -> &Constants {
        &self.constants
    }

    fn surface(&self, packet: &Packet, node: &NodeSamples, lane: usize, j: usize) -> Surface {
        let normal = if node.normal[0].is_empty() {
            [0.0; 3]
        } else {
            node.normal.each_ref().map(|rows| rows[lane].0[j])
        };
        Surface {
            color: self.constants.color_at(node, lane, j),
            normal,
            material: self.constants.material_at(node, lane, j),
            view: packet.direction_f32(lane).map(|v| -v),
        }
    }
}

/// All lights on one sample.
fn lit(
    lights: &[Light],
    surface: &Surface,
    shadows: &ShadowRows,
    packet: &Packet,
    slab: Slab,
    lane: usize,
    j: usize,
) -> [f32; 3] {
    let mut sum = [0.0; 3];
    for (number, light) in lights.iter().enumerate() {
        let reaching = shadows.get(number).and_then(Option::as_ref).map_or(1.0, |rows| rows[lane].0[j]);
        if reaching <= 0.0 {
            continue;
        }
        let (scattered, highlight) = match light.kind {
            LightKind::Ambient => (surface.material[0], 0.0),
            LightKind::Headlight => surface.scatter(surface.view),
            LightKind::Directional { direction } => {
                surface.scatter((-direction.normalize()).to_array().map(|v| v as f32))
            }
            LightKind::Point { position, decays } => {
                let ray = packet.ray(lane);
                let toward = position - ray.at(packet.sample_t_world(lane, slab.first + j as u64));
                let (direction, weakened) = to_point(toward, decays);
                let (scattered, highlight) = surface.scatter(direction);
                (scattered * weakened, highlight * weakened)
            }
        };
        for channel in 0..3 {
            sum[channel] +=
                (surface.color[channel] * scattered + highlight) * (light.color[channel] * reaching);
        }
    }
    sum
}

/// The direction to a point light, and the factor by which its light has decayed.
fn to_point(toward: DVec3, decays: bool) -> ([f32; 3], f32) {
    let distance_squared = toward.length_squared();
    let direction = toward.normalize_or(DVec3::Y).to_array().map(|v| v as f32);
    // Clamped to a finite `f32`: at the light itself the factor would be infinite.
    let weakened = if decays { (1.0 / distance_squared).min(1e12) as f32 } else { 1.0 };
    (direction, weakened)
}

impl Surface {
    /// The fraction of light from a direction that is scattered in the object's colour, and the fraction scattered in
    /// white.
    fn scatter(&self, light: [f32; 3]) -> (f32, f32) {
        let dot = |a: [f32; 3], b: [f32; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        if self.normal == [0.0; 3] {
            return (0.0, 0.0);
        }
        let cosine = dot(self.normal, light).abs().min(1.0);
        let half: [f32; 3] = std::array::from_fn(|c| light[c] + self.view[c]);
        let length = dot(half, half).sqrt();
        // Light from straight behind has no highlight.
        let highlight = if length > 1e-6 { dot(self.normal, half).abs() / length } else { 0.0 };
        (self.material[1] * cosine, self.material[2] * power(highlight.min(1.0), self.material[3]))
    }
}
