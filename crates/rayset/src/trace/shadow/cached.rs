//! Shadows from tables of the light's own rays: each tile a pure function of scene, light and tile, made when it is
//! first wanted, evicted like any page and made again to the same bits.
//!
//! Between rays a table can only blend: it knows edges of shadows to a cell. Where the rays around a sample differ so much
//! that its pixel would show it, the sample is left to a ray of its own, a small part of all where shadows are larger than
//! cells. The decision is a function of sample and tile alone, so no execution setting changes it.

use super::map::{TILE_CELLS, Texel};
use super::place::{lit_place, toward};
use super::table::DeepShadowMap;
use super::transmittance::{self, TransmittanceBuilder};
use super::world::ShadowWorld;
use crate::field::{LANES, Packet, SampleRow, Slab};
use crate::geometry::{DVec3, Ray};
use crate::scene::Light;
use crate::trace::access::{Access, Halt};
use crate::trace::composite::{RayState, Shares};
use crate::trace::counts::RenderCounts;
use crate::trace::march::March;
use crate::trace::node_samples::{NodeSamples, STEPS_TO_BOUNDARY, each_lane};
use crate::working_set::PageGuard;

/// Rays of a light along an edge of a tile.
const CORNERS: u32 = TILE_CELLS + 1;

/// Looks shadows up between the rays of a light, and makes the tiles that are missing.
pub(super) struct DeepShadowLookups<'a> {
    maker: TileMaker<'a>,
}

impl<'a> DeepShadowLookups<'a> {
    pub(super) fn new(world: &'a ShadowWorld, slab_samples: usize) -> Self {
        let maker = TileMaker {
            world,
            march: March::new(&world.program, slab_samples),
            states: [RayState::START; LANES],
            shares: Shares::new(),
        };
        Self { maker }
    }

    /// Fills the rows of the samples that count. Returns those, a bit for each, that the table does not decide: the rays
    /// around them differ, for an edge of a shadow passes between.
    #[expect(clippy::too_many_arguments, reason = "one light on one slab of one packet")]
    pub(super) fn find(
        &mut self,
        access: Access<'_>,
        light: &Light,
        table: &DeepShadowMap,
        packet: &Packet,
        slab: Slab,
        node: &NodeSamples,
        shares: &Shares,
        counts: &mut RenderCounts,
        rows: &mut [SampleRow],
    ) -> Result<[u32; LANES], Halt> {
        let mut undecided = [0_u32; LANES];
        // The tile looked at last stays retained: neighbours mostly share it.
        let mut last: Option<(u32, PageGuard)> = None;
        let mut lanes = shares.lanes();
        while lanes != 0 {
            let lane = lanes.trailing_zeros() as usize;
            lanes &= lanes - 1;
            for j in (0..slab.samples).filter(|j| shares.samples[lane] >> j & 1 == 1) {
                let place = lit_place(packet, node, lane, slab.first + j as u64, j);
                let Some(texel) = table.map.texel(place) else {
                    rows[lane].0[j] = 1.0;
                    continue;
                };
                if last.as_ref().is_none_or(|(number, _)| *number != texel.tile) {
                    drop(last.take());
                    let compute =
                        |bytes: &mut [u8]| self.maker.make(access, table, texel.tile, bytes, counts);
                    let guard = access.pages.retain_computed(&table.tiles, texel.tile, compute)?;
                    last = Some((texel.tile, guard));
                }
                let Some((_, guard)) = &last else { continue };
                let lookup = Lookup::new(light, packet, node, (lane, j), place, &texel);
                let corners = lookup.corners(guard, &texel);
                rows[lane].0[j] = between(corners, texel.within);
                let doubt = spread(corners) * lookup.scattered * shares.share[lane].0[j];
                undecided[lane] |= u32::from(doubt > LARGEST_DOUBT) << j;
            }
        }
        Ok(undecided)
    }
}

/// How much the rays around a sample may differ in what they give its pixel, as a part of what the light gives at best.
const LARGEST_DOUBT: f32 = 1.0 / 64.0;
/// A boundary is taken as flat from ray to ray up to this tangent of its angle to the plane across the light.
const STEEPEST: f64 = 8.0;

/// How a sample is looked up.
struct Lookup {
    /// Distance along the ray through the sample.
    distance: f64,
    /// By how much the distance grows from ray to ray, along rows and columns.
    slope: (f64, f64),
    /// What part of the light that arrives is scattered, before colours.
    scattered: f32,
}

