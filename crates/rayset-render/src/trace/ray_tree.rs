//! The rays of several tiles: those of one generation, and the next, which mirrors and glass make
//! of it.

use std::ops::Range;

use super::bounce::{TreeRay, most_rays_of_a_pixel};
use super::secondary::coherent_groups;
use crate::field::LANES;
use crate::scene::RayMaker;
use rayset_base::geometry::Ray;

/// Most rays, of one generation and the next, that are held at a time if they belong to several
/// pixels.
const MOST_RAYS: usize = 2816;
/// Room for these, and for those of the packet after which they are too many.
const RAY_ROOM: usize = MOST_RAYS + 4 * LANES;
/// With so many rays that follow, no further sheet is begun: each of them may have about two
/// successors.
const ENOUGH_RAYS: usize = MOST_RAYS / 3;
/// Most sheets whose rays are traced together.
pub(super) const MOST_SHEETS: usize = 64;
/// Bytes for each ray and its result.
const RAY_BYTES: usize = size_of::<Successor>() + size_of::<End>();

/// The most bytes that the rays of some tiles take.
pub(super) fn tree_bytes(max_depth: u32) -> u64 {
    let rays = RAY_ROOM.max(2 * most_rays_of_a_pixel(max_depth));
    (rays * RAY_BYTES + MOST_SHEETS * LANES * size_of::<PixelLight>()) as u64
}

/// A ray from the eye.
#[derive(Clone, Copy)]
pub(super) struct PrimaryRay {
    pub(super) ray: Ray,
    /// In steps.
    pub(super) sample_offset: f64,
    /// The pixel of the tile, less than 64.
    pub(super) pixel: usize,
}

/// At most 64 primary rays of one tile, each of another pixel.
pub(super) type Sheet = Vec<PrimaryRay>;

/// One generation of rays, and the next. Kept from tile to tile: allocating and freeing it in
/// between pages would fragment the heap, and the process would exceed its budget.
#[derive(Default)]
pub(super) struct RayTree {
    /// The generation that is being traced, and behind it the next: one grows as the other is done,
    /// so that both need no more room than the larger of them and a few.
    rays: Vec<Successor>,
    /// Number of rays in the generation that is being traced.
    traced: usize,
    /// The results of these.
    pub(super) ends: Vec<End>,
    /// What the pixels of each sheet see, 64 for each.
    seen: Vec<PixelLight>,
}

/// A ray, and where it comes from.
#[derive(Clone, Copy)]
pub(super) struct Successor {
    pub(super) ray: TreeRay,
    /// Index of the ray that it comes from, in its generation.
    pub(super) parent: u32,
    /// Its number among the successors of one ray grows with the distance at which they arose.
    pub(super) order: u32,
}

/// The result of a ray.
#[derive(Clone, Copy, Default)]
pub(super) struct End {
    pub(super) color: [f32; 3],
    /// The fraction of the background that it sees.
    pub(super) open: f64,
}

impl RayTree {
    /// Sets memory aside for rays that follow from others, so that it does not grow by more than is
    /// needed.
    pub(super) fn with_room() -> Self {
        Self { rays: Vec::with_capacity(RAY_ROOM), ends: Vec::with_capacity(RAY_ROOM), ..Self::default() }
    }

    /// Forgets everything.
    pub(super) fn begin(&mut self) {
        self.rays.clear();
        self.traced = 0;
        self.seen.clear();
    }

    /// Makes the rays of a sheet the ones to trace, as those of sheet `at`; the successors of
    /// others are kept.
    pub(super) fn add_sheet(&mut self, sheet: &Sheet, rays: &RayMaker, at: usize) {
        self.seen.resize((at + 1) * LANES, PixelLight::default());
        self.start(sheet, rays, 0..sheet.len(), at);
    }

    /// Makes some rays of sheet `at` the only ones, as if they had not been traced before.
    pub(super) fn start_again(&mut self, sheet: &Sheet, rays: &RayMaker, some: Range<usize>, at: usize) {
        self.rays.truncate(self.traced);
        for primary in &sheet[some.clone()] {
            self.seen[at * LANES + primary.pixel] = PixelLight::default();
        }
        self.start(sheet, rays, some, at);
    }

