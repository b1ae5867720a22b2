//! How the memory of a render is divided between the picture on its way to a file, what the scene
//! needs, and pages.

use super::ambient_occlusion::{ROWS_SENT, rows_kept};
use super::memory::{Demand, SceneNeeds};
use crate::image::LayerPixel;
use rayset_files::grid::format::PAGE_BYTES;
use rayset_files::octree::Cloud;

/// Bytes of a pixel with layers in an OpenEXR file.
const EXR_PIXEL_BYTES: u64 = 64;
/// Blocks' worth of memory that compressing one takes: itself, two copies, and the outcome. An
/// unoptimised encoder checks the outcome, too.
const EXR_COMPRESSING: u64 = if cfg!(debug_assertions) { 5 } else { 4 };
/// Bytes of a pixel in the band that is being rendered.
pub const PIXEL_BYTES: u64 = 16;
/// Fewest rows in a band.
pub const LEAST_BAND_ROWS: u32 = 8;

/// How a memory budget is divided.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(not(feature = "internals"), non_exhaustive)]
pub struct MemoryPlan {
    /// Bytes for pages.
    pub page_bytes: u64,
    /// Of these, the most that cached shadows may take: what the pages of all files leave, but at
    /// least half. Evicted shadows are computed again, as pages of files are read again, but there
    /// can be many more of them.
    pub shadow_bytes: u64,
    /// Bytes of the largest page.
    pub largest_page_bytes: u64,
    /// Rows of the picture rendered at a time.
    pub band_rows: u32,
    /// Bytes for caps.
    pub caps_bytes: u64,
    /// The smallest budget with which the render can run, or, where there are caps, with which
    /// these can be counted.
    pub least_bytes: u64,
    /// A budget with which it runs well: room for the pages that one row of tiles needs, and for as
    /// many ahead.
    pub comfortable_bytes: u64,
}

impl SceneNeeds {
    /// Divides a budget between the picture, the scene and pages.
    ///
    /// # Errors
    /// The smallest sufficient budget in bytes, if `budget_bytes` is smaller.
    pub fn plan(&self, budget_bytes: u64) -> Result<MemoryPlan, u64> {
        let picture = Picture::of(self);
        let Some(least_caps) = self.with_least_caps() else { return picture.plan(self, budget_bytes) };
        let least_bytes = picture.plan(&least_caps, u64::MAX / 2)?.least_bytes;
        let plan = picture.plan(self, budget_bytes).or_else(|_| picture.plan(&least_caps, budget_bytes))?;
        Ok(MemoryPlan { least_bytes, ..plan })
    }
}

/// What is rendered, and by what means.
#[derive(Clone, Copy)]
struct Picture {
    width: u32,
    height: u32,
    threads: usize,
    process_bytes: u64,
}

impl Picture {
    fn of(needs: &SceneNeeds) -> Self {
        let SceneNeeds { size: (width, height), threads, process_bytes, .. } = *needs;
        Self { width, height, threads, process_bytes }
    }

    /// Divides a budget, or says which suffices.
    fn plan(self, needs: &SceneNeeds, budget_bytes: u64) -> Result<MemoryPlan, u64> {
        let Self { width, height, threads, process_bytes } = self;
        let demand = Demand::of(&[needs], threads);
        let pixel = PIXEL_BYTES + if needs.layers { size_of::<LayerPixel>() as u64 } else { 0 };
        // Tiles are listed, 16 bytes each; those that are traced again with a mask of 8.
        let listed = u64::from(width) / if needs.traces_again { 1 } else { 2 };
        let row = u64::from(width) * pixel + listed;
        // Above and below a band, a row is traced besides.
        let rows_around: u32 = if needs.traces_again { 2 } else { 0 };
        let least_rows = LEAST_BAND_ROWS.min(height);
        // The picture's rows also pass through the encoder.
        let encoder = if needs.writes_layers {
            u64::from(width) * exr_bytes(height).saturating_sub(u64::from(least_rows) * EXR_PIXEL_BYTES)
        } else {
            8 * row
        };
        let kept_rows = if needs.ambient_occlusion { rows_kept(height) + ROWS_SENT.min(height) } else { 0 };
        let fixed = process_bytes + demand.fixed + u64::from(kept_rows + rows_around) * row + encoder;
        let least_page_bytes = demand.least_page_bytes();
        let least_bytes = fixed + u64::from(least_rows) * row + least_page_bytes;
        if budget_bytes < least_bytes {
            return Err(least_bytes);
        }
        // Up to a quarter of what is free goes to the picture, in whole rows of look-ahead tiles if
        // at least one fits.
        let free = budget_bytes - fixed - least_page_bytes;
        let rows =
            (free / 4 / row.max(1)).clamp(u64::from(LEAST_BAND_ROWS), u64::from(height.max(LEAST_BAND_ROWS)));
        let rows = if rows < u64::from(height) && rows >= 32 { rows / 32 * 32 } else { rows };
        let band_rows = (rows as u32).min(height).max(1);
        // For a grid, roughly a layer of bricks.
        let layers = needs.grids.iter().map(|g| g.header().pages().isqrt() * 8 * PAGE_BYTES as u64);
        let columns = needs.clouds.iter().map(|cloud| comfortable_pages(cloud) * demand.page);
        let comfortable_pages: u64 = columns.chain(layers).sum();
        let (page_bytes, shadow_bytes) = demand.divide(budget_bytes - fixed - u64::from(band_rows) * row);
        Ok(MemoryPlan {
            largest_page_bytes: demand.page,
            page_bytes,
            shadow_bytes,
            band_rows,
            caps_bytes: needs.caps_bytes,
            least_bytes,
            comfortable_bytes: fixed
                + u64::from(height.min(512)) * row
                + comfortable_pages
                + least_page_bytes,
        })
    }
}

/// Bytes per column for what is being written to an OpenEXR file of `height` rows. Of its blocks of
/// 16 rows one is filled, one waits, and one is compressed; the last has the rows that are left.
/// The band that the first comes from is gone before that is compressed.
pub(super) fn exr_bytes(height: u32) -> u64 {
    let compressed = u64::from(height.min(16));
    let others = u64::from(height.saturating_sub(16).min(32));
    (EXR_COMPRESSING * compressed + others) * EXR_PIXEL_BYTES
}

/// A row of the picture crosses about √n of the n pages of a surface; this is counted for front and
/// back, above and below.
fn comfortable_pages(cloud: &Cloud) -> u64 {
    let header = cloud.header();
    let points = u64::from(header.point_pages);
    (u64::from(header.node_pages) + 8 * (points as f64).sqrt().ceil() as u64).min(u64::from(header.pages()))
}
