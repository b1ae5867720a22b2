//! Which bricks the samples of a slab are in: segments of rays within one brick, brick by brick.

use super::placement::Placement;
use super::places::Places;
use super::rays::GridRays;
use crate::field::{SLAB_SAMPLES, Slab};
use crate::trace::node_samples::Live;
use rayset_base::geometry::DVec3;

/// Samples of one ray in one brick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Segment {
    pub(super) lane: u8,
    /// A bit for each sample.
    pub(super) samples: u32,
    /// The next segment in the same brick; [`NONE`] behind the last.
    next: u16,
}

/// A brick that samples of a slab are in.
#[derive(Clone, Copy, Debug)]
pub(super) struct MetBrick {
    pub(super) number: u32,
    /// Its first live sample on any ray.
    first_sample: u32,
    /// The first and the last of its segments.
    segments: [u16; 2],
    /// Another brick of the same chain; [`NONE`] behind the last.
    next: u16,
}

/// The bricks of a slab with their segments.
pub(super) struct MetBricks {
    bricks: Vec<MetBrick>,
    segments: Vec<Segment>,
    /// For each chain, the brick that was met last.
    latest: [u16; CHAINS],
}

/// No segment or brick: there are at most 64 · 32 of either.
const NONE: u16 = u16::MAX;
/// Bricks are found again in chains, by their numbers.
const CHAINS: usize = 256;

/// Knuth's multiplicative hash: bricks above each other, whose numbers differ by powers of two, are
/// in different chains.
#[inline(always)]
fn chain(number: u32) -> usize {
    (number.wrapping_mul(0x9e37_79b1) >> 24) as usize
}

impl MetBricks {
    /// Bytes of one sample at most.
    pub(super) const BYTES_OF_SAMPLE: usize = size_of::<MetBrick>() + size_of::<Segment>();

    pub(super) fn new() -> Self {
        Self { bricks: Vec::new(), segments: Vec::new(), latest: [NONE; CHAINS] }
    }

    /// Finds where the samples of a slab are, and groups those in `live` that are inside the grid
    /// by brick; bricks by their first sample on any ray.
    #[inline(always)]
    pub(super) fn find(
        &mut self,
        grid: &Placement,
        rays: &GridRays,
        slab: Slab,
        live: &Live,
        places: &mut Places,
    ) {
        self.bricks.clear();
        self.segments.clear();
        self.latest.fill(NONE);
        let mut lanes = live.lanes();
        while lanes != 0 {
            let lane = lanes.trailing_zeros() as usize;
            lanes &= lanes - 1;
            let (first, end) = rays.within(lane, slab);
            if first < end {
                let bricks = places.locate(grid, &rays.ray(lane, slab), lane);
                self.add_ray(&bricks, lane, (first, end), live.0[lane]);
            }
        }
        self.bricks.sort_unstable_by_key(|brick| (brick.first_sample, brick.number));
    }

    /// The bricks, nearest first.
    pub(super) fn bricks(&self) -> &[MetBrick] {
        &self.bricks
    }

    /// The segments in a brick, ray by ray.
    #[inline(always)]
    pub(super) fn segments(&self, brick: &MetBrick) -> impl Iterator<Item = Segment> + Clone {
        let mut next = brick.segments[0];
        std::iter::from_fn(move || {
            let segment = self.segments.get(usize::from(next)).copied();
            next = segment.map_or(NONE, |segment| segment.next);
            segment
        })
    }

    /// Adds the segments of a ray, whose samples `first` to `end` − 1 are inside the grid.
    #[inline(always)]
    fn add_ray(
        &mut self,
        bricks: &[u32; SLAB_SAMPLES],
        lane: usize,
        (first, end): (usize, usize),
        live: u32,
    ) {
        let mut changes = 0;
        for j in 1..SLAB_SAMPLES {
            changes |= u32::from(bricks[j] != bricks[j - 1]) << j;
        }
        changes &= bits(first + 1, end);
        let mut from = first;
        while from < end {
            let to = if changes == 0 { end } else { changes.trailing_zeros() as usize };
            changes &= changes.wrapping_sub(1);
            let samples = bits(from, to) & live;
            if samples != 0 {
                self.add(bricks[from % SLAB_SAMPLES], Segment { lane: lane as u8, samples, next: NONE });
            }
            from = to;
        }
    }

    #[inline(always)]
    fn add(&mut self, number: u32, segment: Segment) {
        let (own, first_sample) = (self.segments.len() as u16, segment.samples.trailing_zeros());
        self.segments.push(segment);
        let latest = &mut self.latest[chain(number)];
        let mut at = *latest;
        while let Some(brick) = self.bricks.get_mut(usize::from(at)) {
            if brick.number == number {
                self.segments[usize::from(brick.segments[1])].next = own;
                brick.segments[1] = own;
                brick.first_sample = brick.first_sample.min(first_sample);
                return;
            }
            at = brick.next;
        }
        let next = std::mem::replace(latest, self.bricks.len() as u16);
        self.bricks.push(MetBrick { number, first_sample, segments: [own; 2], next });
    }
}

