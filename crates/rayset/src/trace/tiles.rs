//! The tiles of a picture, and the order in which threads take them.

use std::cell::Cell;
use std::collections::VecDeque;
use std::sync::atomic::{AtomicUsize, Ordering};

use super::Region;
use super::access::{Access, Lacking};
use super::world::World;
use crate::geometry::curve::hilbert_order;

/// A tile: its upper left pixel and its size.
#[derive(Clone, Copy, Debug)]
pub(super) struct Tile {
    pub(super) x: u32,
    pub(super) y: u32,
    pub(super) width: u32,
    pub(super) height: u32,
}

/// The tiles of a region in Hilbert order, so that threads work side by side on the same pages. Tiles lie on a lattice
/// of the whole picture; those at the edges of the region are cut.
pub(super) struct Tiles {
    tiles: Vec<Tile>,
    next: AtomicUsize,
}

impl Tiles {
    pub(super) fn new(region: &Region, edge: u32) -> Self {
        let (x0, y0) = (region.columns.start / edge, region.rows.start / edge);
        let (x1, y1) = (region.columns.end.div_ceil(edge), region.rows.end.div_ceil(edge));
        let tiles = hilbert_order(x1 - x0, y1 - y0)
            .into_iter()
            .map(|(i, j)| {
                let x = ((x0 + i) * edge).max(region.columns.start);
                let y = ((y0 + j) * edge).max(region.rows.start);
                let (end_x, end_y) = ((x0 + i + 1) * edge, (y0 + j + 1) * edge);
                Tile {
                    x,
                    y,
                    width: end_x.min(region.columns.end) - x,
                    height: end_y.min(region.rows.end) - y,
                }
            })
            .collect();
        Self { tiles, next: AtomicUsize::new(0) }
    }

    fn take(&self) -> Option<Tile> {
        self.tiles.get(self.next.fetch_add(1, Ordering::Relaxed)).copied()
    }
}

/// Attempts at a tile without waiting. One more waits for every page, so that even a budget that keeps none of them
/// between attempts gets on.
const IMPATIENT_ATTEMPTS: u32 = 6;

/// A tile, and how to go about it.
#[derive(Clone, Copy)]
pub(super) struct Attempt<'a> {
    pub(super) tile: Tile,
    pub(super) access: Access<'a>,
    number: u32,
}

/// The tiles that one thread works on: fresh ones, and those that it put off.
pub(super) struct Agenda<'a> {
    world: &'a World,
    tiles: &'a Tiles,
    asked_bytes: &'a Cell<u64>,
    /// Each with the page it lacked, the longest waiting first.
    put_off: VecDeque<(Attempt<'a>, Lacking)>,
}

impl<'a> Agenda<'a> {
    pub(super) fn new(world: &'a World, tiles: &'a Tiles, asked_bytes: &'a Cell<u64>) -> Self {
        Self { world, tiles, asked_bytes, put_off: VecDeque::new() }
    }

    /// A tile whose page has come, else a fresh one, else the one put off first, which then waits. A fresh tile waits too
    /// where none may be put off.
    pub(super) fn next(&mut self, most_put_off: usize) -> Option<Attempt<'a>> {
        let ready = self.put_off.iter().position(|(_, lacking)| self.is_there(lacking));
        if let Some((attempt, _)) = ready.and_then(|at| self.put_off.remove(at)) {
            let waits = attempt.number >= IMPATIENT_ATTEMPTS;
            return Some(self.again(attempt, waits));
        }
        if (self.put_off.is_empty() || self.put_off.len() < most_put_off)
            && let Some(tile) = self.tiles.take()
        {
            let waits = self.world.slabs_on_a_miss == 0 || most_put_off == 0;
            return Some(Attempt { tile, access: self.access(waits), number: 1 });
        }
        let (attempt, _) = self.put_off.pop_front()?;
        Some(self.again(attempt, true))
    }

    fn again(&self, attempt: Attempt<'a>, waits: bool) -> Attempt<'a> {
        Attempt { access: self.access(waits), number: attempt.number + 1, ..attempt }
    }

    pub(super) fn put_off(&mut self, attempt: Attempt<'a>, lacking: Lacking) {
        self.put_off.push_back((attempt, lacking));
    }

    fn access(&self, waits: bool) -> Access<'a> {
        let (slabs_on_a_miss, asked_bytes) = (self.world.slabs_on_a_miss, self.asked_bytes);
        let follows_lines = self.world.follows_lines;
        Access { pages: &self.world.pages, waits, slabs_on_a_miss, follows_lines, asked_bytes }
    }

    fn is_there(&self, lacking: &Lacking) -> bool {
        self.world.pages.is_resident(&lacking.object, lacking.page)
    }
}
