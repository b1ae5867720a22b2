//! Looks ahead of the tile being traced. The picture is divided into look-ahead tiles of 32 × 32 pixels. The pages of
//! upcoming look-ahead tiles are hinted at as far as there is room, given up if their look-ahead tile has passed
//! without using them, and retired once no later look-ahead tile can need them.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use super::deferral::Deferral;
use super::found::{Found, PageId};
use super::pace::Pace;
use super::probe::{Expected, ProbeRays};
use super::view::View;
use crate::field::LANES;
use crate::geometry::{Aabb, DVec3, Ray};
use crate::scene::RayMaker;
use crate::trace::cloud::{CloudPlacement, CloudVolume};
use crate::trace::work::{LOOKAHEAD_TILE_PIXELS, Region, Tile};
use crate::trace::world::World;
use crate::working_set::{Object, PageClient, Reuse};

/// Pages of far files stay for tiles that are deferred, as long as these are not more look-ahead tiles behind.
const MOST_BEHIND: u32 = 4;

/// What is known about the picture being rendered and the rays to come.
#[derive(Clone, Copy)]
pub struct Lookahead<'a> {
    pub(in crate::trace) state: &'a LookaheadState,
    pub(in crate::trace) world: &'a World,
    pub(in crate::trace) rays: &'a RayMaker,
    pub(in crate::trace) pages: &'a PageClient,
    /// What this thread knows about when pages are used again.
    pub(in crate::trace) reuse: &'a RefCell<Reuse>,
}

/// The order in which a render visits its picture, and what has been found ahead.
pub(in crate::trace) struct LookaheadState {
    /// Every cloud of the graph: the index of its instruction, and its expected effect on light.
    clouds: Vec<(usize, Expected)>,
    /// Bytes of the largest page.
    pub(super) page_bytes: u64,
    /// The region that the tiles cover.
    region: Region,
    pub(super) threads: usize,
    columns: u32,
    rows: u32,
    /// Look-ahead tiles in the order in which tiles reach them; a look-ahead tile may occur several times.
    pub(super) order: Vec<(u32, u32)>,
    /// For each tile, the position of its look-ahead tile in `order`.
    of_tile: Vec<u32>,
    /// For each look-ahead tile, its last position in `order`.
    last_place: Vec<u32>,
    found: Mutex<Found>,
    /// Pages that fit the budget besides those that the look-ahead tiles being traced need.
    spare_pages: AtomicU64,
    pub(super) pace: Pace,
    /// Whether pages of any file come from far away.
    pub(super) far: bool,
    /// Number of look-ahead tiles that have been examined, of far files.
    pub(super) examined: AtomicU32,
    /// Places of the tiles that are deferred, of far files, and how many are at each.
    deferred: Mutex<BTreeMap<u32, u32>>,
}

impl LookaheadState {
    /// The order given by some tiles, of which there must be at least one.
    pub(in crate::trace) fn new(world: &World, tiles: &[Tile], threads: usize) -> Self {
        let region = Region::around(tiles);
        let first = (region.columns.start / LOOKAHEAD_TILE_PIXELS, region.rows.start / LOOKAHEAD_TILE_PIXELS);
        let columns = region.columns.end.div_ceil(LOOKAHEAD_TILE_PIXELS) - first.0;
        let rows = region.rows.end.div_ceil(LOOKAHEAD_TILE_PIXELS) - first.1;
        let mut order: Vec<(u32, u32)> = Vec::new();
        let mut of_tile = Vec::with_capacity(tiles.len());
        let mut last_place = vec![0; columns as usize * rows as usize];
        for tile in tiles {
            let lookahead_tile =
                (tile.x / LOOKAHEAD_TILE_PIXELS - first.0, tile.y / LOOKAHEAD_TILE_PIXELS - first.1);
            if order.last() != Some(&lookahead_tile) {
                order.push(lookahead_tile);
            }
            let place = order.len() as u32 - 1;
            of_tile.push(place);
            last_place[(lookahead_tile.1 * columns + lookahead_tile.0) as usize] = place;
        }
        let stop = world.absorption.stop_transmittance as f32;
        let far = world.program.files().any(|pages| pages.is_far());
        let seen = world.program.clouds().filter(|(_, volume)| volume.placement.header().points > 0);
        let page_bytes = |volume: &CloudVolume| u64::from(volume.placement.header().page_bytes);
        Self {
            page_bytes: seen.clone().map(|(_, volume)| page_bytes(volume)).max().unwrap_or(1),
            clouds: seen.map(|(at, volume)| (at, Expected::new(&volume.shading, stop, far))).collect(),
            region,
            threads: threads.max(1),
            columns,
            rows,
            order,
            of_tile,
            last_place,
            found: Mutex::default(),
            spare_pages: AtomicU64::new(0),
            pace: Pace::default(),
            examined: AtomicU32::new(0),
            deferred: Mutex::default(),
            far,
        }
    }

