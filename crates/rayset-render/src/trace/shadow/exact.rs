//! Shadow rays from samples to lights. Traced for every contributing sample, they are the
//! reference, for small pictures; with deep shadow maps, they decide the samples that the maps
//! cannot.

use super::place::{SlabToLight, toward};
use super::sights::Octave;
use super::world::ShadowWorld;
use crate::field::{LANES, Packet, SampleRow, Slab};
use crate::scene::Light;
use crate::trace::access::{Access, Halt};
use crate::trace::cloud::Remaining;
use crate::trace::composite::{Absorption, RayState, Shares};
use crate::trace::counts::RenderCounts;
use crate::trace::march::{March, SlabVisitor};
use crate::trace::node_samples::NodeSamples;
use crate::trace::secondary::coherent_groups;
use rayset_base::geometry::Ray;

/// Traces shadow rays in packets of neighbouring samples at the same depth.
pub(super) struct ShadowRays<'a> {
    world: &'a ShadowWorld,
    march: March<'a>,
    states: [RayState; LANES],
    shares: Shares,
}

/// A shadow ray.
#[derive(Clone, Copy)]
struct ToLight {
    ray: Ray,
    /// The ray's sample offset, in steps.
    sample_offset: f64,
    /// The step at the sample; world space.
    step_world: f64,
    /// Distance of the light; infinite for a directional light.
    light: f64,
    /// How it sees what is far.
    octave: Octave,
    lane: usize,
    /// Sample number within the slab.
    j: usize,
}

impl<'a> ShadowRays<'a> {
    pub(super) fn new(world: &'a ShadowWorld, slab_samples: usize) -> Self {
        Self {
            world,
            march: March::new(&world.program, &world.steps, slab_samples),
            states: [RayState::START; LANES],
            shares: Shares::new(),
        }
    }

    /// Fills the rows of some samples, a bit for each: sample after sample, each on all rays, so
    /// that a packet of shadow rays has origins at about the same depth.
    pub(super) fn find(
        &mut self,
        access: Access<'_>,
        light: &Light,
        samples: SlabToLight<'_>,
        wanted: &[u32; LANES],
        counts: &mut RenderCounts,
        rows: &mut [SampleRow],
    ) -> Result<(), Halt> {
        if access.foresees.is_some() {
            self.ask_ahead(access, light, samples, wanted);
            if access.is_lacking() {
                return Ok(());
            }
        }
        let mut rays = Vec::with_capacity(LANES);
        for (lane, j) in lit(samples, wanted) {
            match self.to_light(light, samples, (lane, j)) {
                Some(ray) => rays.push(ray),
                // The sample is at the position of the light.
                None => rows[lane].0[j] = 1.0,
            }
            if rays.len() == LANES {
                self.trace_all((access, light), &rays, counts, rows)?;
                rays.clear();
            }
        }
        self.trace_all((access, light), &rays, counts, rows)
    }

    /// Asks for the pages that the rays of some samples are expected to need.
    fn ask_ahead(&self, access: Access<'_>, light: &Light, samples: SlabToLight<'_>, wanted: &[u32; LANES]) {
        let rays = lit(samples, wanted).filter_map(|of| self.to_light(light, samples, of));
        let mut rays: Vec<(Octave, Ray)> = rays.map(|to| (to.octave, to.ray)).collect();
        rays.sort_by_key(|(octave, _)| *octave);
        for alike in rays.chunk_by(|a, b| a.0 == b.0) {
            let sight = self.world.octaves.sight(alike[0].0, light).map(|(sight, _)| sight);
            let rays: Vec<Ray> = alike.iter().map(|(_, ray)| *ray).collect();
            self.world.foresight.ask(&self.world.program, access.seen(sight), rays.chunks(LANES));
        }
    }

    /// The ray from a sample to a light; `None` if the sample is at the position of the light.
    fn to_light(
        &self,
        light: &Light,
        samples: SlabToLight<'_>,
        (lane, j): (usize, usize),
    ) -> Option<ToLight> {
        let packet = samples.packet;
        let origin = samples.place((lane, j));
        let (direction, distance) = toward(light, origin)?;
        Some(ToLight {
            ray: Ray { origin, direction },
            sample_offset: packet.sample_offset(lane),
            step_world: packet.step_world(),
            light: distance,
            octave: self.world.octaves.of(samples.pixel_width((lane, j))),
            lane,
            j,
        })
    }

