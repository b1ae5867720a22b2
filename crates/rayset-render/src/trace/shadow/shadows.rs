//! How much of each light reaches the samples of a slab, computed as the settings require.

use super::cached::{DeepShadowLookups, TILE_MAKER_BYTES};
use super::exact::ShadowRays;
use super::place::SlabToLight;
use super::sharing::SharedShadows;
use super::sights::{LightSight, Octaves, sees_from_afar};
use super::table::DeepShadowMap;
use super::world::{LightWithShadows, ShadowWorld};
use crate::field::{LANES, Packet, SLAB_SAMPLES, SampleRow, SimdLevel, Slab};
use crate::scene::{Footprint, Lighting, RenderSettings, Scene};
use crate::trace::access::{Access, Halt};
use crate::trace::composite::Shares;
use crate::trace::counts::RenderCounts;
use crate::trace::march::March;
use crate::trace::node_samples::NodeSamples;
use crate::trace::program::{Program, Purpose};
use crate::trace::shade::ShadowRows;

/// Shadow computation of one thread.
pub(in crate::trace) struct Shadows<'a> {
    exact: ShadowRays<'a>,
    cached: DeepShadowLookups<'a>,
    shared: SharedShadows,
    world: &'a ShadowWorld,
    /// Of the rays of a packet.
    footprints: [Footprint; LANES],
    weights: [f32; LANES],
    rows: ShadowRows,
}

impl<'a> Shadows<'a> {
    /// The most bytes that shadows take of a scene, besides their tables: once, and in each thread.
    pub(in crate::trace) fn most_bytes(scene: &Scene, settings: &RenderSettings) -> (usize, usize) {
        let Lighting::Lit(lights) = &scene.lighting else { return (0, 0) };
        let of_lights = lights.len() * size_of::<Option<LightWithShadows>>();
        if !scene.lighting.throws_shadows() {
            return (of_lights, 0);
        }
        let seen = (Purpose::Shadow, settings.lod);
        let program = Program::compile_seen(scene, seen, SimdLevel::default());
        let instructions = program.instructions.len();
        let of_sights = if sees_from_afar(&program) {
            let of_tables = DeepShadowMap::sights_of(scene, settings.shadows);
            Octaves::bytes(instructions) + of_tables * LightSight::bytes(instructions)
        } else {
            0
        };
        let rows =
            lights.iter().filter(|light| light.throws_shadows()).count() * LANES * size_of::<SampleRow>();
        // One march for rays, one for tables.
        (of_lights + of_sights + program.bytes(), 2 * March::most_bytes(&program) + rows + TILE_MAKER_BYTES)
    }

    pub(in crate::trace) fn new(world: &'a ShadowWorld, slab_samples: usize) -> Self {
        let all = |_: &LightWithShadows| Some(vec![SampleRow([1.0; SLAB_SAMPLES]); LANES]);
        Self {
            exact: ShadowRays::new(world, slab_samples),
            cached: DeepShadowLookups::new(world, slab_samples),
            shared: SharedShadows::new(world.lights.len()),
            world,
            footprints: [Footprint::default(); LANES],
            weights: [1.0; LANES],
            rows: world.lights.iter().map(|light| light.as_ref().and_then(all)).collect(),
        }
    }

    /// Starts a packet, given how wide the pixels of its rays are, and which fraction of each ray's
    /// light reaches its pixel.
    pub(in crate::trace) fn begin(&mut self, rays: impl Iterator<Item = (Footprint, f32)>) {
        for (lane, (footprint, weight)) in rays.enumerate() {
            (self.footprints[lane], self.weights[lane]) = (footprint, weight);
        }
        self.shared.begin();
        self.cached.begin();
    }

    /// Computes how much of each light reaches the contributing samples.
    pub(in crate::trace) fn find(
        &mut self,
        access: Access<'_>,
        packet: &Packet,
        slab: Slab,
        node: &NodeSamples,
        shares: &Shares,
        counts: &mut RenderCounts,
    ) -> Result<&ShadowRows, Halt> {
        self.shared.choose(slab, &self.weights, shares);
        let wanted = &self.shared.computed.clone();
        let samples =
            SlabToLight { packet, slab, node, footprints: &self.footprints, reach: self.world.reach };
        for (number, (light, rows)) in self.world.lights.iter().zip(&mut self.rows).enumerate() {
            let (Some(with_shadows), Some(rows)) = (light, rows) else { continue };
            let LightWithShadows { light, table, .. } = with_shadows;
            match table {
                Some(table) => {
                    let undecided = self.cached.find(
                        access,
                        with_shadows,
                        table,
                        samples,
                        (&self.weights, shares, wanted),
                        counts,
                        rows,
                    )?;
                    self.exact.find(access, light, samples, &undecided, counts, rows)?;
                }
                None => self.exact.find(access, light, samples, wanted, counts, rows)?,
            }
            self.shared.spread(number, rows);
        }
        Ok(&self.rows)
    }
}
