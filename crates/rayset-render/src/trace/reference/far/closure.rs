//! How much light an aggregate absorbs: from its moments and its distribution of densities, for a
//! transfer function, a direction and a pixel.
//!
//! Lengths, areas and extinctions are of one space. g is the extinction at a density. The constants
//! are those of an experiment with clouds of all kinds against the truth by many rays; together
//! they are a *closure*, which may be changed without files becoming others.

use rayset_base::geometry::{DMat3, DVec3};
use rayset_files::octree::aggregates::{Aggregate, BINS, DensityBins};

/// Densities of a bin at which g is taken.
const DENSITIES: usize = 4;
/// How long the way of a ray through a grain is, in radii.
const GRAIN: f64 = 1.15;
/// The largest optical depth of an aggregate: −ln(1 − 4095/4096), of the largest opacity.
const MOST_DEPTH: f64 = 8.3;
/// Between opacities that add up (1) and those that multiply (∞).
const STACKING: f64 = 2.0;
/// By how much flat aggregates are longer along rays that do not cross them at a right angle, so
/// that closed sheets stay closed.
const STRETCH: f64 = 30.0;
/// The largest opacity.
const MOST_OPACITY: f64 = 1.0 - 1.0 / 4096.0;

/// What stands for some points, of which g is known: an aggregate, or a point by itself.
#[derive(Clone, Copy, Debug)]
pub(super) struct Absorber {
    pub(super) center: DVec3,
    /// Principal axes, as columns, and variances along them: of what absorbs, without pixels.
    pub(super) axes: DMat3,
    pub(super) variances: DVec3,
    /// What its density integrates to.
    pub(super) mass: f64,
    /// The area that it takes of the light, seen by itself.
    pub(super) cross_section: f64,
}

impl Absorber {
    /// Of an aggregate; `integral` and `variance` are the kernel's.
    pub(super) fn of(
        aggregate: &Aggregate,
        (integral, variance): (f64, f64),
        g: impl Fn(f64) -> f64,
    ) -> Self {
        let variances = DVec3::from_array(aggregate.deviations.map(|length| length * length));
        Self {
            center: aggregate.centroid,
            axes: DMat3::from_quat(aggregate.rotation),
            variances,
            mass: integral * aggregate.mass,
            cross_section: cross_section(aggregate, variances, (integral, variance), g),
        }
    }

    /// What is seen of it along a direction, with a pixel of this edge.
    pub(super) fn seen(&self, direction: DVec3, pixel: f64) -> Seen {
        let across = self.axes.transpose() * direction;
        let squares = across * across;
        let v = self.variances;
        // The determinant of the covariance across the direction.
        let area = squares.x * v.y * v.z + squares.y * v.z * v.x + squares.z * v.x * v.y;
        let area = 12.0 * area.max(0.0).sqrt();
        let depth = if area > 0.0 { (self.cross_section / area).min(MOST_DEPTH) } else { MOST_DEPTH };
        let blurred = v + pixel * pixel / 12.0;
        let least = blurred.min_element();
        let stretched = blurred * (1.0 + STRETCH * (1.0 - least / blurred));
        let length = (std::f64::consts::TAU / (squares / stretched).element_sum()).sqrt();
        Seen {
            center: self.center,
            axes: self.axes,
            variances: blurred,
            mass: self.mass,
            area: if area > 0.0 { area } else { self.cross_section / MOST_DEPTH },
            opacity: -(-depth).exp_m1(),
            length,
        }
    }
}

/// X, the area that an aggregate takes of the light.
fn cross_section(
    aggregate: &Aggregate,
    variances: DVec3,
    (integral, variance): (f64, f64),
    g: impl Fn(f64) -> f64,
) -> f64 {
    let mass = integral * aggregate.mass;
    let samples = Samples::of(&aggregate.densities, g);
    let mean = |of: &dyn Fn(&Sample) -> f64| samples.0.iter().map(|s| s.part * of(s)).sum::<f64>();
    let first = mass * mean(&|s| s.g / s.density);
    let second = mass * mean(&|s| s.g * s.g / s.density);
    if !(first > 0.0 && second > 0.0) {
        return 0.0;
    }
    // The volume that would absorb as much if it all absorbed alike, in that of the aggregate.
    let filled = first * first / second;
    let grain = variance * aggregate.radius * aggregate.radius;
    let own = variances.to_array().map(|v| (v - grain).max(grain.min(v)));
    let extent = own.iter().map(|v| (12.0 * v).sqrt()).product::<f64>();
    let granularity = (1.0 - filled / extent).max(0.0);
    let mass_volume = mass / mean(&|s| s.density);
    let longest = GRAIN * aggregate.radius * (filled / mass_volume).min(1.0);
    mass * mean(&|s| {
        let way = longest.min((mass * s.bin / s.density).cbrt());
        s.g / s.density / (1.0 + 0.5 * granularity * s.g * way)
    })
}

/// A density of an aggregate.
#[derive(Clone, Copy, Default)]
struct Sample {
    density: f64,
    g: f64,
    /// What part of the mass has it, and what part its bin has.
    part: f64,
    bin: f64,
}

struct Samples([Sample; BINS * DENSITIES]);

impl Samples {
    fn of(bins: &DensityBins, g: impl Fn(f64) -> f64) -> Self {
        let (width, fractions) = (0.5 * f64::from(bins.width.half_octaves()), bins.fractions());
        Self(std::array::from_fn(|at| {
            let (bin, within) = (at / DENSITIES, at % DENSITIES);
            let of_bin = fractions[bin];
            let octaves = width * (within as f64 + 0.5) / DENSITIES as f64;
            let density = bins.lower_bound(bin) * octaves.exp2();
            Sample { density, g: g(density), part: of_bin / DENSITIES as f64, bin: of_bin }
        }))
    }
}

/// What is seen of an absorber.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seen {
    pub(super) center: DVec3,
    pub(super) axes: DMat3,
    /// Widened by a pixel.
    pub(super) variances: DVec3,
    /// What its density integrates to.
    pub(super) mass: f64,
    /// P, the area that it covers.
    pub(super) area: f64,
    /// c, the part of the light that it takes there.
    pub(super) opacity: f64,
    /// L, how long it is along the direction.
    pub(super) length: f64,
}

/// Sums over what is seen at a place, of which each has a part of its area and its mass there.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Sums {
    /// The density, as far as pixels tell.
    pub(super) density: f64,
    area: f64,
    area_length: f64,
    area_opacity: f64,
}

impl Sums {
    /// Adds what has this share of its own at the place, for a unit of volume.
    pub(super) fn add(&mut self, share: f64, seen: &Seen) {
        let area = share * seen.area;
        self.density += share * seen.mass;
        self.area += area;
        self.area_length += area * seen.length;
        self.area_opacity += area * seen.opacity;
    }

    /// σ, the extinction at the place.
    pub(super) fn extinction(&self) -> f64 {
        if !(self.area > 0.0) {
            return 0.0;
        }
        // How much of a pixel is covered, over the length of what covers it.
        let (length, covered) = (self.area_length / self.area, self.area_length);
        let opacity = (self.area_opacity / self.area).min(MOST_OPACITY);
        if STACKING * covered < 1.0 {
            -(-STACKING * covered * opacity).ln_1p() / (STACKING * length)
        } else {
            -covered * (-opacity).ln_1p() / length
        }
    }
}
