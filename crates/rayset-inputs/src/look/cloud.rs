//! Looks of points.

use anyhow::{Result, bail};
use rayset::Cloud;
use rayset::file::Header;
use rayset::geometry::DVec3;
use rayset::scene::{Kernel, SplatFilter};
use serde_json::{Value, json};

use super::classes::class_name;
use super::evidence::{class_column, fills_volume, intensity_column, varies, vertical};
use super::gas::{self, Gas};
use super::palettes;
use super::splats::{STEP, filter_of};
use super::statistics::{Statistics, percentile, range};
use super::upright::orientation;
use super::view::Orientation;
use crate::style::LookName;

/// The colour of unpainted plaster.
const PLAIN: &str = "#dbccb2";
/// Behind surfaces.
const BACKDROP: &str = "#262a31";
/// Behind what glows.
const NIGHT: &str = "#000000";
/// Colours whose brightest reach less than this, as displayed, are made brighter.
const DARK: f64 = 0.6;
/// The middle of colours that are darker than this is made brighter, however bright a few are.
const DIM: f64 = 0.2;
/// A class counts if it has this share of the points.
const LEAST_CLASS: f64 = 0.1;
/// Fewer different intensities than these are no picture.
const LEAST_INTENSITIES: usize = 32;

/// What a surface is coloured by.
#[derive(Clone, PartialEq)]
enum Paint {
    Points,
    Plain,
    Classes(String),
    /// A coordinate or an attribute, with the name of a map.
    Ramp(String, Value),
}

/// How points are to be seen.
pub(super) struct CloudLook {
    pub(super) name: LookName,
    paint: Paint,
    pub(super) orientation: Orientation,
    statistics: Statistics,
    /// Whether the kernels of gas are normalised: the density is that of numbers.
    is_normalised: bool,
    /// Of splats, how they are filtered.
    pub(super) filter: Option<SplatFilter>,
    /// Stops by which dark colours are made brighter.
    pub(super) exposure: f64,
    /// What made it so.
    reason: String,
}

impl CloudLook {
    /// The look of a cloud: `wanted`, or the one that its columns and its shape suggest.
    pub(super) fn choose(
        cloud: &Cloud,
        statistics: Statistics,
        wanted: Option<LookName>,
        up: Option<DVec3>,
    ) -> Result<Self> {
        let header = cloud.header();
        let orientation = orientation(cloud, &statistics, up);
        let (name, reason) = match wanted {
            Some(name) => (name, "as asked for".to_owned()),
            None => suggested(header, &statistics, &orientation),
        };
        let has_colors = statistics.has_colors(header);
        let paint = match name {
            LookName::Classes => match class_column(header) {
                Some(column) => Paint::Classes(column),
                None => bail!("--look classes: {} stores no classes", cloud.path().display()),
            },
            LookName::Height => Paint::Ramp(vertical(&orientation).to_owned(), json!("viridis")),
            LookName::Intensity => match intensity_column(header, &statistics) {
                Some(column) => {
                    let greys = greys(&statistics.sorted(&column));
                    Paint::Ramp(column, greys)
                }
                None => bail!("--look intensity: {} stores no intensities", cloud.path().display()),
            },
            _ if has_colors => Paint::Points,
            _ => Paint::Plain,
        };
        // Captures are shown as they were trained.
        let may_be_dark = paint == Paint::Points && name != LookName::Splats;
        let exposure = if may_be_dark { exposure_of(&statistics.brightnesses(header)) } else { 0.0 };
        let is_normalised = gas::is_normalised(cloud, &statistics);
        let filter = filter_of(&header.sources).filter(|_| name == LookName::Splats);
        Ok(Self { name, paint, orientation, statistics, is_normalised, filter, exposure, reason })
    }

    /// The points that the camera frames, each with its radius.
    pub(super) fn points(&self) -> Vec<(DVec3, f64)> {
        let fades = self.name == LookName::Gas && self.paint != Paint::Points;
        let dense = if fades { self.as_gas().dense_points() } else { None };
        dense.unwrap_or_else(|| self.statistics.positions().zip(self.statistics.values("radius")).collect())
    }

