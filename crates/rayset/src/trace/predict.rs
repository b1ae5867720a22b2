//! Bringing pages in before rays need them. A prediction can be wrong without harm to the picture.

use std::collections::VecDeque;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

use super::Region;
use super::world::World;
use crate::field::Packet;
use crate::geometry::curve::hilbert_order;
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
const DEEPER: f64 = 1.05;

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
    queue: Mutex<Queue>,
}

#[derive(Default)]
struct Queue {
    /// Next block of the curve to be looked at.
    next: usize,
    /// Blocks that could not be looked through because node pages were absent.
    again: VecDeque<usize>,
}

/// A page ahead and the distance at which it is met.
#[derive(Clone, Copy, PartialEq, PartialOrd)]
struct Sight {
    sample: u64,
    page: u32,
}

impl<'a> Lookahead<'a> {
    pub(super) fn new(world: &'a World<'a>, rays: &'a RayMaker, region: &Region, step: f64) -> Self {
        let blocks = |range: &std::ops::Range<u32>| range.end.div_ceil(BLOCK_PIXELS) - range.start / BLOCK_PIXELS;
        let (columns, rows) = (blocks(&region.columns), blocks(&region.rows));
        let order = hilbert_order(columns, rows);
        let mut place = vec![0; order.len()];
        for (at, (i, j)) in order.iter().enumerate() {
            place[(j * columns + i) as usize] = at as u32;
        }
        let depth = order.iter().map(|_| AtomicU64::new(0)).collect();
        let queue = Mutex::default();
        Self { world, rays, region: region.clone(), columns, rows, step, order, place, depth, queue }
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
    }

    /// Looks at the blocks that come within reach with the tile at a pixel.
    fn scout(&self, x: u32, y: u32) {
        // One thread at a time; the others have tiles to trace.
        let Ok(mut queue) = self.queue.try_lock() else { return };
        let until = (self.place[self.block(x, y)] as usize + 1 + BLOCKS_AHEAD).min(self.order.len());
        if let Some(block) = queue.again.pop_front()
            && !self.look(block)
        {
            queue.again.push_back(block);
        }
        while queue.next < until {
            let block = queue.next;
            queue.next += 1;
            if !self.look(block) {
                queue.again.push_back(block);
            }
        }
    }

    /// Hints at the pages of one block; false where node pages were absent, which are then on their way.
    fn look(&self, at: usize) -> bool {
        let (i, j) = self.order[at];
        let packet = self.packet(i, j);
        let limit = self.depth_limit(i, j).map_or(u64::MAX, |t| (t / self.step) as u64);
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
                points.extend((own.first_page..=last_page).map(|page| Sight { sample, page }));
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
        points.sort_unstable_by(|a, b| (a.sample, a.page).cmp(&(b.sample, b.page)));
        let mut pages: Vec<u32> = Vec::with_capacity(points.len());
        for sight in &points {
            if !pages.contains(&sight.page) {
                pages.push(sight.page);
            }
        }
        self.world.pages.hint(&self.world.object, &pages, HINT_PRIORITY);
        complete
    }

    /// A record, if its page is in memory.
    fn node_at(&self, page: u32, index: u16) -> Option<Node> {
        let page = self.world.first_node_page + page;
        if self.world.header.points == 0 || !self.world.pages.is_resident(&self.world.object, page) {
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

    /// How far rays of a block will go, from those around it that are finished; nothing where none is.
    fn depth_limit(&self, i: u32, j: u32) -> Option<f64> {
        let mut deepest = 0.0_f64;
        for y in j.saturating_sub(1)..(j + 2).min(self.rows) {
            for x in i.saturating_sub(1)..(i + 2).min(self.columns) {
                let bits = self.depth[(y * self.columns + x) as usize].load(Ordering::Relaxed);
                deepest = deepest.max(f64::from_bits(bits));
            }
        }
        (deepest > 0.0).then_some(deepest * DEEPER)
    }

    /// Rays on the edges and within a block, whose bounds are those of all its rays.
    fn packet(&self, i: u32, j: u32) -> Packet {
        let x0 = ((self.region.columns.start / BLOCK_PIXELS + i) * BLOCK_PIXELS).max(self.region.columns.start);
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
