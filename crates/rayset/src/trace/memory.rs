//! What a render needs besides pages, so that a budget for the whole process can be kept.

use std::sync::Arc;

use super::block::{Block, Wants};
use super::packet_tracer::tree_bytes;
use super::shadow::{BLOCK_BYTES, LightTable};
use crate::field::{LANES, SampleRow};
use crate::grid::Grid;
use crate::grid::format::PAGE_BYTES;
use crate::image::LayerPixel;
use crate::octree::Cloud;
use crate::scene::{Lighting, MOST_ATTRIBUTES, Node, Operator, RenderSettings, Scene, Shape};
use crate::working_set::{OVERHEAD_BYTES, WorkingSet};

/// Scratch memory, stack and bookkeeping of one thread that traces a single cloud.
const THREAD_BYTES: u64 = 640 << 10;
/// What every further cloud of a graph adds to that: a packet in its space and the part of its octree ahead.
const CLOUD_BYTES: u64 = 48 << 10;
/// What look-ahead remembers of a page, most of which it never sees at a time.
const LOOKAHEAD_BYTES: u64 = 24;
/// One part in so many of the pages' memory is lost in between them.
const ALLOCATOR_PART: u64 = 32;
/// And more where pages and blocks of shadows, of other sizes, take each other's place.
const MIXED_ALLOCATOR_PART: u64 = 14;
/// Blocks of 16 rows of layers on their way into an OpenEXR file, for each column: six, with what compression takes.
const EXR_BYTES: u64 = 6 * 16 * 60;
/// Bytes of a pixel while its band is being made.
pub const PIXEL_BYTES: u64 = 16;
/// Fewest rows that are worked on together.
pub const LEAST_BAND_ROWS: u32 = 8;
/// Room for the reads that are in flight and the threads that serve them.
const READING_BYTES: u64 = 1 << 20;

/// What of a scene takes memory besides its pages.
#[derive(Clone, Debug)]
pub struct SceneNeeds {
    clouds: Vec<Arc<Cloud>>,
    grids: Vec<Arc<Grid>>,
    thread_bytes: u64,
    /// Blocks of cached shadows.
    shadow_blocks: u64,
    layers: bool,
}

impl SceneNeeds {
    /// Of a scene that has been checked.
    #[must_use]
    pub fn of(scene: &Scene, settings: &RenderSettings) -> Self {
        let (mut clouds, mut grids) = (Vec::new(), Vec::new());
        let mut leaves = 0;
        scene.root.for_each(&mut |node| match &node.shape {
            Shape::Cloud(object) => {
                leaves += 1;
                if !clouds.iter().any(|known| Arc::ptr_eq(known, &object.cloud)) {
                    clouds.push(object.cloud.clone());
                }
            }
            Shape::Grid(object) if !grids.iter().any(|known| Arc::ptr_eq(known, &object.grid)) => {
                grids.push(object.grid.clone());
            }
            Shape::Grid(_) | Shape::Procedural(_) | Shape::Operator(..) => {}
        });
        let lit = scene.lighting != Lighting::Unlit;
        let has = |wanted: fn(&Node) -> bool| {
            let mut found = false;
            scene.root.for_each(&mut |node| found |= wanted(node));
            found
        };
        let turns = has(|n| n.material.is_some_and(|m| m.reflectance > 0.0 || m.refractive_index != 1.0));
        let names = scene.root.attributes_read().len().min(MOST_ATTRIBUTES) as u32;
        let wants = Wants {
            color: true,
            normal: lit || settings.layers,
            boundary: lit
                && (turns
                    || scene.lighting.throws_shadows()
                    || has(|node| matches!(node.shape, Shape::Operator(Operator::Difference, _)))),
            outside: false,
            material: settings.layers || (lit && has(|node| node.material.is_some())),
            attributes: u32::MAX.checked_shr(32 - names).unwrap_or(0),
        };
        let picture = blocks(&scene.root) * Block::bytes(wants);
        let opacity_only = Wants { attributes: wants.attributes, ..Wants::default() };
        let shadow = if scene.lighting.throws_shadows() {
            blocks(&scene.root) * Block::bytes(opacity_only)
        } else {
            0
        };
        let passes = if shadow > 0 { 2 } else { 1 };
        let tree = if turns && settings.max_depth > 0 { tree_bytes(settings.max_depth) } else { 0 };
        // Of the field of a cloud, once for pictures and once for shadows.
        let sums = u64::from(names) * passes * (LANES * size_of::<SampleRow>()) as u64;
        let thread_bytes =
            THREAD_BYTES + (picture + shadow) as u64 + leaves * passes * CLOUD_BYTES + tree + sums;
        let shadow_blocks = LightTable::blocks_of(scene, settings.shadows);
        Self { clouds, grids, thread_bytes, shadow_blocks, layers: settings.layers }
    }

    /// Every grid of the scene, each once.
    #[must_use]
    pub fn grids(&self) -> &[Arc<Grid>] {
        &self.grids
    }

    /// Pages of every file and the bytes of each.
    fn files(&self) -> impl Iterator<Item = (u64, u64)> {
        let clouds =
            self.clouds.iter().map(|c| (u64::from(c.header().pages()), u64::from(c.header().page_bytes)));
        clouds.chain(self.grids.iter().map(|grid| (grid.header().pages(), PAGE_BYTES as u64)))
    }

    /// Every cloud of the scene, each once.
    #[must_use]
    pub fn clouds(&self) -> &[Arc<Cloud>] {
        &self.clouds
    }
}

