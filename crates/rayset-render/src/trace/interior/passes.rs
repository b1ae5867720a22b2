//! Where rays pass through the surface of a node: the places where it is at least half opaque.

use crate::field::{LANES, Packet, Slab};
use crate::trace::access::{Access, Halt};
use crate::trace::counts::RenderCounts;
use crate::trace::march::{March, SlabVisitor};
use crate::trace::node_samples::{NodeSamples, each_lane};
use crate::trace::program::Program;
use crate::trace::steps::StepRule;
use rayset_base::geometry::{DVec3, Ray};

/// The optical depth of half opacity per unit distance: ln 2.
const HALF_OPAQUE: f32 = std::f32::consts::LN_2;
/// Offset of a ray's first sample, in steps.
const SAMPLE_OFFSET: f64 = 0.5;

/// Follows rays through a node.
pub(super) struct PassTracer<'p> {
    march: March<'p>,
    open: Vec<Option<Pass>>,
    counts: RenderCounts,
}

/// Samples of a ray that follow each other and are at least half opaque: distance and shading
/// vector of the first and of the last.
#[derive(Clone, Copy, Debug)]
struct Pass {
    first: (f64, DVec3),
    last: (f64, DVec3),
}

impl Pass {
    /// Where the ray crosses the surface; `None` if it leaves on the side from which it came, so
    /// that it has only grazed it. Shading vectors point away from the surface, on either side of
    /// it.
    fn crossing(&self) -> Option<f64> {
        (self.first.1.dot(self.last.1) < 0.0).then_some(0.5 * (self.first.0 + self.last.0))
    }
}

impl<'p> PassTracer<'p> {
    pub(super) fn new(program: &'p Program, steps: &'p StepRule, slab_samples: usize) -> Self {
        let march = March::new(program, steps, slab_samples);
        Self { march, open: vec![None; LANES], counts: RenderCounts::default() }
    }

    /// For each of at most 64 rays, the distances at which it crosses the surface, ascending.
    pub(super) fn crossings(&mut self, access: Access<'_>, rays: &[Ray]) -> Result<Vec<Vec<f64>>, Halt> {
        let rays: Vec<(Ray, f64)> = rays.iter().map(|&ray| (ray, SAMPLE_OFFSET)).collect();
        let mut found = vec![Vec::new(); rays.len()];
        self.open.fill(None);
        let mut passes = Passes { open: &mut self.open, found: &mut found, counts: &mut self.counts };
        self.march.slabs(access, &rays, &mut passes)?;
        (0..rays.len()).for_each(|lane| passes.close(lane));
        Ok(found)
    }
}

/// The passes of the rays of a packet.
struct Passes<'t> {
    open: &'t mut [Option<Pass>],
    /// For each ray, where it crosses the surface.
    found: &'t mut [Vec<f64>],
    counts: &'t mut RenderCounts,
}

impl SlabVisitor for Passes<'_> {
    fn passed_nothing(&mut self, going: u64) -> u64 {
        each_lane(going, |lane| self.close(lane));
        0
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
        each_lane(going, |lane| self.extend(packet, slab, node, lane));
        Ok(going)
    }
}

impl Passes<'_> {
    /// Goes through the samples of a lane in a slab.
    fn extend(&mut self, packet: &Packet, slab: Slab, node: &NodeSamples, lane: usize) {
        if node.touched >> lane & 1 == 0 {
            return self.close(lane);
        }
        for j in 0..slab.samples {
            if node.opacity[lane].0[j] < HALF_OPAQUE {
                self.close(lane);
                continue;
            }
            let here = (packet.sample_t_world(lane, slab.first + j as u64), node.normal_at(lane, j));
            let pass = self.open[lane].get_or_insert(Pass { first: here, last: here });
            pass.last = here;
        }
    }

    fn close(&mut self, lane: usize) {
        self.found[lane].extend(self.open[lane].take().and_then(|pass| pass.crossing()));
    }
}
