//! Looks ahead of the tile being traced. The picture is divided into look-ahead tiles of 32 × 32 pixels. The pages of
//! upcoming look-ahead tiles are hinted at as far as there is room, given up if their look-ahead tile has passed
//! without using them, and retired once no later look-ahead tile can need them.

use std::cell::RefCell;
use std::collections::{BTreeSet, HashMap, HashSet, VecDeque};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

use super::probe::{Expected, OctreeView, ProbeRays};
use crate::field::LANES;
use crate::geometry::{Aabb, DVec3, Ray};
use crate::octree::node::{Node, NodePage};
use crate::scene::RayMaker;
use crate::trace::cloud::{CloudPlacement, CloudVolume};
use crate::trace::work::{LOOKAHEAD_TILE_PIXELS, Region, Tile};
use crate::trace::world::World;
use crate::working_set::{Object, PageClient, Reuse};

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
    page_bytes: u64,
    /// The region that the tiles cover.
    region: Region,
    threads: usize,
    columns: u32,
    rows: u32,
    /// Look-ahead tiles in the order in which tiles reach them; a look-ahead tile may occur several times.
    order: Vec<(u32, u32)>,
    /// For each tile, the position of its look-ahead tile in `order`.
    of_tile: Vec<u32>,
    /// For each look-ahead tile, its last position in `order`.
    last_place: Vec<u32>,
    queue: Mutex<Queue>,
    /// Pages that fit the budget besides those that the look-ahead tiles being traced need.
    spare_pages: AtomicU64,
}

/// A page of one of the files.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
struct PageId {
    file: u32,
    page: u32,
}

/// Pages found ahead. Look-ahead tiles are identified by their position in the order of the render.
#[derive(Default)]
struct Queue {
    /// Next look-ahead tile to examine.
    next: u32,
    /// Look-ahead tile for which pages were last retired.
    retired_at: u32,
    /// Pages that are wanted but not yet hinted at: the first look-ahead tile that wants the page, the page's rank in
    /// it, and the page.
    waiting: BTreeSet<(u32, u32, PageId)>,
    /// Pages found ahead that some upcoming look-ahead tile may need.
    seen: HashMap<PageId, Seen>,
    /// Number of pages found so far, from which ranks are assigned.
    sights: u32,
    /// Node pages that were hinted at for the next look-ahead tile, each once.
    nodes_hinted: HashSet<PageId>,
    /// Some of them had gone before all were there.
    nodes_do_not_fit: bool,
    /// The look-ahead tiles that have been examined but not yet traced, each with the number of pages it wants.
    demands: VecDeque<(u32, u64)>,
}

/// A page that has been found ahead.
struct Seen {
    /// Its key in `waiting`, if it is there.
    waits: Option<(u32, u32)>,
    /// The last look-ahead tile known to want it.
    wanted_by: u32,
    /// The last look-ahead tile whose rays can meet it.
    use_by: u32,
}

impl Queue {
    /// Records that a look-ahead tile wants a page.
    fn want(&mut self, page: PageId, lookahead_tile: u32, use_by: u32) {
        self.sights += 1;
        let key = (lookahead_tile, self.sights);
        let seen = self.seen.entry(page).or_insert(Seen { waits: None, wanted_by: lookahead_tile, use_by });
        seen.wanted_by = seen.wanted_by.max(lookahead_tile);
        seen.use_by = seen.use_by.max(use_by);
        match seen.waits {
            Some(earlier) if earlier.0 <= lookahead_tile => return,
            Some(later) => drop(self.waiting.remove(&(later.0, later.1, page))),
            None => {}
        }
        seen.waits = Some(key);
        self.waiting.insert((key.0, key.1, page));
    }

