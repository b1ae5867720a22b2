//! Traces the rays of a tile, packet by packet, and each packet slab by slab: the loop that takes nearly all of the
//! time.

use std::ops::Range;

use super::access::{Access, Halt};
use super::bounce::{RefractionStates, TreeRay, most_rays_of_a_pixel};
use super::composite::{RayState, Shares};
use super::counts::RenderCounts;
use super::layers::Layers;
use super::march::March;
use super::node_samples::NodeSamples;
use super::secondary::coherent_groups;
use super::shade::Shown;
use super::shadow::Shadows;
use super::world::World;
use crate::field::{LANES, Packet, Slab};
use crate::geometry::Ray;
use crate::scene::RayMaker;

/// The scratch memory of one thread.
pub(super) struct PacketTracer<'a> {
    world: &'a World,
    /// The rays of the view.
    rays: &'a RayMaker,
    march: March<'a>,
    shadows: Option<Shadows<'a>>,
    refraction: Option<RefractionStates>,
    layers: Option<Layers>,
    tree: Tree,
    shares: Shares,
    states: [RayState; LANES],
    counts: RenderCounts,
}

/// Most rays, of one generation and the next, that are held at a time if they belong to several pixels.
const MOST_RAYS: usize = 2048;
/// Bytes for each of them: the ray twice, its result, and its place in a packet.
const RAY_BYTES: usize = 3 * size_of::<(usize, TreeRay)>();

/// The most bytes that the rays of a tile take.
pub(super) fn tree_bytes(max_depth: u32) -> u64 {
    ((MOST_RAYS + LANES).max(2 * most_rays_of_a_pixel(max_depth)) * RAY_BYTES) as u64
}

/// One generation of rays, and the next. Kept from tile to tile: allocating and freeing it in between pages would
/// fragment the heap, and the process would exceed its budget.
#[derive(Default)]
struct Tree {
    rays: Vec<TreeRay>,
    ends: Vec<End>,
    /// Each with the index of the ray that it comes from.
    next: Vec<(usize, TreeRay)>,
}

/// Whether all rays of a generation were traced.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Traced {
    Whole,
    /// Stopped, because too many rays follow.
    TooMany,
}

/// The result of a ray.
#[derive(Clone, Copy, Default)]
struct End {
    color: [f32; 3],
    /// The fraction of the background that it sees.
    open: f64,
}

impl<'a> PacketTracer<'a> {
    pub(super) fn new(world: &'a World, rays: &'a RayMaker, slab_samples: usize) -> Self {
        Self {
            world,
            rays,
            march: March::new(&world.program, slab_samples),
            shadows: world.shadows.as_ref().map(|world| Shadows::new(world, slab_samples)),
            refraction: world.bounces.map(RefractionStates::new),
            layers: world.layers.then(Layers::new),
            tree: Tree::default(),
            shares: Shares::new(),
            states: [RayState::START; LANES],
            counts: RenderCounts::default(),
        }
    }

    pub(super) fn counts(&self) -> RenderCounts {
        self.counts
    }

    /// Resets the counts to `counts` and counts a deferred tile.
    pub(super) fn deferred(&mut self, counts: RenderCounts) {
        self.counts = RenderCounts { deferred: counts.deferred + 1, ..counts };
    }

    /// The layers of the tile that is being traced, if they are requested.
    pub(super) fn layers(&mut self) -> Option<&mut Layers> {
        self.layers.as_mut()
    }

    /// Traces at most 64 primary rays, each with its sample offset, and the rays that follow from them. Returns what
    /// each of them sees, in the order of `rays`.
    pub(super) fn trace(
        &mut self,
        access: Access<'_>,
        rays: &[(Ray, f64)],
    ) -> Result<[[f32; 4]; LANES], Halt> {
        let mut seen = [Seen::default(); LANES];
        self.pixels(access, rays, 0..rays.len(), &mut seen)?;
        if let Some(layers) = &mut self.layers {
            (0..rays.len()).for_each(|pixel| layers.hide(pixel, 1.0 - seen[pixel].open as f32));
        }
        Ok(seen.map(|seen| seen.pixel(self.world.background)))
    }

