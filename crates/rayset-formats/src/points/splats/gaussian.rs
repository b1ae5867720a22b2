//! What a Gaussian of a splat file becomes: a point that is an ellipsoid, whose weight is its
//! opacity.
//!
//! A splat is an ellipsoidal Gaussian whose projection is drawn with an opacity of
//! `opacity·exp(−d²/2)` at the distance of d deviations from its centre (Kerbl et al., *3D Gaussian
//! Splatting for Real-Time Radiance Field Rendering*, 2023). A point has the same axes, as long as
//! where that falls to 1/512: what the kernel `splat` takes them for.
//!
//! Where points are to be round, the ellipsoid is replaced by the ball that has, on average over
//! all directions, the same shadow: by Cauchy's theorem, that of the same surface area. A thin disc
//! keeps its coverage this way; with the volume kept instead (the geometric mean of the
//! deviations), surfaces would fall apart into specks.

use super::harmonics::{self, Harmonics};
use crate::points::{ColorDepth, ColumnInfo, ColumnType, PointBatch, ROUND_RADIUS, SHAPE_COLUMNS, Schema};
use rayset_base::geometry::DVec3;
use rayset_files::points::harmonics::CONSTANT;

/// A point ends where it would be drawn with one part in so many.
const CUT: f64 = 512.0;
/// The least radius of a point, in deviations: those that are never drawn have one, too.
const LEAST_RADIUS: f64 = 0.5;
/// No point is thinner than this part of its radius; flat splats have no thickness.
const THINNEST: f64 = 1.0 / 1024.0;
/// No splat is more opaque than this.
const MOST_OPAQUE: f64 = 0.999;
/// Exponent of Thomsen's formula for the surface area of an ellipsoid, which is within 1.1 % of it.
const THOMSEN: f64 = 1.6075;

/// The columns of every splat file, in this order; those of [harmonics] follow.
const NAMES: [&str; COLUMNS] = [
    "red",
    "green",
    "blue",
    "opacity",
    "radius",
    "weight",
    "scale_0",
    "scale_1",
    "scale_2",
    SHAPE_COLUMNS[0],
    SHAPE_COLUMNS[1],
    SHAPE_COLUMNS[2],
    SHAPE_COLUMNS[3],
    SHAPE_COLUMNS[4],
    SHAPE_COLUMNS[5],
    SHAPE_COLUMNS[6],
    ROUND_RADIUS,
];
/// Number of columns that every splat file has.
pub(super) const COLUMNS: usize = 17;

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
    /// The rotation of these axes, of any length: x, y, z and w of a quaternion.
    pub(super) rotation: [f64; 4],
    pub(super) harmonics: Harmonics,
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
            4 => {
                let [a, b, c] = self.deviations;
                self.radius_in_deviations() * a.max(b).max(c)
            }
            5 => self.weight(),
            6..9 => self.deviations[index - 6],
            9..12 => {
                let [a, b, c] = self.deviations;
                let deviation = self.deviations[index - 9];
                let thinnest = THINNEST * a.max(b).max(c);
                // What is no number stays none.
                let deviation = if deviation < thinnest { thinnest } else { deviation };
                self.radius_in_deviations() * deviation
            }
            12..16 => self.rotation[index - 12],
            16 => self.radius_in_deviations() * self.mean_deviation(),
            _ => self.harmonics.value(index - COLUMNS),
        }
    }

    /// Its opacity, as far as it goes. What is no number stays none.
    fn weight(&self) -> f64 {
        if self.opacity > MOST_OPAQUE { MOST_OPAQUE } else { self.opacity }
    }

    /// How many deviations from its centre it ends.
    fn radius_in_deviations(&self) -> f64 {
        let square = 2.0 * (CUT * self.weight()).ln();
        if square > LEAST_RADIUS * LEAST_RADIUS { square.sqrt() } else { LEAST_RADIUS }
    }

    /// Appends a point to a batch of the selected columns. Columns of the file's own, from `own`
    /// on, are left to the caller.
    pub(super) fn append(&self, own: usize, selected: &[usize], batch: &mut PointBatch) {
        batch.position.push(self.position);
        for (column, &index) in batch.columns.iter_mut().zip(selected) {
            if index < own {
                column.push(self.value(index));
            }
        }
    }
}

/// The constant part of a colour, 0 to 1, from its coefficient of the harmonics.
pub(super) fn color_of(coefficient: f64) -> f64 {
    unit(0.5 + CONSTANT * coefficient)
}

/// Within 0 and 1; what is no number is 0.
pub(super) fn unit(value: f64) -> f64 {
    if value > 0.0 { value.min(1.0) } else { 0.0 }
}