    /// Traces at most one packet of rays. Each result is the same, bit for bit, as if the ray were
    /// traced alone.
    fn trace_all(
        &mut self,
        (access, light): (Access<'_>, &Light),
        rays: &[ToLight],
        counts: &mut RenderCounts,
        rows: &mut [SampleRow],
    ) -> Result<(), Halt> {
        let mut octaves: Vec<usize> = (0..rays.len()).collect();
        octaves.sort_by_key(|&i| rays[i].octave);
        for alike in octaves.chunk_by(|&a, &b| rays[a].octave == rays[b].octave) {
            let step_world = rays[alike[0]].step_world;
            for members in coherent_groups(|i| &rays[i].ray, alike.to_vec(), step_world) {
                let rays: Vec<ToLight> = members.iter().map(|&i| rays[i]).collect();
                self.trace((access, light), &rays, counts)?;
                for (place, to) in rays.iter().enumerate() {
                    rows[to.lane].0[to.j] = self.states[place].transmittance as f32;
                }
            }
        }
        Ok(())
    }

    /// Leaves the transmittance of each ray of one octave in its state. A ray begins half a step of
    /// its sample from there, so that no sample shadows itself.
    fn trace(
        &mut self,
        (access, light): (Access<'_>, &Light),
        rays: &[ToLight],
        counts: &mut RenderCounts,
    ) -> Result<(), Halt> {
        let half = |to: &ToLight| 0.5 * to.step_world;
        let shifted = |to: &ToLight| (Ray { origin: to.ray.at(half(to)), ..to.ray }, to.sample_offset);
        let lanes: Vec<(Ray, f64)> = rays.iter().map(shifted).collect();
        let limits: Vec<f64> = rays.iter().map(|to| to.light - half(to)).collect();
        self.states.fill(RayState::START);
        counts.shadow_rays += rays.len() as u64;
        let mut tracing = LightTracing {
            absorption: &self.world.absorption,
            limits: &limits,
            states: &mut self.states,
            shares: &mut self.shares,
            counts,
        };
        let (sight, steps) = self.world.octaves.sight(rays[0].octave, light).unzip();
        self.march.set_steps(steps.unwrap_or(&self.world.steps));
        self.march.slabs(access.seen(sight), &lanes, &mut tracing)?;
        Ok(())
    }
}

/// Rays to a light, while they are traced.
struct LightTracing<'t> {
    absorption: &'t Absorption,
    /// How far the light is along each ray; world space.
    limits: &'t [f64],
    states: &'t mut [RayState; LANES],
    shares: &'t mut Shares,
    counts: &'t mut RenderCounts,
}

impl SlabVisitor for LightTracing<'_> {
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
        lanes: u64,
        node: &mut NodeSamples,
    ) -> Result<u64, Halt> {
        let Self { absorption, limits, .. } = *self;
        let mut going = lanes;
        if !limits.iter().any(|limit| limit.is_finite()) {
            return Ok(absorption.absorb(packet, slab, node, going, self.states, self.shares));
        }
        cut_off(packet, slab, limits, node);
        // Rays that have reached their light end.
        for (lane, limit) in limits.iter().enumerate() {
            if packet.sample_t_world(lane, slab.end()) >= *limit {
                going &= !(1 << lane);
            }
        }
        let reached = lanes & !going;
        let absorbing = going | reached & node.touched;
        Ok(going & absorption.absorb(packet, slab, node, absorbing, self.states, self.shares))
    }
}

/// Makes everything behind the light transparent.
fn cut_off(packet: &Packet, slab: Slab, limits: &[f64], node: &mut NodeSamples) {
    for (lane, limit) in limits.iter().enumerate() {
        for j in 0..slab.samples {
            if packet.sample_t_world(lane, slab.first + j as u64) >= *limit {
                node.opacity[lane].0[j] = 0.0;
            }
        }
    }
}

/// The lanes and numbers of the samples whose bits are set: sample after sample, each on
/// all rays.
fn lit<'s>(
    samples: SlabToLight<'_>,
    wanted: &'s [u32; LANES],
) -> impl Iterator<Item = (usize, usize)> + use<'s> {
    let lanes = samples.packet.len();
    let any = wanted.iter().fold(0, |any, lane| any | lane);
    let numbers = (0..samples.slab.samples).filter(move |j| any >> j & 1 == 1);
    numbers.flat_map(move |j| {
        (0..lanes).filter(move |&lane| wanted[lane] >> j & 1 == 1).map(move |lane| (lane, j))
    })
}
