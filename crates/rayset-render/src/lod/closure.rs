//! The closure: from areas that take light to the extinction of a ray at a place.
//!
//! Each aggregate covers an area P across a ray, of which it takes the part c, over a length L. At
//! a place they are spread by Gaussians; sums over them by area give how much of a pixel is
//! covered, how opaque what covers it is, and how long: the extinction is what makes the right
//! opacity of them, whether they are beside or behind each other.

use super::cross_sections::CrossSections;
use rayset_base::geometry::{DMat3, DVec3};
use rayset_base::kernel::Kernel;
use rayset_files::octree::aggregates::Aggregate;

/// By which kernel areas are spread: with the variances of what is seen.
pub(crate) const SPREAD: Kernel = Kernel::Gaussian;
/// The largest optical depth of an aggregate: −ln(1 − 4095/4096), of the largest opacity.
pub(crate) const MOST_DEPTH: f64 = 8.3;
/// Between opacities that add up (1) and those that multiply (∞).
pub(crate) const STACKING: f64 = 2.0;
/// By how much flat aggregates are longer along rays that do not cross them at a right angle, so
/// that closed sheets stay closed.
pub(crate) const STRETCH: f64 = 30.0;
/// The largest opacity.
pub(crate) const MOST_OPACITY: f64 = 1.0 - 1.0 / 4096.0;

/// What stands for some points, of which g is known: an aggregate, or a point by itself.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Absorber {
    pub(crate) center: DVec3,
    /// Principal axes, as columns, and variances along them: of what absorbs, without pixels.
    pub(crate) axes: DMat3,
    pub(crate) variances: DVec3,
    /// What its density integrates to.
    pub(crate) mass: f64,
    /// The area that it takes of the light, seen by itself.
    pub(crate) cross_section: f64,
}

impl Absorber {
    /// Of an aggregate.
    pub(crate) fn of(aggregate: &Aggregate, sections: &CrossSections) -> Self {
        let variances = aggregate.deviations.map(|length| length * length);
        Self {
            center: aggregate.centroid,
            axes: DMat3::from_quat(aggregate.rotation),
            variances: DVec3::from_array(variances),
            mass: sections.kernel.0 * aggregate.mass,
            cross_section: sections.of(aggregate, variances),
        }
    }

    /// The direction across it, against one to it, of a length that says how flat it is: 0 to 1.
    pub(crate) fn normal(&self, toward: DVec3) -> DVec3 {
        let v = self.variances;
        let (least, axis) = (v.min_element(), v.min_position());
        let middle = v.x + v.y + v.z - least - v.max_element();
        let flat = if middle > 0.0 { 1.0 - least / middle } else { 0.0 };
        let across = self.axes.col(axis) * (flat * flat);
        if across.dot(toward) > 0.0 { -across } else { across }
    }

    /// What is seen of it along a direction, with a pixel of this edge.
    pub(crate) fn seen(&self, direction: DVec3, pixel: f64) -> Seen {
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
            depth,
            length,
        }
    }
}

/// What is seen of an absorber.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Seen {
    pub(crate) center: DVec3,
    pub(crate) axes: DMat3,
    /// Widened by a pixel.
    pub(crate) variances: DVec3,
    /// What its density integrates to.
    pub(crate) mass: f64,
    /// P, the area that it covers.
    pub(crate) area: f64,
    /// c, the part of the light that it takes there.
    pub(crate) opacity: f64,
    /// −ln(1 − c).
    pub(crate) depth: f64,
    /// L, how long it is along the direction.
    pub(crate) length: f64,
}

/// Sums over what is seen at a place, of which each has a part of its area and its mass there.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Sums {
    /// The density, as far as pixels tell.
    pub(crate) density: f64,
    area: f64,
    area_length: f64,
    area_opacity: f64,
    area_depth: f64,
}

impl Sums {
    /// Adds what has this share of its own at the place, for a unit of volume.
    pub(crate) fn add(&mut self, share: f64, seen: &Seen) {
        let area = share * seen.area;
        self.density += share * seen.mass;
        self.area += area;
        self.area_length += area * seen.length;
        self.area_opacity += area * seen.opacity;
        self.area_depth += area * seen.depth;
    }

    /// The mean opacity of what covers a part of a pixel.
    pub(crate) fn mean_opacity(&self) -> f64 {
        if self.area > 0.0 { self.area_opacity / self.area } else { 0.0 }
    }

    /// σ, the extinction at the place.
    pub(crate) fn extinction(&self) -> f64 {
        if !(self.area > 0.0) {
            return 0.0;
        }
        // How much of a pixel is covered, over the length of what covers it.
        let (length, covered) = (self.area_length / self.area, self.area_length);
        let opacity = (self.area_opacity / self.area).min(MOST_OPACITY);
        let depth = self.area_depth / self.area;
        if STACKING * covered < 1.0 {
            // What is beside each other takes light by its mean opacity, what is behind each other
            // by its mean depth.
            let behind = STACKING * covered;
            let opacity = opacity + behind * (-(-depth).exp_m1() - opacity).max(0.0);
            -(-STACKING * covered * opacity).ln_1p() / (STACKING * length)
        } else {
            covered * depth / length
        }
    }
}