    /// Traces some of the primary rays: together, or half of them at a time if too many rays would follow.
    fn pixels(
        &mut self,
        access: Access<'_>,
        rays: &[(Ray, f64)],
        pixels: Range<usize>,
        seen: &mut [Seen; LANES],
    ) -> Result<(), Halt> {
        let before = self.layers.clone();
        let mut tree = std::mem::take(&mut self.tree);
        tree.rays.clear();
        tree.rays.extend(pixels.clone().map(|pixel| {
            let (ray, sample_offset) = rays[pixel];
            TreeRay::primary(ray, sample_offset, pixel as u32, self.rays.footprint(&ray))
        }));
        let mut outcome = Ok(Traced::Whole);
        // Generation by generation, adding the light of rays in their order: sums do not depend on how rays form
        // packets.
        while !tree.rays.is_empty() && matches!(outcome, Ok(Traced::Whole)) {
            outcome = self.generation(access, &mut tree, seen, pixels.len());
        }
        self.tree = tree;
        if outcome? == Traced::Whole {
            return Ok(());
        }
        self.layers = before;
        seen[pixels.clone()].fill(Seen::default());
        let middle = pixels.start + pixels.len() / 2;
        self.pixels(access, rays, pixels.start..middle, seen)?;
        self.pixels(access, rays, middle..pixels.end, seen)
    }

    /// Traces one generation of rays, which belong to `pixels` pixels, and makes the next one from their successors.
    fn generation(
        &mut self,
        access: Access<'_>,
        tree: &mut Tree,
        seen: &mut [Seen; LANES],
        pixels: usize,
    ) -> Result<Traced, Halt> {
        tree.ends.clear();
        tree.ends.resize(tree.rays.len(), End::default());
        tree.next.clear();
        for (step, members) in self.packets(access, &tree.rays)? {
            self.packet(access, tree, &members, step)?;
            if pixels > 1 && tree.rays.len() + tree.next.len() > MOST_RAYS {
                return Ok(Traced::TooMany);
            }
        }
        for (ray, end) in tree.rays.iter().zip(&tree.ends) {
            seen[ray.pixel as usize].add(ray, end, self.world.background);
        }
        tree.next.sort_by_key(|(parent, _)| *parent);
        tree.rays.clear();
        tree.rays.extend(tree.next.iter().map(|(_, ray)| ray));
        Ok(Traced::Whole)
    }

    /// Groups rays into packets: the step and the members of each.
    fn packets(&self, access: Access<'_>, rays: &[TreeRay]) -> Result<Vec<(f64, Vec<usize>)>, Halt> {
        let places: Vec<(Ray, f64)> = rays.iter().map(|r| (r.ray, r.sample_offset)).collect();
        let steps = &self.world.steps;
        if rays[0].is_primary() {
            let groups = steps.groups(access, &self.world.program, &places)?;
            return Ok(groups.into_iter().map(|group| (group.step, group.members)).collect());
        }
        let mut packets = Vec::new();
        let mut order: Vec<usize> = (0..rays.len()).collect();
        order.sort_by_key(|&i| rays[i].octant());
        for some in
            order.chunk_by(|&a, &b| rays[a].octant() == rays[b].octant()).flat_map(|same| same.chunks(LANES))
        {
            let some_places: Vec<(Ray, f64)> = some.iter().map(|&i| places[i]).collect();
            for group in steps.groups(access, &self.world.program, &some_places)? {
                let members: Vec<usize> = group.members.iter().map(|&i| some[i]).collect();
                packets.extend(
                    coherent_groups(&places, &members, group.step).into_iter().map(|m| (group.step, m)),
                );
            }
        }
        Ok(packets)
    }

    /// Traces one packet; stores the results of its rays in `ends` and their successors in `next`.
    fn packet(
        &mut self,
        access: Access<'_>,
        Tree { rays, ends, next }: &mut Tree,
        members: &[usize],
        step: f64,
    ) -> Result<(), Halt> {
        let lanes: Vec<(Ray, f64)> = members.iter().map(|&i| (rays[i].ray, rays[i].sample_offset)).collect();
        let packet = Packet::new(&lanes, step);
        let mut refraction = self.refraction.take();
        if let Some(refraction) = &mut refraction {
            refraction.begin(members.iter().map(|&i| rays[i]));
        }
        self.states.fill(RayState::START);
        if let Some(shadows) = &mut self.shadows {
            shadows.begin(members.iter().map(|&i| rays[i].footprint));
        }
        self.counts.packets += 1;
        let before = self.counts;
        self.march.begin(&packet);
        let mut node = self.march.node_samples();
        let places: Vec<usize> = members.iter().map(|&i| rays[i].pixel as usize).collect();
        let pixels = rays[members[0]].is_primary().then_some(&places[..]);
        let outcome = self.pass(access, &packet, pixels, refraction.as_mut(), &mut node);
        self.march.give_back(node);
        if let Some(refraction) = &refraction {
            next.extend(refraction.next().iter().map(|&(lane, ray)| (members[lane], ray)));
        }
        self.refraction = refraction;
        let replaced = outcome?;
        if !rays[members[0]].is_primary() {
            self.counts.bounced_rays += members.len() as u64;
            let shadows = self.counts.shadow_splats - before.shadow_splats;
            self.counts.bounced_splats += self.counts.splats - before.splats - shadows;
        }
        for (lane, &i) in members.iter().enumerate() {
            let RayState { color, transmittance } = self.states[lane];
            let flat =
                self.world.shader.flat_color().map(|flat| flat.map(|v| v * (1.0 - transmittance as f32)));
            let open = if replaced >> lane & 1 == 1 { 0.0 } else { transmittance };
            ends[i] = End { color: flat.unwrap_or(color), open };
        }
        Ok(())
    }

