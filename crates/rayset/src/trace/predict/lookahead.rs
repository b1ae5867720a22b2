//! What is ahead of the tile being traced, block after block: pages are hinted at as room allows, given up when their
//! block has gone by without them, and retired when no later block can want them.

use std::collections::{BTreeSet, HashMap, VecDeque};
use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

use super::scout::{Expected, Scout, Terrain};
use crate::field::LANES;
use crate::geometry::curve::hilbert_order;
use crate::geometry::{Aabb, DVec3, Ray};
use crate::octree::node::{Node, NodePage};
use crate::scene::RayMaker;
use crate::trace::Region;
use crate::trace::access::NODE_PRIORITY;
use crate::trace::cloud_volume::CloudVolume;
use crate::trace::world::World;
use crate::working_set::Object;

/// Edge, in pixels, of the blocks of tiles that are looked at together.
const BLOCK_PIXELS: u32 = 32;
/// Priority of a page that is expected: pages that were released give way to it.
const HINT_PRIORITY: u8 = 200;

/// What is known of the picture being made: where rays will go.
pub struct Lookahead<'a> {
    world: &'a World,
    /// Every cloud of the graph, and what is expected of it.
    clouds: Vec<(&'a CloudVolume, Expected)>,
    /// Bytes of the largest page.
    page_bytes: u64,
    rays: &'a RayMaker,
    region: Region,
    threads: usize,
    columns: u32,
    rows: u32,
    /// Blocks along the curve that tiles are taken on.
    order: Vec<(u32, u32)>,
    /// Place of each block along the curve.
    place: Vec<u32>,
    queue: Mutex<Queue>,
    /// Pages of the budget that the blocks being traced do not need themselves.
    spare_pages: AtomicU64,
}

/// A page of one of the files.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
struct PageId {
    file: u32,
    page: u32,
}

/// Blocks are known by their place along the curve.
#[derive(Default)]
struct Queue {
    /// Next block to be looked at.
    next: u32,
    /// Block for which pages were last retired.
    retired_at: u32,
    /// Pages that are wanted and not yet hinted at: the block that wants each first, their order in that, the page.
    waiting: BTreeSet<(u32, u32, PageId)>,
    /// Pages seen ahead that some block to come may meet.
    seen: HashMap<PageId, Seen>,
    /// Pages seen so far, for their order.
    sights: u32,
    /// The blocks that have been looked at and not yet traced, and how many pages each wants.
    demands: VecDeque<(u32, u64)>,
}

/// A page seen ahead.
struct Seen {
    /// Its place among those waiting.
    waits: Option<(u32, u32)>,
    /// The last block known to want it.
    wanted_by: u32,
    /// The last block whose rays can meet it.
    use_by: u32,
}

impl Queue {
    /// Notes that a block wants a page.
    fn want(&mut self, page: PageId, block: u32, use_by: u32) {
        self.sights += 1;
        let key = (block, self.sights);
        let seen = self.seen.entry(page).or_insert(Seen { waits: None, wanted_by: block, use_by });
        seen.wanted_by = seen.wanted_by.max(block);
        seen.use_by = seen.use_by.max(use_by);
        match seen.waits {
            Some(earlier) if earlier.0 <= block => return,
            Some(later) => drop(self.waiting.remove(&(later.0, later.1, page))),
            None => {}
        }
        seen.waits = Some(key);
        self.waiting.insert((key.0, key.1, page));
    }

    /// Takes the first waiting pages away.
    fn dealt_with(&mut self, count: usize) {
        for _ in 0..count {
            let Some((_, _, page)) = self.waiting.pop_first() else { return };
            if let Some(seen) = self.seen.get_mut(&page) {
                seen.waits = None;
            }
        }
    }
}

impl<'a> Lookahead<'a> {
    pub(in crate::trace) fn new(
        world: &'a World,
        rays: &'a RayMaker,
        region: &Region,
        threads: usize,
    ) -> Self {
        let blocks = |range: &Range<u32>| range.end.div_ceil(BLOCK_PIXELS) - range.start / BLOCK_PIXELS;
        let (columns, rows) = (blocks(&region.columns), blocks(&region.rows));
        let order = hilbert_order(columns, rows);
        let mut place = vec![0; order.len()];
        for (at, (i, j)) in order.iter().enumerate() {
            place[(j * columns + i) as usize] = at as u32;
        }
        let region = region.clone();
        let (queue, spare_pages) = (Mutex::default(), AtomicU64::new(0));
        let threads = threads.max(1);
        let stop = world.absorption.stop_transmittance as f32;
        let seen = world.program.clouds().filter(|volume| volume.header().points > 0);
        let clouds: Vec<_> = seen.map(|volume| (volume, Expected::new(volume, stop))).collect();
        let page_bytes = clouds.iter().map(|(v, _)| u64::from(v.header().page_bytes)).max().unwrap_or(1);
        Self {
            world,
            clouds,
            page_bytes,
            rays,
            region,
            threads,
            columns,
            rows,
            order,
            place,
            queue,
            spare_pages,
        }
    }

