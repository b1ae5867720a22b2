//! The area that an aggregate takes of the light, for one transfer function.

use rayset_files::octree::aggregates::{Aggregate, BINS, DensityBins, Width};

/// Densities of a bin at which g is taken.
const DENSITIES: usize = 4;
/// How long the way of a ray through a grain is, in radii.
const GRAIN: f64 = 1.15;
/// Bins begin at half octaves; means are known from 2^(−128) to 2^128.
const MOST_HALF_OCTAVES: i32 = 256;
const WIDTHS: [Width; 4] = [Width::HalfOctave, Width::Octave, Width::TwoOctaves, Width::FourOctaves];

/// Means over the densities D of a bin.
#[derive(Clone, Copy, Debug, Default)]
struct BinMeans {
    /// ⟨g/D⟩ and ⟨g²/D⟩.
    first: f64,
    second: f64,
}

/// X, for all aggregates of clouds with one transfer function g, the extinction at a density.
#[derive(Clone, Debug)]
pub(crate) struct CrossSections {
    /// What the kernel of the points integrates to over the unit ball, and its variance.
    pub(crate) kernel: (f64, f64),
    /// By width, and the half octave at which a bin begins.
    means: Vec<BinMeans>,
    /// Likewise, the mean colour by g/D, if colours are those of densities; linear light.
    colors: Vec<[f32; 3]>,
}

impl CrossSections {
    /// Bytes of its lists.
    pub(crate) fn bytes(has_colors: bool) -> usize {
        let bins = WIDTHS.len() * 2 * MOST_HALF_OCTAVES as usize;
        bins * (size_of::<BinMeans>() + if has_colors { size_of::<[f32; 3]>() } else { 0 })
    }

    /// For points whose kernel has this integral and this variance.
    pub(crate) fn new(kernel: (f64, f64), g: impl Fn(f64) -> f64) -> Self {
        let bins = WIDTHS.into_iter().flat_map(|width| bins().map(move |bin| (width, bin)));
        let means = bins.map(|(width, bin)| {
            let mut means = BinMeans::default();
            for density in densities(width, bin) {
                let g = g(density).max(0.0);
                means.first += g / density / DENSITIES as f64;
                means.second += g * (g / density) / DENSITIES as f64;
            }
            means
        });
        Self { kernel, means: means.collect(), colors: Vec::new() }
    }

    /// With the colours of densities.
    pub(crate) fn with_colors(self, g: impl Fn(f64) -> f64, color: impl Fn(f64) -> [f32; 3]) -> Self {
        let bins = WIDTHS.into_iter().flat_map(|width| bins().map(move |bin| (width, bin)));
        let colors = bins.map(|(width, bin)| {
            let (mut sum, mut weights) = ([0.0; 3], 0.0);
            for density in densities(width, bin) {
                let (weight, color) = ((g(density).max(0.0) / density) as f32, color(density));
                weights += weight;
                (0..3).for_each(|channel| sum[channel] += weight * color[channel]);
            }
            if weights > 0.0 && weights.is_finite() { sum.map(|v| v / weights) } else { [0.0; 3] }
        });
        Self { colors: colors.collect(), ..self }
    }

    /// Forgets the colours of densities.
    pub(crate) fn forget_colors(&mut self) {
        self.colors = Vec::new();
    }

    fn place(bins: &DensityBins, bin: usize) -> usize {
        let begins = (i32::from(bins.top) - bin as i32) * bins.width.half_octaves();
        let at = begins.clamp(-MOST_HALF_OCTAVES, MOST_HALF_OCTAVES - 1) + MOST_HALF_OCTAVES;
        let width = bins.width.half_octaves().trailing_zeros() as usize;
        width * 2 * MOST_HALF_OCTAVES as usize + at as usize
    }

