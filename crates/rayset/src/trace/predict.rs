//! Bringing pages in before rays need them. A prediction can be wrong without harm to the picture.

use std::collections::{HashMap, VecDeque};
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

use super::Region;
use super::world::World;
use crate::field::Packet;
use crate::geometry::curve::hilbert_order;
use crate::geometry::{Aabb, DVec3};
use crate::octree::node::{Node, NodePage};
use crate::scene::RayMaker;

/// Turns known rays, or past accesses, into hints.
pub trait Predictor: Send + Sync {
    /// Called by a thread that is about to trace the tile at a pixel.
    fn ahead(&self, lookahead: &Lookahead<'_>, x: u32, y: u32);
    /// What to call it in reports.
    fn name(&self) -> &'static str;
}

/// Predicts nothing: every page is read when it is needed.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoPredictor;

impl Predictor for NoPredictor {
    fn ahead(&self, _: &Lookahead<'_>, _: u32, _: u32) {}

    fn name(&self) -> &'static str {
        "none"
    }
}

/// The rays of the next tiles are known: walks the octree ahead of them, a block of tiles at a time, and hints at the
/// pages that they will meet, as deep as their neighbours went.
#[derive(Clone, Copy, Debug, Default)]
pub struct PacketPredictor;

impl Predictor for PacketPredictor {
    fn ahead(&self, lookahead: &Lookahead<'_>, x: u32, y: u32) {
        lookahead.scout(x, y);
    }

    fn name(&self) -> &'static str {
        "packet"
    }
}

/// Edge, in pixels, of the blocks of tiles that are looked at together.
const BLOCK_PIXELS: u32 = 32;
/// Blocks looked at ahead of the one being traced.
const BLOCKS_AHEAD: usize = 12;
/// Priority of a page that is expected: above that of pages released, below that of pages in use.
const HINT_PRIORITY: u8 = 150;
/// A block with an unfinished neighbourhood is taken to go this much deeper than its neighbours did, as a fraction.
const DEEPER: f64 = 1.1;

/// What is known of the picture being made: where rays will go, and how deep those already traced went.
pub struct Lookahead<'a> {
    world: &'a World<'a>,
    rays: &'a RayMaker,
    region: Region,
    columns: u32,
    rows: u32,
    step: f64,
    /// Place of each block along the curve.
    order: Vec<(u32, u32)>,
    place: Vec<u32>,
    /// Greatest depth of any finished tile of a block, as the bits of an `f64`; 0 before the first.
    depth: Vec<AtomicU64>,
    /// Depth of the last tile anywhere that was opaque, or of the first.
    recent_depth: AtomicU64,
    queue: Mutex<Queue>,
}

#[derive(Default)]
struct Queue {
    /// Next block of the curve to be looked at.
    next: usize,
    /// Blocks that could not be looked through because node pages were absent.
    again: VecDeque<usize>,
    /// Pages seen ahead for which there was no room yet, each with the block they are for.
    waiting: VecDeque<(usize, u32)>,
    /// Pages hinted at, each with the block they are for.
    hinted: VecDeque<(usize, u32)>,
    /// For each page seen ahead, the place along the curve of the last block that may need it.
    use_by: HashMap<u32, u32>,
    /// Place of the last block for which pages were retired.
    retired_at: u32,
}

/// A page ahead and the distance at which it is met.
#[derive(Clone, Copy, PartialEq, PartialOrd)]
struct Sight {
    sample: u64,
    page: u32,
}

impl<'a> Lookahead<'a> {
    pub(super) fn new(world: &'a World<'a>, rays: &'a RayMaker, region: &Region, step: f64) -> Self {
        let blocks =
            |range: &std::ops::Range<u32>| range.end.div_ceil(BLOCK_PIXELS) - range.start / BLOCK_PIXELS;
        let (columns, rows) = (blocks(&region.columns), blocks(&region.rows));
        let order = hilbert_order(columns, rows);
        let mut place = vec![0; order.len()];
        for (at, (i, j)) in order.iter().enumerate() {
            place[(j * columns + i) as usize] = at as u32;
        }
        let depth = order.iter().map(|_| AtomicU64::new(0)).collect();
        let queue = Mutex::default();
        Self {
            world,
            rays,
            region: region.clone(),
            columns,
            rows,
            step,
            order,
            place,
            depth,
            recent_depth: AtomicU64::new(0),
            queue,
        }
    }

