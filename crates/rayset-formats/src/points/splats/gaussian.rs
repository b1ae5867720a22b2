//! What a Gaussian of a splat file becomes: a round point that absorbs as much light, on average
//! over all directions.
//!
//! A splat is an ellipsoidal Gaussian whose projection is drawn with an opacity of
//! `opacity·exp(−d²/2s²)` at the distance d from its centre (Kerbl et al., *3D Gaussian Splatting
//! for Real-Time Radiance Field Rendering*, 2023). A point here has one radius, so the ellipsoid is
//! replaced by the ball that has, on average over all directions, the same shadow: by Cauchy's
//! theorem, that of the same surface area. A thin disc keeps its coverage this way; with the volume
//! kept instead (the geometric mean of the deviations), surfaces would fall apart into specks.
//!
//! Its weight is the extinction at its centre. The line through the centre of a Gaussian of
//! deviation s and peak w has an optical depth of w·s·√(2π), which has to be −ln(1 − opacity).
//! Extinctions add up along a ray as opacities of splats multiply, so overlapping splats are as
//! opaque as in their own renderers.

use std::f64::consts::TAU;

use crate::points::{ColorDepth, ColumnInfo, ColumnType, PointBatch, Schema};
use rayset_base::geometry::DVec3;

/// Radius of a point, in deviations of its Gaussian: where splat renderers cut it off, and where
/// the kernel `gaussian`, whose deviation is a third of its radius, ends.
const CUT: f64 = 3.0;
/// Splat renderers draw no splat more opaque than this.
const MOST_OPAQUE: f64 = 0.99;
/// The zeroth spherical harmonic, ½·√(1/π).
const HARMONIC: f64 = 0.282_094_791_773_878_14;
/// Exponent of Thomsen's formula for the surface area of an ellipsoid, which is within 1.1 % of it.
const THOMSEN: f64 = 1.6075;

/// The columns of every splat file, in this order.
const NAMES: [&str; COLUMNS] =
    ["red", "green", "blue", "opacity", "radius", "weight", "scale_0", "scale_1", "scale_2"];
/// Number of columns that every splat file has; those of its own come behind.
pub(super) const COLUMNS: usize = 9;

/// A Gaussian, decoded.
#[derive(Clone, Copy, Debug)]
pub(super) struct Gaussian {
    pub(super) position: [f64; 3],
    /// In the range of the schema's depth.
    pub(super) color: [f64; 3],
    /// At the centre, 0 to 1.
    pub(super) opacity: f64,
    /// Standard deviations along its axes, in units of the coordinates.
    pub(super) deviations: [f64; 3],
}

impl Gaussian {
    /// The deviation of the ball with the same surface area.
    fn mean_deviation(&self) -> f64 {
        let [a, b, c] = self.deviations;
        let largest = a.max(b).max(c);
        if !(largest > 0.0 && largest.is_finite()) {
            return largest;
        }
        // Relative to the largest, so that no power leaves the range of numbers.
        let [a, b, c] = [a / largest, b / largest, c / largest];
        let faces = [a * b, a * c, b * c].map(|face| face.powf(THOMSEN));
        largest * (faces.iter().sum::<f64>() / 3.0).powf(0.5 / THOMSEN)
    }

    /// The value in column `index` of [`NAMES`].
    fn value(&self, index: usize) -> f64 {
        match index {
            0..3 => self.color[index],
            3 => self.opacity,
            4 => CUT * self.mean_deviation(),
            5 => -(-self.opacity.min(MOST_OPAQUE)).ln_1p() / (TAU.sqrt() * self.mean_deviation()),
            _ => self.deviations[index - 6],
        }
    }

    /// Appends a point to a batch of the selected columns. Columns of the file's own are left to
    /// the caller.
    pub(super) fn append(&self, selected: &[usize], batch: &mut PointBatch) {
        batch.position.push(self.position);
        for (column, &index) in batch.columns.iter_mut().zip(selected) {
            if index < COLUMNS {
                column.push(self.value(index));
            }
        }
    }
}

/// The constant part of a colour, 0 to 1, from its coefficient of the spherical harmonics.
pub(super) fn color_of_harmonic(coefficient: f64) -> f64 {
    unit(0.5 + HARMONIC * coefficient)
}

/// Within 0 and 1; what is no number is 0.
pub(super) fn unit(value: f64) -> f64 {
    if value > 0.0 { value.min(1.0) } else { 0.0 }
}

/// The schema of a file that holds `what`, with colours of `depth`; `view_dependent` if these have
/// coefficients besides the constant one.
pub(super) fn schema(what: &str, depth: ColorDepth, view_dependent: bool, up: DVec3) -> Schema {
    let of_color = if depth == ColorDepth::Byte { ColumnType::U8 } else { ColumnType::F32 };
    let column = |(index, name): (usize, &&str)| {
        ColumnInfo::new(*name, if index < 3 { of_color } else { ColumnType::F32 })
    };
    let mut schema = Schema::new(NAMES.iter().enumerate().map(column).collect(), depth);
    let axis = match up.y {
        y if y < 0.0 => "y down",
        y if y > 0.0 => "y up",
        _ => "z up",
    };
    schema.description = format!("{what}; Gaussian splats as round points, {axis}");
    let colors = if view_dependent { ", and colours do not change with the view" } else { "" };
    schema.warnings = vec![format!(
        "Gaussian splats are read as round points of the same mean shadow: their ellipsoids are lost{colors}"
    )];
    schema.up = Some(up);
    schema
}

/// Whether every splat file has a column of this name.
pub(super) fn has(name: &str) -> bool {
    NAMES.contains(&name)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(deviations: [f64; 3]) -> Gaussian {
        Gaussian { position: [0.0; 3], color: [0.0; 3], opacity: 0.75, deviations }
    }

    #[test]
    fn a_ball_keeps_its_size_and_a_disc_its_mean_shadow() {
        for size in [1e-300, 0.25, 1e300] {
            let ball = of([size; 3]);
            assert!(
                (ball.mean_deviation() / size - 1.0).abs() < 1e-12
                    && ball.value(4) == 3.0 * ball.mean_deviation()
            );
        }
        // A disc turned at random casts half its area.
        let disc = of([2.0, 0.0, 3.0]).mean_deviation();
        assert!((disc * disc / (0.5 * 2.0 * 3.0) - 1.0).abs() < 0.011, "{disc}");
        assert_eq!([of([0.0; 3]).value(4), of([f64::INFINITY, 1.0, 1.0]).value(4)], [0.0, f64::INFINITY]);
    }

    #[test]
    fn the_line_through_the_centre_of_a_point_is_as_opaque_as_its_splat() {
        for (opacity, expected) in [(0.25, 0.25), (0.75, 0.75), (1.0, MOST_OPAQUE), (0.0, 0.0)] {
            let point = Gaussian { opacity, ..of([0.5; 3]) };
            let (deviation, steps) = (point.value(4) / CUT, 10_000);
            let at = |i: i32| f64::from(i) / f64::from(steps) * 8.0;
            let depth: f64 = (-steps..=steps).map(|i| point.value(5) * (-0.5 * at(i).powi(2)).exp()).sum();
            let found = -(-depth * deviation * 8.0 / f64::from(steps)).exp_m1();
            assert!((found - expected).abs() < 1e-9, "{found} for {opacity}");
        }
    }
}
