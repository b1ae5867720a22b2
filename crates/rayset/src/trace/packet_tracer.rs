//! One packet of rays, slab after slab: the loop that all time goes into.

use super::access::{Access, Halt};
use super::block::Block;
use super::composite::{RayState, Shares};
use super::march::March;
use super::shadow::Shadows;
use super::steps::StepGroup;
use super::world::World;
use crate::field::{LANES, Packet, SplatCounts};
use crate::geometry::Ray;

/// How much work a render was.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RenderCounts {
    /// Work on pairs of rays and points.
    pub splats: SplatCounts,
    /// Samples that were looked at.
    pub samples: u64,
    /// Samples that were not transparent.
    pub nonzero_samples: u64,
    /// Slabs of packets that had anything in them.
    pub slabs: u64,
    /// Runs decoded, each once a slab of a packet.
    pub runs: u64,
    /// Packets traced, without those of shadow rays.
    pub packets: u64,
    /// Shadow rays traced.
    pub shadow_rays: u64,
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
        self.shadow_rays += other.shadow_rays;
        self.put_off += other.put_off;
    }
}

/// The scratch memory of one thread.
pub(super) struct PacketTracer<'a> {
    world: &'a World,
    march: March<'a>,
    shadows: Option<Shadows<'a>>,
    shares: Shares,
    states: [RayState; LANES],
    counts: RenderCounts,
}

impl<'a> PacketTracer<'a> {
    pub(super) fn new(world: &'a World, slab_samples: usize) -> Self {
        Self {
            world,
            march: March::new(&world.program, slab_samples),
            shadows: Shadows::new(world, slab_samples),
            shares: Shares::new(),
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
        self.states.fill(RayState::START);
        self.counts.packets += 1;
        self.march.begin(&packet);
        let mut block = self.march.block();
        let outcome = self.pass(access, &packet, &mut block);
        self.march.give_back(block);
        outcome?;
        for (lane, &pixel) in group.members.iter().enumerate() {
            pixels[pixel] = self.pixel(&self.states[lane]);
        }
        Ok(())
    }

    /// Slab after slab, front to back, until all rays are opaque or nothing is left ahead.
    fn pass(&mut self, access: Access<'_>, packet: &Packet, block: &mut Block) -> Result<(), Halt> {
        let world = self.world;
        let flat = world.shader.flat_color().is_some();
        let mut going = packet.all();
        let mut from = 0;
        while going != 0
            && let Some(slab) = self.march.next_slab(from)
        {
            from = slab.end();
            self.march.evaluate(access, packet, slab, going, &mut self.counts, block)?;
            self.counts.slabs += 1;
            self.counts.samples += u64::from(going.count_ones()) * slab.samples as u64;
            let lanes = going;
            going = world.absorption.absorb(packet, slab, block, lanes, &mut self.states, &mut self.shares);
            self.counts.nonzero_samples += self.shares.count();
            if flat || self.shares.lanes() == 0 {
                continue;
            }
            let none = Vec::new();
            let shadows = match &mut self.shadows {
                Some(shadows) => shadows.find(
                    access,
                    &world.shader,
                    packet,
                    slab,
                    block,
                    &self.shares,
                    &mut self.counts,
                )?,
                None => &none,
            };
            world.shader.shade(packet, slab, block, &self.shares, shadows, &mut self.states);
        }
        Ok(())
    }

    /// The pixel of a ray that has ended.
    fn pixel(&self, state: &RayState) -> [f32; 4] {
        let (color, transmittance) = (state.color, state.transmittance as f32);
        let color =
            self.world.shader.flat_color().map_or(color, |flat| flat.map(|v| v * (1.0 - transmittance)));
        match self.world.background {
            Some(background) => {
                let behind = |c: usize| color[c] + transmittance * background[c];
                [behind(0), behind(1), behind(2), 1.0]
            }
            None => [color[0], color[1], color[2], 1.0 - transmittance],
        }
    }
}