/// The bricks that the samples of a slab lie in, or some more: the first and the last along each
/// axis. `None` if no sample is inside the grid.
#[inline(always)]
pub(super) fn bricks_met(grid: &Placement, rays: &GridRays, slab: Slab, lanes: u64) -> Option<[[u32; 2]; 3]> {
    let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    let mut lanes = lanes;
    while lanes != 0 {
        let lane = lanes.trailing_zeros() as usize;
        lanes &= lanes - 1;
        let (first, end) = rays.within(lane, slab);
        if first < end {
            let ray = rays.ray(lane, slab);
            let (a, b) = (ray.place(first), ray.place(end - 1));
            (low, high) = (low.min(a.min(b)), high.max(a.max(b)));
        }
    }
    if low.x > high.x {
        return None;
    }
    let last_cell = grid.bounds_voxel.max - 1.0;
    let brick = |place: f64, axis: usize| {
        place.floor().max(0.0).min(last_cell[axis]) as u32 / grid.bricks.shape.cells(axis) as u32
    };
    Some([0, 1, 2].map(|axis| [brick(low[axis], axis), brick(high[axis], axis)]))
}

/// Bits `first` to `end` − 1.
#[inline(always)]
fn bits(first: usize, end: usize) -> u32 {
    let below = |n: usize| if n >= 32 { u32::MAX } else { (1 << n) - 1 };
    below(end) & !below(first)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::Packet;
    use crate::trace::grid::placement::Bricks;
    use crate::trace::grid::volume::tests::header;
    use rayset_base::geometry::{Aabb, DAffine3, Ray};
    use rayset_files::grid::format::VoxelKind;

    #[test]
    fn segments_hold_every_live_sample_in_the_grid_once_nearest_bricks_first() {
        let header = header([90, 70, 50], VoxelKind::F32);
        let bounds = Aabb::new(DVec3::ZERO, header.last_voxel());
        let grid = Placement {
            voxel_from_world: DAffine3::IDENTITY,
            bounds_voxel: bounds,
            bricks: Bricks::new(&header),
        };
        let rays: Vec<(Ray, f64)> = (0..64)
            .map(|i| {
                let to = DVec3::new(40.0 + f64::from(i % 8), 30.0 + f64::from(i / 8), 20.0);
                let origin = DVec3::new(-20.0, -31.0, 90.0);
                (Ray { origin, direction: (to - origin).normalize() }, f64::from(i) / 64.0)
            })
            .collect();
        let packet = Packet::new(&rays, 1.7);
        let mut live = Live::of(u64::MAX);
        live.0[5] = 0x00ff_ff00;
        live.0[6] = 0;
        let (mut found, mut places) = (MetBricks::new(), Places::new());
        let in_voxels = GridRays::new(&grid, &packet);
        for number in 0..5 {
            let slab = Slab { first: 32 * number, samples: SLAB_SAMPLES, level: 0 };
            found.find(&grid, &in_voxels, slab, &live, &mut places);
            let mut covered = [0_u32; 64];
            for brick in found.bricks() {
                for segment in found.segments(brick) {
                    let lane = usize::from(segment.lane);
                    assert_eq!(covered[lane] & segment.samples, 0, "no sample twice");
                    covered[lane] |= segment.samples;
                    let ray = in_voxels.ray(lane, slab);
                    for j in (0..SLAB_SAMPLES).filter(|j| segment.samples >> j & 1 == 1) {
                        let at = ray.place(j).to_array().map(|place| place as u32 / 17);
                        assert_eq!(grid.bricks.number(at), brick.number);
                    }
                }
            }
            for lane in 0..64 {
                for j in 0..SLAB_SAMPLES {
                    let place = packet.ray(lane).at(packet.sample_t_world(lane, slab.first + j as u64));
                    let expected = bounds.contains(place) && live.0[lane] >> j & 1 == 1;
                    assert_eq!(covered[lane] >> j & 1 == 1, expected, "lane {lane}, sample {j}");
                }
            }
            if let Some(met) = bricks_met(&grid, &in_voxels, slab, live.lanes()) {
                let at = |number: u32| [number % 6, number / 6 % 5, number / 30];
                let holds =
                    |brick| at(brick).iter().zip(met).all(|(&b, [low, high])| (low..=high).contains(&b));
                assert!(found.bricks().iter().all(|brick| holds(brick.number)), "{met:?}");
            } else {
                assert!(found.bricks().is_empty());
            }
            let first = |brick| found.segments(brick).map(|s| s.samples.trailing_zeros()).min().unwrap_or(0);
            let firsts: Vec<u32> = found.bricks().iter().map(first).collect();
            assert!(firsts.is_sorted(), "{firsts:?}");
            let mut bricks: Vec<u32> = found.bricks().iter().map(|brick| brick.number).collect();
            let count = bricks.len();
            bricks.sort_unstable();
            bricks.dedup();
            assert_eq!(bricks.len(), count, "a brick is there once");
        }
    }
}
