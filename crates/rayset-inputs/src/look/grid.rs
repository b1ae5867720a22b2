//! The looks of voxels: by their values, or by labels.

use anyhow::{Result, bail};
use rayset::Grid;
use rayset::geometry::DVec3;
use serde_json::{Value, json};

use super::labels::LabelLook;
use super::ranges::over_logarithm;
use super::statistics::percentile;
use super::view::Orientation;
use super::voxels::{Background, Content, number};
use crate::style::LookName;

/// Values of a sample.
const SAMPLE_VALUES: usize = 1 << 15;
/// Values at or beyond this are marks of places without one, as 9.97e36 and 1e20 are: scenes know
/// numbers up to 1e18.
const MARKS: f64 = 1e17;
/// Largest number of a scene.
const LARGEST: f64 = 1e18;
/// Values of which the largest are smaller than this are too close together for scenes, whose
/// numbers differ by 1e-18.
const TINY: f64 = 1e-12;
/// Surfaces without colours.
const PLAIN: &str = "#dbccb2";
/// Behind voxels.
const NIGHT: &str = "#0b0d10";

/// How voxels are to be seen.
pub(super) struct GridLook {
    content: Content,
    /// The values of a sample without the background, ascending.
    pub(super) shown: Vec<f64>,
    background: Background,
    /// Whether there are marks of places without a value.
    has_marks: bool,
    pub(super) orientation: Orientation,
    /// The places that the camera frames.
    points: Vec<(DVec3, f64)>,
    /// What shows labels, if the values can be such, and the places that the camera frames then.
    labels: Option<(LabelLook, Vec<(DVec3, f64)>)>,
    diagonal: f64,
    /// The shortest edge of a voxel.
    voxel: f64,
}

impl GridLook {
    pub(super) fn choose(grid: &Grid, up: Option<DVec3>) -> Result<Self> {
        let header = grid.header();
        let is_value = |v: f64| v.abs() < MARKS;
        let sample = grid.sample(SAMPLE_VALUES)?;
        let all: Vec<f64> = (0..sample.len()).map(|i| sample.columns[0].get(i)).collect();
        let mut values: Vec<f64> = all.iter().copied().filter(|&v| is_value(v)).collect();
        values.sort_by(f64::total_cmp);
        check_range(grid, &values)?;
        let content = Content::of(&values, &header.sources, header.facing.is_some());
        let background = Background::of(content, &values);
        let shown: Vec<f64> = values.iter().copied().filter(|&v| !background.has(v)).collect();
        let orientation = match (up, header.up) {
            (Some(up), _) => Orientation::with_up(up, "as asked for"),
            (None, Some(up)) => Orientation::with_up(up, "said by the file").toward_front(header.facing),
            (None, None) => Orientation::with_up(DVec3::Z, "the custom of volumes"),
        };
        let corners = corners(grid);
        let matrix = header.space_from_voxel.matrix3;
        let voxel = [matrix.x_axis, matrix.y_axis, matrix.z_axis].map(DVec3::length).into_iter();
        let mut look = Self {
            content,
            shown,
            background,
            has_marks: all.iter().any(|v| v.abs() >= MARKS),
            orientation,
            points: Vec::new(),
            labels: None,
            diagonal: corners[0].distance(corners[7]),
            voxel: voxel.fold(f64::INFINITY, f64::min),
        };
        // The surface lies between the voxels inside and those outside.
        let margin = if content == Content::LevelSet { look.voxel } else { 0.0 };
        let stands_out = look.stands_out();
        let places = sample.position.iter().zip(&all).filter(|(_, v)| is_value(**v) && stands_out(**v));
        let places: Vec<DVec3> = places.map(|(p, _)| DVec3::from_array(*p)).collect();
        let is_solid = content == Content::Constant;
        look.points = framed(if is_solid { Vec::new() } else { places }, margin, corners);
        look.labels = LabelLook::of(header).map(|labels| {
            let shown = sample.position.iter().zip(&all).filter(|(_, v)| labels.shows(**v));
            let shown = shown.map(|(p, _)| DVec3::from_array(*p)).collect();
            (labels, framed(shown, look.voxel, corners))
        });
        Ok(look)
    }

