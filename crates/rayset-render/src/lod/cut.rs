//! The cut: by which part a cell stands for its points, and a point is a density.
//!
//! A node or a cell of edge e, where a pixel is ρ wide, stands for its points by the part
//! S(log₂(ρ/e)), with S the smoothstep; what is below it has the rest. So its part grows where ρ
//! does from e to 2 e, and every point is seen once altogether. A cell that is not divided takes
//! the place of those of half its edge that would be below it, too: otherwise each of its points
//! would be looked at for a part that is hardly seen. For the same reason it does so wholly from
//! ρ = e/√2 on. A point of radius r that is seen by itself is a density by S(2·log₂(r/(h·ρ)) + ½),
//! and a Gaussian like aggregates by the rest; here ρ is what Gaussians are spread over, which is
//! less for coarse cells. h is 1 for balls, and 2^¾ for ellipsoids: thin ones ask for fine steps
//! where they are densities.

/// Least part that is not left out.
pub(crate) const LEAST_PART: f64 = 1e-6;

/// The radii, in h pixels, from which on a point is a density in part, and wholly: 2^(−¼), 2^¼.
pub(crate) const DENSITY_FADE: [f64; 2] = [0.840_896_415, 1.189_207_116];

/// h, the pixels in a radius at which a point is a density by half.
pub(crate) fn half_density(are_ellipsoids: bool) -> f64 {
    if are_ellipsoids { 1.681_792_831 } else { 1.0 }
}

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
    own + (1.0 - own) * smoothstep(2.0 * (2.0 * pixel / edge).log2())
}

/// The part by which a point that is seen by itself is a density, where h pixels are so wide.
pub(crate) fn density_part(radius: f64, half: f64) -> f64 {
    smoothstep(2.0 * (radius / half).log2() + 0.5)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_fade_in_over_an_octave_and_points_fade_out() {
        assert_eq!([0.5, 1.0].map(|pixel| part_of_cell(1.0, pixel)), [0.0; 2]);
        assert!((part_of_cell(1.0, 2_f64.sqrt()) - 0.5).abs() < 1e-12);
        assert_eq!([2.0, 9.0].map(|pixel| part_of_cell(1.0, pixel)), [1.0; 2]);
        assert_eq!([0.5, 0.708].map(|pixel| part_of_last_cell(1.0, pixel)), [0.0, 1.0]);
        assert!([0.1, DENSITY_FADE[0]].into_iter().all(|radius| density_part(radius, 1.0) < 1e-12));
        assert_eq!([DENSITY_FADE[1], 9.0].map(|radius| density_part(radius, 1.0)), [1.0; 2]);
    }
}
