//! Shading of samples: groups of eight with a contributing sample are gathered and lit many at a
//! time (`surfaces`); those that contribute are added to their rays front to back.

use super::bounce::RefractionStates;
use super::composite::{RayState, Shares};
use super::display_values::all_from_linear;
use super::node_samples::{Constants, NodeSamples, each_lane, numbers};
use super::surfaces::{BATCH, Group, LightSource, Row, Surfaces, eight};
use crate::field::{BLOCK_SAMPLES, LANES, Packet, SLAB_SAMPLES, SampleRow, SimdLevel, Slab, dispatch};
use crate::scene::{Compositing, Lighting, Scene};

/// The lights of a scene, and the outputs that all samples share.
pub(super) struct Shader {
    /// `None` if the scene is unlit: samples then show the colours of their transfer functions.
    lights: Option<Vec<LightSource>>,
    constants: Constants,
    /// Their colour as it is added up, if that is all the light there is.
    flat_color: Option<[f32; 3]>,
    compositing: Compositing,
    simd: SimdLevel,
}

/// For each light, the fraction of it that reaches each sample; `None` for a light that casts no
/// shadows.
pub(super) type ShadowRows = Vec<Option<Vec<SampleRow>>>;

/// What a slab shows, to be shaded.
#[derive(Clone, Copy)]
pub(super) struct SlabToShade<'a> {
    pub(super) packet: &'a Packet,
    pub(super) slab: Slab,
    pub(super) node: &'a NodeSamples,
    pub(super) shares: &'a Shares,
    pub(super) shadows: &'a ShadowRows,
}

impl Shader {
    pub(super) fn new(scene: &Scene, constants: Constants, simd: SimdLevel) -> Self {
        let lights = match &scene.lighting {
            Lighting::Unlit => None,
            Lighting::Lit(lights) => Some(lights.iter().map(LightSource::new).collect()),
        };
        let compositing = scene.compositing;
        let flat_color = constants.color.filter(|_| lights.is_none()).map(|mut color| {
            if compositing == Compositing::Display {
                all_from_linear(&mut color);
            }
            color
        });
        Self { lights, constants, flat_color, compositing, simd }
    }

    /// The colour of all samples, if they share one and are unlit: a ray's colour then follows from
    /// its transmittance.
    pub(super) fn flat_color(&self) -> Option<[f32; 3]> {
        self.flat_color
    }

    /// Adds the light of the contributing samples to their rays.
    pub(super) fn shade(
        &self,
        shown: SlabToShade<'_>,
        mut refraction: Option<&mut RefractionStates>,
        states: &mut [RayState; LANES],
    ) {
        let Some(lights) = &self.lights else {
            return self.shade_unlit(shown, states);
        };
        let mut surfaces = Surfaces::new();
        each_lane(shown.shares.lanes(), |lane| {
            for (block, samples) in shown.shares.samples[lane].to_le_bytes().into_iter().enumerate() {
                if samples == 0 {
                    continue;
                }
                surfaces.push(shown.packet, shown.node, &self.constants, Group { lane, block, samples });
                if surfaces.is_full() {
                    self.add(lights, &surfaces, shown, refraction.as_deref_mut(), states);
                    surfaces.clear();
                }
            }
        });
        if !surfaces.is_empty() {
            self.add(lights, &surfaces, shown, refraction, states);
        }
    }

    fn shade_unlit(&self, SlabToShade { node, shares, .. }: SlabToShade<'_>, states: &mut [RayState; LANES]) {
        each_lane(shares.lanes(), |lane| {
            let mut samples = shares.samples[lane];
            let displayed = self.displayed(node, lane);
            while samples != 0 {
                let j = samples.trailing_zeros() as usize;
                samples &= samples - 1;
                let share = shares.share[lane].0[j];
                let color = match &displayed {
                    Some(rows) => rows.each_ref().map(|row| row[j]),
                    None => self.constants.color_at(node, lane, j),
                };
                for channel in 0..3 {
                    states[lane].color[channel] += share * color[channel];
                }
            }
        });
    }

    /// The colours of the samples of a lane as display values, if these are composited.
    fn displayed(&self, node: &NodeSamples, lane: usize) -> Option<[[f32; SLAB_SAMPLES]; 3]> {
        let is_so = self.compositing == Compositing::Display;
        is_so.then(|| {
            node.color.each_ref().map(|rows| {
                let mut row = rows[lane].0;
                dispatch!(self.simd.level(), _simd => all_from_linear(&mut row));
                row
            })
        })
    }

    /// Lights some samples and adds them to their rays.
    fn add(
        &self,
        lights: &[LightSource],
        surfaces: &Surfaces,
        SlabToShade { packet, slab, node, shares, shadows }: SlabToShade<'_>,
        mut refraction: Option<&mut RefractionStates>,
        states: &mut [RayState; LANES],
    ) {
        let mut lit = [[0.0; BATCH]; 3];
        for (number, light) in lights.iter().enumerate() {
            let mut reaching: Row = [1.0; BATCH];
            if let Some(Some(rows)) = shadows.get(number) {
                for (i, group) in surfaces.groups().iter().enumerate() {
                    for (reaching, shadow) in eight(&mut reaching, i).iter_mut().zip(group.of(rows)) {
                        *reaching = shadow.max(0.0);
                    }
                }
            }
            let from = light.arrives(packet, slab, surfaces);
            dispatch!(self.simd.level(), _simd => surfaces.light(light.color, &from, &reaching, &mut lit));
        }
        if self.compositing == Compositing::Display {
            lit.iter_mut().for_each(|row| dispatch!(self.simd.level(), _simd => all_from_linear(row)));
        }
        for (number, group) in surfaces.groups().iter().enumerate() {
            let Group { lane, block, samples } = *group;
            let share = group.of(&shares.share);
            let mut sum = states[lane].color;
            for in_group in numbers(samples.into()) {
                let i = number * BLOCK_SAMPLES + in_group;
                let (color, share) = ([lit[0][i], lit[1][i], lit[2][i]], share[in_group]);
                let mut given = color.map(|v| share * v);
                if let Some(refraction) = &mut refraction {
                    let j = block * BLOCK_SAMPLES + in_group;
                    let mirrored = refraction
                        .reflectance(lane, |value| self.constants.material_at(node, value, lane, j));
                    if mirrored > 0.0 {
                        let before = refraction.reflect(packet, slab, node, lane, j, share * mirrored, color);
                        given = [0, 1, 2].map(|c| before[c] + (1.0 - mirrored) * given[c]);
                    }
                }
                for channel in 0..3 {
                    sum[channel] += given[channel];
                }
            }
            states[lane].color = sum;
        }
    }

    /// The outputs that all shaded samples share.
    pub(super) fn constants(&self) -> &Constants {
        &self.constants
    }
}