    /// Whether there is a look of the name.
    pub(super) fn can_be(&self, name: LookName) -> bool {
        name == LookName::Volume || name == LookName::Labels && self.labels.is_some()
    }

    /// The look that is wanted, or the one that the values suggest.
    pub(super) fn named(&self, wanted: Option<LookName>) -> Result<LookName> {
        let are_known = matches!(self.content, Content::Hounsfield | Content::LevelSet);
        match wanted {
            None if self.labels.as_ref().is_some_and(|(labels, _)| labels.is_suggested(are_known)) => {
                Ok(LookName::Labels)
            }
            None => Ok(LookName::Volume),
            Some(name) if self.can_be(name) => Ok(name),
            Some(LookName::Labels) => bail!(
                "--look labels: the voxels have more than 2048 values, or values that are no whole numbers, or the grid \
                 was built by an older rayset; --look volume shows values"
            ),
            Some(name) => {
                bail!(
                    "--look {} is for points; the input has voxels, whose looks are volume and labels",
                    name.name()
                )
            }
        }
    }

    /// What shows labels, in the look of them.
    fn labels(&self, name: LookName) -> Option<&(LabelLook, Vec<(DVec3, f64)>)> {
        self.labels.as_ref().filter(|_| name == LookName::Labels)
    }

    /// The places that the camera frames.
    pub(super) fn points(&self, name: LookName) -> &[(DVec3, f64)] {
        self.labels(name).map_or(&self.points, |(_, points)| points)
    }

    /// The labels that are shown, with their names.
    pub(super) fn classes(&self, name: LookName) -> Vec<(f64, String)> {
        self.labels(name).map_or_else(Vec::new, |(labels, _)| labels.classes())
    }

    /// Whether a value is framed: what is nearly transparent is not.
    fn stands_out(&self) -> impl Fn(f64) -> bool + use<> {
        let at = |part: f64| percentile(&self.shown, part);
        let (background, content, is_empty) = (self.background, self.content, self.shown.is_empty());
        let faint = match (content, background) {
            (Content::LevelSet, _) => 0.0,
            (Content::Density, _) => at(0.5),
            (_, Background::Above(_)) => at(0.95),
            _ => at(0.05),
        };
        move |v: f64| {
            let is_seen = match background {
                Background::Above(_) => v <= faint,
                Background::Below(_) => v >= faint,
                Background::Within(_) => !background.has(v),
            };
            !is_empty && is_seen
        }
    }

    /// The object of the scene.
    pub(super) fn root(&self, name: LookName, file: &str) -> Value {
        if let Some((labels, _)) = self.labels(name) {
            return labels.root(file);
        }
        let (opacity, color, range) = match self.content {
            Content::Hounsfield => self.hounsfield(),
            Content::LevelSet => self.level_set(),
            Content::Body | Content::Field => self.ramp(),
            Content::Density => self.logarithmic(),
            Content::Signed => self.diverging(),
            Content::Constant => self.constant(),
        };
        json!({
            "type": "grid",
            "file": file,
            "transferFunction": {"opacity": opacity, "color": color, "valueRange": [range.0, range.1]},
            "material": {"ambient": 0.45, "diffuse": 0.65, "specular": 0.15, "shininess": 24}
        })
    }

    /// Air is left out, skin and fat are thin, bone and vessels with contrast are solid.
    fn hounsfield(&self) -> (Value, Value, (f64, f64)) {
        let (low, high) = (-300.0, 1500.0);
        let place = |v: f64| (v - low) / (high - low);
        let opacity = json!([
            [-300, 0],
            [-120, 0.004],
            [60, 0.012],
            [140, 0.03],
            [220, 0.35],
            [500, 0.8],
            [1500, 0.95]
        ]);
        let color = json!([
            [0, "#a8563a"],
            [place(60.0), "#c9694b"],
            [place(160.0), "#e0906a"],
            [place(260.0), "#f0d8b8"],
            [place(600.0), "#fbf3e4"],
            [1, "#ffffff"]
        ]);
        (opacity, color, (low, high))
    }

