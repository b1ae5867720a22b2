//! One packet of rays, slab after slab: the loop that all time goes into.

use super::access::{Access, Halt, POINT_PRIORITY};
use super::composite::RayState;
use super::frontier::{ActiveRun, Frontier, LiveRays};
use super::steps::StepGroup;
use super::world::World;
use crate::field::{DecodedRun, FieldSamples, LANES, Packet, Slab, SplatCounts};
use crate::geometry::Ray;
use crate::octree::page::PointPage;

/// How much work a render was.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RenderCounts {
    /// Work on pairs of rays and points.
    pub splats: SplatCounts,
    /// Samples that were looked at.
    pub samples: u64,
    /// Samples that were not transparent.
    pub nonzero_samples: u64,
    /// Slabs of packets that had any points.
    pub slabs: u64,
    /// Runs decoded, each once a slab of a packet.
    pub runs: u64,
    /// Packets traced.
    pub packets: u64,
    /// Tiles that were put off because a page was absent. Work done on them until then is not counted.
    pub put_off: u64,
}

impl std::ops::AddAssign for RenderCounts {
    fn add_assign(&mut self, other: Self) {
        self.splats += other.splats;
        self.samples += other.samples;
        self.nonzero_samples += other.nonzero_samples;
        self.slabs += other.slabs;
        self.runs += other.runs;
        self.packets += other.packets;
        self.put_off += other.put_off;
    }
}

/// The scratch memory of one thread.
pub(super) struct PacketTracer<'a> {
    world: &'a World<'a>,
    slab_samples: usize,
    frontier: Frontier,
    active: Vec<ActiveRun>,
    run: Box<DecodedRun>,
    samples: FieldSamples,
    states: [RayState; LANES],
    counts: RenderCounts,
}

impl<'a> PacketTracer<'a> {
    pub(super) fn new(world: &'a World<'a>, slab_samples: usize) -> Self {
        Self {
            world,
            slab_samples,
            frontier: Frontier::default(),
            active: Vec::new(),
            run: Box::default(),
            samples: FieldSamples::new(world.splatter.channels),
            states: [RayState::START; LANES],
            counts: RenderCounts::default(),
        }
    }

    pub(super) fn counts(&self) -> RenderCounts {
        self.counts
    }

    /// Forgets what has been counted since `counts`: the tile is put off.
    pub(super) fn put_off(&mut self, counts: RenderCounts) {
        self.counts = RenderCounts { put_off: counts.put_off + 1, ..counts };
    }

    /// Traces the rays of a group and writes their pixels.
    pub(super) fn trace(
        &mut self,
        access: Access<'_>,
        rays: &[(Ray, f64)],
        group: &StepGroup,
        pixels: &mut [[f32; 4]; LANES],
    ) -> Result<(), Halt> {
        let members: Vec<(Ray, f64)> = group.members.iter().map(|&i| rays[i]).collect();
        let packet = Packet::new(&members, group.step);
        self.march(access, &packet)?;
        for (lane, &pixel) in group.members.iter().enumerate() {
            pixels[pixel] = self.world.compositor.pixel(&self.states[lane]);
        }
        Ok(())
    }

    /// Slab after slab, front to back, until all rays are opaque or nothing is left ahead.
    fn march(&mut self, access: Access<'_>, packet: &Packet) -> Result<(), Halt> {
        self.states.fill(RayState::START);
        self.active.clear();
        self.counts.packets += 1;
        let mut lanes = packet.all();
        let simd = self.world.splatter.simd;
        let mut rays = LiveRays::new(packet, lanes, simd);
        self.frontier.begin(access, &rays)?;
        let slab_samples = self.slab_samples as u64;
        let mut next = 0_u64;
        while lanes != 0 {
            if self.active.is_empty() {
                // Empty space: on to the slab of whatever comes next.
                match self.frontier.next_sample() {
                    Some(sample) => next = next.max(sample / slab_samples * slab_samples),
                    None => break,
                }
            }
            let slab = Slab { first: next, samples: self.slab_samples };
            next = next.saturating_add(slab_samples);
            self.frontier.advance(access, &rays, next, &mut self.active)?;
            self.active.retain(|run| run.last >= slab.first);
            if self.active.is_empty() {
                continue;
            }
            self.gather(access, packet, slab, lanes)?;
            let live = u64::from(lanes.count_ones());
            self.counts.samples += live * slab_samples;
            let compositor = &self.world.compositor;
            let nonzero = &mut self.counts.nonzero_samples;
            let going = compositor.composite(packet, slab, &self.samples, lanes, &mut self.states, nonzero);
            if going != lanes {
                lanes = going;
                rays = LiveRays::new(packet, lanes, simd);
            }
        }
        Ok(())
    }

    /// Adds all active runs to the samples of a slab, in the order of the file, one page retained at a time.
    fn gather(&mut self, access: Access<'_>, packet: &Packet, slab: Slab, lanes: u64) -> Result<(), Halt> {
        self.counts.slabs += 1;
        self.samples.clear();
        self.active.sort_unstable();
        let world = self.world;
        let mut at = 0;
        while let Some(&ActiveRun { page, .. }) = self.active.get(at) {
            let guard = access.retain(page, POINT_PRIORITY)?;
            let points = PointPage::trusted(&guard, world.header);
            while let Some(active) = self.active.get(at).filter(|a| a.page == page) {
                let run = points.run(usize::from(active.run));
                world.decoder.decode(&run, world.header, world.splatter.simd, &mut self.run);
                self.counts.runs += 1;
                self.counts.splats += world.splatter.splat(&self.run, packet, slab, lanes, &mut self.samples);
                at += 1;
            }
        }
        Ok(())
    }
}