impl Lookup {
    /// As an exact shadow ray does, the look-up leaves out what lies within the sample offset. Of a boundary each ray is looked up
    /// where it meets the tangent plane: all are as far before the boundary as the sample, and none sees it as its own
    /// shadow. Half a cell is what a boundary may be nearer than its tangent plane.
    fn new(
        light: &Light,
        packet: &Packet,
        node: &NodeSamples,
        (lane, j): (usize, usize),
        place: DVec3,
        texel: &Texel,
    ) -> Self {
        let distance = texel.distance - packet.sample_offset(lane) * packet.step_world();
        let normal = node.normal_at(lane, j);
        let Some((toward, _)) = toward(light, place).filter(|_| normal != DVec3::ZERO) else {
            // Without a shading vector nothing is scattered.
            return Self { distance, slope: (0.0, 0.0), scattered: 0.0 };
        };
        let cosine = normal.dot(toward);
        let scattered = cosine.abs() as f32;
        if f64::from(node.boundary[lane].0[j]).abs() > STEPS_TO_BOUNDARY * packet.step_world() {
            return Self { distance, slope: (0.0, 0.0), scattered };
        }
        let gradient = (normal / cosine - toward).clamp_length_max(STEEPEST);
        // Light that only grazes the boundary is next to none.
        let gradient = if gradient.is_finite() { gradient } else { DVec3::ZERO };
        let slope = (gradient.dot(texel.next.0), gradient.dot(texel.next.1));
        Self { distance: distance - 0.5 * texel.size(), slope, scattered }
    }

    /// What is left of the light on the rays around: (0, 0), (1, 0), (0, 1), (1, 1).
    fn corners(&self, page: &[u8], texel: &Texel) -> [f32; 4] {
        [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(i, k)| {
            let ray = (texel.cell.1 + k) * CORNERS + texel.cell.0 + i;
            let (right, up) = (f64::from(i) - texel.within.0, f64::from(k) - texel.within.1);
            let distance = self.distance + right * self.slope.0 + up * self.slope.1;
            transmittance::transmittance(page, (CORNERS * CORNERS) as usize, ray as usize, distance as f32)
        })
    }
}

/// Bilinear.
fn between([a, b, c, d]: [f32; 4], (u, v): (f64, f64)) -> f32 {
    let (u, v) = (u as f32, v as f32);
    let (low, high) = (a + (b - a) * u, c + (d - c) * u);
    (low + (high - low) * v).clamp(0.0, 1.0)
}

/// By how much the rays differ.
fn spread(corners: [f32; 4]) -> f32 {
    let (least, most) = corners.iter().fold((1.0_f32, 0.0_f32), |(a, b), &x| (a.min(x), b.max(x)));
    most - least
}

/// Traces the rays of a light.
struct TileMaker<'a> {
    world: &'a ShadowWorld,
    march: March<'a>,
    states: [RayState; LANES],
    shares: Shares,
}

impl TileMaker<'_> {
    /// Makes a tile.
    fn make(
        &mut self,
        access: Access<'_>,
        table: &DeepShadowMap,
        tile: u32,
        bytes: &mut [u8],
        counts: &mut RenderCounts,
    ) -> Result<(), Halt> {
        let rays: Vec<(Ray, f64)> = table.map.rays(tile).into_iter().map(|ray| (ray, 0.5)).collect();
        let mut curves: Vec<TransmittanceBuilder> = vec![TransmittanceBuilder::new(); rays.len()];
        for group in self.world.steps.groups(access, &self.world.program, &rays)? {
            let members: Vec<(Ray, f64)> = group.members.iter().map(|&i| rays[i]).collect();
            let packet = Packet::new(&members, group.step);
            counts.shadow_rays += members.len() as u64;
            self.states.fill(RayState::START);
            self.march.begin(&packet);
            let mut scratch = self.march.node_samples();
            let outcome = self.pass(access, &packet, &group.members, &mut scratch, &mut curves, counts);
            self.march.give_back(scratch);
            outcome?;
        }
        transmittance::encode(curves.into_iter().map(TransmittanceBuilder::finish).collect(), bytes);
        Ok(())
    }

    fn pass(
        &mut self,
        access: Access<'_>,
        packet: &Packet,
        members: &[usize],
        node: &mut NodeSamples,
        curves: &mut [TransmittanceBuilder],
        counts: &mut RenderCounts,
    ) -> Result<(), Halt> {
        let mut going = packet.all();
        let mut from = 0;
        while going != 0
            && let Some(slab) = self.march.next_slab(from)
        {
            from = slab.end();
            self.march.evaluate(access, packet, slab, going, counts, node)?;
            let lanes = going;
            let before = self.states.map(|state| state.transmittance as f32);
            let absorption = &self.world.absorption;
            going = absorption.absorb(packet, slab, node, lanes, &mut self.states, &mut self.shares);
            each_lane(self.shares.lanes(), |lane| {
                self.extend(packet, slab, lane, before[lane], &mut curves[members[lane]]);
            });
        }
        Ok(())
    }

    /// Appends the samples of a slab to the curve of a ray. A sample takes its light between the middles of the gaps
    /// beside it.
    fn extend(
        &self,
        packet: &Packet,
        slab: Slab,
        lane: usize,
        before: f32,
        curve: &mut TransmittanceBuilder,
    ) {
        let (mut left, step) = (before, packet.step_world());
        let mut samples = self.shares.samples[lane];
        while samples != 0 {
            let j = samples.trailing_zeros() as usize;
            samples &= samples - 1;
            let t = packet.sample_t_world(lane, slab.first + j as u64);
            let (near, far) = ((t - 0.5 * step) as f32, (t + 0.5 * step) as f32);
            // Where the ray came through nothing, the light has not changed since the last knot.
            if curve.last().is_none_or(|x| x < near) {
                curve.push((near, left));
            }
            left = self.shares.behind[lane].0[j];
            curve.push((far, left));
        }
    }
}