    /// Solid inside, with a surface as thick as a voxel.
    fn level_set(&self) -> (Value, Value, (f64, f64)) {
        let half = (0.5 * self.voxel).max(1e-17);
        (json!([[-half, 0.95], [half, 0]]), json!(PLAIN), (-half, half))
    }

    /// From the background to the rarest values: thin, then solid.
    fn ramp(&self) -> (Value, Value, (f64, f64)) {
        let (edge, is_low) = match self.background {
            Background::Above(edge) => (edge, false),
            Background::Below(edge) | Background::Within(edge) => (edge, true),
        };
        let at = |part: f64| percentile(&self.shown, if is_low { part } else { 1.0 - part });
        let mut stops = vec![(edge, 0.0), (at(0.5), 0.02), (at(0.9), 0.12), (at(0.995), 0.6)];
        if !is_low {
            stops.reverse();
        }
        stops.dedup_by(|b, a| b.0 <= a.0);
        let (low, high) = (stops[0].0, stops[stops.len() - 1].0);
        let high = if high > low { high } else { low + low.abs().max(1.0) * 1e-3 };
        let map = match (self.content, is_low) {
            (Content::Body, _) => {
                json!([[0, "#6b3a2e"], [0.35, "#b98a76"], [0.7, "#ead9cb"], [1, "#ffffff"]])
            }
            (_, true) => json!("inferno"),
            (_, false) => json!("inferno_r"),
        };
        (self.curve(stops), map, (low, high))
    }

    /// Colours and opacity by the logarithm, as of gas: the rarest values are solid, and most of
    /// what is shown is thin.
    fn logarithmic(&self) -> (Value, Value, (f64, f64)) {
        /// Points of the curve, evenly spaced in the logarithm.
        const KNOTS: usize = 64;
        let (low, high) = self.density_range();
        let stops = (0..=KNOTS).map(|i| i as f64 / KNOTS as f64);
        let stops = stops.map(|t| (low * (high / low).powf(t), 0.002 * t + 0.5 * t.powi(4))).collect();
        let map = over_logarithm(&json!("inferno"), (low, high)).unwrap_or_else(|_| json!("inferno"));
        (self.curve(stops), map, (low, high))
    }

    /// The ends of a map over the logarithm.
    fn density_range(&self) -> (f64, f64) {
        let (low, high) = (percentile(&self.shown, 0.0), percentile(&self.shown, 0.999));
        (low, high.max(1.1 * low))
    }

    /// Values about 0 are left out; those far from it are solid, on either side in a colour of
    /// their own.
    fn diverging(&self) -> (Value, Value, (f64, f64)) {
        let mut sizes: Vec<f64> = self.shown.iter().map(|v| v.abs()).collect();
        sizes.sort_by(f64::total_cmp);
        let at = |part: f64| percentile(&sizes, part);
        let edge = if let Background::Within(edge) = self.background { edge } else { 0.0 };
        let mut stops = vec![(edge, 0.0), (at(0.5), 0.03), (at(0.9), 0.3), (at(0.99), 0.8)];
        stops.dedup_by(|b, a| b.0 <= a.0);
        let far = stops[stops.len() - 1].0;
        let below = stops.iter().rev().map(|&(v, opacity)| (-v, opacity));
        let all = below.chain(stops.iter().copied()).collect();
        (self.curve(all), json!("coolwarm"), (-far, far))
    }

    /// A solid box.
    fn constant(&self) -> (Value, Value, (f64, f64)) {
        let value = percentile(&self.shown, 0.0);
        let apart = value.abs().max(1.0) * 1e-3;
        (json!([[value, 0.95]]), json!(PLAIN), (value - apart, value + apart))
    }

    /// An opacity curve that leaves out marks of places without a value.
    fn curve(&self, mut stops: Vec<(f64, f64)>) -> Value {
        if self.has_marks {
            stops.insert(0, (-LARGEST, 0.0));
            stops.push((LARGEST, 0.0));
        }
        stops.iter().map(|&(v, o)| json!([v, o])).collect::<Vec<_>>().into()
    }