    /// Removes the first waiting pages.
    fn dealt_with(&mut self, count: usize) {
        for _ in 0..count {
            let Some((_, _, page)) = self.waiting.pop_first() else { return };
            if let Some(seen) = self.seen.get_mut(&page) {
                seen.waits = None;
            }
        }
    }
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
        let seen = world.program.clouds().filter(|(_, volume)| volume.placement.header().points > 0);
        let page_bytes = |volume: &CloudVolume| u64::from(volume.placement.header().page_bytes);
        Self {
            page_bytes: seen.clone().map(|(_, volume)| page_bytes(volume)).max().unwrap_or(1),
            clouds: seen.map(|(at, volume)| (at, Expected::new(&volume.shading, stop))).collect(),
            region,
            threads: threads.max(1),
            columns,
            rows,
            order,
            of_tile,
            last_place,
            queue: Mutex::default(),
            spare_pages: AtomicU64::new(0),
        }
    }

    /// How many of `count` tiles from one on are in the same look-ahead tile: at least that one. What a thread is still to
    /// trace must not count as passed.
    pub(in crate::trace) fn together(&self, tile: usize, count: usize) -> usize {
        self.of_tile[tile..][..count].iter().take_while(|&&place| place == self.of_tile[tile]).count()
    }

    /// How many tiles a thread may defer: as many as there is room for besides those being traced. If rays need most of
    /// the budget at a time, tracing other tiles meanwhile would only evict their pages.
    pub(in crate::trace) fn tiles_to_defer(&self) -> usize {
        /// Enough to hide the latency of a slow disk.
        const MOST: u64 = 32;
        /// Pages that a tile may bring in before it is deferred again.
        const PAGES_EACH: u64 = 8;
        let spare = self.spare_pages.load(Ordering::Relaxed);
        (spare / (PAGES_EACH * self.threads as u64)).min(MOST) as usize
    }
}

impl<'a> Lookahead<'a> {
    /// Examines up to `tiles_ahead` look-ahead tiles beyond that of `tile`, and hints at their pages as far as there is
    /// room.
    pub(super) fn scout(&self, tile: usize, tiles_ahead: u32) {
        if self.state.clouds.is_empty() {
            return;
        }
        // One thread at a time does this; the others have tiles to trace.
        let Ok(mut queue) = self.state.queue.try_lock() else { return };
        let here = self.state.of_tile[tile];
        self.retire(&mut queue, here);
        if queue.next < here {
            queue.next = here;
            queue.nodes_hinted.clear();
        }
        let until = here.saturating_add(1).saturating_add(tiles_ahead).min(self.state.order.len() as u32);
        // The current look-ahead tile and the next are examined even without room, to know how many pages they need.
        while queue.next < until
            && (self.hint(&mut queue, here) || queue.next <= here + 1)
            && self.look(queue.next, &mut queue)
        {
            queue.next += 1;
        }
    }

    /// Hints at the waiting pages; false if there was no room for some of them.
    fn hint(&self, queue: &mut Queue, here: u32) -> bool {
        /// Hints may take one part in this many of the budget: more would leave too little for pages that later
        /// look-ahead tiles use again.
        const MOST_OF_BUDGET: u64 = 4;
        let spare = self.spare(queue, here) * self.state.page_bytes;
        let most = self.pages.share_bytes() / MOST_OF_BUDGET;
        // Where the tiles being traced need nearly all, what they need would give way, or the hinted pages before their use.
        if spare < most {
            return false;
        }
        let pages: Vec<PageId> = queue.waiting.iter().map(|&(_, _, page)| page).collect();
        for same_file in pages.chunk_by(|a, b| a.file == b.file) {
            let numbers: Vec<u32> = same_file.iter().map(|id| id.page).collect();
            let Some(object) = self.object(same_file[0].file) else { continue };
            let dealt_with = self.pages.hint_knowing(object, &numbers, most, Some(self.reuse));
            queue.dealt_with(dealt_with);
            if dealt_with < numbers.len() {
                break;
            }
        }
        queue.waiting.is_empty()
    }

