//! What columns and a sample of a cloud tell about its look.

use rayset::file::Header;

use super::statistics::{Statistics, percentile, range};
use super::view::Orientation;

/// Points that fill more than this dimension are no surface; halos of simulations have 2.3, scans
/// of statues and trees 2.0.
const FILLING: f64 = 2.2;
/// Points in more than this part of the inner cells of their box are no surface, however they
/// crowd; those of rooms are in few.
const BOX: f64 = 0.7;

/// The column of class labels, if there is one.
pub(super) fn class_column(header: &Header) -> Option<String> {
    let classes = || header.attributes.iter().filter(|a| a.is_class);
    let customary = classes().find(|a| a.name.eq_ignore_ascii_case("classification"));
    customary.or_else(|| classes().next()).map(|a| a.name.clone())
}

/// The column of intensities, if there is one: the first whose values differ, else the first.
pub(super) fn intensity_column(header: &Header, statistics: &Statistics) -> Option<String> {
    let names = ["intensity", "reflectance", "scalar_intensity", "amplitude"];
    let stored = |name: &&str| header.attributes.iter().find(|a| a.name.eq_ignore_ascii_case(name));
    let found: Vec<String> = names.iter().filter_map(stored).map(|a| a.name.clone()).collect();
    found.iter().find(|name| varies(statistics, name)).or(found.first()).cloned()
}

/// Whether the values of a column differ so much that they show anything.
pub(super) fn varies(statistics: &Statistics, column: &str) -> bool {
    let sorted = statistics.sorted(column);
    let (low, high) = (percentile(&sorted, 0.02), percentile(&sorted, 0.98));
    high - low > 0.05 * high.abs().max(low.abs()).max(1e-12)
}

/// The coordinate along the vertical.
pub(super) fn vertical(orientation: &Orientation) -> &'static str {
    let up = orientation.up.abs();
    let axis = (0..3).max_by(|&a, &b| up[a].total_cmp(&up[b])).unwrap_or(2);
    ["x", "y", "z"][axis]
}

/// The dimension of what points fill: halving the cells of a lattice multiplies the number of those
/// with points in them by nearly eight for a volume, by four for surfaces.
fn dimension(statistics: &Statistics) -> f64 {
    let bounds = ["x", "y", "z"].map(|axis| range(&statistics.sorted(axis), 0.005));
    let side = bounds.iter().map(|(low, high)| high - low).fold(0.0, f64::max);
    let occupied = |cells: f64| {
        let mut found: Vec<[i64; 3]> = statistics
            .positions()
            .map(|p| std::array::from_fn(|axis| ((p[axis] - bounds[axis].0) / side * cells).floor() as i64))
            .collect();
        found.sort_unstable();
        found.dedup();
        found.len() as f64
    };
    let points = statistics.positions().count() as f64;
    // As fine as still has several points in an occupied cell.
    let mut cells = 4.0;
    while occupied(2.0 * cells) * 6.0 < points && cells < 256.0 {
        cells *= 2.0;
    }
    (occupied(cells) / occupied(0.5 * cells)).log2()
}

pub(super) fn fills_volume(statistics: &Statistics) -> bool {
    dimension(statistics) > FILLING || inside(statistics) > BOX
}

/// The part of the inner cells of a cube around the points, eight along each side, that have points
/// in them.
fn inside(statistics: &Statistics) -> f64 {
    const CELLS: usize = 8;
    let bounds = ["x", "y", "z"].map(|axis| range(&statistics.sorted(axis), 0.005));
    let side = bounds.iter().map(|(low, high)| high - low).fold(0.0, f64::max);
    let mut has_points = vec![false; CELLS.pow(3)];
    for p in statistics.positions() {
        let cell = [0, 1, 2].map(|axis| (p[axis] - bounds[axis].0) / side * CELLS as f64);
        if cell.iter().all(|&at| at >= 1.0 && at < (CELLS - 1) as f64) {
            has_points[(cell[0] as usize * CELLS + cell[1] as usize) * CELLS + cell[2] as usize] = true;
        }
    }
    has_points.iter().filter(|&&has| has).count() as f64 / (CELLS - 2).pow(3) as f64
}