    /// Lights, background and rendering settings.
    pub(super) fn dress(&self, name: LookName, scene: &mut Value) {
        let Orientation { up, facing, .. } = self.orientation;
        let right = facing.cross(up);
        let sun = (facing * 0.7 + right * 0.5 - up * 0.8).normalize().to_array();
        let shows_labels = self.labels(name).is_some();
        scene["background"] = json!(NIGHT);
        if self.content != Content::LevelSet && !shows_labels {
            // Voxels have no edges that rays between those of pixels would smooth.
            scene["image"]["samples"] = json!(1);
        }
        scene["lights"] = json!([
            {"type": "ambient", "intensity": 0.9},
            {"type": "headlight", "intensity": 0.5},
            {"type": "directional", "direction": sun, "intensity": 0.5, "shadow": false}
        ]);
        // A label hides what is behind it within a quarter of a voxel.
        let unit = if shows_labels { 0.25 * self.voxel } else { self.diagonal / 200.0 };
        scene["rendering"]["unitDistance"] = json!(unit.max(1e-17));
        if shows_labels {
            scene["rendering"]["ambientOcclusion"] = json!(0.7);
            // Steps of a quarter of a voxel: a first sample that lies deeper may have the shading
            // of another side.
            scene["rendering"]["stepFraction"] = json!(0.125);
        }
    }

    /// `look: volume, …`
    pub(super) fn line(&self, name: LookName) -> String {
        if let Some((labels, _)) = self.labels(name) {
            return format!(
                "look: labels ({}), {}; --look volume shows values, --view and --up say otherwise",
                labels.what(),
                self.orientation.reason_and_up()
            );
        }
        let what = match self.content {
            Content::Hounsfield => "computed tomography in Hounsfield units".to_owned(),
            Content::LevelSet => "a level set, the surface where values are 0".to_owned(),
            Content::Constant => {
                format!("every voxel is {}", number(percentile(&self.shown, 0.0)))
            }
            Content::Density => {
                let (low, high) = self.density_range();
                format!("the logarithm of values from {} to {}", number(low), number(high))
            }
            Content::Signed | Content::Body | Content::Field => self.background.to_string(),
        };
        format!(
            "look: volume ({what}), {}; --opacity, --colormap, --value-range, --view and --up say otherwise",
            self.orientation.reason_and_up()
        )
    }
}

/// Places to frame, each with a margin around it; of few, the whole box.
fn framed(places: Vec<DVec3>, margin: f64, corners: [DVec3; 8]) -> Vec<(DVec3, f64)> {
    if places.len() < 8 {
        return corners.map(|corner| (corner, 0.0)).into();
    }
    places.into_iter().map(|place| (place, margin)).collect()
}

/// The corners of the box around the voxels, in the space of the file.
fn corners(grid: &Grid) -> [DVec3; 8] {
    let (header, last) = (grid.header(), grid.header().last_voxel());
    std::array::from_fn(|i| {
        let corner = std::array::from_fn(|axis| if i >> axis & 1 == 1 { last[axis] } else { 0.0 });
        header.space_from_voxel.transform_point3(DVec3::from_array(corner))
    })
}

/// Whether scenes can hold the values: what [`crate::open`] builds is scaled, other grids may not
/// be.
fn check_range(grid: &Grid, values: &[f64]) -> Result<()> {
    let largest = values.iter().fold(0.0_f64, |largest, v| largest.max(v.abs()));
    let what = if values.is_empty() {
        "every voxel is beyond ±1e17, which marks places without a value".to_owned()
    } else if largest > 0.0 && largest < TINY {
        format!("no voxel is larger than {largest:.1e}")
    } else {
        return Ok(());
    };
    bail!(
        "{}: {what}, and scenes hold values from 1e-12 to 1e17; render the file that the grid was built from, whose values \
         are then multiplied by a power of ten, or write it in other units",
        grid.path().display()
    )
}