    fn as_gas(&self) -> Gas<'_> {
        Gas { statistics: &self.statistics, is_normalised: self.is_normalised }
    }

    /// The coordinate along the vertical.
    pub(super) fn vertical(&self) -> &'static str {
        vertical(&self.orientation)
    }

    /// The object of the scene.
    pub(super) fn root(&self, cloud: &Cloud, file: &str) -> Value {
        let mut root = json!({"type": "cloud", "file": file});
        root["transferFunction"] = match self.name {
            LookName::Gas => self.as_gas().transfer_function(self.paint == Paint::Points),
            LookName::Density => json!({"opacity": "clamp", "color": self.color_value()}),
            LookName::Splats => json!({"opacity": {"extinction": 1}, "color": self.color_value()}),
            _ => self.painted(cloud.header()),
        };
        // Weights of simulations are densities already; without them, the number of points in a
        // volume counts.
        if self.name == LookName::Gas && self.is_normalised {
            root["normalised"] = json!(true);
        }
        if self.name == LookName::Splats {
            match self.filter {
                Some(filter) => {
                    root["kernel"] = json!(Kernel::Splat.name());
                    root["splatFilter"] = json!(filter.name());
                }
                None => root["kernel"] = json!(Kernel::Gaussian.name()),
            }
        }
        root
    }

    fn color_value(&self) -> Value {
        if self.paint == Paint::Points { json!("points") } else { json!(PLAIN) }
    }

    /// A surface where the density reaches a part of that of a filled region.
    fn painted(&self, header: &Header) -> Value {
        // Steep, so that the surface is thin; below the density between two neighbours, so that it
        // has no holes.
        let opacity = json!([[0.25, 0.0], [0.55, 1.0]]);
        match &self.paint {
            Paint::Points | Paint::Plain => json!({"opacity": opacity, "color": self.color_value()}),
            Paint::Classes(column) => {
                let number = header.attribute_number(column).unwrap_or(0);
                let (low, high) = header.attribute_range(number);
                let customary = column.eq_ignore_ascii_case("classification");
                let (stops, (first, last)) = palettes::of_classes(low, high, customary);
                json!({"opacity": opacity, "color": stops, "input": column, "valueRange": [first, last]})
            }
            Paint::Ramp(column, map) => {
                let (low, high) = range(&self.statistics.sorted(column), 0.02);
                json!({"opacity": opacity, "color": map, "input": column, "valueRange": [low, high]})
            }
        }
    }

    /// The classes in a sample of the points, with their names, if classes are shown.
    pub(super) fn classes(&self) -> Vec<(f64, String)> {
        let Paint::Classes(column) = &self.paint else { return Vec::new() };
        let mut values = self.statistics.sorted(column);
        values.dedup();
        values.into_iter().map(|value| (value, class_name(value, column))).collect()
    }

    /// The values of a column, of a coordinate, or of the density of gas, ascending; `None` if they
    /// are not known.
    pub(super) fn sorted(&self, name: &str) -> Option<Vec<f64>> {
        match name {
            "density" => (self.name == LookName::Gas).then(|| self.as_gas().densities()),
            // By custom another name of the vertical.
            "height" if self.statistics.sorted(name).is_empty() => Some(self.statistics.sorted("z")),
            _ => Some(self.statistics.sorted(name)),
        }
    }

    /// Estimates of the density that opacity is over, at some points.
    pub(super) fn opacity_densities(&self) -> Vec<f64> {
        const BALL: f64 = 4.0 / 3.0 * std::f64::consts::PI;
        if self.name == LookName::Gas {
            return self.as_gas().densities();
        }
        let (weights, radii) = (self.statistics.values("weight"), self.statistics.values("radius"));
        // A point counts whole at its own place, and each other that it reaches by its kernel,
        // whose mean over its ball is about a fifth.
        let reached = |i: usize, density: f64| density * BALL * radii[i].powi(3);
        let around = self.statistics.number_densities();
        around.iter().map(|&(i, density)| (1.0 + 0.2 * reached(i, density)) * weights[i]).collect()
    }

    /// Lights, background and rendering settings.
    pub(super) fn dress(&self, cloud: &Cloud, scene: &mut Value) {
        let header = cloud.header();
        let radius = header.radius_mean.max(1e-18);
        match self.name {
            LookName::Density => {
                scene["image"]["samples"] = json!(1);
                scene["rendering"]["unitDistance"] = json!(radius);
            }
            LookName::Gas => {
                scene["lights"] = json!("none");
                scene["background"] = json!(NIGHT);
                scene["rendering"]["unitDistance"] = json!(self.as_gas().unit_distance());
                // Of what glows smoothly half as many samples make the same picture, to a step of a
                // byte, in half the time.
                scene["rendering"]["stepFraction"] = json!(0.5);
                scene["image"]["samples"] = json!("auto");
            }
            LookName::Splats => {
                scene["lights"] = json!("none");
                scene["background"] = json!(NIGHT);
                scene["rendering"]["unitDistance"] = json!(radius);
                scene["rendering"]["compositing"] = json!("display");
                if self.filter.is_some() {
                    // Which splat is in front is told apart by steps, and costs little.
                    scene["rendering"]["stepFraction"] = json!(STEP);
                }
                if self.filter.is_some_and(|filter| filter != SplatFilter::None) {
                    // What is filtered has no detail finer than a pixel.
                    scene["image"]["samples"] = json!(1);
                }
            }
            _ => {
                scene["background"] = json!(BACKDROP);
                scene["lights"] = self.lamps();
                // A surface hides what is behind it within a fraction of a radius.
                scene["rendering"]["unitDistance"] = json!(0.25 * radius);
                // Colours of points show the form of what was photographed already.
                let occlusion = if self.paint == Paint::Points { 0.5 } else { 1.0 };
                scene["rendering"]["ambientOcclusion"] = json!(occlusion);
            }
        }
        if self.exposure > 0.0 {
            // Highlights, which would be made brighter too, are left out.
            scene["root"]["material"] = json!({"specular": 0});
        }
    }

    /// A sun from behind the eye's left shoulder, without shadows, which would cost as much again,
    /// and light from everywhere.
    fn lamps(&self) -> Value {
        let Orientation { up, facing, .. } = self.orientation;
        let right = facing.cross(up);
        let sun = (facing * 0.55 + right * 0.5 - up).normalize().to_array();
        json!([
            {"type": "ambient", "intensity": 1.5},
            {"type": "headlight", "intensity": 0.3},
            {"type": "directional", "direction": sun, "intensity": 0.6, "shadow": false}
        ])
    }

    /// `look: surface, points' colours, z up (map coordinates); …`
    pub(super) fn line(&self) -> String {
        let paint = match &self.paint {
            _ if self.name == LookName::Gas => "colours by the logarithm of the density".to_owned(),
            Paint::Points => "points' colours".to_owned(),
            Paint::Plain => "plain".to_owned(),
            Paint::Classes(column) => format!("colours by the classes in {column}"),
            Paint::Ramp(column, _) => format!("colours by {column}"),
        };
        let brighter = if self.exposure > 0.0 {
            format!(", dark colours made brighter by {:.1} stops", self.exposure)
        } else {
            String::new()
        };
        let (filtered, option) = match self.filter {
            Some(filter) => (format!(", filter {filter}"), ", --splat-filter"),
            None => (String::new(), ""),
        };
        format!(
            "look: {} ({}), {paint}{filtered}{brighter}, {}; --look{option}, --view, --up and --background say otherwise",
            self.name.name(),
            self.reason,
            self.orientation.reason_and_up()
        )
    }
}

