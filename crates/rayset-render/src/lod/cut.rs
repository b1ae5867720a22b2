//! The cut: by which part a cell stands for its points, and a point is a density.
//!
//! A node or a cell of edge e, where a pixel is ρ wide, stands for its points by the part
//! S(log₂(ρ/e)), with S the smoothstep; what is below it has the rest. So its part grows where ρ
//! does from e to 2 e, and every point is seen once altogether. A cell that is not divided takes
//! the place of those of half its edge that would be below it, too: otherwise each of its points
//! would be looked at for a part that is hardly seen. A point of radius r that is seen by itself is
//! a density by S(log₂(r/ρ)), and a Gaussian like aggregates by the rest.

/// Least part that is not left out.
pub(crate) const LEAST_PART: f64 = 1e-6;

/// S(x) of x from 0 to 1.
fn smoothstep(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    x * x * (3.0 - 2.0 * x)
}

/// The part by which a cell with this edge stands for its points, where a pixel is so wide.
pub(crate) fn part_of_cell(edge: f64, pixel: f64) -> f64 {
    smoothstep((pixel / edge).log2())
}

/// The same of a cell that is not divided any further, which takes the place of what would be below
/// it.
pub(crate) fn part_of_last_cell(edge: f64, pixel: f64) -> f64 {
    let own = part_of_cell(edge, pixel);
    own + (1.0 - own) * part_of_cell(0.5 * edge, pixel)
}

/// The part by which a point that is seen by itself is a density, where a pixel is so wide.
pub(crate) fn density_part(radius: f64, pixel: f64) -> f64 {
    smoothstep((radius / pixel).log2())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_fade_in_over_an_octave_and_points_fade_out() {
        assert_eq!([0.5, 1.0].map(|pixel| part_of_cell(1.0, pixel)), [0.0; 2]);
        assert!((part_of_cell(1.0, 2_f64.sqrt()) - 0.5).abs() < 1e-12);
        assert_eq!([2.0, 9.0].map(|pixel| part_of_cell(1.0, pixel)), [1.0; 2]);
        assert_eq!([0.5, 1.0].map(|pixel| part_of_last_cell(1.0, pixel)), [0.0, 1.0]);
        assert_eq!([0.1, 1.0].map(|radius| density_part(radius, 1.0)), [0.0; 2]);
        assert_eq!([2.0, 9.0].map(|radius| density_part(radius, 1.0)), [1.0; 2]);
    }
}