    fn block(&self, x: u32, y: u32) -> usize {
        let i = x / BLOCK_PIXELS - self.region.columns.start / BLOCK_PIXELS;
        let j = y / BLOCK_PIXELS - self.region.rows.start / BLOCK_PIXELS;
        (j * self.columns + i) as usize
    }

    /// Looks at so many blocks beyond that of the tile at a pixel, and hints at what there is room for.
    pub(super) fn scout(&self, x: u32, y: u32, blocks_ahead: u32) {
        if self.clouds.is_empty() {
            return;
        }
        // One thread at a time; the others have tiles to trace.
        let Ok(mut queue) = self.queue.try_lock() else { return };
        let here = self.place[self.block(x, y)];
        self.retire(&mut queue, here);
        queue.next = queue.next.max(here);
        let until = here.saturating_add(1).saturating_add(blocks_ahead).min(self.order.len() as u32);
        // Of those, this block and the next are looked at in any case, to know how much room they need.
        while queue.next < until
            && (self.hint(&mut queue, here) || queue.next <= here + 1)
            && self.look(queue.next, &mut queue)
        {
            queue.next += 1;
        }
    }

    /// How many tiles a thread may put off: as many as there is room for besides what is being traced. Where rays need
    /// most of the budget at a time, going elsewhere meanwhile would only drive their pages out.
    pub(in crate::trace) fn tiles_to_put_off(&self) -> usize {
        /// Enough to cover a slow disk.
        const MOST: u64 = 32;
        /// Pages that a tile may bring in before it is put off once more.
        const PAGES_EACH: u64 = 4;
        let spare = self.spare_pages.load(Ordering::Relaxed);
        (spare / (PAGES_EACH * self.threads as u64)).min(MOST) as usize
    }

    /// Hints at the pages that wait; false where there was no room for some.
    fn hint(&self, queue: &mut Queue, here: u32) -> bool {
        /// More than this part of the budget would leave too little for pages to be met again by later blocks.
        const MOST_OF_BUDGET: u64 = 4;
        let world = self.world;
        let spare = self.spare(queue, here) * self.page_bytes;
        let most = spare.min(world.pages.budget_bytes() / MOST_OF_BUDGET);
        if most == 0 {
            return false;
        }
        let pages: Vec<PageId> = queue.waiting.iter().map(|&(_, _, page)| page).collect();
        for same_file in pages.chunk_by(|a, b| a.file == b.file) {
            let numbers: Vec<u32> = same_file.iter().map(|id| id.page).collect();
            let Some(object) = self.object(same_file[0].file) else { continue };
            let dealt_with = world.pages.hint(object, &numbers, HINT_PRIORITY, most);
            queue.dealt_with(dealt_with);
            if dealt_with < numbers.len() {
                break;
            }
        }
        queue.waiting.is_empty()
    }