    /// Traces a packet slab by slab, front to back, until all rays have ended or nothing is left ahead. Returns the
    /// lanes of rays that successors have replaced. `pixels` are the pixels of primary rays; `None` for other rays.
    fn pass(
        &mut self,
        access: Access<'_>,
        packet: &Packet,
        pixels: Option<&[usize]>,
        mut refraction: Option<&mut RefractionStates>,
        node: &mut NodeSamples,
    ) -> Result<u64, Halt> {
        let world = self.world;
        let mut going = packet.all();
        let mut from = 0;
        while going != 0
            && let Some(slab) = self.march.next_slab(from)
        {
            if let Some(refraction) = &mut refraction
                && slab.first > from
            {
                going &= !refraction.leave(packet, going, &self.states);
            }
            from = slab.end();
            self.march.expect_ends(world.absorption.remaining(packet, &self.states));
            self.march.evaluate(access, packet, slab, going, &mut self.counts, node)?;
            self.counts.slabs += 1;
            self.counts.samples += u64::from(going.count_ones()) * slab.samples as u64;
            if let Some(refraction) = &mut refraction {
                refraction.bend(packet, slab, node, going, world.shader.constants());
            }
            going = world.absorption.absorb(packet, slab, node, going, &mut self.states, &mut self.shares);
            self.counts.nonzero_samples += self.shares.count();
            if let (Some(layers), Some(pixels)) = (&mut self.layers, pixels) {
                layers
                    .gather(packet, slab, node, &self.shares, world.shader.constants(), |lane| pixels[lane]);
            }
            if world.shader.flat_color().is_none() && self.shares.lanes() != 0 {
                self.shade(access, packet, slab, node, refraction.as_deref_mut())?;
            }
            if let Some(refraction) = &mut refraction {
                going &= !refraction.follow(going, &self.states);
            }
        }
        let Some(refraction) = refraction else { return Ok(0) };
        refraction.leave(packet, going, &self.states);
        refraction.end_mirrors(packet, &mut self.states);
        Ok(refraction.replaced())
    }

    /// Adds the light of the samples of a slab to their rays.
    fn shade(
        &mut self,
        access: Access<'_>,
        packet: &Packet,
        slab: Slab,
        node: &NodeSamples,
        refraction: Option<&mut RefractionStates>,
    ) -> Result<(), Halt> {
        let (shader, none) = (&self.world.shader, Vec::new());
        let shadows = match &mut self.shadows {
            Some(shadows) => {
                let before = self.counts.splats;
                let rows = shadows.find(access, packet, slab, node, &self.shares, &mut self.counts)?;
                self.counts.shadow_splats += self.counts.splats - before;
                rows
            }
            None => &none,
        };
        let shown = Shown { packet, slab, node, shares: &self.shares, shadows };
        shader.shade(shown, refraction, &mut self.states);
        Ok(())
    }
}

/// What is seen at a place of the picture.
#[derive(Clone, Copy, Default)]
struct Seen {
    color: [f32; 3],
    /// The fraction of the background that is seen.
    open: f64,
}

impl Seen {
    fn add(&mut self, ray: &TreeRay, end: &End, background: Option<[f32; 3]>) {
        let weight = ray.weight as f32;
        for channel in 0..3 {
            self.color[channel] += weight * end.color[channel];
        }
        if ray.covers {
            self.open += ray.weight * end.open;
        } else if let Some(background) = background {
            let open = (ray.weight * end.open) as f32;
            (0..3).for_each(|channel| self.color[channel] += open * background[channel]);
        }
    }

    fn pixel(&self, background: Option<[f32; 3]>) -> [f32; 4] {
        let (color, open) = (self.color, self.open as f32);
        match background {
            Some(background) => {
                let behind = |c: usize| color[c] + open * background[c];
                [behind(0), behind(1), behind(2), 1.0]
            }
            None => [color[0], color[1], color[2], 1.0 - open],
        }
    }
}
