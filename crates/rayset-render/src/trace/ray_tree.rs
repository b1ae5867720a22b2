//! The rays of several tiles: those of one generation, and the next, which mirrors and glass make
//! of it.
//!
//! Where a generation is large, half of its pixels wait until the others and all that follows from
//! them are done. So there are never many rays at a time, and none is traced twice. The light of a
//! pixel is added in the same order, whatever waits: generation by generation, and in each by the
//! numbers of the rays.

use super::bounce::{TreeRay, most_rays_of_a_pixel};
use super::secondary::coherent_groups;
use crate::field::LANES;
use crate::scene::RayMaker;
use rayset_base::geometry::Ray;

/// Most rays that are held at a time if those of the next generation belong to several pixels.
const MOST_RAYS: usize = 2816;
/// Of more rays than this, half of the pixels wait.
const WIDEST: usize = 1024;
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
    // Besides one pixel's, which cannot be halved, others may wait.
    let rays = MOST_RAYS + 2 * most_rays_of_a_pixel(max_depth);
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
    /// Rays that wait, then the generation that is being traced, then the next.
    rays: Vec<Successor>,
    /// Where those begin that wait for the same.
    waiting: Vec<usize>,
    /// Where the generation that is being traced begins, and the number of its rays.
    first: usize,
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
        self.waiting.clear();
        (self.first, self.traced) = (0, 0);
        self.seen.clear();
    }

    /// Makes the rays of a sheet the ones to trace, as those of sheet `at`; the successors of
    /// others are kept. None may wait.
    pub(super) fn add_sheet(&mut self, sheet: &Sheet, rays: &RayMaker, at: usize) {
        self.seen.resize((at + 1) * LANES, PixelLight::default());
        let primary = (0..).zip(sheet).map(|(order, &PrimaryRay { ray, sample_offset, pixel })| {
            let number = (at * LANES + pixel) as u32;
            let ray = TreeRay::primary(ray, sample_offset, number, rays.footprint(&ray));
            Successor { ray, parent: 0, order }
        });
        self.rays.splice(..self.traced, primary);
        self.traced = sheet.len();
    }

    /// Makes the next generation the one to trace, or if there is none, rays that wait. Returns
    /// whether there are any.
    pub(super) fn advance(&mut self) -> bool {
        self.rays.drain(self.first..self.first + self.traced);
        if self.rays.len() == self.first
            && let Some(first) = self.waiting.pop()
        {
            self.first = first;
        }
        self.traced = self.rays.len() - self.first;
        if self.traced > WIDEST {
            self.halve();
        }
        self.traced > 0
    }

    /// The rays of the generation that is being traced.
    pub(super) fn generation(&self) -> &[Successor] {
        &self.rays[self.first..self.first + self.traced]
    }

    /// Number of rays in the next generation, so far.
    pub(super) fn following(&self) -> usize {
        self.rays.len() - self.first - self.traced
    }

    /// Whether any rays wait.
    pub(super) fn some_wait(&self) -> bool {
        !self.waiting.is_empty()
    }

    /// Lets half of the pixels of the generation wait, as if they had not been traced; nothing if
    /// it is of one. Of those that follow, `known` are of others and stay.
    pub(super) fn start_with_half(&mut self, known: usize) {
        self.rays.truncate(self.first + self.traced + known);
        self.halve();
    }

    fn halve(&mut self) {
        let Some(pixel) = self.middle_pixel() else { return };
        let generation = &mut self.rays[self.first..self.first + self.traced];
        generation.sort_unstable_by_key(|s| (s.ray.pixel < pixel, s.parent, s.order));
        let waiting = generation.partition_point(|s| s.ray.pixel >= pixel);
        self.waiting.push(self.first);
        self.first += waiting;
        self.traced -= waiting;
    }

    /// The pixel from which on they are about half of those of the generation, not the first of
    /// them; `None` if there is but one.
    fn middle_pixel(&self) -> Option<u32> {
        let mut pixels: Vec<u32> = self.generation().iter().map(|s| s.ray.pixel).collect();
        pixels.sort_unstable();
        let first = *pixels.first()?;
        let middle = pixels[pixels.len() / 2];
        if middle > first { Some(middle) } else { pixels.into_iter().find(|&pixel| pixel > first) }
    }

    /// Whether the rays of the generation are of several pixels.
    pub(super) fn is_of_several_pixels(&self) -> bool {
        self.generation().windows(2).any(|two| two[0].ray.pixel != two[1].ray.pixel)
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
        let (held, next) = self.rays.split_at_mut(self.first + self.traced);
        for (Successor { ray, .. }, end) in held[self.first..].iter().zip(&self.ends) {
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
        let generation = self.generation();
        if generation.first().is_some_and(|first| first.ray.is_primary()) {
            return vec![in_order(generation.len()).collect()];
        }
        let mut order: Vec<usize> = (0..generation.len()).collect();
        let octant = |i: usize| generation[i].ray.octant();
        order.sort_by_key(|&i| octant(i));
        let mut packets = Vec::new();
        for same in order.chunk_by(|&a, &b| octant(a) == octant(b)) {
            let ray = |i: usize| &generation[i].ray.ray;
            let longest = same.iter().map(|&i| generation[i].ray.step_world).fold(0.0, f64::max);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Camera;
    use proptest::prelude::*;
    use rayset_base::geometry::DVec3;

    /// A number from 0 to 1, the same for the same numbers.
    fn number(of: f64, and: usize) -> f64 {
        let mixed = (of * 7919.0 + and as f64 * 104_729.0 + 17.0).sin() * 43_758.5;
        mixed - mixed.floor()
    }

    /// Traces made-up rays of some sheets, of which each has `most` successors at most and is known
    /// by its sample offset; returns the light of all pixels, and how many rays were traced. In
    /// some attempts, `fails` of all, too many follow.
    fn traced(sheets: &[Vec<usize>], generations: usize, most: usize, fails: f64) -> (Vec<[u32; 4]>, usize) {
        let camera = Camera::look_at(DVec3::Z, DVec3::ZERO, DVec3::Y, 1.0);
        let maker = camera.ray_maker(8, 8).expect("a camera");
        let (mut tree, mut traced, mut attempts) = (RayTree::with_room(), 0, 0);
        tree.begin();
        let mut generation = |tree: &mut RayTree| {
            let known = tree.following();
            loop {
                attempts += 1;
                tree.ends = vec![End::default(); tree.generation().len()];
                let can_fail = tree.is_of_several_pixels();
                for members in tree.packets(1.0) {
                    for i in members {
                        let ray = tree.generation()[i].ray;
                        let color = [0, 1, 2].map(|channel| number(ray.sample_offset, channel) as f32);
                        tree.ends[i] = End { color, open: number(ray.sample_offset, 3) };
                        let weight_of_next = ray.weight * 0.7;
                        let many = (number(ray.sample_offset, 4) * (most + 1) as f64) as usize;
                        let is_last = weight_of_next < 0.7_f64.powi(generations as i32);
                        for next in 0..if is_last { 0 } else { many } {
                            let sample_offset = number(ray.sample_offset, 5 + next);
                            let mut next = ray;
                            (next.sample_offset, next.weight) = (sample_offset, weight_of_next);
                            tree.follow(next, i);
                        }
                    }
                }
                if !can_fail || number(f64::from(attempts), 1) >= fails {
                    traced += tree.generation().len();
                    return tree.gather(known, None);
                }
                tree.start_with_half(known);
            }
        };
        for (at, pixels) in sheets.iter().enumerate() {
            let rays = pixels.iter().map(|&pixel| PrimaryRay {
                ray: maker.ray(f64::from(pixel as u32), 0.0),
                sample_offset: number((at * LANES + pixel) as f64, 9),
                pixel,
            });
            tree.add_sheet(&rays.collect(), &maker, at);
            generation(&mut tree);
            while (tree.some_wait() || at + 1 == sheets.len()) && tree.advance() {
                generation(&mut tree);
            }
        }
        let bits = |light: PixelLight| {
            let [r, g, b] = light.color.map(f32::to_bits);
            [r, g, b, (light.open as f32).to_bits()]
        };
        ((0..sheets.len()).flat_map(|at| tree.seen_by(at)).map(bits).collect(), traced)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]
        #[test]
        fn pixels_have_the_same_light_whatever_waits_and_no_ray_is_traced_twice(
            (sheets, pixels) in (1_usize..4, 1_usize..=64),
            generations in 0_usize..9,
            most in 1_usize..4,
            fails in prop::sample::select(vec![0.0, 0.3]),
        ) {
            let sheets: Vec<Vec<usize>> = (0..sheets).map(|_| (0..pixels).collect()).collect();
            let (light, rays) = traced(&sheets, generations, most, fails);
            let mut alone = 0;
            for (at, sheet) in sheets.iter().enumerate() {
                for &pixel in sheet {
                    let mut only = vec![Vec::new(); at];
                    only.push(vec![pixel]);
                    let (own, rays) = traced(&only, generations, most, 0.0);
                    alone += rays;
                    prop_assert_eq!(own[at * LANES + pixel], light[at * LANES + pixel], "{} {}", at, pixel);
                }
            }
            prop_assert_eq!(rays, alone);
        }
    }
}
