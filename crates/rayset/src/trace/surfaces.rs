//! Blinn's local model, two-sided, for many samples at a time.

use super::math::power;
use super::node_samples::{Constants, NodeSamples};
use crate::field::{LANES, Packet, SLAB_SAMPLES, Slab};
use crate::geometry::DVec3;
use crate::scene::{Light, LightKind};

/// Samples that are lit together.
pub(super) const BATCH: usize = 32;

/// One number for each of them.
pub(super) type Row = [f32; BATCH];

/// A light, prepared for samples.
pub(super) struct LightSource {
    kind: SourceKind,
    pub(super) color: [f32; 3],
}

enum SourceKind {
    Ambient,
    Headlight,
    /// From a direction of length one.
    Directional([f32; 3]),
    Point {
        position: DVec3,
        decays: bool,
    },
}

/// How the light of a source arrives at samples.
pub(super) enum Arrival {
    FromEverywhere,
    FromTheEye,
    From([f32; 3]),
    /// From a direction for each sample, weakened by a factor.
    Each(Box<([Row; 3], Row)>),
}

impl LightSource {
    pub(super) fn new(light: &Light) -> Self {
        let kind = match light.kind {
            LightKind::Ambient => SourceKind::Ambient,
            LightKind::Headlight => SourceKind::Headlight,
            LightKind::Directional { direction } => {
                SourceKind::Directional((-direction.normalize()).to_array().map(|v| v as f32))
            }
            LightKind::Point { position, decays } => SourceKind::Point { position, decays },
        };
        Self { kind, color: light.color }
    }

    /// How it arrives at some samples of a slab.
    pub(super) fn arrives(&self, packet: &Packet, slab: Slab, surfaces: &Surfaces) -> Arrival {
        match self.kind {
            SourceKind::Ambient => Arrival::FromEverywhere,
            SourceKind::Headlight => Arrival::FromTheEye,
            SourceKind::Directional(direction) => Arrival::From(direction),
            SourceKind::Point { position, decays } => {
                let mut each = Box::new(([[0.0; BATCH]; 3], [0.0; BATCH]));
                for (i, (lane, j)) in surfaces.samples().enumerate() {
                    let place = packet.ray(lane).at(packet.sample_t_world(lane, slab.first + j as u64));
                    let (direction, weakened) = to_point(position - place, decays);
                    for (row, v) in each.0.iter_mut().zip(direction) {
                        row[i] = v;
                    }
                    each.1[i] = weakened;
                }
                Arrival::Each(each)
            }
        }
    }
}

/// The direction to a point light, and the factor by which its light has decayed.
fn to_point(toward: DVec3, decays: bool) -> ([f32; 3], f32) {
    let distance_squared = toward.length_squared();
    let direction = toward.normalize_or(DVec3::Y).to_array().map(|v| v as f32);
    // Clamped to a finite `f32`: at the light itself the factor would be infinite.
    let weakened = if decays { (1.0 / distance_squared).min(1e12) as f32 } else { 1.0 };
    (direction, weakened)
}

/// Samples as surfaces to be lit.
pub(super) struct Surfaces {
    len: usize,
    /// Lane and sample.
    at: [(u8, u8); BATCH],
    color: [Row; 3],
    normal: [Row; 3],
    /// Ambient, diffuse, specular, shininess.
    material: [Row; 4],
    /// Toward the eye.
    view: [Row; 3],
}

impl Surfaces {
    pub(super) fn new() -> Self {
        let zero = [0.0; BATCH];
        Self {
            len: 0,
            at: [(0, 0); BATCH],
            color: [zero; 3],
            normal: [zero; 3],
            material: [zero; 4],
            view: [zero; 3],
        }
    }

    pub(super) fn len(&self) -> usize {
        self.len
    }

    pub(super) fn clear(&mut self) {
        self.len = 0;
    }