/// The schema of a file that holds `what`, with colours of `depth` and with harmonics of a degree.
pub(super) fn schema(what: &str, depth: ColorDepth, degree: u8, up: DVec3) -> Schema {
    let of_color = if depth == ColorDepth::Byte { ColumnType::U8 } else { ColumnType::F32 };
    let column = |(index, name): (usize, &&str)| {
        ColumnInfo::new(*name, if index < 3 { of_color } else { ColumnType::F32 })
    };
    let columns = NAMES.iter().enumerate().map(column).chain(harmonics::columns(degree));
    let mut schema = Schema::new(columns.collect(), depth);
    let axis = match up.y {
        y if y < 0.0 => "y down",
        y if y > 0.0 => "y up",
        _ => "z up",
    };
    schema.description = format!("{what}; Gaussian splats, {axis}");
    schema.up = Some(up);
    schema.weights_add = false;
    schema
}

/// Says that a file's splats were trained with the mip filter.
pub(super) fn say_antialiased(schema: &mut Schema) {
    schema.description.push_str(ANTIALIASED);
}

/// What is said of files whose splats were trained with the mip filter.
const ANTIALIASED: &str = ", antialiased";

/// Whether a PLY file says in a comment that its splats were trained with the mip filter:
/// `SplatRenderMode: mip` (Brush, gsplat, splat-transform; the last counts) or `antialiased 1`
/// (Postshot).
pub(super) fn is_antialiased(comments: &str) -> bool {
    let comments = comments.to_ascii_lowercase();
    let mode = comments.split("; ").filter_map(|comment| comment.strip_prefix("splatrendermode:")).last();
    let mode = mode.map(|mode| mode.trim() == "mip");
    mode.unwrap_or_else(|| comments.split("; ").any(|comment| comment == "antialiased 1"))
}

/// Whether every splat file has a column of this name.
pub(super) fn has(name: &str) -> bool {
    NAMES.contains(&name)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(deviations: [f64; 3]) -> Gaussian {
        let rotation = [0.0, 0.0, 0.0, 1.0];
        let (position, color, harmonics) = ([0.0; 3], [0.0; 3], Harmonics::NONE);
        Gaussian { position, color, opacity: 0.75, deviations, rotation, harmonics }
    }

    #[test]
    fn a_ball_keeps_its_size_and_a_disc_its_mean_shadow() {
        let radius = (2.0 * (0.75 * CUT).ln()).sqrt();
        for size in [1e-300, 0.25, 1e300] {
            let ball = of([size; 3]);
            assert!((ball.mean_deviation() / size - 1.0).abs() < 1e-12);
            for column in [4, 9, 10, 11, 16] {
                assert!((ball.value(column) / (radius * size) - 1.0).abs() < 1e-12);
            }
        }
        // A disc turned at random casts half its area.
        let disc = of([2.0, 0.0, 3.0]).mean_deviation();
        assert!((disc * disc / (0.5 * 2.0 * 3.0) - 1.0).abs() < 0.011, "{disc}");
        assert_eq!([of([0.0; 3]).value(16), of([f64::INFINITY, 1.0, 1.0]).value(16)], [0.0, f64::INFINITY]);
    }

    #[test]
    fn comments_say_which_filter_splats_were_trained_with() {
        for mip in [
            "binary_little_endian 1.0; Exported from Brush; SplatRenderMode: mip",
            "a; splatrendermode: default; SplatRenderMode: MIP",
            "ascii 1.0; antialiased 1",
        ] {
            assert!(is_antialiased(mip), "{mip}");
        }
        for other in [
            "",
            "a; SplatRenderMode: mip; SplatRenderMode: default",
            "a; antialiased 0",
            "a; not antialiased 1",
        ] {
            assert!(!is_antialiased(other), "{other}");
        }
    }

    #[test]
    fn points_end_where_they_are_drawn_with_a_512th_and_have_a_thickness() {
        for (opacity, most) in [(0.01, 0.01), (0.5, 0.5), (1.0, MOST_OPAQUE), (7.0, MOST_OPAQUE)] {
            let splat = Gaussian { opacity, ..of([2.0, 1.0, 0.0]) };
            let end = splat.value(9) / 2.0;
            assert!((most * (-0.5 * end * end).exp() * CUT - 1.0).abs() < 1e-12, "{opacity}");
            assert_eq!((splat.value(10) * 2.0, splat.value(11)), (splat.value(9), splat.value(9) / 1024.0));
            assert_eq!(splat.value(5), most);
        }
        for opacity in [0.0, 1e-3, -1.0, f64::NAN] {
            let splat = Gaussian { opacity, ..of([1.0; 3]) };
            assert_eq!(splat.value(9), LEAST_RADIUS);
            assert!(splat.value(5) == opacity || splat.value(5).is_nan() && opacity.is_nan());
        }
        assert!(of([1.0, f64::NAN, 1.0]).value(10).is_nan() && of([1.0, 1.0, -1.0]).value(11) > 0.0);
    }
}
