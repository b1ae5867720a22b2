//! From densities to optical depths, and between these and opacities, lane by lane.

use crate::math::{absorbed, ln};
use crate::scene::MAX_OPACITY;
use crate::trace::node_samples::Rows;

// Loops instead of `map`: the compiler does not inline closures into functions compiled for other
// instruction sets.

#[inline(always)]
pub(super) fn optical_depth_of_extinction(
    mut lanes: u64,
    density: &Rows,
    (per_density, most): (f32, f32),
    rows: &mut Rows,
) {
    while lanes != 0 {
        let lane = lanes.trailing_zeros() as usize;
        lanes &= lanes - 1;
        for (t, &d) in rows[lane].0.iter_mut().zip(&density[lane].0) {
            // A density that is negative or NaN absorbs nothing.
            *t = if d > 0.0 { (per_density * d).min(most) } else { 0.0 };
        }
    }
}

#[inline(always)]
pub(super) fn opacity_of_optical_depth(mut lanes: u64, rows: &mut Rows) {
    while lanes != 0 {
        let lane = lanes.trailing_zeros() as usize;
        lanes &= lanes - 1;
        for t in &mut rows[lane].0 {
            *t = absorbed(*t).min(MAX_OPACITY as f32);
        }
    }
}

#[inline(always)]
pub(super) fn optical_depth_of_opacity(mut lanes: u64, rows: &mut Rows) {
    while lanes != 0 {
        let lane = lanes.trailing_zeros() as usize;
        lanes &= lanes - 1;
        for o in &mut rows[lane].0 {
            *o = if *o > 0.0 { -ln(1.0 - o.min(MAX_OPACITY as f32)) } else { 0.0 };
        }
    }
}
