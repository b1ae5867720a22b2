//! How much of each light reaches the samples of a slab, computed as the settings require.

use super::cached::DeepShadowLookups;
use super::exact::ShadowRays;
use super::sharing::SharedShadows;
use super::world::{LightWithShadows, ShadowWorld};
use crate::field::{LANES, Packet, SLAB_SAMPLES, SampleRow, Slab};
use crate::scene::Footprint;
use crate::trace::access::{Access, Halt};
use crate::trace::composite::Shares;
use crate::trace::counts::RenderCounts;
use crate::trace::node_samples::NodeSamples;
use crate::trace::shade::ShadowRows;

/// Shadow computation of one thread.
pub(in crate::trace) struct Shadows<'a> {
    exact: ShadowRays<'a>,
    cached: DeepShadowLookups<'a>,
    shared: SharedShadows,
    world: &'a ShadowWorld,
    rows: ShadowRows,
}

impl<'a> Shadows<'a> {
    pub(in crate::trace) fn new(world: &'a ShadowWorld, slab_samples: usize) -> Self {
        let all = |_: &LightWithShadows| Some(vec![SampleRow([1.0; SLAB_SAMPLES]); LANES]);
        Self {
            exact: ShadowRays::new(world, slab_samples),
            cached: DeepShadowLookups::new(world, slab_samples),
            shared: SharedShadows::new(world.lights.len()),
            world,
            rows: world.lights.iter().map(|light| light.as_ref().and_then(all)).collect(),
        }
    }

    /// Starts a packet, given how wide the pixels of its rays are.
    pub(in crate::trace) fn begin(&mut self, footprints: impl Iterator<Item = Footprint>) {
        self.shared.begin();
        self.cached.begin(footprints);
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
        self.shared.choose(slab, shares);
        let samples = &self.shared.computed.clone();
        for (number, (light, rows)) in self.world.lights.iter().zip(&mut self.rows).enumerate() {
            let (Some(with_shadows), Some(rows)) = (light, rows) else { continue };
            let LightWithShadows { light, table, .. } = with_shadows;
            match table {
                Some(table) => {
                    let undecided = self.cached.find(
                        access,
                        with_shadows,
                        table,
                        packet,
                        slab,
                        node,
                        (shares, samples),
                        counts,
                        rows,
                    )?;
                    self.exact.find(access, light, packet, slab, node, &undecided, counts, rows)?;
                }
                None => self.exact.find(access, light, packet, slab, node, samples, counts, rows)?,
            }
            self.shared.spread(number, rows);
        }
        Ok(&self.rows)
    }
}