    /// A tile is deferred that was not before.
    pub(in crate::trace) fn deferred(&self, tile: usize) {
        if self.far {
            *self.deferred_places().entry(self.of_tile[tile]).or_default() += 1;
        }
    }

    /// A tile that was deferred is finished.
    pub(in crate::trace) fn undeferred(&self, tile: usize) {
        if !self.far {
            return;
        }
        if let Entry::Occupied(mut place) = self.deferred_places().entry(self.of_tile[tile]) {
            *place.get_mut() -= 1;
            if *place.get() == 0 {
                place.remove();
            }
        }
    }

    fn deferred_places(&self) -> MutexGuard<'_, BTreeMap<u32, u32>> {
        self.deferred.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The place of the first tile that is deferred.
    fn oldest_deferred(&self) -> Option<u32> {
        if self.far { self.deferred_places().first_key_value().map(|(&place, _)| place) } else { None }
    }

    /// Whether a tile should wait until those that are deferred are finished: the pages that it needs have not been looked for,
    /// because those of the deferred ones take all the room.
    pub(in crate::trace) fn is_too_early(&self, tile: usize) -> bool {
        self.far && self.of_tile[tile] >= self.examined.load(Ordering::Relaxed)
    }

    /// A thread has traced for so long, without waiting.
    pub(in crate::trace) fn worked(&self, time: Duration) {
        self.pace.worked(time);
    }

    /// How many of `count` tiles from one on are in the same look-ahead tile: at least that one. What a thread is still to
    /// trace must not count as passed.
    pub(in crate::trace) fn together(&self, tile: usize, count: usize) -> usize {
        self.of_tile[tile..][..count].iter().take_while(|&&place| place == self.of_tile[tile]).count()
    }

    /// How many tiles a thread may defer: as many as there is room for besides those being traced. If rays need most of
    /// the budget at a time, tracing other tiles meanwhile would only evict their pages.
    pub(in crate::trace) fn deferral(&self) -> Deferral {
        /// Enough to hide the latency of a slow disk.
        const MOST: u64 = 32;
        /// The same of far storage, where most pages come in time: more tiles would keep more pages from those that come after them.
        const MOST_FAR: u64 = 16;
        /// Pages that a tile may bring in before it is deferred again.
        const PAGES_EACH: u64 = 8;
        let spare = self.spare_pages.load(Ordering::Relaxed);
        let most = match self.far {
            true => MOST_FAR as usize,
            false => (spare / (PAGES_EACH * self.threads as u64)).min(MOST) as usize,
        };
        Deferral { most, far: self.far }
    }
}

impl<'a> Lookahead<'a> {
    /// Looks ahead of a tile that is about to be traced: at the look-ahead tiles beyond its own, up to `tiles_ahead` of them, or,
    /// of far files, at as many as there is room for. Hints at their pages.
    pub(super) fn scout(&self, tile: usize, tiles_ahead: u32) {
        let state = self.state;
        if state.clouds.is_empty() && !state.far {
            return;
        }
        // One thread at a time does this; the others have tiles to trace.
        let Ok(mut found) = state.found.try_lock() else { return };
        let here = state.of_tile[tile];
        let oldest = state.oldest_deferred().unwrap_or(here).max(here.saturating_sub(MOST_BEHIND));
        let passed_to = here.min(oldest);
        self.retire(&mut found, passed_to);
        if found.next < here {
            found.next = here;
            found.nodes_hinted.clear();
        }
        if state.far {
            return self.fill_window(&mut found, here);
        }
        let until = here.saturating_add(1).saturating_add(tiles_ahead).min(state.order.len() as u32);
        // The current look-ahead tile and the next are examined even without room, to know how many pages they need.
        while found.next < until
            && (self.hint(&mut found, here) || found.next <= here + 1)
            && self.look(found.next, &mut found)
        {
            found.next += 1;
        }
    }