/// An upper bound of the blocks in use at a time.
fn blocks(node: &Node) -> usize {
    let Shape::Operator(operator, children) = &node.shape else { return 1 };
    let deepest = children.iter().map(|child| blocks(child)).max().unwrap_or(0);
    // One more for a child that others use too.
    let shared = children.iter().filter(|child| Arc::strong_count(child) > 1).count();
    let own = if *operator == Operator::Intersection { children.len() } else { 2 };
    own + deepest + shared
}

/// How a budget is spent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MemoryPlan {
    /// For pages.
    pub page_bytes: u64,
    /// Of these, the most that cached shadows may take: what all files together leave, and at least half. Shadows are made
    /// again where files are read again, but there can be many more of them.
    pub shadow_bytes: u64,
    /// Bytes of the largest page.
    pub largest_page_bytes: u64,
    /// Rows of the picture made at a time.
    pub band_rows: u32,
    /// The smallest budget in which the render runs.
    pub least_bytes: u64,
    /// A budget in which it runs well: the pages that one row of tiles sees, and as many ahead.
    pub comfortable_bytes: u64,
}

/// Spends `budget_bytes` on a render; `process_bytes` is what the process takes before it starts. Returns the plan, or
/// the smallest budget that would do.
///
/// # Errors
/// The smallest budget in bytes, where this one is smaller.
pub fn plan(
    needs: &SceneNeeds,
    width: u32,
    height: u32,
    threads: usize,
    process_bytes: u64,
    budget_bytes: u64,
) -> Result<MemoryPlan, u64> {
    let page = needs.files().map(|(_, bytes)| bytes).max().unwrap_or(4096);
    // Tiles are listed, 24 bytes each.
    let pixel = PIXEL_BYTES + if needs.layers { size_of::<LayerPixel>() as u64 } else { 0 };
    let row = u64::from(width) * pixel + u64::from(width) / 2;
    let pages: u64 = needs.files().map(|(pages, _)| pages).sum();
    let slots = pages + needs.shadow_blocks;
    let overhead = WorkingSet::overhead_bytes(u32::try_from(slots).unwrap_or(u32::MAX));
    let overhead = overhead + pages * LOOKAHEAD_BYTES;
    // The picture's rows also pass through the encoder.
    let fixed = process_bytes + threads as u64 * needs.thread_bytes + READING_BYTES + overhead + 8 * row;
    let encoder = if needs.layers { EXR_BYTES * u64::from(width) } else { 0 };
    let fixed = fixed + encoder;
    let block = BLOCK_BYTES as u64;
    let largest = if needs.shadow_blocks > 0 { page.max(block) } else { page };
    let least_page_bytes = least_pages(threads) * (largest + OVERHEAD_BYTES + largest / MIXED_ALLOCATOR_PART);
    let least_bytes = fixed + u64::from(LEAST_BAND_ROWS.min(height)) * row + least_page_bytes;
    if budget_bytes < least_bytes {
        return Err(least_bytes);
    }
    // A quarter of what is free may go to the picture, in whole rows of look-ahead blocks where it can.
    let free = budget_bytes - fixed - least_page_bytes;
    let rows =
        (free / 4 / row.max(1)).clamp(u64::from(LEAST_BAND_ROWS), u64::from(height.max(LEAST_BAND_ROWS)));
    let rows = if rows < u64::from(height) && rows >= 32 { rows / 32 * 32 } else { rows };
    let band_rows = (rows as u32).min(height).max(1);
    let picture = u64::from(band_rows) * row;
    // Of a grid, a layer of bricks.
    let layers = needs.grids.iter().map(|g| g.header().pages().isqrt() * 8 * PAGE_BYTES as u64);
    let columns = needs.clouds.iter().map(|cloud| comfortable_pages(cloud) * page);
    let comfortable_pages: u64 = columns.chain(layers).sum();
    // What the allocator adds to each counts most where they are small.
    let unit = if needs.shadow_blocks > 0 { page.min(block) } else { page };
    let mixed = needs.shadow_blocks > 0 && needs.files().any(|(_, bytes)| bytes != block);
    let part = if mixed { MIXED_ALLOCATOR_PART } else { ALLOCATOR_PART };
    let page_bytes = (budget_bytes - fixed - picture) / (unit + OVERHEAD_BYTES + unit / part) * unit;
    let page_bytes = page_bytes.max(least_pages(threads) * largest);
    let file_bytes: u64 = needs.files().map(|(pages, bytes)| pages * bytes).sum();
    Ok(MemoryPlan {
        largest_page_bytes: page,
        page_bytes,
        shadow_bytes: page_bytes
            .saturating_sub(file_bytes)
            .max(page_bytes / 2)
            .max(block * (threads as u64 + 1))
            .min(page_bytes),
        band_rows,
        least_bytes,
        comfortable_bytes: fixed + u64::from(height.min(512)) * row + comfortable_pages + least_page_bytes,
    })
}

/// Pages without which threads could wait for each other for ever: each retains one at a time, and one is on its way.
#[must_use]
pub fn least_pages(threads: usize) -> u64 {
    2 * threads as u64 + 2
}

/// A surface of n pages crosses a row of the picture with about √n of them, front and back, above and below.
fn comfortable_pages(cloud: &Cloud) -> u64 {
    let header = cloud.header();
    let points = u64::from(header.point_pages);
    (u64::from(header.node_pages) + 8 * (points as f64).sqrt().ceil() as u64).min(u64::from(header.pages()))
}
