//! Where the samples of a slab are in a grid: positions in voxels, and segments of rays within one brick.

use super::voxels::Voxel;
use crate::field::{LANES, Packet, SLAB_SAMPLES, Slab};
use crate::geometry::{Aabb, DAffine3, DVec3, Ray};
use crate::grid::format::GridHeader;
use crate::trace::node_samples::Live;

/// The rays of a packet in voxels, and where they are inside the grid.
#[derive(Clone, Debug)]
pub(super) struct GridRays {
    origin: [[f64; LANES]; 3],
    direction: [[f64; LANES]; 3],
    offset: [f64; LANES],
    /// The first sample inside the grid, and the one after the last.
    within: [(u64, u64); LANES],
    step: f64,
}

impl GridRays {
    pub(super) fn new(grid: &Placement, packet: &Packet) -> Self {
        let mut rays = Self {
            origin: [[0.0; LANES]; 3],
            direction: [[0.0; LANES]; 3],
            offset: [0.0; LANES],
            within: [(0, 0); LANES],
            step: packet.step_world(),
        };
        for lane in 0..packet.len() {
            let world = packet.ray(lane);
            let origin = grid.voxel_from_world.transform_point3(world.origin);
            let direction = grid.voxel_from_world.transform_vector3(world.direction);
            for axis in 0..3 {
                (rays.origin[axis][lane], rays.direction[axis][lane]) = (origin[axis], direction[axis]);
            }
            rays.offset[lane] = packet.sample_offset(lane);
            rays.within[lane] = rays.find_within(lane, &Ray { origin, direction }, &grid.bounds_voxel);
        }
        rays
    }

    /// The samples of a ray that are inside a box.
    fn find_within(&self, lane: usize, ray: &Ray, bounds: &Aabb) -> (u64, u64) {
        let Some((enter, exit)) = bounds.clip(ray) else { return (0, 0) };
        let number = |t: f64| (t / self.step - self.offset[lane]).clamp(0.0, MOST_SAMPLES);
        // Whether a sample is inside is tested at its own position; this range has at most one or two too many at either
        // end.
        let (mut first, mut end) =
            ((number(enter).floor() - 1.0).max(0.0) as u64, (number(exit).ceil() + 2.0) as u64);
        let slab = |sample: u64| self.ray(lane, Slab { first: sample, samples: 1 });
        while first < end && !bounds.contains(slab(first).place(0)) {
            first += 1;
        }
        while first < end && !bounds.contains(slab(end - 1).place(0)) {
            end -= 1;
        }
        (first, end)
    }

    #[inline(always)]
    pub(super) fn ray(&self, lane: usize, slab: Slab) -> GridRay {
        GridRay {
            origin: DVec3::new(self.origin[0][lane], self.origin[1][lane], self.origin[2][lane]),
            direction: DVec3::new(self.direction[0][lane], self.direction[1][lane], self.direction[2][lane]),
            offset: self.offset[lane],
            first: slab.first,
            step: self.step,
        }
    }

    /// The samples of a ray inside the grid, counted from the first of the slab: the first, and the one after the last.
    #[inline(always)]
    fn within(&self, lane: usize, slab: Slab) -> (usize, usize) {
        let (first, end) = self.within[lane];
        let (first, end) = (first.max(slab.first), end.min(slab.end()));
        if first < end { ((first - slab.first) as usize, (end - slab.first) as usize) } else { (0, 0) }
    }
}

/// Upper bound of sample numbers.
const MOST_SAMPLES: f64 = (1_u64 << 52) as f64;

/// One ray in a slab; positions in voxels, distances in the world.
#[derive(Clone, Copy, Debug)]
pub(super) struct GridRay {
    origin: DVec3,
    direction: DVec3,
    offset: f64,
    first: u64,
    step: f64,
}

impl GridRay {
    /// The position of a sample, counted from the first of the slab.
    #[inline(always)]
    fn place(&self, j: usize) -> DVec3 {
        self.origin + self.direction * (((self.first + j as u64) as f64 + self.offset) * self.step)
    }

    /// The cells of all samples, and how far into its cell each lies, 0 to 1 on each axis. Positions beyond the first or
    /// the last cell of the grid are in that one: a place on the last voxel of an axis is at 1 in the last cell.
    ///
    /// The difference between a position and its cell is between numbers within a cell of each other, so it is not rounded
    /// until it becomes single precision.
    #[inline(always)]
    pub(super) fn cells(&self, last_cell: DVec3) -> ([[i32; SLAB_SAMPLES]; 3], [[f32; SLAB_SAMPLES]; 3]) {
        let (mut cells, mut within) = ([[0; SLAB_SAMPLES]; 3], [[0.0; SLAB_SAMPLES]; 3]);
        let mut t = [0.0; SLAB_SAMPLES];
        for (j, t) in t.iter_mut().enumerate() {
            *t = ((self.first + j as u64) as f64 + self.offset) * self.step;
        }
        for axis in 0..3 {
            let (origin, direction, last) = (self.origin[axis], self.direction[axis], last_cell[axis]);
            for j in 0..SLAB_SAMPLES {
                let place = origin + direction * t[j];
                let cell = place.floor().max(0.0).min(last);
                cells[axis][j] = cell as i32;
                within[axis][j] = (place - cell) as f32;
            }
        }
        (cells, within)
    }
}

