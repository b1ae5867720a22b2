//! Shadows from deep shadow maps, which are traced from the light. Each tile of a map is a pure
//! function of scene, light and tile; it is computed when first needed, evicted like any page, and
//! recomputed to the same bits.
//!
//! A map has levels, each of half as many rays along a side as the one before. A sample is looked
//! up in the coarsest whose cells are at most an eighth as wide as the sample's pixel: a function
//! of view and sample. So a picture costs shadows by its pixels, and a level that several views
//! need is computed once.
//!
//! Between its rays a map can only interpolate: it resolves shadow edges to one cell. If the rays
//! around a sample differ so much that the difference would be visible in its pixel, the sample
//! gets a shadow ray of its own; where shadows are larger than cells these are a small fraction of
//! all samples. The decision is a function of sample and tile only, so it does not depend on
//! execution settings.

use std::collections::BTreeSet;
use std::sync::Arc;

use super::map::{TILE_CELLS, Texel};
use super::place::{SlabToLight, toward};
use super::table::DeepShadowMap;
use super::transmittance::{self, TransmittanceCurves};
use super::world::{LightWithShadows, ShadowWorld};
use crate::field::{LANES, Packet, SLAB_SAMPLES, SampleRow, Slab};
use crate::trace::access::{Access, Halt};
use crate::trace::cloud::Remaining;
use crate::trace::composite::{Absorption, RayState, Shares};
use crate::trace::counts::RenderCounts;
use crate::trace::march::{March, SlabVisitor};
use crate::trace::node_samples::{NodeSamples, each_lane};
use rayset_base::geometry::{DVec3, Ray};
use rayset_store::working_set::PageGuard;

/// Memory of a thread that makes tiles, besides that of its march.
pub(in crate::trace) const TILE_MAKER_BYTES: usize = TransmittanceCurves::BYTES;
/// Rays along an edge of a tile.
const CORNERS: u32 = TILE_CELLS + 1;

/// Looks up shadows by interpolation between the rays of a light; computes missing tiles.
pub(super) struct DeepShadowLookups<'a> {
    maker: TileMaker<'a>,
    /// Tiles of the tables of lights, by their objects, that a packet lacks and whose rays have
    /// been asked for.
    asked: BTreeSet<(usize, u32)>,
}

impl<'a> DeepShadowLookups<'a> {
    pub(super) fn new(world: &'a ShadowWorld, slab_samples: usize) -> Self {
        let maker = TileMaker {
            world,
            march: March::new(&world.program, &world.steps, slab_samples),
            states: [RayState::START; LANES],
            shares: Shares::new(),
            curves: TransmittanceCurves::new(),
        };
        Self { maker, asked: BTreeSet::new() }
    }

    /// Starts a packet.
    pub(super) fn begin(&mut self) {
        self.asked.clear();
    }

    /// Fills the rows of the samples that are wanted, a bit for each. Returns a bit for each sample
    /// that the map does not decide, because the rays around it differ: the edge of a shadow passes
    /// between them.
    #[expect(clippy::too_many_arguments, reason = "one light on one slab of one packet")]
    pub(super) fn find(
        &mut self,
        access: Access<'_>,
        light: &LightWithShadows,
        table: &'a DeepShadowMap,
        samples: SlabToLight<'_>,
        (weights, shares, wanted): (&[f32; LANES], &Shares, &[u32; LANES]),
        counts: &mut RenderCounts,
        rows: &mut [SampleRow],
    ) -> Result<[u32; LANES], Halt> {
        let mut undecided = [0_u32; LANES];
        // The tile of the last look-up stays retained: neighbouring samples mostly share it.
        let mut last: Option<(u32, PageGuard)> = None;
        let mut lanes = shares.lanes();
        while lanes != 0 {
            let lane = lanes.trailing_zeros() as usize;
            lanes &= lanes - 1;
            let mut left = wanted[lane];
            while left != 0 {
                let j = left.trailing_zeros() as usize & (SLAB_SAMPLES - 1);
                left &= left - 1;
                let place = samples.place((lane, j));
                let Some(texel) = table.map.texel(place, samples.pixel_width((lane, j))) else {
                    rows[lane].0[j] = 1.0;
                    continue;
                };
                if last.as_ref().is_none_or(|(number, _)| *number != texel.tile) {
                    drop(last.take());
                    if access.foresees.is_some()
                        && self.maker.lacks(access, table, texel.tile, &mut self.asked)
                    {
                        continue;
                    }
                    // Whoever comes first makes the tile: what it takes is of no pixel in
                    // particular.
                    let asked_bytes = access.asked_bytes.get();
                    let compute =
                        |bytes: &mut [u8]| self.maker.make(access, table, texel.tile, bytes, counts);
                    let guard = access.pages.retain_computed(&table.tiles, texel.tile, compute)?;
                    access.asked_bytes.set(asked_bytes);
                    last = Some((texel.tile, guard));
                }
                let Some((_, guard)) = &last else { continue };
                let lookup = Lookup::new(light, samples, (lane, j), place, &texel);
                let corners = lookup.corners(guard, &texel);
                rows[lane].0[j] = between(corners, texel.within);
                let share = weights[lane] * shares.share[lane].0[j];
                let doubt = spread(corners) * lookup.scattered * share;
                undecided[lane] |= u32::from(doubt > LARGEST_DOUBT) << j;
            }
        }
        Ok(undecided)
    }
}

