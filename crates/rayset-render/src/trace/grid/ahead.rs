//! The bricks that rays are expected to need: from where rays are and from the ranges of values of
//! bricks, without any brick.

use std::collections::HashMap;

use super::placement::Placement;
use super::volume::GridVolume;
use rayset_base::geometry::{DVec3, Ray};
use rayset_store::working_set::{PageClient, PageGuard};

/// Places are looked at so many times on the way through a brick.
const PLACES_IN_BRICK: f64 = 4.0;
/// At most so many on a ray: in a grid of more bricks, some are met unexpectedly.
const MOST_PLACES: f64 = 512.0;
/// At most so many bricks are found at a time: a picture that needs more between two of its tiles
/// is not helped by a list of them.
const MOST_BRICKS: usize = 1 << 14;
/// Rays between those that are given are looked for at most so many bricks away.
const MOST_MARGIN: f64 = 2.0;

/// The pages of a grid that rays are expected to need.
#[derive(Default)]
pub(in crate::trace) struct PagesAhead {
    /// Bricks, nearest first.
    pub(in crate::trace) bricks: Vec<u32>,
    /// Ranges of bricks on the way that are not in memory: of these, all are expected to be needed.
    pub(in crate::trace) absent_ranges: Vec<u32>,
    /// Places in bricks that show anything: the index of the ray, and the distance.
    pub(in crate::trace) met: Vec<(usize, f32)>,
}

impl GridVolume {
    /// The pages that rays are expected to need, up to where their optical depth is at least
    /// `opaque`. There may be others within `gap` of each, which is given at a distance; world
    /// space.
    pub(in crate::trace) fn pages_ahead(
        &self,
        pages: &PageClient,
        rays: &[Ray],
        gap: impl Fn(f64) -> f64 + Copy,
        opaque: f32,
    ) -> PagesAhead {
        let placement = &self.field().placement;
        let mut walk = Walk {
            volume: self,
            pages,
            ranges: HashMap::new(),
            nearest: HashMap::new(),
            met: Vec::new(),
            absent: Vec::new(),
        };
        for (number, ray) in rays.iter().enumerate() {
            walk.follow(placement, (number, ray), gap, opaque);
        }
        let mut bricks: Vec<(f32, u32)> = walk.nearest.iter().map(|(&brick, &t)| (t, brick)).collect();
        bricks.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        PagesAhead {
            bricks: bricks.into_iter().map(|(_, brick)| brick).collect(),
            absent_ranges: walk.absent,
            met: walk.met,
        }
    }
}

/// The brick of a place, which is given in bricks.
fn at(placement: &Placement, place: DVec3) -> [u32; 3] {
    std::array::from_fn(|axis| {
        place[axis].floor().clamp(0.0, f64::from(placement.bricks.count[axis].saturating_sub(1))) as u32
    })
}

struct Walk<'a> {
    volume: &'a GridVolume,
    pages: &'a PageClient,
    /// Pages of ranges; `None` if they are not in memory.
    ranges: HashMap<u32, Option<PageGuard>>,
    /// Bricks that show anything, each with the least distance of a ray that meets it.
    nearest: HashMap<u32, f32>,
    met: Vec<(usize, f32)>,
    absent: Vec<u32>,
}

impl Walk<'_> {
    fn follow(
        &mut self,
        placement: &Placement,
        (number, ray): (usize, &Ray),
        gap: impl Fn(f64) -> f64 + Copy,
        opaque: f32,
    ) {
        let map = &placement.voxel_from_world;
        let ray =
            Ray { origin: map.transform_point3(ray.origin), direction: map.transform_vector3(ray.direction) };
        let voxels_per_world = ray.direction.length();
        let cells = self.volume.brick_cells();
        let shortest = cells.min_element();
        let Some((enter, exit)) = placement.bounds_voxel.clip(&ray).filter(|_| voxels_per_world > 0.0) else {
            return;
        };
        let places =
            ((exit - enter) * voxels_per_world / shortest * PLACES_IN_BRICK).ceil().clamp(1.0, MOST_PLACES);
        let step = (exit - enter) / places;
        let (mut depth, mut last) = (0.0, None);
        for i in 0..places as u32 {
            let t = enter + (f64::from(i) + 0.5) * step;
            let margin = (gap(t) * voxels_per_world / cells).min(DVec3::splat(MOST_MARGIN));
            let place = ray.at(t) / cells;
            self.meet(placement, place, margin, t as f32);
            let brick = placement.bricks.number(at(placement, place));
            if last != Some(brick) && self.shows(brick) {
                self.met.push((number, t as f32));
            }
            last = Some(brick);
            depth += self.least_extinction(brick) * step as f32;
            if depth >= opaque {
                return;
            }
        }
    }

    /// Takes in the bricks around a place, which is given in bricks.
    fn meet(&mut self, placement: &Placement, place: DVec3, margin: DVec3, t: f32) {
        let (low, high) = (at(placement, place - margin), at(placement, place + margin));
        for z in low[2]..=high[2] {
            for y in low[1]..=high[1] {
                for x in low[0]..=high[0] {
                    let brick = placement.bricks.number([x, y, z]);
                    if let Some(nearest) = self.nearest.get_mut(&brick) {
                        *nearest = nearest.min(t);
                    } else if self.nearest.len() < MOST_BRICKS && self.shows(brick) {
                        self.nearest.insert(brick, t);
                    }
                }
            }
        }
    }

    /// Whether a brick may show anything; as far as is known.
    fn shows(&mut self, brick: u32) -> bool {
        self.range(brick).is_none_or(|(low, high)| self.volume.field().opacities.shows(low, high))
    }

    /// The least extinction that is certain in a brick; per unit of world space.
    fn least_extinction(&mut self, brick: u32) -> f32 {
        let Some((low, high)) = self.range(brick) else { return 0.0 };
        self.volume.field().opacities.least_optical_depth(low, high) / self.volume.unit_distance() as f32
    }

    /// The least and largest number of a brick, less the base; `None` if it is not in memory.
    fn range(&mut self, brick: u32) -> Option<(f32, f32)> {
        let page = self.volume.ranges_page(brick);
        let guard = self.ranges.entry(page).or_insert_with(|| {
            let guard = self.pages.peek(self.volume.pages(), page);
            if guard.is_none() {
                self.absent.push(page);
            }
            guard
        });
        guard.as_ref().map(|page| self.volume.range_of(page, brick))
    }
}
