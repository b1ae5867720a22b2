//! Clusters: points of a run that are seen by themselves, but lie together in a cell that is small
//! beside a pixel, are seen as one.
//!
//! The footprint f follows from f² = ρ² + 12 μ r². A pixel is ρ wide, r is the least radius of the
//! run, and μ is the variance of the kernel. Cells of clusters have the edge e with 2 e ≤ f < 4 e.
//!
//! While f grows from 2 e to 4 e, the clusters in a cell of edge 2 e become one, by the part
//! s = S(log₂(f/e) − 1). The square of their distance from its middle shrinks by 1 − s, and all
//! else is mixed by s. So the covariance of all of them stays what it is. Nothing changes where f
//! passes on to the next octave.

use super::cut::part_of_cell;

/// How many times the edge of the cloud's root cell may be halved.
const MOST_HALVINGS: f64 = 48.0;

/// The cells whose points are seen as one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ClusterCells {
    /// Their edge.
    pub(crate) edge: f64,
    /// How much they are already those of twice that edge, from 0 to 1.
    pub(crate) wider: f64,
}

impl ClusterCells {
    /// Of points of at least this radius, where a pixel is so wide, in a root cell of some edge.
    pub(crate) fn new(pixel: f64, (radius, variance): (f64, f64), root: f64) -> Self {
        let footprint = (pixel * pixel + 12.0 * variance * radius * radius).sqrt();
        let halvings = (root / footprint).log2().clamp(-1.0, MOST_HALVINGS - 2.0);
        let edge = root * (-(halvings.floor() + 2.0)).exp2();
        let edge = if part_of_cell(2.0 * edge, footprint) >= 1.0 { 2.0 * edge } else { edge };
        Self { edge, wider: part_of_cell(2.0 * edge, footprint) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_a_quarter_to_half_of_the_footprint_and_grow_without_a_jump() {
        let mut before = ClusterCells::new(0.011, (0.0, 1.0), 8.0);
        for i in 1..4000 {
            let pixel = 0.011 * 1.002_f64.powi(i);
            let now = ClusterCells::new(pixel, (0.0, 1.0), 8.0);
            if pixel < 8.0 {
                assert!(2.0 * now.edge <= pixel * (1.0 + 1e-12) && pixel < 4.0 * now.edge, "{pixel} {now:?}");
                assert_eq!((8.0 / now.edge).log2().fract(), 0.0);
            }
            let jumps = if now.edge == before.edge {
                now.wider - before.wider
            } else {
                1.0 + now.wider - before.wider
            };
            assert!((0.0..0.006).contains(&jumps), "{before:?} {now:?}");
            before = now;
        }
        let with_radius = ClusterCells::new(0.3, (0.4, 1.0 / 12.0), 8.0);
        assert_eq!(with_radius, ClusterCells::new(0.5, (0.0, 1.0), 8.0));
        for pixel in [0.0, f64::INFINITY] {
            let cells = ClusterCells::new(pixel, (0.0, 1.0), 8.0);
            assert!(cells.edge > 0.0 && cells.wider.is_finite(), "{cells:?}");
        }
    }
}