/// The bricks of a grid.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bricks {
    /// Along each axis.
    count: [u64; 3],
    /// Cells along an edge.
    cells: u64,
}

impl Bricks {
    pub(super) fn new(header: &GridHeader) -> Self {
        Self { count: header.bricks(), cells: header.kind.brick_cells() }
    }

    /// The number of the brick at a place among the bricks.
    #[inline(always)]
    pub(super) fn number(&self, [x, y, z]: [u32; 3]) -> u64 {
        (u64::from(z) * self.count[1] + u64::from(y)) * self.count[0] + u64::from(x)
    }

    /// The number of the brick of a cell, x fastest.
    #[inline(always)]
    fn of<V: Voxel>(&self, [x, y, z]: [i32; 3]) -> u64 {
        let cells = (V::SIDE - 3) as u32;
        self.number([x as u32 / cells, y as u32 / cells, z as u32 / cells])
    }

    /// The first voxel of a brick: one before its first cell on each axis.
    pub(super) fn first_voxel(&self, brick: u64) -> [i32; 3] {
        let at = [
            brick % self.count[0],
            brick / self.count[0] % self.count[1],
            brick / self.count[0] / self.count[1],
        ];
        at.map(|b| (b * self.cells) as i32 - 1)
    }
}

/// Samples of one ray in one brick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Segment {
    pub(super) brick: u64,
    pub(super) lane: u8,
    /// A bit for each sample.
    pub(super) samples: u32,
}

/// Where a grid is.
#[derive(Clone, Copy, Debug)]
pub(super) struct Placement {
    pub(super) voxel_from_world: DAffine3,
    pub(super) bounds_voxel: Aabb,
    pub(super) bricks: Bricks,
}

/// The segments of a slab, ray by ray.
#[inline(always)]
pub(super) fn segments<V: Voxel>(
    grid: &Placement,
    rays: &GridRays,
    slab: Slab,
    live: &Live,
    out: &mut Vec<Segment>,
) {
    out.clear();
    let mut lanes = live.lanes();
    while lanes != 0 {
        let lane = lanes.trailing_zeros() as usize;
        lanes &= lanes - 1;
        let (first, end) = rays.within(lane, slab);
        if first < end {
            of_ray::<V>(grid, &rays.ray(lane, slab), lane, (first, end), live.0[lane], out);
        }
    }
}

/// The bricks that the samples of a slab lie in, or some more: the first and the last along each axis. `None` if no
/// sample is inside the grid.
#[inline(always)]
pub(super) fn bricks_met<V: Voxel>(
    grid: &Placement,
    rays: &GridRays,
    slab: Slab,
    lanes: u64,
) -> Option<[[u32; 2]; 3]> {
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
    let brick =
        |place: f64, axis: usize| place.floor().max(0.0).min(last_cell[axis]) as u32 / (V::SIDE - 3) as u32;
    Some([0, 1, 2].map(|axis| [brick(low[axis], axis), brick(high[axis], axis)]))
}

/// The segments of one ray.
#[inline(always)]
fn of_ray<V: Voxel>(
    grid: &Placement,
    ray: &GridRay,
    lane: usize,
    (first, end): (usize, usize),
    live: u32,
    out: &mut Vec<Segment>,
) {
    let (cells, _) = ray.cells(grid.bounds_voxel.max - 1.0);
    let mut from = first;
    while from < end {
        // Bricks are convex: if its ends are in one, so is what lies between.
        let brick = grid.bricks.of::<V>([cells[0][from], cells[1][from], cells[2][from]]);
        let (mut inside, mut outside) = (from, end);
        let mut middle = end - 1;
        while inside + 1 < outside {
            let at = grid.bricks.of::<V>([cells[0][middle], cells[1][middle], cells[2][middle]]);
            if at == brick {
                inside = middle;
            } else {
                outside = middle;
            }
            middle = (inside + outside) / 2;
        }
        let samples = bits(from, inside + 1) & live;
        if samples != 0 {
            out.push(Segment { brick, lane: lane as u8, samples });
        }
        from = inside + 1;
    }
}

/// Bits `first` to `end` − 1.
fn bits(first: usize, end: usize) -> u32 {
    let below = |n: usize| if n >= 32 { u32::MAX } else { (1 << n) - 1 };
    below(end) & !below(first)
}