    fn block(&self, x: u32, y: u32) -> usize {
        let i = x / BLOCK_PIXELS - self.region.columns.start / BLOCK_PIXELS;
        let j = y / BLOCK_PIXELS - self.region.rows.start / BLOCK_PIXELS;
        (j * self.columns + i) as usize
    }

    /// Notes how deep a tile went.
    pub(super) fn finished(&self, x: u32, y: u32, depth: f64) {
        // Positive floats compare like their bits.
        self.depth[self.block(x, y)].fetch_max(depth.to_bits(), Ordering::Relaxed);
        // Once rays have ended at something, tiles that miss it say nothing of how deep others go.
        let recent = f64::from_bits(self.recent_depth.load(Ordering::Relaxed));
        if depth.is_finite() || recent == 0.0 {
            self.recent_depth.store(depth.to_bits(), Ordering::Relaxed);
        }
    }

    /// Looks at the blocks that come within reach with the tile at a pixel.
    fn scout(&self, x: u32, y: u32) {
        if self.world.header.points == 0 {
            return;
        }
        // One thread at a time; the others have tiles to trace.
        let Ok(mut queue) = self.queue.try_lock() else { return };
        let here = self.place[self.block(x, y)];
        self.retire(&mut queue, here);
        let until = (here as usize + 1 + BLOCKS_AHEAD).min(self.order.len());
        while self.hint(&mut queue, here as usize) {
            // Blocks that have been traced meanwhile need no looking ahead.
            let block = match queue.again.pop_front() {
                Some(block) if block < here as usize => continue,
                Some(block) => block,
                // Before the first tile is done nothing is known of depths.
                None if queue.next < until && self.recent_depth.load(Ordering::Relaxed) != 0 => {
                    let block = queue.next.max(here as usize);
                    queue.next = block + 1;
                    block
                }
                None => return,
            };
            if !self.look(block, &mut queue) {
                queue.again.push_front(block);
                return;
            }
        }
    }

    /// Hints at the pages that wait for room, and gives up those whose block has been traced without them; false
    /// where some still wait.
    fn hint(&self, queue: &mut Queue, here: usize) -> bool {
        let object = &self.world.object;
        let past = |list: &VecDeque<(usize, u32)>| list.iter().take_while(|(block, _)| *block < here).count();
        let wrong: Vec<u32> = queue.hinted.drain(..past(&queue.hinted)).map(|(_, page)| page).collect();
        self.world.pages.retire_unused(object, &wrong);
        queue.waiting.drain(..past(&queue.waiting));
        if queue.waiting.is_empty() {
            return true;
        }
        let pages: Vec<u32> = queue.waiting.iter().map(|&(_, page)| page).collect();
        let dealt_with = self.world.pages.hint(object, &pages, HINT_PRIORITY);
        queue.hinted.extend(queue.waiting.drain(..dealt_with));
        queue.waiting.is_empty()
    }