/// Largest difference that the rays around a sample may make to its pixel, as a fraction of the
/// light's largest contribution.
pub(super) const LARGEST_DOUBT: f32 = 1.0 / 64.0;
/// A boundary is extrapolated as a plane up to this slope against the plane across the light's
/// rays; steeper slopes are clamped.
const STEEPEST: f64 = 8.0;

/// Parameters of a sample's look-up.
struct Lookup {
    /// Distance along the light's ray through the sample.
    distance: f64,
    /// Increase of the distance from ray to ray, along rows and columns.
    slope: (f64, f64),
    /// Fraction of the arriving light that is scattered, before colours.
    scattered: f32,
}

impl Lookup {
    /// Like an exact shadow ray, the look-up ignores what lies within the sample offset of the
    /// sample. At a boundary, each ray is looked up where it meets the boundary's tangent plane, so
    /// that all rays are equally far in front of the boundary and it does not shadow itself. The
    /// distance is reduced by half a cell, in case the boundary is nearer than its tangent plane.
    #[inline(always)]
    fn new(
        light: &LightWithShadows,
        samples: SlabToLight<'_>,
        (lane, j): (usize, usize),
        place: DVec3,
        texel: &Texel,
    ) -> Self {
        let SlabToLight { packet, node, .. } = samples;
        let distance = texel.distance - packet.sample_offset(lane) * packet.step_world();
        let normal = node.normal_at(lane, j);
        let toward = light.direction.or_else(|| toward(&light.light, place).map(|(toward, _)| toward));
        let Some(toward) = toward.filter(|_| normal != DVec3::ZERO) else {
            // Without a shading vector no light is scattered.
            return Self { distance, slope: (0.0, 0.0), scattered: 0.0 };
        };
        let cosine = normal.dot(toward);
        let scattered = cosine.abs() as f32;
        if f64::from(node.boundary[lane].0[j]).abs() > samples.reach_world((lane, j)) {
            return Self { distance, slope: (0.0, 0.0), scattered };
        }
        let gradient = (normal / cosine - toward).clamp_length_max(STEEPEST);
        // Light at grazing incidence contributes almost nothing.
        let gradient = if gradient.is_finite() { gradient } else { DVec3::ZERO };
        let slope = (gradient.dot(texel.next.0), gradient.dot(texel.next.1));
        Self { distance: distance - 0.5 * texel.size(), slope, scattered }
    }

    /// Transmittance of the rays around the sample: (0, 0), (1, 0), (0, 1), (1, 1).
    #[inline(always)]
    fn corners(&self, page: &[u8], texel: &Texel) -> [f32; 4] {
        let mut corners = [0.0; 4];
        for (corner, (i, k)) in corners.iter_mut().zip([(0, 0), (1, 0), (0, 1), (1, 1)]) {
            let ray = (texel.cell.1 + k) * CORNERS + texel.cell.0 + i;
            let (right, up) = (f64::from(i) - texel.within.0, f64::from(k) - texel.within.1);
            let distance = self.distance + right * self.slope.0 + up * self.slope.1;
            let rays = (CORNERS * CORNERS) as usize;
            *corner = transmittance::transmittance(page, rays, ray as usize, distance as f32);
        }
        corners
    }
}

/// Bilinear interpolation.
fn between([a, b, c, d]: [f32; 4], (u, v): (f64, f64)) -> f32 {
    let (u, v) = (u as f32, v as f32);
    let (low, high) = (a + (b - a) * u, c + (d - c) * u);
    (low + (high - low) * v).clamp(0.0, 1.0)
}

