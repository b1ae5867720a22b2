//! Traces the rays of tiles, packet by packet, and each packet slab by slab: the loop that takes
//! nearly all of the time.

use super::access::{Access, Halt};
use super::bounce::{RefractionStates, TreeRay};
use super::cloud::Remaining;
use super::composite::{RayState, Shares};
use super::counts::RenderCounts;
use super::layers::Layers;
use super::march::{March, SlabVisitor};
use super::node_samples::NodeSamples;
use super::ray_tree::{End, MOST_SHEETS, RayTree, Sheet, Successor};
use super::shade::SlabToShade;
use super::shadow::Shadows;
use super::steps::StepRule;
use super::work::PixelMask;
use super::world::World;
use crate::field::{LANES, Packet, Slab};
use crate::scene::RayMaker;
use rayset_base::geometry::Ray;

/// The scratch memory of one thread.
pub(super) struct PacketTracer<'a> {
    world: &'a World,
    /// The rays of the view.
    rays: &'a RayMaker,
    steps: &'a StepRule,
    march: March<'a>,
    shadows: Option<Shadows<'a>>,
    refraction: Option<RefractionStates>,
    layers: Option<Layers>,
    tree: RayTree,
    shares: Shares,
    states: [RayState; LANES],
    counts: RenderCounts,
}

/// Whether all rays of a generation were traced.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Traced {
    Whole,
    /// Stopped, because too many rays follow.
    TooMany,
}