    /// Ends looking ahead: nothing is kept for it any more.
    pub(in crate::trace) fn finish(&self) {
        let Ok(found) = self.state.found.try_lock() else { return };
        if self.state.far {
            let kept: Vec<PageId> =
                found.seen.keys().chain(&found.to_let_go).chain(&found.nodes_to_let_go).copied().collect();
            kept.into_iter().for_each(|page| {
                self.let_go(page);
            });
        }
    }

    /// Hints at the waiting pages; false if there was no room for some of them.
    fn hint(&self, found: &mut Found, here: u32) -> bool {
        /// Hints may take one part in this many of the budget: more would leave too little for pages that later
        /// look-ahead tiles use again.
        const MOST_OF_BUDGET: u64 = 4;
        let spare = self.spare(found, here) * self.state.page_bytes;
        let most = self.pages.share_bytes() / MOST_OF_BUDGET;
        // Where the tiles being traced need nearly all, what they need would give way, or the hinted pages before their use.
        if spare < most {
            return false;
        }
        let pages: Vec<PageId> = found.waiting.iter().map(|&(_, _, page)| page).collect();
        for same_file in pages.chunk_by(|a, b| a.file == b.file) {
            let numbers: Vec<u32> = same_file.iter().map(|id| id.page).collect();
            let Some(object) = self.object(same_file[0].file) else { continue };
            let dealt_with = self.pages.hint_knowing(object, &numbers, most, Some(self.reuse));
            found.dealt_with(dealt_with);
            if dealt_with < numbers.len() {
                break;
            }
        }
        found.waiting.is_empty()
    }