    /// X of an aggregate whose kernels have spread its mass to these variances along its axes.
    pub(crate) fn of(&self, aggregate: &Aggregate, variances: [f64; 3]) -> f64 {
        let (integral, variance) = self.kernel;
        let mass = integral * aggregate.mass;
        let bins = &aggregate.densities;
        let fractions = bins.fractions();
        let means: [BinMeans; BINS] = std::array::from_fn(|bin| self.means[Self::place(bins, bin)]);
        let mean =
            |of: fn(&BinMeans) -> f64| fractions.iter().zip(&means).map(|(f, m)| f * of(m)).sum::<f64>();
        let (first, second) = (mass * mean(|m| m.first), mass * mean(|m| m.second));
        if !(first > 0.0 && second > 0.0) {
            return 0.0;
        }
        // The volume that would absorb as much if it all absorbed alike, in that of the aggregate.
        let filled = first * first / second;
        let grain = variance * aggregate.radius * aggregate.radius;
        let own = variances.map(|v| (v - grain).max(grain.min(v)));
        let extent = own.into_iter().map(|v| (12.0 * v).sqrt()).product::<f64>();
        let granularity = (1.0 - filled / extent).max(0.0);
        if granularity == 0.0 {
            return first;
        }
        // What hardly shadows itself takes what all of it would by itself.
        let strongest = means.iter().map(|m| if m.first > 0.0 { m.second / m.first } else { 0.0 });
        let most = strongest.fold(0.0, f64::max);
        if 0.5 * granularity * most * GRAIN * aggregate.radius < 1e-3 {
            return first;
        }
        let density: [f64; BINS] = std::array::from_fn(|bin| bins.lower_bound(bin) * middle(bins.width));
        let mean_density: f64 = fractions.iter().zip(&density).map(|(f, d)| f * d).sum();
        let longest = GRAIN * aggregate.radius * (filled * mean_density / mass).min(1.0);
        let of_bin = |bin: usize| {
            let BinMeans { first, second } = means[bin];
            if !(fractions[bin] * first > 0.0) {
                return 0.0;
            }
            let way = longest.min(root3(mass * fractions[bin] / density[bin]));
            fractions[bin] * first / (1.0 + 0.5 * granularity * (second / first) * way)
        };
        mass * (0..BINS).map(of_bin).sum::<f64>()
    }

    /// The mean colour of what absorbs in an aggregate, by its densities; linear light.
    pub(crate) fn color(&self, aggregate: &Aggregate) -> [f32; 3] {
        let bins = &aggregate.densities;
        let fractions = bins.fractions();
        let (mut sum, mut weights) = ([0.0; 3], 0.0);
        for bin in 0..BINS {
            let place = Self::place(bins, bin);
            let weight = fractions[bin] * self.means[place].first;
            weights += weight;
            (0..3).for_each(|channel| sum[channel] += weight * f64::from(self.colors[place][channel]));
        }
        if weights > 0.0 { sum.map(|v| (v / weights) as f32) } else { [0.0; 3] }
    }
}

/// The half octaves at which bins begin.
fn bins() -> std::ops::Range<i32> {
    -MOST_HALF_OCTAVES..MOST_HALF_OCTAVES
}

/// The densities of a bin that begins at a half octave.
fn densities(width: Width, begins: i32) -> impl Iterator<Item = f64> {
    let octaves = 0.5 * f64::from(width.half_octaves());
    let lower = (0.5 * f64::from(begins)).exp2();
    (0..DENSITIES).map(move |at| lower * (octaves * (at as f64 + 0.5) / DENSITIES as f64).exp2())
}

/// The cube root of a number above 0, to a millionth.
fn root3(x: f64) -> f64 {
    // A third of the exponent, and two steps of Halley's method.
    let mut root = f64::from_bits(x.to_bits() / 3 + (1023_u64 << 52) / 3 * 2);
    for _ in 0..2 {
        let cube = root * root * root;
        root *= (cube + 2.0 * x) / (2.0 * cube + x);
    }
    root
}

/// The mean density of a bin, in parts of the least.
fn middle(width: Width) -> f64 {
    const MIDDLES: [f64; 4] = [1.194_793_944, 1.440_891_55, 2.153_249_96, 5.303_300_859];
    MIDDLES[width.half_octaves().trailing_zeros() as usize]
}

#[cfg(test)]
mod tests {
    use super::*;
    use rayset_base::geometry::{DQuat, DVec3};

    #[test]
    fn the_middle_of_a_bin_is_the_mean_of_its_densities() {
        for width in WIDTHS {
            let mean = densities(width, 0).sum::<f64>() / DENSITIES as f64;
            assert!((middle(width) / mean - 1.0).abs() < 1e-6, "{width:?}: {mean}");
        }
    }

    #[test]
    fn cube_roots_are_right_to_a_millionth() {
        for i in -400..400 {
            let x = 1.37_f64.powi(i);
            assert!((root3(x) / x.cbrt() - 1.0).abs() < 1e-6, "{x}: {}", root3(x));
        }
    }

    #[test]
    fn what_is_linear_takes_the_mass_times_the_factor() {
        let mut roots = [0; BINS];
        (roots[0], roots[3]) = (255, 100);
        let aggregate = Aggregate {
            centroid: DVec3::ZERO,
            mass: 7.0,
            deviations: [1e-3; 3],
            rotation: DQuat::IDENTITY,
            radius: 1e-3,
            densities: DensityBins { width: Width::HalfOctave, top: 5, roots },
            child_mask: 0,
            cells: 0,
            first_child: 0,
            first_point: 0,
            more_points: 0,
        };
        let sections = CrossSections::new((2.0, 0.1), |density| 0.25 * density);
        assert!((sections.of(&aggregate, [1e-6; 3]) / (0.25 * 2.0 * 7.0) - 1.0).abs() < 1e-9);
    }
}
