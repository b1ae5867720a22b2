//! What a render needs besides pages, so that a budget for the whole process can be kept.

use crate::octree::format::Header;
use crate::working_set::{OVERHEAD_BYTES, WorkingSet};

/// Scratch memory, stack and bookkeeping of one tracing thread.
pub const THREAD_BYTES: u64 = 768 << 10;
/// Bytes of a pixel while its band is being made.
pub const PIXEL_BYTES: u64 = 16;
/// Fewest rows that are worked on together.
pub const LEAST_BAND_ROWS: u32 = 8;
/// Room for the reads that are in flight and the threads that serve them.
const READING_BYTES: u64 = 1 << 20;

/// How a budget is spent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MemoryPlan {
    /// For pages.
    pub page_bytes: u64,
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
    header: &Header,
    width: u32,
    height: u32,
    threads: usize,
    process_bytes: u64,
    budget_bytes: u64,
) -> Result<MemoryPlan, u64> {
    let page = u64::from(header.page_bytes);
    let row = u64::from(width) * PIXEL_BYTES;
    // The picture's rows also pass through the encoder.
    let fixed = process_bytes
        + threads as u64 * THREAD_BYTES
        + READING_BYTES
        + WorkingSet::overhead_bytes(header.pages())
        + 8 * row;
    let least_pages = least_pages(threads) * page;
    let least_bytes =
        fixed + u64::from(LEAST_BAND_ROWS.min(height)) * row + least_pages * (page + OVERHEAD_BYTES) / page;
    if budget_bytes < least_bytes {
        return Err(least_bytes);
    }
    // A quarter of what is free may go to the picture, in whole rows of look-ahead blocks where it can.
    let free = budget_bytes - fixed - least_pages * (page + OVERHEAD_BYTES) / page;
    let rows =
        (free / 4 / row.max(1)).clamp(u64::from(LEAST_BAND_ROWS), u64::from(height.max(LEAST_BAND_ROWS)));
    let rows = if rows < u64::from(height) && rows >= 32 { rows / 32 * 32 } else { rows };
    let band_rows = (rows as u32).min(height).max(1);
    let picture = u64::from(band_rows) * row;
    Ok(MemoryPlan {
        page_bytes: (budget_bytes - fixed - picture) / (page + OVERHEAD_BYTES) * page,
        band_rows,
        least_bytes,
        comfortable_bytes: fixed
            + u64::from(height.min(512)) * row
            + comfortable_pages(header) * page
            + least_pages,
    })
}

/// Pages without which threads could wait for each other for ever: each retains one at a time, and one is on its way.
#[must_use]
pub fn least_pages(threads: usize) -> u64 {
    2 * threads as u64 + 2
}

/// A surface of n pages crosses a row of the picture with about √n of them, front and back, above and below.
fn comfortable_pages(header: &Header) -> u64 {
    let points = u64::from(header.point_pages);
    (u64::from(header.node_pages) + 8 * (points as f64).sqrt().ceil() as u64).min(u64::from(header.pages()))
}
