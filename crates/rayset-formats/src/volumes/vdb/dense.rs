//! All voxels of a box, from a tree that mentions some of them.

use std::io::{self, Read};
use std::ops::Range;

use super::stream::{Stream, Wrong};
use super::tree::{Bounds, LEAF, Tree};
use super::values::Decoder;

/// Largest window in bytes, as long as a row of voxels is not larger.
const MOST_WINDOW_BYTES: u64 = 32 << 20;

/// The voxels of a box, z fastest and x slowest, as they are ordered in leaves. They are put
/// together in windows: slabs of eight slices, so that each leaf is decompressed once, or parts of
/// one slice if a slab is too large.
pub(super) struct Dense {
    stream: Stream,
    tree: Tree,
    decoder: Decoder,
    bounds: Bounds,
    window: Vec<u8>,
    /// Bytes of the window that have been read.
    read: usize,
    /// The first x and y of the window to come.
    next: [i64; 2],
}

impl Dense {
    pub(super) fn new(stream: Stream, tree: Tree, bounds: Bounds) -> Self {
        let next = [bounds.low[0], bounds.low[1]];
        Self { stream, tree, decoder: Decoder::default(), bounds, window: Vec::new(), read: 0, next }
    }

    /// Bytes of the index, the largest window and the buffers of a node.
    pub(super) fn memory_bytes(&self) -> u64 {
        let rows = self.rows_of_window();
        let slices = if self.holds_slabs() { LEAF as u64 } else { 1 };
        self.tree.memory_bytes() + slices * rows * self.row_bytes() + (1 << 20)
    }

    /// Voxels along an axis.
    fn size(&self, axis: usize) -> u64 {
        (self.bounds.high[axis] - self.bounds.low[axis] + 1) as u64
    }

    fn row_bytes(&self) -> u64 {
        self.size(2) * self.tree.coding.width as u64
    }

    fn holds_slabs(&self) -> bool {
        LEAF as u64 * self.size(1) * self.row_bytes() <= MOST_WINDOW_BYTES
    }

    fn rows_of_window(&self) -> u64 {
        if self.holds_slabs() {
            self.size(1)
        } else {
            (MOST_WINDOW_BYTES / self.row_bytes()).clamp(1, self.size(1))
        }
    }

    /// Puts the next window together; false behind the last.
    fn advance(&mut self) -> Result<bool, Wrong> {
        let [x, y] = self.next;
        if x > self.bounds.high[0] {
            return Ok(false);
        }
        let last_x = if self.holds_slabs() { x.div_euclid(LEAF) * LEAF + LEAF - 1 } else { x };
        let last_y = y + self.rows_of_window() as i64 - 1;
        let region = Bounds {
            low: [x, y, self.bounds.low[2]],
            high: [last_x.min(self.bounds.high[0]), last_y.min(self.bounds.high[1]), self.bounds.high[2]],
        };
        self.fill(region)?;
        self.read = 0;
        self.next = if region.high[1] == self.bounds.high[1] {
            [region.high[0] + 1, self.bounds.low[1]]
        } else {
            [x, region.high[1] + 1]
        };
        Ok(true)
    }

    fn fill(&mut self, region: Bounds) -> Result<(), Wrong> {
        let Self { stream, tree, decoder, window, .. } = self;
        let width = tree.coding.width;
        let [nx, ny, nz] = [0, 1, 2].map(|axis: usize| (region.high[axis] - region.low[axis] + 1) as usize);
        window.resize(nx * ny * nz * width, 0);
        fill_with(window, &tree.coding.background[..width]);
        tree.tiles(stream, decoder, region, |bounds, value| {
            for (_, to) in runs(region, bounds) {
                fill_with(&mut window[to.start * width..to.end * width], value);
            }
        })?;
        tree.leaves(stream, decoder, region, |bounds, values| {
            for (from, to) in runs(region, bounds) {
                let from = &values[from.start * width..from.end * width];
                window[to.start * width..to.end * width].copy_from_slice(from);
            }
        })
    }
}

fn fill_with(voxels: &mut [u8], value: &[u8]) {
    voxels.chunks_exact_mut(value.len()).for_each(|voxel| voxel.copy_from_slice(value));
}

/// The runs along z of the voxels that a region and a cube share: their places among the voxels of
/// the cube, and among those of the region.
fn runs(region: Bounds, cube: Bounds) -> impl Iterator<Item = (Range<usize>, Range<usize>)> {
    let shared = region.and(cube);
    let place = move |of: Bounds, x: i64, y: i64| {
        let [ny, nz] = [1, 2].map(|axis: usize| of.high[axis] - of.low[axis] + 1);
        let row = ((x - of.low[0]) * ny + (y - of.low[1])) * nz;
        let along = |z: i64| (row + z - of.low[2]) as usize;
        along(shared.low[2])..along(shared.high[2]) + 1
    };
    let rows = if shared.is_empty() { 0..0 } else { shared.low[0]..shared.high[0] + 1 };
    rows.flat_map(move |x| {
        (shared.low[1]..=shared.high[1]).map(move |y| (place(cube, x, y), place(region, x, y)))
    })
}

impl Read for Dense {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        if self.read == self.window.len() && !self.advance()? {
            return Ok(0);
        }
        let now = (self.window.len() - self.read).min(out.len());
        out[..now].copy_from_slice(&self.window[self.read..self.read + now]);
        self.read += now;
        Ok(now)
    }
}