/// Sorts segments by brick, and bricks by their first sample on any ray.
pub(super) fn sort(segments: &mut [Segment]) {
    if segments.iter().all(|s| s.brick == segments[0].brick) {
        return;
    }
    segments.sort_unstable_by_key(|s| (s.brick, s.lane));
    let mut nearest: Vec<(u32, u64)> = (segments.chunk_by(|a, b| a.brick == b.brick))
        .map(|of_brick| {
            let first = of_brick.iter().map(|s| s.samples.trailing_zeros()).min();
            (first.unwrap_or(u32::MAX), of_brick[0].brick)
        })
        .collect();
    nearest.sort_unstable();
    let order = |brick: u64| nearest.iter().position(|&(_, b)| b == brick);
    segments.sort_by_cached_key(|s| (order(s.brick), s.lane));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::format::VoxelKind;
    use crate::trace::grid::volume::tests::header;
    use crate::trace::grid::voxels::{self, with_voxel};

    /// Cells and fractions of 32 places along the x axis of a grid.
    fn along_x(header: &GridHeader, places: &[f64]) -> Vec<(i32, f32)> {
        let last_cell = header.last_voxel() - 1.0;
        let found = places.iter().map(|&x| {
            let ray = GridRay {
                origin: DVec3::new(x, 0.0, 0.0),
                direction: DVec3::ZERO,
                offset: 0.0,
                first: 0,
                step: 1.0,
            };
            let (cells, within) = ray.cells(last_cell);
            (cells[0][0], within[0][0])
        });
        found.collect()
    }

    #[test]
    fn a_place_is_in_its_own_cell_and_in_one_that_its_brick_has() {
        for &kind in VoxelKind::ALL {
            let cells = kind.brick_cells() as i32;
            for n in 2..=130_i32 {
                let header = header([n as u64, n as u64, 2], kind);
                let last = f64::from(n - 1);
                // Every voxel, the floating-point numbers next to it, and places in between.
                let places = (0..n).flat_map(|i| {
                    let i = f64::from(i);
                    [i, i.next_down(), i.next_up(), i + 1e-17, i + 1e-3, i + 0.5, (i + 1.0).next_down()]
                });
                let places: Vec<f64> = places.filter(|x| (0.0..=last).contains(x)).collect();
                for (&x, (cell, within)) in places.iter().zip(along_x(&header, &places)) {
                    assert_eq!(cell, (x as i32).min(n - 2), "{n} voxels, at {x:e}");
                    let bricks = Bricks::new(&header);
                    let number = with_voxel!(kind, V => bricks.of::<V>([cell, 0, 0]));
                    let first = bricks.first_voxel(number)[0];
                    assert!((1..=cells).contains(&(cell - first)), "{n} voxels, at {x:e}: cell {cell}");
                    assert!((0.0..=1.0).contains(&within), "{n} voxels, at {x:e}: {within}");
                    assert!((f64::from(within) + f64::from(cell) - x).abs() < 1e-7, "{n} voxels, at {x:e}");
                }
            }
        }
    }

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
        let mut found = Vec::new();
        let in_voxels = GridRays::new(&grid, &packet);
        for number in 0..5 {
            let slab = Slab { first: 32 * number, samples: SLAB_SAMPLES };
            segments::<voxels::F32>(&grid, &in_voxels, slab, &live, &mut found);
            sort(&mut found);
            let mut covered = [0_u32; 64];
            for segment in &found {
                let lane = usize::from(segment.lane);
                assert_eq!(covered[lane] & segment.samples, 0, "no sample twice");
                covered[lane] |= segment.samples;
                let ray = in_voxels.ray(lane, slab);
                for j in (0..SLAB_SAMPLES).filter(|j| segment.samples >> j & 1 == 1) {
                    let cell = ray.place(j).floor().as_ivec3().to_array();
                    assert_eq!(grid.bricks.of::<voxels::F32>(cell), segment.brick);
                }
            }
            for lane in 0..64 {
                for j in 0..SLAB_SAMPLES {
                    let place = packet.ray(lane).at(packet.sample_t_world(lane, slab.first + j as u64));
                    let expected = bounds.contains(place) && live.0[lane] >> j & 1 == 1;
                    assert_eq!(covered[lane] >> j & 1 == 1, expected, "lane {lane}, sample {j}");
                }
            }
            if let Some(met) = bricks_met::<voxels::F32>(&grid, &in_voxels, slab, live.lanes()) {
                let at = |number: u64| [number % 6, number / 6 % 5, number / 30].map(|n| n as u32);
                let holds =
                    |brick| at(brick).iter().zip(met).all(|(&b, [low, high])| (low..=high).contains(&b));
                assert!(found.iter().all(|segment| holds(segment.brick)), "{met:?}");
            } else {
                assert!(found.is_empty());
            }
            let firsts: Vec<u32> = (found.chunk_by(|a, b| a.brick == b.brick))
                .map(|of| of.iter().map(|s| s.samples.trailing_zeros()).min().unwrap_or(0))
                .collect();
            assert!(firsts.is_sorted(), "{firsts:?}");
            let mut bricks: Vec<u64> =
                found.chunk_by(|a, b| a.brick == b.brick).map(|of| of[0].brick).collect();
            let chunks = bricks.len();
            bricks.sort_unstable();
            bricks.dedup();
            assert_eq!(bricks.len(), chunks, "a brick is one chunk");
        }
    }
}