/// The look that columns and shape suggest, and why.
fn suggested(header: &Header, statistics: &Statistics, orientation: &Orientation) -> (LookName, String) {
    let has = |name: &str| header.attributes.iter().any(|a| a.name.eq_ignore_ascii_case(name));
    let said = |word: &str| header.sources.iter().any(|source| source.contains(word));
    if said("Gaussian splat") || has("scale_0") && has("opacity") {
        return (LookName::Splats, "Gaussian splats".into());
    }
    if said("GADGET") || said("SWIFT") || said("AREPO") || said("snapshot") {
        return (LookName::Gas, "particles of a simulation".into());
    }
    if statistics.has_colors(header) {
        if fills_volume(statistics) {
            return (LookName::Gas, "points with colours that fill a volume".into());
        }
        return (LookName::Surface, "points with colours".into());
    }
    if let Some(column) = class_column(header) {
        let classes = statistics.classes(&column);
        let told_apart = classes.iter().filter(|(class, share)| {
            // Unclassified points, and noise, tell nothing.
            *share >= LEAST_CLASS && ![0.0, 1.0, 7.0, 12.0, 18.0].contains(class)
        });
        if told_apart.count() >= 2 {
            return (LookName::Classes, "classified points".into());
        }
    }
    // Along a direction that is no axis there are no coordinates to colour by.
    if orientation.lies && orientation.up.abs().max_element() > 0.95 {
        return (LookName::Height, "terrain without colours".into());
    }
    if fills_volume(statistics) {
        return (LookName::Gas, "points that fill a volume".into());
    }
    // Other files have columns of this name that are no measure of light.
    let scanned = ["LAS", "E57", "PTX", "PTS", "PCD"].iter().any(|kind| said(kind));
    let shows =
        |column: String| varies(statistics, &column) && statistics.different(&column) >= LEAST_INTENSITIES;
    if intensity_column(header, statistics).is_some_and(shows) && scanned {
        return (LookName::Intensity, "intensities".into());
    }
    (LookName::Surface, "points without colours".into())
}

/// Stops by which colours of these brightnesses, as displayed and ascending, are made brighter: so
/// far that the brightest reach white, or the middle is seen, as long as nine in ten stay below
/// white.
fn exposure_of(brightnesses: &[f64]) -> f64 {
    // In linear light, roughly the square of displayed values.
    let stops = |from: f64, to: f64| 2.2 * (to / from.max(1.0 / 255.0)).log2();
    let [middle, high, brightest] = [0.5, 0.9, 0.99].map(|part| percentile(brightnesses, part));
    let of_brightest = if brightest < DARK { stops(brightest, 0.85) } else { 0.0 };
    let of_middle = if middle < DIM { stops(middle, 0.35).min(stops(high, 1.0)) } else { 0.0 };
    if brightnesses.is_empty() { 0.0 } else { of_brightest.max(of_middle).clamp(0.0, 4.0) }
}

/// Greys of intensities in ascending order, over the range that is shown: if a few that are far
/// brighter would leave most in the dark, the middle one is a middle grey.
fn greys(sorted: &[f64]) -> Value {
    /// A middle that lies lower than this in the range is dark.
    const LOW: f64 = 0.3;
    let (low, high) = range(sorted, 0.02);
    let middle = (percentile(sorted, 0.5) - low) / (high - low);
    if middle < LOW {
        json!([[0, "#1c1c1c"], [middle.max(0.01), "#8c8c8c"], [1, "#ffffff"]])
    } else {
        json!([[0, "#1c1c1c"], [1, "#ffffff"]])
    }
}