    fn object(&self, file: u32) -> Option<&'a Arc<Object>> {
        self.clouds.iter().find(|(volume, _)| volume.file == file).map(|(volume, _)| &volume.pages)
    }

    /// Tells the working set of pages, file by file.
    fn by_file(&self, mut pages: Vec<PageId>, tell: impl Fn(&Object, &[u32])) {
        pages.sort_unstable();
        for same_file in pages.chunk_by(|a, b| a.file == b.file) {
            let numbers: Vec<u32> = same_file.iter().map(|id| id.page).collect();
            if let Some(object) = self.object(same_file[0].file) {
                tell(object, &numbers);
            }
        }
    }

    /// Pages of the budget that the blocks being traced do not need themselves.
    fn spare(&self, queue: &mut Queue, here: u32) -> u64 {
        let past = queue.demands.iter().take_while(|&&(block, _)| block < here).count();
        queue.demands.drain(..past);
        // Columns are taken over page by page, and threads may be in different ones.
        let columns = queue.demands.iter().take(self.threads).map(|&(_, pages)| pages);
        let budget = self.world.pages.budget_bytes() / self.page_bytes;
        let spare = budget.saturating_sub(columns.sum());
        self.spare_pages.store(spare, Ordering::Relaxed);
        spare
    }

    /// Gives up the pages whose blocks have gone by, one block late: other threads may still be there.
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
                if let Some((block, order)) = seen.waits.take() {
                    waiting.remove(&(block, order, page));
                }
            }
            if seen.use_by < here {
                finished.push(page);
            }
            seen.use_by >= here
        });
        self.by_file(unused, |object, pages| self.world.pages.retire_unused(object, pages));
        self.by_file(finished, |object, pages| self.world.pages.retire(object, pages));
    }

    /// Place along the curve of the last block whose rays may meet a box.
    fn last_block(&self, bounds: &Aabb) -> u32 {
        let (mut low, mut high) = ((f64::INFINITY, f64::INFINITY), (f64::NEG_INFINITY, f64::NEG_INFINITY));
        for corner in 0..8 {
            let pick = |bit: u32, axis: usize| {
                if corner >> bit & 1 == 0 { bounds.min[axis] } else { bounds.max[axis] }
            };
            let Some((x, y)) = self.rays.project(DVec3::new(pick(0, 0), pick(1, 1), pick(2, 2))) else {
                return self.order.len() as u32;
            };
            low = (low.0.min(x), low.1.min(y));
            high = (high.0.max(x), high.1.max(y));
        }
        let index = |v: f64, start: u32, count: u32| {
            let first = f64::from(start / BLOCK_PIXELS);
            (v / f64::from(BLOCK_PIXELS) - first).clamp(0.0, f64::from(count - 1)) as u32
        };
        let columns = index(low.0, self.region.columns.start, self.columns)
            ..=index(high.0, self.region.columns.start, self.columns);
        let rows = index(low.1, self.region.rows.start, self.rows)
            ..=index(high.1, self.region.rows.start, self.rows);
        rows.flat_map(|j| columns.clone().map(move |i| self.place[(j * self.columns + i) as usize]))
            .max()
            .unwrap_or(0)
    }

    /// Lists the pages that a block wants; false where node pages were absent, which are then on their way.
    fn look(&self, at: u32, queue: &mut Queue) -> bool {
        let (i, j) = self.order[at as usize];
        let rays = self.rays_of(i, j);
        let (mut complete, mut pages) = (true, 0);
        for (volume, expected) in &self.clouds {
            let mut view =
                View { ahead: self, volume, queue, at, absent_nodes: Vec::new(), pages: 0, opened: 1 };
            let root = volume.header().root;
            match view.node_at(root.page, root.index) {
                Some(root) => {
                    let rays = rays.map(|ray| volume.local_ray(&ray));
                    Scout::new(self.world.program.simd, &rays).explore(root, expected, &mut view);
                }
                None => view.absent_nodes.push(volume.first_node_page + root.page),
            }
            pages += view.pages;
            let absent = view.absent_nodes;
            self.world.pages.hint(&volume.pages, &absent, NODE_PRIORITY, u64::MAX);
            complete &= absent.is_empty();
        }
        if complete {
            queue.demands.push_back((at, pages));
        }
        complete
    }

    /// Rays on the edges and within a block.
    fn rays_of(&self, i: u32, j: u32) -> [Ray; LANES] {
        let x0 =
            ((self.region.columns.start / BLOCK_PIXELS + i) * BLOCK_PIXELS).max(self.region.columns.start);
        let y0 = ((self.region.rows.start / BLOCK_PIXELS + j) * BLOCK_PIXELS).max(self.region.rows.start);
        let x1 = (x0 / BLOCK_PIXELS * BLOCK_PIXELS + BLOCK_PIXELS).min(self.region.columns.end);
        let y1 = (y0 / BLOCK_PIXELS * BLOCK_PIXELS + BLOCK_PIXELS).min(self.region.rows.end);
        std::array::from_fn(|lane| {
            let (u, v) = (lane % 8, lane / 8);
            let x = f64::from(x0) + f64::from(x1 - x0) * u as f64 / 7.0;
            let y = f64::from(y0) + f64::from(y1 - y0) * v as f64 / 7.0;
            self.rays.ray(x, y)
        })
    }
}

/// The octree of a cloud as far as it is in memory, seen for one block.
struct View<'v, 'a> {
    ahead: &'v Lookahead<'a>,
    volume: &'a CloudVolume,
    queue: &'v mut Queue,
    at: u32,
    absent_nodes: Vec<u32>,
    /// Pages wanted, each counted for every node that has points in it.
    pages: u64,
    opened: u64,
}

impl View<'_, '_> {
    /// A record, if its page is in memory.
    fn node_at(&self, page: u32, index: u16) -> Option<Node> {
        let guard = self.ahead.world.pages.peek(&self.volume.pages, self.volume.first_node_page + page)?;
        NodePage::trusted(&guard).get(usize::from(index))
    }
}

impl Terrain for View<'_, '_> {
    fn bounds(&self, node: &Node) -> Aabb {
        node.bounds(self.volume.root_cell)
    }

    fn children(&mut self, node: &Node, found: &mut Vec<Node>) {
        let first = node.first_child;
        for k in 0..node.child_mask.count_ones() as u16 {
            match self.node_at(first.page, first.index + k) {
                // What is no tree is for the rays to find out.
                Some(child) if !child.is_child_of(node) || self.opened >= self.volume.most_nodes() => return,
                Some(child) => {
                    self.opened += 1;
                    found.push(child);
                }
                None => return self.absent_nodes.push(self.volume.first_node_page + first.page),
            }
        }
    }

    fn want(&mut self, node: &Node) {
        let pages = self.volume.own_pages(node);
        if !pages.is_empty() {
            self.pages += pages.len() as u64;
            let use_by = self.ahead.last_block(&self.volume.bounds_world_of(node));
            let file = self.volume.file;
            pages.for_each(|page| self.queue.want(PageId { file, page }, self.at, use_by));
        }
    }
}