    /// Gives up the pages whose last block has been traced. Other threads may still be a block behind.
    fn retire(&self, queue: &mut Queue, here: u32) {
        if here <= queue.retired_at {
            return;
        }
        queue.retired_at = here;
        let mut finished = Vec::new();
        queue.use_by.retain(|&page, &mut last| {
            let keep = last + 1 >= here;
            if !keep {
                finished.push(page);
            }
            keep
        });
        self.world.pages.retire(&self.world.object, &finished);
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

    /// Lists the pages of one block; false where node pages were absent, which are then on their way.
    fn look(&self, at: usize, queue: &mut Queue) -> bool {
        let (i, j) = self.order[at];
        let packet = self.packet(i, j);
        let limit = (self.depth_limit(i, j) / self.step) as u64;
        let (mut points, mut absent_nodes) = (Vec::new(), Vec::new());
        let mut stack: Vec<(Node, u64)> = Vec::new();
        let visit = |node: Node, stack: &mut Vec<(Node, u64)>| {
            if let Some((first, _)) = packet.samples_in(&node.bounds(self.world.root_cell))
                && first <= limit
            {
                stack.push((node, first));
            }
        };
        match self.node_at(self.world.header.root.page, self.world.header.root.index) {
            Some(root) => visit(root, &mut stack),
            None => absent_nodes.push(self.world.first_node_page + self.world.header.root.page),
        }
        while let Some((node, sample)) = stack.pop() {
            let own = node.own;
            if own.runs > 0 {
                let last = u64::from(own.first_run) + u64::from(own.runs);
                let pages = (last / self.runs_per_page()) as u32;
                let last_page = (own.first_page + pages).min(self.world.first_node_page - 1);
                let last_block = self.last_block(&node.bounds(self.world.root_cell));
                for page in own.first_page..=last_page {
                    points.push(Sight { sample, page });
                    queue.use_by.entry(page).and_modify(|b| *b = last_block.max(*b)).or_insert(last_block);
                }
            }
            if node.child_mask == 0 {
                continue;
            }
            for k in 0..node.child_mask.count_ones() as u16 {
                match self.node_at(node.first_child.page, node.first_child.index + k) {
                    Some(child) => visit(child, &mut stack),
                    None => {
                        absent_nodes.push(self.world.first_node_page + node.first_child.page);
                        break;
                    }
                }
            }
        }
        let complete = absent_nodes.is_empty();
        self.world.pages.hint(&self.world.object, &absent_nodes, super::frontier::NODE_PRIORITY);
        points.sort_unstable_by_key(|sight| (sight.sample, sight.page));
        for sight in &points {
            if !queue.waiting.iter().any(|&(_, page)| page == sight.page) {
                queue.waiting.push_back((at, sight.page));
            }
        }
        complete
    }

    /// A record, if its page is in memory.
    fn node_at(&self, page: u32, index: u16) -> Option<Node> {
        let page = self.world.first_node_page + page;
        if !self.world.pages.is_resident(&self.world.object, page) {
            return None;
        }
        let guard = self.world.retain(page, super::frontier::NODE_PRIORITY).ok()?;
        NodePage::trusted(&guard).get(usize::from(index))
    }

    /// Most runs that a page can hold, so that a range of runs is never taken for shorter than it is by a page.
    fn runs_per_page(&self) -> u64 {
        let least_run = crate::octree::page::RUN_POINTS * (6 + self.world.header.column_bytes());
        (u64::from(self.world.header.page_bytes) / least_run as u64).max(1)
    }

    /// How far rays of a block will go: as those around it that are finished and opaque, else as the last tile.
    /// Beside the outline of an object some neighbours let light through; a page missed there is read on demand,
    /// where following them would bring in everything behind the object.
    fn depth_limit(&self, i: u32, j: u32) -> f64 {
        let mut deepest = 0.0_f64;
        for y in j.saturating_sub(1)..(j + 2).min(self.rows) {
            for x in i.saturating_sub(1)..(i + 2).min(self.columns) {
                let bits = self.depth[(y * self.columns + x) as usize].load(Ordering::Relaxed);
                if f64::from_bits(bits).is_finite() {
                    deepest = deepest.max(f64::from_bits(bits));
                }
            }
        }
        if deepest == 0.0 {
            deepest = f64::from_bits(self.recent_depth.load(Ordering::Relaxed));
        }
        deepest * DEEPER
    }

    /// Rays on the edges and within a block, whose bounds are those of all its rays.
    fn packet(&self, i: u32, j: u32) -> Packet {
        let x0 =
            ((self.region.columns.start / BLOCK_PIXELS + i) * BLOCK_PIXELS).max(self.region.columns.start);
        let y0 = ((self.region.rows.start / BLOCK_PIXELS + j) * BLOCK_PIXELS).max(self.region.rows.start);
        let x1 = (x0 / BLOCK_PIXELS * BLOCK_PIXELS + BLOCK_PIXELS).min(self.region.columns.end);
        let y1 = (y0 / BLOCK_PIXELS * BLOCK_PIXELS + BLOCK_PIXELS).min(self.region.rows.end);
        let mut rays = Vec::with_capacity(64);
        for v in 0..8 {
            for u in 0..8 {
                let x = f64::from(x0) + f64::from(x1 - x0) * f64::from(u) / 7.0;
                let y = f64::from(y0) + f64::from(y1 - y0) * f64::from(v) / 7.0;
                rays.push((self.rays.ray(x, y), 0.5));
            }
        }
        Packet::new(&rays, self.step)
    }
}