/// Difference between the largest and the smallest value.
fn spread(corners: [f32; 4]) -> f32 {
    let (least, most) = corners.iter().fold((1.0_f32, 0.0_f32), |(a, b), &x| (a.min(x), b.max(x)));
    most - least
}

/// Traces the rays of a light to make tiles.
struct TileMaker<'a> {
    world: &'a ShadowWorld,
    march: March<'a>,
    states: [RayState; LANES],
    shares: Shares,
    /// One for each ray of the tile.
    curves: TransmittanceCurves,
}

impl<'a> TileMaker<'a> {
    /// Whether a tile is not there and cannot be made in this attempt; asks for the pages that its
    /// rays are expected to need.
    fn lacks(
        &self,
        access: Access<'_>,
        table: &DeepShadowMap,
        tile: u32,
        asked: &mut BTreeSet<(usize, u32)>,
    ) -> bool {
        if table.tiles.is_resident(tile) {
            return false;
        }
        if asked.insert((Arc::as_ptr(&table.tiles) as usize, tile)) {
            let rays = table.map.rays(tile);
            let access = access.seen(table.sight(tile).map(|of_tile| of_tile.sight));
            self.world.foresight.ask(&self.world.program, access, rays.chunks(LANES));
        }
        access.is_lacking()
    }

    /// Computes a tile.
    fn make(
        &mut self,
        access: Access<'_>,
        table: &'a DeepShadowMap,
        tile: u32,
        bytes: &mut [u8],
        counts: &mut RenderCounts,
    ) -> Result<(), Halt> {
        let rays: Vec<(Ray, f64)> = table.map.rays(tile).into_iter().map(|ray| (ray, 0.5)).collect();
        self.curves.begin(rays.len());
        counts.shadow_rays += rays.len() as u64;
        self.states.fill(RayState::START);
        let mut tracing = CurveTracing {
            absorption: &self.world.absorption,
            states: &mut self.states,
            shares: &mut self.shares,
            curves: &mut self.curves,
            counts,
        };
        let seen = table.sight(tile);
        self.march.set_steps(seen.map_or(&self.world.steps, |of_tile| &of_tile.steps));
        self.march.slabs(access.seen(seen.map(|of_tile| of_tile.sight)), &rays, &mut tracing)?;
        self.curves.encode(bytes);
        Ok(())
    }
}

/// The transmittance along the rays of a packet, while they are traced.
struct CurveTracing<'t> {
    absorption: &'t Absorption,
    states: &'t mut [RayState; LANES],
    shares: &'t mut Shares,
    curves: &'t mut TransmittanceCurves,
    counts: &'t mut RenderCounts,
}

impl SlabVisitor for CurveTracing<'_> {
    fn remaining(&self, packet: &Packet) -> Option<Remaining> {
        self.absorption.remaining(packet, self.states)
    }

    fn counts(&mut self) -> &mut RenderCounts {
        self.counts
    }

    fn sampled(
        &mut self,
        packet: &Packet,
        slab: Slab,
        going: u64,
        node: &mut NodeSamples,
    ) -> Result<u64, Halt> {
        let before = self.states.map(|state| state.transmittance as f32);
        let going = self.absorption.absorb(packet, slab, node, going, self.states, self.shares);
        each_lane(self.shares.lanes(), |lane| self.extend(packet, slab, lane, before[lane]));
        Ok(going)
    }
}

impl CurveTracing<'_> {
    /// Appends the samples of a slab to the curve of a ray. Each sample absorbs its light over one
    /// step, centred at the sample.
    fn extend(&mut self, packet: &Packet, slab: Slab, lane: usize, before: f32) {
        let (mut left, step) = (before, packet.step_world());
        let mut samples = self.shares.samples[lane];
        while samples != 0 {
            let j = samples.trailing_zeros() as usize;
            samples &= samples - 1;
            let t = packet.sample_t_world(lane, slab.first + j as u64);
            let (near, far) = ((t - 0.5 * step) as f32, (t + 0.5 * step) as f32);
            // If the ray has crossed empty space, the transmittance has not changed since the last
            // knot.
            if self.curves.last(lane).is_none_or(|x| x < near) {
                self.curves.push(lane, (near, left));
            }
            left = self.shares.behind[lane].0[j];
            self.curves.push(lane, (far, left));
        }
    }
}
