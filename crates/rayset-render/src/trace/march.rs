//! The march of one packet through the whole graph: its samples, slab after slab.
//!
//! Where rays have different steps, a slab has the samples of some of them, at one level. Cells of
//! the steps ([`StepRule`]) are gone through depth first: the rays that need no finer steps there
//! pass the cell, then the others pass both of its halves. So every ray meets its samples front to
//! back, and no slab begins before one that was there earlier.

use super::access::{Access, Halt};
use super::cloud::Remaining;
use super::counts::RenderCounts;
use super::evaluate::{Asked, GraphSamples, Lanes};
use super::node_samples::{NodeSamples, each_lane};
use super::program::Program;
use super::steps::{Details, StepRule};
use crate::field::{BLOCK_SAMPLES, LANES, Packet, SLAB_SAMPLES, Slab};
use rayset_base::geometry::Ray;

/// The march of one packet after another, with scratch memory.
pub(super) struct March<'p> {
    steps: &'p StepRule,
    slab_samples: usize,
    details: Details<'p>,
    graph: GraphSamples<'p>,
    /// The lanes of rays that have not ended.
    going: u64,
    /// The tick up to which each ray has come.
    reached: [u64; LANES],
}

/// What is done with the samples of a packet: the light of rays from the eye, what is left of light
/// on its way, surfaces that are crossed.
pub(super) trait SlabVisitor {
    /// Called where samples are skipped that are empty on rays, but not behind their last slab.
    /// Returns the lanes of those in `going` that end there.
    fn passed_nothing(&mut self, _going: u64) -> u64 {
        0
    }

    /// How much is left of the rays before the next slab: samples behind the end of a ray may then
    /// be left empty. `None` if rays do not end by what they pass.
    fn remaining(&self, _packet: &Packet) -> Option<Remaining> {
        None
    }

    /// Where work is counted.
    fn counts(&mut self) -> &mut RenderCounts;

    /// Takes the samples of a slab, of the lanes in `going`. The packet is at the level of the
    /// slab. Opacities are optical depths. Returns the lanes that go on.
    fn sampled(
        &mut self,
        packet: &Packet,
        slab: Slab,
        going: u64,
        node: &mut NodeSamples,
    ) -> Result<u64, Halt>;
}

/// A packet that is traced, and what is done with its samples.
struct Course<'t, V> {
    access: Access<'t>,
    packet: Packet,
    visitor: &'t mut V,
    /// Room for the samples of the root.
    node: NodeSamples,
}

impl<'p> March<'p> {
    pub(super) fn new(program: &'p Program, steps: &'p StepRule, slab_samples: usize) -> Self {
        Self {
            steps,
            slab_samples,
            details: Details::new(program, steps),
            graph: GraphSamples::new(program),
            going: 0,
            reached: [0; LANES],
        }
    }

    /// From now on, rays have these steps.
    pub(super) fn set_steps(&mut self, steps: &'p StepRule) {
        self.steps = steps;
        self.details.set_rule(steps);
    }

    /// Follows at most 64 rays, each with its sample offset in steps, front to back, slab by slab,
    /// until all have ended or nothing is left ahead. Returns the lanes of the rays that have not
    /// ended.
    pub(super) fn slabs<V: SlabVisitor>(
        &mut self,
        access: Access<'_>,
        rays: &[(Ray, f64)],
        visitor: &mut V,
    ) -> Result<u64, Halt> {
        let packet = Packet::new(rays, self.steps.tick_world());
        self.going = packet.all();
        self.reached.fill(0);
        self.graph.begin(&packet, access.sight.as_ref());
        self.details.begin(&packet, self.graph.spans());
        let node = self.graph.node_samples();
        let mut course = Course { access, packet, visitor, node };
        let outcome = self.each_cell(&mut course);
        self.graph.give_back(course.node);
        outcome?;
        Ok(self.going)
    }

    fn each_cell<V: SlabVisitor>(&mut self, course: &mut Course<'_, V>) -> Result<(), Halt> {
        let mut from = 0;
        while self.going != 0
            && let Some(tick) = self.graph.next_tick(from)
        {
            if self.steps.is_uniform() {
                // From where there is something, so that it takes as few slabs as may be, but never
                // back.
                let slab = Slab { first: whole_blocks(tick).max(from), samples: self.slab_samples, level: 0 };
                let lanes = Lanes { here: self.going, waiting: 0, since: slab.first };
                self.slab(course, slab, lanes)?;
                from = slab.end();
            } else {
                let cell = self.steps.cell_at(tick.max(from));
                self.cell(course, cell, self.going)?;
                from = cell.end_tick();
            }
        }
        Ok(())
    }

    /// Takes some rays through a cell of their steps.
    fn cell<V: SlabVisitor>(
        &mut self,
        course: &mut Course<'_, V>,
        cell: Slab,
        lanes: u64,
    ) -> Result<(), Halt> {
        let since = cell.first_tick();
        let next = self.graph.next_tick(since);
        let Some(tick) = next.filter(|&tick| lanes & self.going != 0 && tick < cell.end_tick()) else {
            return Ok(());
        };
        let lanes = lanes & self.going;
        let finer = match cell.level {
            0 => 0,
            _ => self.details.finer(course.access, &course.packet, cell, (self.going, lanes))?,
        };
        let here = lanes & !finer;
        let mut first = whole_blocks(tick >> cell.level).max(cell.first);
        while first < cell.end() && here & self.going != 0 {
            let samples = self.slab_samples.min((cell.end() - first) as usize);
            let slab = Slab { first, samples, level: cell.level };
            self.slab(course, slab, Lanes { here: here & self.going, waiting: self.going & !here, since })?;
            first = slab.end();
        }
        if finer != 0 {
            for half in cell.halves() {
                self.cell(course, half, finer)?;
            }
        }
        Ok(())
    }

    /// Takes some rays through a slab.
    fn slab<V: SlabVisitor>(
        &mut self,
        course: &mut Course<'_, V>,
        slab: Slab,
        mut lanes: Lanes,
    ) -> Result<(), Halt> {
        let Course { access, packet, visitor, node } = course;
        packet.set_level(slab.level);
        let mut skipped = 0;
        each_lane(lanes.here, |lane| {
            skipped |= u64::from(self.reached[lane] < slab.first_tick()) << lane;
            self.reached[lane] = slab.end_tick();
        });
        if skipped != 0 {
            let ended = visitor.passed_nothing(skipped);
            lanes.here &= !ended;
            self.going &= !ended;
        }
        if lanes.here == 0 {
            return Ok(());
        }
        let remaining = visitor.remaining(packet);
        let asked = Asked { access: *access, packet, slab, lanes, ends: remaining.as_ref() };
        self.graph.evaluate(asked, visitor.counts(), node)?;
        let going = visitor.sampled(packet, slab, lanes.here, node)?;
        self.going &= going | !lanes.here;
        Ok(())
    }
}

/// The first sample of the block of samples that one is in.
fn whole_blocks(sample: u64) -> u64 {
    sample / BLOCK_SAMPLES as u64 * BLOCK_SAMPLES as u64
}

const _: () = assert!(SLAB_SAMPLES == 32, "a lane's samples are the bits of a u32");