    pub(super) fn clouds(&self) -> impl Iterator<Item = (&'a CloudPlacement, &'a Expected)> + use<'a> {
        let world = self.world;
        let clouds = self.state.clouds.iter();
        clouds
            .filter_map(|(at, expected)| world.program.cloud(*at).map(|volume| (&volume.placement, expected)))
    }

    pub(super) fn object(&self, file: u32) -> Option<&'a Arc<Object>> {
        self.clouds().find(|(cloud, _)| cloud.file == file).map(|(cloud, _)| &cloud.pages)
    }

    /// Calls `tell` with some pages, grouped by file.
    fn by_file(&self, mut pages: Vec<PageId>, tell: impl Fn(&Arc<Object>, &[u32])) {
        pages.sort_unstable();
        for same_file in pages.chunk_by(|a, b| a.file == b.file) {
            let numbers: Vec<u32> = same_file.iter().map(|id| id.page).collect();
            if let Some(object) = self.object(same_file[0].file) {
                tell(object, &numbers);
            }
        }
    }

    /// Pages that fit the budget besides those that the look-ahead tiles being traced need.
    pub(super) fn spare(&self, found: &mut Found, here: u32) -> u64 {
        let past = found.demands.iter().take_while(|&&(lookahead_tile, _)| lookahead_tile < here).count();
        found.demands.drain(..past);
        // The pages of one look-ahead tile are replaced gradually by those of the next, and threads may be in different
        // ones.
        let columns = found.demands.iter().take(self.state.threads).map(|&(_, pages)| pages);
        let budget = self.pages.share_bytes() / self.state.page_bytes;
        let needed = match found.demands.is_empty() {
            true if found.nodes_do_not_fit => budget,
            // As long as it is not known what they need.
            true => budget / 2,
            false => columns.sum(),
        };
        let spare = budget.saturating_sub(needed);
        self.state.spare_pages.store(spare, Ordering::Relaxed);
        spare
    }

    /// Gives up the pages whose look-ahead tiles have passed, one look-ahead tile late because other threads may still
    /// be there.
    fn retire(&self, found: &mut Found, here: u32) {
        let passed = found.pass(here);
        if self.state.far {
            let let_go: Vec<PageId> =
                found.to_let_go.drain(..).chain(passed.unused.iter().copied()).collect();
            found.to_let_go = let_go.into_iter().filter(|&page| self.let_go(page)).collect();
        }
        self.by_file(passed.unused, |object, pages| self.pages.retire_unused(object, pages));
        self.by_file(passed.finished, |object, pages| self.pages.retire(object, pages));
    }

    /// Position in `order` of the last look-ahead tile whose rays may meet a box.
    pub(super) fn last_visit(&self, bounds: &Aabb) -> u32 {
        let (mut low, mut high) = ((f64::INFINITY, f64::INFINITY), (f64::NEG_INFINITY, f64::NEG_INFINITY));
        for corner in 0..8 {
            let pick = |bit: u32, axis: usize| {
                if corner >> bit & 1 == 0 { bounds.min[axis] } else { bounds.max[axis] }
            };
            let Some((x, y)) = self.rays.project(DVec3::new(pick(0, 0), pick(1, 1), pick(2, 2))) else {
                return self.state.order.len() as u32;
            };
            low = (low.0.min(x), low.1.min(y));
            high = (high.0.max(x), high.1.max(y));
        }
        let index = |v: f64, start: u32, count: u32| {
            let first = f64::from(start / LOOKAHEAD_TILE_PIXELS);
            (v / f64::from(LOOKAHEAD_TILE_PIXELS) - first).clamp(0.0, f64::from(count - 1)) as u32
        };
        let state = self.state;
        let columns = index(low.0, state.region.columns.start, state.columns)
            ..=index(high.0, state.region.columns.start, state.columns);
        let rows = index(low.1, state.region.rows.start, state.rows)
            ..=index(high.1, state.region.rows.start, state.rows);
        rows.flat_map(|j| columns.clone().map(move |i| state.last_place[(j * state.columns + i) as usize]))
            .max()
            .unwrap_or(0)
    }

    /// Lists the pages that a look-ahead tile wants; false if node pages were absent, which are then hinted at.
    pub(super) fn look(&self, at: u32, found: &mut Found) -> bool {
        let (i, j) = self.state.order[at as usize];
        let rays = self.rays_of(i, j);
        let (mut complete, mut gone, mut pages) = (true, false, 0);
        let last_visit = |bounds: &Aabb| self.last_visit(bounds);
        for (cloud, expected) in self.clouds() {
            let mut view = View::new(self.pages, self.state.far, &last_visit, cloud, found, at);
            let root = cloud.header().root;
            match view.node_at(root.page, root.index) {
                Some(root) => {
                    let rays = rays.map(|ray| cloud.local_ray(&ray));
                    ProbeRays::new(self.world.program.simd, &rays).explore(root, expected, &mut view);
                }
                None => view.absent_nodes.push(cloud.first_node_page + root.page),
            }
            pages += view.pages.len() as u64;
            let (mut absent, file) = (view.absent_nodes, cloud.file);
            complete &= absent.is_empty();
            absent.retain(|&page| {
                let fresh = found.nodes_hinted.insert(PageId { file, page });
                gone |= !fresh && cloud.pages.is_absent(page);
                fresh
            });
            self.pages.hint_knowing(&cloud.pages, &absent, u64::MAX, Some(self.reuse));
        }
        found.nodes_do_not_fit = gone;
        if complete {
            found.nodes_hinted.clear();
            found.demands.push_back((at, pages));
        }
        complete
    }

    /// A lattice of rays over a look-ahead tile, its edges included.
    fn rays_of(&self, i: u32, j: u32) -> [Ray; LANES] {
        let Region { columns, rows } = &self.state.region;
        let x0 = ((columns.start / LOOKAHEAD_TILE_PIXELS + i) * LOOKAHEAD_TILE_PIXELS).max(columns.start);
        let y0 = ((rows.start / LOOKAHEAD_TILE_PIXELS + j) * LOOKAHEAD_TILE_PIXELS).max(rows.start);
        let x1 =
            (x0 / LOOKAHEAD_TILE_PIXELS * LOOKAHEAD_TILE_PIXELS + LOOKAHEAD_TILE_PIXELS).min(columns.end);
        let y1 = (y0 / LOOKAHEAD_TILE_PIXELS * LOOKAHEAD_TILE_PIXELS + LOOKAHEAD_TILE_PIXELS).min(rows.end);
        std::array::from_fn(|lane| {
            let (u, v) = (lane % 8, lane / 8);
            let x = f64::from(x0) + f64::from(x1 - x0) * u as f64 / 7.0;
            let y = f64::from(y0) + f64::from(y1 - y0) * v as f64 / 7.0;
            self.rays.ray(x, y)
        })
    }
}
