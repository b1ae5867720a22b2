//! Blinn's local model, two-sided, for many samples at a time.

use super::node_samples::{Constants, NodeSamples, numbers};
use crate::field::{BLOCK_SAMPLES, Packet, SampleRow, Slab};
use crate::math::power;
use crate::scene::{Light, LightKind};
use rayset_base::geometry::DVec3;

/// Samples that are lit together.
pub(super) const BATCH: usize = BATCH_GROUPS * BLOCK_SAMPLES;
const BATCH_GROUPS: usize = 4;

/// One number for each of them.
pub(super) type Row = [f32; BATCH];

/// The numbers of one group.
#[inline(always)]
pub(super) fn eight(row: &mut Row, group: usize) -> &mut [f32; BLOCK_SAMPLES] {
    &mut row.as_chunks_mut().0[group]
}

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
                for (number, &Group { lane, block, samples }) in surfaces.groups().iter().enumerate() {
                    for in_group in numbers(samples.into()) {
                        let sample = slab.first + (block * BLOCK_SAMPLES + in_group) as u64;
                        let place = packet.ray(lane).at(packet.sample_t_world(lane, sample));
                        let (direction, weakened) = to_point(position - place, decays);
                        let i = number * BLOCK_SAMPLES + in_group;
                        for (row, v) in each.0.iter_mut().zip(direction) {
                            row[i] = v;
                        }
                        each.1[i] = weakened;
                    }
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

/// Samples as surfaces to be lit, in groups of eight samples that follow each other on a ray. Not
/// all of a group need count; what becomes of the others is of no importance.
pub(super) struct Surfaces {
    len: usize,
    groups: [Group; BATCH_GROUPS],
    color: [Row; 3],
    normal: [Row; 3],
    /// Ambient, diffuse, specular, shininess.
    material: [Row; 4],
    /// Toward the eye.
    view: [Row; 3],
}

/// Eight samples of a ray.
#[derive(Clone, Copy, Default)]
pub(super) struct Group {
    pub(super) lane: usize,
    /// Their place among the groups of the lane.
    pub(super) block: usize,
    /// A bit for each that counts.
    pub(super) samples: u8,
}

impl Group {
    /// Its numbers among those of some rows.
    #[inline(always)]
    pub(super) fn of<'r>(&self, rows: &'r [SampleRow]) -> &'r [f32; BLOCK_SAMPLES] {
        &rows[self.lane].0.as_chunks().0[self.block]
    }
}

impl Surfaces {
    pub(super) fn new() -> Self {
        let zero = [0.0; BATCH];
        Self {
            len: 0,
            groups: [Group::default(); BATCH_GROUPS],
            color: [zero; 3],
            normal: [zero; 3],
            material: [zero; 4],
            view: [zero; 3],
        }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.len == 0
    }

    pub(super) fn is_full(&self) -> bool {
        self.len == BATCH_GROUPS
    }

    pub(super) fn clear(&mut self) {
        self.len = 0;
    }

    /// The groups that it holds, in the order in which they were added.
    pub(super) fn groups(&self) -> &[Group] {
        &self.groups[..self.len]
    }

    /// Adds samples of the root; there must be room.
    #[inline(always)]
    pub(super) fn push(&mut self, packet: &Packet, root: &NodeSamples, constants: &Constants, group: Group) {
        let at = self.len;
        self.groups[at] = group;
        let view = packet.direction_f32(group.lane);
        for axis in 0..3 {
            *eight(&mut self.color[axis], at) = match constants.color {
                Some(color) => [color[axis]; BLOCK_SAMPLES],
                None => *group.of(&root.color[axis]),
            };
            *eight(&mut self.view[axis], at) = [-view[axis]; BLOCK_SAMPLES];
            let normal = &root.normal[axis];
            *eight(&mut self.normal[axis], at) =
                if normal.is_empty() { [0.0; BLOCK_SAMPLES] } else { *group.of(normal) };
        }
        for k in 0..4 {
            *eight(&mut self.material[k], at) = match constants.material {
                Some(material) => [material[k]; BLOCK_SAMPLES],
                None => *group.of(&root.material[k]),
            };
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

    /// The fraction of light from a direction that each sample scatters in its own colour, and the
    /// fraction that it scatters in white.
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