    fn start(&mut self, sheet: &Sheet, rays: &RayMaker, some: Range<usize>, at: usize) {
        let primary = sheet[some.clone()].iter().map(|&PrimaryRay { ray, sample_offset, pixel }| {
            let number = (at * LANES + pixel) as u32;
            let ray = TreeRay::primary(ray, sample_offset, number, rays.footprint(&ray));
            Successor { ray, parent: 0, order: 0 }
        });
        self.rays.splice(..self.traced, primary);
        self.traced = some.len();
    }

    /// Makes the next generation the one to trace. Returns whether there is any.
    pub(super) fn advance(&mut self) -> bool {
        self.rays.drain(..self.traced);
        self.traced = self.rays.len();
        self.traced > 0
    }

    /// The rays of the generation that is being traced.
    pub(super) fn generation(&self) -> &[Successor] {
        &self.rays[..self.traced]
    }

    /// Number of rays in the next generation, so far.
    pub(super) fn following(&self) -> usize {
        self.rays.len() - self.traced
    }

    /// Adds a ray that follows from one of this generation, whose index is `parent`.
    pub(super) fn follow(&mut self, ray: TreeRay, parent: usize) {
        let (parent, order) = (parent as u32, self.following() as u32);
        self.rays.push(Successor { ray, parent, order });
    }

    /// Whether the rays that follow are enough to be traced.
    pub(super) fn is_full(&self) -> bool {
        self.following() >= ENOUGH_RAYS
    }

    pub(super) fn has_too_many(&self) -> bool {
        self.rays.len() > MOST_RAYS
    }

    /// Adds the light of the rays to their pixels, and sorts the successors from number `known` on
    /// by their parents.
    pub(super) fn gather(&mut self, known: usize, background: Option<[f32; 3]>) {
        let (generation, next) = self.rays.split_at_mut(self.traced);
        for (Successor { ray, .. }, end) in generation.iter().zip(&self.ends) {
            self.seen[ray.pixel as usize].add(ray, end, background);
        }
        next[known..].sort_unstable_by_key(|successor| (successor.parent, successor.order));
    }

    /// What the pixels of a sheet have seen.
    pub(super) fn seen_by(&self, at: usize) -> [PixelLight; LANES] {
        std::array::from_fn(|pixel| self.seen[at * LANES + pixel])
    }

    /// Groups the rays into packets: the members of each. Where rays begin at the eye, inside an
    /// object, their step there is taken to be `step_world`. Rays that have been turned
    /// are together if their directions are in the same octant and their first slabs near to each
    /// other.
    pub(super) fn packets(&self, step_world: f64) -> Vec<Vec<usize>> {
        if self.rays[0].ray.is_primary() {
            return vec![in_order(self.traced).collect()];
        }
        let mut order: Vec<usize> = (0..self.traced).collect();
        let octant = |i: usize| self.rays[i].ray.octant();
        order.sort_by_key(|&i| octant(i));
        let mut packets = Vec::new();
        for same in order.chunk_by(|&a, &b| octant(a) == octant(b)) {
            let ray = |i: usize| &self.rays[i].ray.ray;
            let longest = same.iter().map(|&i| self.rays[i].ray.step_world).fold(0.0, f64::max);
            let step = if longest > 0.0 { longest } else { step_world };
            packets.extend(coherent_groups(ray, same.to_vec(), step));
        }
        packets
    }
}

/// The indices of rays, such that neighbours follow each other: 64 rays are those of a tile of 8 ×
/// 8 pixels, row after row, and come in the order of a Z curve.
fn in_order(rays: usize) -> impl Iterator<Item = usize> {
    let even_bits = |i: usize| i & 1 | i >> 1 & 2 | i >> 2 & 4;
    (0..rays).map(move |i| if rays == LANES { even_bits(i) + 8 * even_bits(i >> 1) } else { i })
}

/// What is seen at a place of the picture.
#[derive(Clone, Copy, Default)]
pub(super) struct PixelLight {
    color: [f32; 3],
    /// The fraction of the background that is seen.
    pub(super) open: f64,
}

impl PixelLight {
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

    pub(super) fn pixel(&self, background: Option<[f32; 3]>) -> [f32; 4] {
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
