//! How much of each light reaches each sample.

mod exact;

use super::access::{Access, Halt};
use super::composite::Shares;
use super::packet_tracer::RenderCounts;
use super::shade::{Shader, ShadowRows};
use super::world::World;
use crate::field::{LANES, Packet, SLAB_SAMPLES, SampleRow, Slab};

use self::exact::ShadowRays;

/// The shadows of one thread.
pub(super) struct Shadows<'a> {
    exact: ShadowRays<'a>,
    rows: ShadowRows,
}

impl<'a> Shadows<'a> {
    /// Nothing where no light throws any.
    pub(super) fn new(world: &'a World, slab_samples: usize) -> Option<Self> {
        let program = world.shadow_program.as_ref()?;
        let mut rows: ShadowRows = vec![None; world.shader.lights()];
        for (number, _) in world.shader.shadow_lights() {
            rows[number] = Some(vec![SampleRow([1.0; SLAB_SAMPLES]); LANES]);
        }
        Some(Self { exact: ShadowRays::new(world, program, slab_samples), rows })
    }

    /// Finds what reaches the samples that count.
    pub(super) fn find(
        &mut self,
        access: Access<'_>,
        shader: &Shader,
        packet: &Packet,
        slab: Slab,
        shares: &Shares,
        counts: &mut RenderCounts,
    ) -> Result<&ShadowRows, Halt> {
        for (number, light) in shader.shadow_lights() {
            if let Some(rows) = &mut self.rows[number] {
                self.exact.find(access, light, packet, slab, shares, counts, rows)?;
            }
        }
        Ok(&self.rows)
    }
}