    /// The lanes and samples that it holds, in the order in which they were added.
    pub(super) fn samples(&self) -> impl Iterator<Item = (usize, usize)> + use<> {
        let at = self.at;
        (0..self.len).map(move |i| (usize::from(at[i].0) % LANES, usize::from(at[i].1) % SLAB_SAMPLES))
    }

    /// Adds a sample of the root; there must be room.
    #[inline(always)]
    pub(super) fn push(
        &mut self,
        packet: &Packet,
        root: &NodeSamples,
        constants: &Constants,
        lane: usize,
        j: usize,
    ) {
        let i = self.len;
        self.at[i] = (lane as u8, j as u8);
        let color = constants.color_at(root, lane, j);
        let view = packet.direction_f32(lane);
        for axis in 0..3 {
            self.color[axis][i] = color[axis];
            self.view[axis][i] = -view[axis];
            self.normal[axis][i] = root.normal[axis].get(lane).map_or(0.0, |row| row.0[j]);
        }
        match constants.material {
            Some(material) => (0..4).for_each(|k| self.material[k][i] = material[k]),
            None => (0..4).for_each(|k| self.material[k][i] = root.material[k][lane].0[j]),
        }
        self.len += 1;
    }

    /// Adds what the samples scatter of a light to `lit`.
    #[inline(always)]
    pub(super) fn light(&self, color: [f32; 3], from: &Arrival, reaching: &Row, lit: &mut [Row; 3]) {
        let (mut scattered, mut highlight) = ([0.0; BATCH], [0.0; BATCH]);
        match from {
            Arrival::FromEverywhere => scattered = self.material[0],
            Arrival::FromTheEye => self.scatter(&self.view, &mut scattered, &mut highlight),
            Arrival::From(direction) => {
                let toward = [[direction[0]; BATCH], [direction[1]; BATCH], [direction[2]; BATCH]];
                self.scatter(&toward, &mut scattered, &mut highlight);
            }
            Arrival::Each(each) => {
                self.scatter(&each.0, &mut scattered, &mut highlight);
                for i in 0..BATCH {
                    scattered[i] *= each.1[i];
                    highlight[i] *= each.1[i];
                }
            }
        }
        for channel in 0..3 {
            for i in 0..BATCH {
                let given = self.color[channel][i] * scattered[i] + highlight[i];
                lit[channel][i] += given * (color[channel] * reaching[i]);
            }
        }
    }

    /// The fraction of light from a direction that each sample scatters in its own colour, and the fraction that it
    /// scatters in white.
    #[inline(always)]
    fn scatter(&self, toward: &[Row; 3], scattered: &mut Row, highlight: &mut Row) {
        let ([x, y, z], [vx, vy, vz], [lx, ly, lz]) = (&self.normal, &self.view, toward);
        let mut shines = false;
        for i in 0..BATCH {
            let faces = x[i] != 0.0 || y[i] != 0.0 || z[i] != 0.0;
            let cosine = (x[i] * lx[i] + y[i] * ly[i] + z[i] * lz[i]).abs().min(1.0);
            scattered[i] = if faces { self.material[1][i] * cosine } else { 0.0 };
            shines |= faces && self.material[2][i] != 0.0;
        }
        if !shines {
            return;
        }
        for i in 0..BATCH {
            let faces = x[i] != 0.0 || y[i] != 0.0 || z[i] != 0.0;
            let (hx, hy, hz) = (lx[i] + vx[i], ly[i] + vy[i], lz[i] + vz[i]);
            let length = (hx * hx + hy * hy + hz * hz).sqrt();
            // Light from straight behind has no highlight.
            let cosine = if length > 1e-6 { (x[i] * hx + y[i] * hy + z[i] * hz).abs() / length } else { 0.0 };
            let shine = self.material[2][i] * power(cosine.min(1.0), self.material[3][i]);
            highlight[i] = if faces { shine } else { 0.0 };
        }
    }
}