impl<'a> PacketTracer<'a> {
    pub(super) fn new(
        world: &'a World,
        (rays, steps): (&'a RayMaker, &'a StepRule),
        slab_samples: usize,
    ) -> Self {
        Self {
            world,
            rays,
            steps,
            march: March::new(&world.program, steps, slab_samples),
            shadows: world.shadows.as_ref().map(|world| Shadows::new(world, slab_samples)),
            refraction: world.bounces.map(RefractionStates::new),
            layers: (world.layers || world.lump_opacity.is_some())
                .then(|| Layers::new(world.all_layers, world.lump_opacity)),
            tree: if world.bounces.is_some() { RayTree::with_room() } else { RayTree::default() },
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

    /// The layers of the tile that is being traced, if they are gathered.
    pub(super) fn layers(&mut self) -> Option<&mut Layers> {
        self.layers.as_mut()
    }

    /// Counts the errors of pixels of a finished tile.
    pub(super) fn count_errors(&mut self, traced: PixelMask, count: usize) {
        let Some(layers) = self.layers.as_ref().filter(|_| self.world.lump_opacity.is_some()) else { return };
        let bounds: Vec<f32> = layers.bounds_of_errors(count).collect();
        traced.pixels().for_each(|pixel| self.counts.lod_errors.add(bounds[pixel]));
    }

    /// Traces sheets of primary rays and the rays that follow from them. `make` fills the sheet of
    /// a number; `done` is given the number of a sheet and what each of its rays sees, in the order
    /// of the sheets.
    ///
    /// Layers are gathered by pixel of a tile, sheet by sheet: with layers, there is one sheet at a
    /// time.
    ///
    /// Rays that follow from several sheets are traced together: mirrored rays of one tile go in
    /// all directions, and few of them one way. The light of rays is added generation by generation
    /// in the order of their parents, so that sums do not depend on how rays form packets.
    pub(super) fn trace(
        &mut self,
        access: Access<'_>,
        sheets: usize,
        make: impl Fn(usize, &mut Sheet),
        done: impl FnMut(usize, [[f32; 4]; LANES]),
    ) -> Result<(), Halt> {
        let mut tree = std::mem::take(&mut self.tree);
        let access = Access { sight: Some(self.rays.sight()), ..access };
        let outcome = self.sheets(access, &mut tree, sheets, make, done);
        self.tree = tree;
        outcome
    }

    fn sheets(
        &mut self,
        access: Access<'_>,
        tree: &mut RayTree,
        sheets: usize,
        make: impl Fn(usize, &mut Sheet),
        mut done: impl FnMut(usize, [[f32; 4]; LANES]),
    ) -> Result<(), Halt> {
        let (mut first, mut sheet) = (0, Sheet::with_capacity(LANES));
        tree.begin();
        for number in 0..sheets {
            make(number, &mut sheet);
            tree.add_sheet(&sheet, self.rays, number - first);
            self.generation(access, tree)?;
            let is_last = number + 1 == sheets || number + 1 - first == MOST_SHEETS;
            let is_enough = is_last || tree.is_full() || tree.some_wait();
            if !is_enough && self.world.bounces.is_some() {
                continue;
            }
            while tree.advance() {
                self.generation(access, tree)?;
            }
            for one in first..=number {
                let seen = tree.seen_by(one - first);
                if let Some(layers) = &mut self.layers {
                    sheet.iter().for_each(|of| layers.hide(of.pixel, 1.0 - seen[of.pixel].open as f32));
                }
                done(one, seen.map(|seen| self.world.pixel(&seen)));
            }
            first = number + 1;
            tree.begin();
        }
        Ok(())
    }

    /// Traces the rays of a generation, or of half of its pixels, and so on, if too many would
    /// follow.
    fn generation(&mut self, access: Access<'_>, tree: &mut RayTree) -> Result<(), Halt> {
        let known = tree.following();
        // Only rays from the eye have layers.
        let are_primary = tree.generation().first().is_some_and(|first| first.ray.is_primary());
        let layers_before = self.layers.as_ref().filter(|_| are_primary).cloned();
        while self.attempt(access, tree)? == Traced::TooMany {
            if layers_before.is_some() {
                self.layers.clone_from(&layers_before);
            }
            tree.start_with_half(known);
        }
        Ok(())
    }

    /// Traces the rays of a generation and adds their light; collects their successors. Stops if
    /// they are too many and half of the pixels could wait.
    fn attempt(&mut self, access: Access<'_>, tree: &mut RayTree) -> Result<Traced, Halt> {
        let (known, is_limited) = (tree.following(), tree.is_of_several_pixels());
        tree.ends.clear();
        tree.ends.resize(tree.generation().len(), End::default());
        let packets = tree.packets(self.steps.coarsest_world());
        self.ask_ahead(access, tree, &packets);
        for members in packets {
            self.packet(access, tree, &members)?;
            if is_limited && tree.has_too_many() {
                return Ok(Traced::TooMany);
            }
        }
        access.end_if_lacking()?;
        tree.gather(known, self.world.background);
        Ok(Traced::Whole)
    }

    /// Asks for the pages that rays will need. Those of rays from the eye have been looked for
    /// before: they are only if that did not suffice.
    fn ask_ahead(&self, access: Access<'_>, tree: &RayTree, packets: &[Vec<usize>]) {
        let generation = tree.generation();
        let Some(reach) = access.foresees else { return };
        let is_known = |first: &Successor| first.ray.is_primary() && reach <= 1.0;
        if generation.first().is_none_or(is_known) {
            return;
        }
        let rays: Vec<Vec<Ray>> =
            packets.iter().map(|members| members.iter().map(|&i| generation[i].ray.ray).collect()).collect();
        self.world.foresight.ask(&self.world.program, access, rays.iter().map(Vec::as_slice));
    }

    /// Traces one packet; adds the results of its rays and their successors to the tree.
    fn packet(&mut self, access: Access<'_>, tree: &mut RayTree, members: &[usize]) -> Result<(), Halt> {
        let rays: Vec<TreeRay> = members.iter().map(|&i| tree.generation()[i].ray).collect();
        let lanes: Vec<(Ray, f64)> = rays.iter().map(|ray| (ray.ray, ray.sample_offset)).collect();
        let mut refraction = self.refraction.take();
        if let Some(refraction) = &mut refraction {
            refraction.begin(rays.iter().copied());
        }
        self.states.fill(RayState::START);
        if let Some(shadows) = &mut self.shadows {
            shadows.begin(rays.iter().map(|ray| (ray.footprint, ray.weight as f32)));
        }
        self.counts.packets += 1;
        let before = self.counts;
        let places: Vec<usize> = rays.iter().map(|ray| ray.pixel as usize % LANES).collect();
        let is_primary = rays[0].is_primary();
        let mut light = LightOfPacket {
            world: self.world,
            access,
            layers: self.layers.as_mut().filter(|_| is_primary),
            pixels: &places,
            shadows: self.shadows.as_mut(),
            refraction: refraction.as_mut(),
            states: &mut self.states,
            shares: &mut self.shares,
            counts: &mut self.counts,
        };
        let outcome = self.march.slabs(access, &lanes, &mut light).map(|going| light.end(going));
        if let Some(refraction) = &refraction {
            for &(lane, ray) in refraction.next() {
                tree.follow(ray, members[lane]);
            }
        }
        self.refraction = refraction;
        let replaced = outcome?;
        if is_primary {
            self.counts.rays += members.len() as u64;
        } else {
            self.counts.bounced_rays += members.len() as u64;
            let shadows = self.counts.shadow_splats - before.shadow_splats;
            self.counts.bounced_splats += self.counts.splats - before.splats - shadows;
        }
        for (lane, &i) in members.iter().enumerate() {
            let RayState { color, transmittance } = self.states[lane];
            let flat =
                self.world.shader.flat_color().map(|flat| flat.map(|v| v * (1.0 - transmittance as f32)));
            let open = if replaced >> lane & 1 == 1 { 0.0 } else { transmittance };
            tree.ends[i] = End { color: flat.unwrap_or(color), open };
        }
        Ok(())
    }
}

/// The light of the rays of a packet, while they are traced.
struct LightOfPacket<'t, 'a> {
    world: &'t World,
    access: Access<'t>,
    /// If layers are gathered, and these rays are primary.
    layers: Option<&'t mut Layers>,
    /// The pixel of the tile that each ray is of.
    pixels: &'t [usize],
    shadows: Option<&'t mut Shadows<'a>>,
    refraction: Option<&'t mut RefractionStates>,
    states: &'t mut [RayState; LANES],
    shares: &'t mut Shares,
    counts: &'t mut RenderCounts,
}

impl SlabVisitor for LightOfPacket<'_, '_> {
    fn passed_nothing(&mut self, going: u64) -> u64 {
        let Some(refraction) = &mut self.refraction else { return 0 };
        refraction.leave(going, self.states)
    }

    fn remaining(&self, packet: &Packet) -> Option<Remaining> {
        self.world.absorption.remaining(packet, self.states)
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
        let world = self.world;
        self.counts.slabs += 1;
        self.counts.samples += u64::from(going.count_ones()) * slab.samples as u64;
        if let Some(refraction) = &mut self.refraction {
            refraction.bend(packet, slab, node, going, world.shader.constants());
        }
        let mut going = world.absorption.absorb(packet, slab, node, going, self.states, self.shares);
        self.counts.nonzero_samples += self.shares.count();
        if let Some(layers) = &mut self.layers {
            let pixels = self.pixels;
            layers.gather(packet, slab, node, self.shares, world.shader.constants(), |lane| pixels[lane]);
        }
        if world.shader.flat_color().is_none() && self.shares.lanes() != 0 {
            self.shade(packet, slab, node)?;
        }
        if let Some(refraction) = &mut self.refraction {
            going &= !refraction.follow(going, self.states);
        }
        Ok(going)
    }
}

impl LightOfPacket<'_, '_> {
    /// Adds the light of the samples of a slab to their rays.
    fn shade(&mut self, packet: &Packet, slab: Slab, node: &NodeSamples) -> Result<(), Halt> {
        let (shader, none) = (&self.world.shader, Vec::new());
        let shadows = match &mut self.shadows {
            Some(shadows) => {
                let before = self.counts.splats;
                let rows = shadows.find(self.access, packet, slab, node, self.shares, self.counts)?;
                self.counts.shadow_splats += self.counts.splats - before;
                rows
            }
            None => &none,
        };
        let shown = SlabToShade { packet, slab, node, shares: self.shares, shadows };
        shader.shade(shown, self.refraction.as_deref_mut(), self.states);
        Ok(())
    }

    /// Ends the rays in `going`, which leave everything. Returns the lanes of rays that successors
    /// have replaced.
    fn end(self, going: u64) -> u64 {
        let Some(refraction) = self.refraction else { return 0 };
        refraction.leave(going, self.states);
        refraction.end_mirrors(self.states);
        refraction.replaced()
    }
}
