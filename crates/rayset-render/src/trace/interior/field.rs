//! The inside of a surface as a volume object.

use std::sync::Arc;

use super::inside::Inside;
use super::lattice::{Lattice, VOTE};
use crate::scene::{Procedural, ProceduralSample};
use rayset_base::geometry::{Aabb, DVec3};

/// A place is inside where more votes say so than this: of whole votes, four of six.
const INSIDE: f64 = 3.5;
/// The same as a cell counts votes.
pub(super) const INSIDE_VOTES: u8 = VOTE / 2 * 7;
/// Edge of the blocks of cells of which it is known whether any part is inside.
const BLOCK_CELLS: usize = 8;

/// Everything that a surface encloses, in one colour.
pub(super) struct Interior {
    votes: Arc<Inside>,
    color: [f64; 3],
    /// Of all cells that are inside, and half a cell around them.
    bounds: Aabb,
    /// Number of blocks along each axis.
    blocks: [usize; 3],
    /// Whether anything in a block may be inside.
    occupied: Vec<bool>,
}

impl std::fmt::Debug for Interior {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Interior").field("lattice", &self.votes.lattice).finish_non_exhaustive()
    }
}

impl Interior {
    pub(super) fn new(votes: Arc<Inside>, color: [f64; 3]) -> Self {
        let lattice = votes.lattice;
        let blocks = lattice.size.map(|n| n.div_ceil(BLOCK_CELLS));
        let mut occupied = vec![false; blocks.iter().product()];
        let (mut least, mut greatest, mut is_empty) = ([usize::MAX; 3], [0; 3], true);
        for z in 0..lattice.size[2] {
            for y in 0..lattice.size[1] {
                for x in 0..lattice.size[0] {
                    let cell = [x, y, z];
                    if votes.of_cell(cell) < INSIDE_VOTES {
                        continue;
                    }
                    is_empty = false;
                    least = std::array::from_fn(|axis| least[axis].min(cell[axis]));
                    greatest = std::array::from_fn(|axis| greatest[axis].max(cell[axis] + 1));
                    // Votes are interpolated, so a cell reaches into its neighbours.
                    let near = |axis: usize| {
                        let last = (cell[axis] + 1).min(lattice.size[axis] - 1);
                        cell[axis].saturating_sub(1) / BLOCK_CELLS..=last / BLOCK_CELLS
                    };
                    for w in near(2) {
                        for v in near(1) {
                            near(0).for_each(|u| occupied[(w * blocks[1] + v) * blocks[0] + u] = true);
                        }
                    }
                }
            }
        }
        let bounds = if is_empty {
            Aabb::EMPTY
        } else {
            let [least, greatest] = [least, greatest].map(|cell| DVec3::from_array(cell.map(|i| i as f64)));
            lattice.bounds_of(least - 0.5, greatest + 0.5)
        };
        Self { votes, color, bounds, blocks, occupied }
    }

    /// Bytes besides those of the votes.
    pub(super) fn bytes(lattice: &Lattice) -> u64 {
        let blocks: usize = lattice.size.iter().map(|n| n.div_ceil(BLOCK_CELLS)).product();
        (size_of::<Self>() + blocks) as u64 + 4096
    }

    /// Whether anything in the box between two places, in cells, may be inside.
    fn is_near(&self, a: DVec3, b: DVec3) -> bool {
        let block = |p: f64, axis: usize| {
            (p.max(0.0) as usize / BLOCK_CELLS).min(self.blocks[axis].saturating_sub(1))
        };
        let (least, greatest) = (a.min(b), a.max(b));
        let range = |axis: usize| block(least[axis], axis)..=block(greatest[axis], axis);
        range(2).any(|w| {
            range(1).any(|v| range(0).any(|u| self.occupied[(w * self.blocks[1] + v) * self.blocks[0] + u]))
        })
    }

    /// Interpolated votes at a place in cells, and their gradient.
    fn votes(&self, p: DVec3) -> (f64, DVec3) {
        let size = self.votes.lattice.size;
        let (mut low, mut high, mut within) = ([0; 3], [0; 3], [0.0; 3]);
        for axis in 0..3 {
            let place = (p[axis] - 0.5).clamp(0.0, size[axis] as f64 - 1.0);
            low[axis] = place as usize;
            high[axis] = (low[axis] + 1).min(size[axis] - 1);
            within[axis] = place - low[axis] as f64;
        }
        let corner = |i: usize| {
            let cell = std::array::from_fn(|axis| if i >> axis & 1 == 1 { high[axis] } else { low[axis] });
            f64::from(self.votes.of_cell(cell)) / f64::from(VOTE)
        };
        let c: [f64; 8] = std::array::from_fn(corner);
        let mix = |a: f64, b: f64, t: f64| a + (b - a) * t;
        let [u, v, w] = within;
        let face = |i: usize| mix(mix(c[i], c[i + 1], u), mix(c[i + 2], c[i + 3], u), v);
        let across = mix(mix(c[1] - c[0], c[3] - c[2], v), mix(c[5] - c[4], c[7] - c[6], v), w);
        let up = mix(mix(c[2] - c[0], c[3] - c[1], u), mix(c[6] - c[4], c[7] - c[5], u), w);
        let (near, far) = (face(0), face(4));
        (mix(near, far, w), DVec3::new(across, up, far - near))
    }
}

impl Procedural for Interior {
    fn bounds(&self) -> Aabb {
        self.bounds
    }

    /// Without limit: its edge lies within the surface, which asks for steps of its own.
    fn detail(&self) -> f64 {
        f64::INFINITY
    }

    fn uniform_color(&self) -> Option<[f64; 3]> {
        Some(self.color)
    }

    fn sample(&self, p: DVec3) -> ProceduralSample {
        let lattice = &self.votes.lattice;
        if !self.bounds.contains(p) {
            return ProceduralSample { implicit: f64::INFINITY, ..ProceduralSample::default() };
        }
        let (votes, gradient) = self.votes(lattice.in_cells(p));
        let inside = votes >= INSIDE;
        // Never 0, so that divided by the length of a gradient of 0 it is infinite.
        let implicit = (INSIDE - votes) * lattice.spacing - if inside { f64::MIN_POSITIVE } else { 0.0 };
        let opacity = f64::from(u8::from(inside));
        ProceduralSample { opacity, implicit, gradient: -gradient, color: self.color }
    }

    fn sample_all(&self, places: &[DVec3], out: &mut [ProceduralSample]) {
        let (Some(&first), Some(&last)) = (places.first(), places.last()) else { return };
        let lattice = &self.votes.lattice;
        if !self.is_near(lattice.in_cells(first), lattice.in_cells(last)) {
            let outside = ProceduralSample { implicit: f64::INFINITY, ..ProceduralSample::default() };
            return out.fill(outside);
        }
        for (sample, &p) in out.iter_mut().zip(places) {
            *sample = self.sample(p);
        }
    }
}
