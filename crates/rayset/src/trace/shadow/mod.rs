//! How much of each light reaches each sample.

mod cached;
mod exact;
mod map;
mod transmittance;

use super::access::{Access, Halt};
use super::composite::Shares;
use super::counts::RenderCounts;
use super::node_samples::{NodeSamples, STEPS_TO_BOUNDARY};
use super::shade::{Shader, ShadowRows};
use super::world::World;
use crate::field::{LANES, Packet, SLAB_SAMPLES, SampleRow, Slab};
use crate::geometry::DVec3;
use crate::scene::{Light, LightKind};

use self::cached::DeepShadowLookups;
pub(super) use self::cached::{DeepShadowMap, SHADOW_TILE_BYTES};
use self::exact::ShadowRays;

/// The place at which a sample is lit.
fn lit_place(packet: &Packet, node: &NodeSamples, lane: usize, sample: u64, j: usize) -> DVec3 {
    let place = packet.ray(lane).at(packet.sample_t_world(lane, sample));
    let depth = -f64::from(node.boundary[lane].0[j]);
    if !(depth > 0.0 && depth <= STEPS_TO_BOUNDARY * packet.step_world()) {
        return place;
    }
    place + node.normal_at(lane, j) * depth
}

/// The direction from a place to a light and its distance, infinite where it is nowhere; `None` where no ray goes there.
fn toward(light: &Light, place: DVec3) -> Option<(DVec3, f64)> {
    match light.kind {
        LightKind::Directional { direction } => Some((-direction.normalize(), f64::INFINITY)),
        LightKind::Point { position, .. } => {
            let toward = position - place;
            Some((toward.try_normalize()?, toward.length()))
        }
        LightKind::Ambient | LightKind::Headlight => None,
    }
}

/// The shadows of one thread.
pub(super) struct Shadows<'a> {
    exact: ShadowRays<'a>,
    cached: DeepShadowLookups<'a>,
    world: &'a World,
    rows: ShadowRows,
}

impl<'a> Shadows<'a> {
    /// `None` where no light throws any.
    pub(super) fn new(world: &'a World, slab_samples: usize) -> Option<Self> {
        let program = world.shadow_program.as_ref()?;
        let mut rows: ShadowRows = vec![None; world.shader.lights()];
        for (number, _) in world.shader.shadow_lights() {
            rows[number] = Some(vec![SampleRow([1.0; SLAB_SAMPLES]); LANES]);
        }
        let exact = ShadowRays::new(world, program, slab_samples);
        let cached = DeepShadowLookups::new(world, program, slab_samples);
        Some(Self { exact, cached, world, rows })
    }

    /// Finds what reaches the samples that count.
    #[expect(clippy::too_many_arguments, reason = "one slab of one packet, as light sees it")]
    pub(super) fn find(
        &mut self,
        access: Access<'_>,
        shader: &Shader,
        packet: &Packet,
        slab: Slab,
        node: &NodeSamples,
        shares: &Shares,
        counts: &mut RenderCounts,
    ) -> Result<&ShadowRows, Halt> {
        for (number, light) in shader.shadow_lights() {
            let Some(rows) = &mut self.rows[number] else { continue };
            match self.world.light_tables.get(number).and_then(Option::as_ref) {
                Some(table) => {
                    let undecided =
                        self.cached.find(access, light, table, packet, slab, node, shares, counts, rows)?;
                    self.exact.find_some(access, light, packet, slab, node, &undecided, counts, rows)?;
                }
                None => self.exact.find(access, light, packet, slab, node, shares, counts, rows)?,
            }
        }
        Ok(&self.rows)
    }
}