    fn clouds(&self) -> impl Iterator<Item = (&'a CloudPlacement, &'a Expected)> + use<'a> {
        let world = self.world;
        let clouds = self.state.clouds.iter();
        clouds
            .filter_map(|(at, expected)| world.program.cloud(*at).map(|volume| (&volume.placement, expected)))
    }

    fn object(&self, file: u32) -> Option<&'a Arc<Object>> {
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
    fn spare(&self, queue: &mut Queue, here: u32) -> u64 {
        let past = queue.demands.iter().take_while(|&&(lookahead_tile, _)| lookahead_tile < here).count();
        queue.demands.drain(..past);
        // The pages of one look-ahead tile are replaced gradually by those of the next, and threads may be in different
        // ones.
        let columns = queue.demands.iter().take(self.state.threads).map(|&(_, pages)| pages);
        let budget = self.pages.share_bytes() / self.state.page_bytes;
        let needed = match queue.demands.is_empty() {
            true if queue.nodes_do_not_fit => budget,
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
    fn retire(&self, queue: &mut Queue, here: u32) {
        if here <= queue.retired_at {
            return;
        }
        let (from, here) = (queue.retired_at.saturating_sub(1), here - 1);
        queue.retired_at = here + 1;
        let (mut unused, mut finished) = (Vec::new(), Vec::new());
        let waiting = &mut queue.waiting;
        queue.seen.retain(|&page, seen| {
            if (from..here).contains(&seen.wanted_by) {
                unused.push(page);
                if let Some((lookahead_tile, order)) = seen.waits.take() {
                    waiting.remove(&(lookahead_tile, order, page));
                }
            }
            if seen.use_by < here {
                finished.push(page);
            }
            seen.use_by >= here
        });
        self.by_file(unused, |object, pages| self.pages.retire_unused(object, pages));
        self.by_file(finished, |object, pages| self.pages.retire(object, pages));
    }

    /// Position in `order` of the last look-ahead tile whose rays may meet a box.
    fn last_visit(&self, bounds: &Aabb) -> u32 {
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
    fn look(&self, at: u32, queue: &mut Queue) -> bool {
        let (i, j) = self.state.order[at as usize];
        let rays = self.rays_of(i, j);
        let (mut complete, mut gone, mut pages) = (true, false, 0);
        for (cloud, expected) in self.clouds() {
            let mut view =
                View { ahead: self, cloud, queue, at, absent_nodes: Vec::new(), pages: 0, opened: 1 };
            let root = cloud.header().root;
            match view.node_at(root.page, root.index) {
                Some(root) => {
                    let rays = rays.map(|ray| cloud.local_ray(&ray));
                    ProbeRays::new(self.world.program.simd, &rays).explore(root, expected, &mut view);
                }
                None => view.absent_nodes.push(cloud.first_node_page + root.page),
            }
            pages += view.pages;
            let (mut absent, file) = (view.absent_nodes, cloud.file);
            complete &= absent.is_empty();
            absent.retain(|&page| {
                let fresh = queue.nodes_hinted.insert(PageId { file, page });
                gone |= !fresh && cloud.pages.is_absent(page);
                fresh
            });
            self.pages.hint_knowing(&cloud.pages, &absent, u64::MAX, Some(self.reuse));
        }
        queue.nodes_do_not_fit = gone;
        if complete {
            queue.nodes_hinted.clear();
            queue.demands.push_back((at, pages));
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

/// The part of a cloud's octree that is in memory, as seen by one look-ahead tile.
struct View<'v, 'a> {
    ahead: &'v Lookahead<'a>,
    cloud: &'a CloudPlacement,
    queue: &'v mut Queue,
    at: u32,
    absent_nodes: Vec<u32>,
    /// Number of pages wanted; a page is counted once for every node that has points in it.
    pages: u64,
    opened: u64,
}

impl View<'_, '_> {
    /// A node record, if its page is in memory.
    fn node_at(&self, page: u32, index: u16) -> Option<Node> {
        let guard = self.ahead.pages.peek(&self.cloud.pages, self.cloud.first_node_page + page)?;
        NodePage::scaled(&guard, self.cloud.header()).get(usize::from(index))
    }
}

impl OctreeView for View<'_, '_> {
    fn bounds(&self, node: &Node) -> Aabb {
        node.bounds(self.cloud.root_cell)
    }

    fn children(&mut self, node: &Node, found: &mut Vec<Node>) {
        let first = node.first_child;
        for k in 0..node.child_mask.count_ones() as u16 {
            match self.node_at(first.page, first.index + k) {
                // A file that is not a tree is reported when rays reach it.
                Some(child) if !child.is_child_of(node) || self.opened >= self.cloud.most_nodes() => return,
                Some(child) => {
                    self.opened += 1;
                    found.push(child);
                }
                None => return self.absent_nodes.push(self.cloud.first_node_page + first.page),
            }
        }
    }

    fn want(&mut self, node: &Node) {
        let pages = self.cloud.own_pages(node);
        if !pages.is_empty() {
            self.pages += pages.len() as u64;
            let use_by = self.ahead.last_visit(&self.cloud.bounds_world_of(node));
            let file = self.cloud.file;
            pages.for_each(|page| self.queue.want(PageId { file, page }, self.at, use_by));
        }
    }
}
