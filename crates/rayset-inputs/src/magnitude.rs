//! Volumes whose values no scene could hold are built with other units.

use anyhow::Result;
use rayset::Grid;

/// Values of a sample.
const SAMPLE: usize = 1 << 14;
/// Largest values that a scene holds well; those up to [`MARKS`] still are held.
const HELD: std::ops::RangeInclusive<f64> = 1e-9..=1e15;
/// Values from here on may be marks of places without one…
const MARKS: f64 = 1e17;
/// … if there are no more different ones than these.
const MOST_MARKS: usize = 8;

/// The power of ten by which the values of a grid are to be multiplied so that scenes, whose
/// numbers go to 1e18 and differ by 1e-18, can hold them; `None` if they can already.
pub(crate) fn exponent(grid: &Grid) -> Result<Option<i32>> {
    let sample = grid.sample(SAMPLE)?;
    let mut sizes: Vec<f64> = (0..sample.len()).map(|i| sample.columns[0].get(i).abs()).collect();
    sizes.retain(|size| size.is_finite() && *size > 0.0);
    sizes.sort_by(f64::total_cmp);
    let mut beyond = sizes[sizes.partition_point(|&size| size < MARKS)..].to_vec();
    beyond.dedup();
    if beyond.len() <= MOST_MARKS {
        sizes.retain(|&size| size < MARKS);
    }
    let (Some(half), Some(largest)) = (sizes.get(sizes.len() / 2), sizes.last()) else { return Ok(None) };
    if (*HELD.start()..MARKS).contains(largest) {
        return Ok(None);
    }
    // The middle of the values becomes about 1, unless the largest would be too large.
    let middle = half.log10().max(largest.log10() - HELD.end().log10());
    Ok(Some(-middle.floor() as i32))
}
