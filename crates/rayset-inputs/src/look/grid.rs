//! The look of voxels.

use anyhow::Result;
use rayset::Grid;
use rayset::geometry::DVec3;
use serde_json::{Value, json};

use super::statistics::percentile;
use super::view::Orientation;

/// Values of a sample.
const SAMPLE_VALUES: usize = 1 << 15;
/// Values at or beyond this are marks of places without one, as 9.97e36 and 1e20 are: scenes know numbers up to 1e18.
const MARKS: f64 = 1e17;
/// Largest number of a scene.
const LARGEST: f64 = 1e18;
/// What the reader of OpenVDB says of a level set begins like this.
const LEVEL_SET: &str = "a level set";
/// Surfaces without colours.
const PLAIN: &str = "#dbccb2";
/// Behind voxels.
const NIGHT: &str = "#0b0d10";

/// What voxels hold.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Content {
    /// X-ray absorption in Hounsfield units: air is -1000, water 0.
    Hounsfield,
    /// Distances to a surface, negative inside, in units of the file.
    LevelSet,
    /// Anything else of a body.
    Body,
    /// A field of a simulation or a measurement.
    Field,
}

/// How voxels are to be seen.
pub(super) struct GridLook {
    content: Content,
    /// The values of a sample without the background, ascending.
    pub(super) shown: Vec<f64>,
    /// What is at or below this, or at or above it if the background is high, is background.
    threshold: f64,
    background_is_low: bool,
    /// Whether there are marks of places without a value.
    has_marks: bool,
    pub(super) orientation: Orientation,
    /// The places that the camera frames.
    pub(super) points: Vec<(DVec3, f64)>,
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
        let (least, largest) = (percentile(&values, 0.0), percentile(&values, 1.0));
        let content = if header.sources.iter().any(|about| about.starts_with(LEVEL_SET)) {
            Content::LevelSet
        } else if (-9000.0..=-900.0).contains(&least) && (600.0..70_000.0).contains(&largest) {
            Content::Hounsfield
        } else {
            Content::Field
        };
        let mode = mode(&values);
        let background_is_low =
            content != Content::LevelSet && mode <= percentile(&values, 0.5).max(0.5 * (least + largest));
        let threshold = match content {
            Content::Hounsfield => -300.0,
            Content::LevelSet => 0.0,
            Content::Body | Content::Field => threshold(&values, mode),
        };
        let shown: Vec<f64> = values
            .iter()
            .copied()
            .filter(|&v| if background_is_low { v > threshold } else { v < threshold })
            .collect();
        let last = header.last_voxel();
        let corner = |i: usize| {
            DVec3::from_array(std::array::from_fn(|axis| if i >> axis & 1 == 1 { last[axis] } else { 0.0 }))
        };
        let corners = [0, 7].map(|i| header.space_from_voxel.transform_point3(corner(i)));
        let diagonal = corners[0].distance(corners[1]);
        // What is nearly transparent is not framed.
        let faint = match content {
            Content::LevelSet => threshold,
            _ => percentile(&shown, if background_is_low { 0.05 } else { 0.95 }),
        };
        let stands_out = |v: f64| if background_is_low { v >= faint } else { v <= faint };
        let matrix = header.space_from_voxel.matrix3;
        let voxel = [matrix.x_axis, matrix.y_axis, matrix.z_axis].map(DVec3::length).into_iter();
        let voxel = voxel.fold(f64::INFINITY, f64::min);
        // The surface lies between the voxels inside and those outside.
        let margin = if content == Content::LevelSet { voxel } else { 0.0 };
        let points: Vec<(DVec3, f64)> = sample
            .position
            .iter()
            .zip(&all)
            .filter(|(_, v)| !shown.is_empty() && is_value(**v) && stands_out(**v))
            .map(|(p, _)| (DVec3::from_array(*p), margin))
            .collect();
        let points = if points.len() >= 8 {
            points
        } else {
            (0..8).map(|i| (header.space_from_voxel.transform_point3(corner(i)), 0.0)).collect()
        };
        let orientation = match (up, header.up) {
            (Some(up), _) => Orientation::with_up(up, "as asked for"),
            (None, Some(up)) => Orientation::with_up(up, "said by the file").toward_front(header.facing),
            (None, None) => Orientation::with_up(DVec3::Z, "the custom of volumes"),
        };
        let is_body = content == Content::Field && header.facing.is_some();
        let content = if is_body { Content::Body } else { content };
        let has_marks = all.iter().any(|v| v.abs() >= MARKS);
        Ok(Self {
            content,
            shown,
            threshold,
            background_is_low,
            has_marks,
            orientation,
            points,
            diagonal,
            voxel,
        })
    }

    /// The object of the scene.
    pub(super) fn root(&self, file: &str) -> Value {
        let (opacity, color, range) = match self.content {
            Content::Hounsfield => self.hounsfield(),
            Content::LevelSet => self.level_set(),
            Content::Body | Content::Field => self.ramp(),
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
        let at = |fraction: f64| {
            let fraction = if self.background_is_low { fraction } else { 1.0 - fraction };
            percentile(&self.shown, fraction)
        };
        let (start, half, most, end) = (self.threshold, at(0.5), at(0.9), at(0.995));
        let mut stops = vec![(start, 0.0), (half, 0.02), (most, 0.12), (end, 0.6)];
        if !self.background_is_low {
            stops.reverse();
        }
        stops.dedup_by(|b, a| b.0 <= a.0);
        let (low, high) = (stops[0].0, stops[stops.len() - 1].0);
        let high = if high > low { high } else { low + low.abs().max(1.0) * 1e-3 };
        if self.has_marks {
            stops.insert(0, (-LARGEST, 0.0));
            stops.push((LARGEST, 0.0));
        }
        let map = match (self.content, self.background_is_low) {
            (Content::Body, _) => {
                json!([[0, "#6b3a2e"], [0.35, "#b98a76"], [0.7, "#ead9cb"], [1, "#ffffff"]])
            }
            (_, true) => json!("inferno"),
            (_, false) => json!("inferno_r"),
        };
        let opacity = stops.iter().map(|&(v, o)| json!([v, o])).collect::<Vec<_>>();
        (opacity.into(), map, (low, high))
    }

    /// Lights, background and rendering settings.
    pub(super) fn dress(&self, scene: &mut Value) {
        let Orientation { up, facing, .. } = self.orientation;
        let right = facing.cross(up);
        let sun = (facing * 0.7 + right * 0.5 - up * 0.8).normalize().to_array();
        scene["background"] = json!(NIGHT);
        if self.content != Content::LevelSet {
            // Voxels have no edges that rays between those of pixels would smooth.
            scene["image"]["samples"] = json!(1);
        }
        scene["lights"] = json!([
            {"type": "ambient", "intensity": 0.9},
            {"type": "headlight", "intensity": 0.5},
            {"type": "directional", "direction": sun, "intensity": 0.5, "shadow": false}
        ]);
        scene["rendering"]["unitDistance"] = json!((self.diagonal / 200.0).max(1e-17));
    }

    /// `look: volume, …`
    pub(super) fn line(&self) -> String {
        let what = match self.content {
            Content::Hounsfield => "computed tomography in Hounsfield units".to_owned(),
            Content::LevelSet => "a level set, the surface where values are 0".to_owned(),
            Content::Body | Content::Field => {
                let side = if self.background_is_low { "above" } else { "below" };
                format!("values {side} {:.4}", self.threshold)
            }
        };
        format!(
            "look: volume ({what}), {}; --opacity, --colormap, --value-range, --view and --up say otherwise",
            self.orientation.reason_and_up()
        )
    }
}

/// The middle of the most frequent of 256 ranges of values.
fn mode(sorted: &[f64]) -> f64 {
    let (low, high) = (percentile(sorted, 0.001), percentile(sorted, 0.999));
    if !(high > low) {
        return low;
    }
    let mut counts = [0_u32; 256];
    for v in sorted {
        let place = ((v - low) / (high - low) * 256.0).clamp(0.0, 255.0);
        counts[place as usize] += 1;
    }
    let most = (0..256).max_by_key(|&i| counts[i]).unwrap_or(0);
    low + (most as f64 + 0.5) / 256.0 * (high - low)
}

/// The value that parts the background from the rest: Otsu's (1979), which makes both parts as uniform as possible, moved
/// toward the background, so that faint tissue shows.
fn threshold(sorted: &[f64], mode: f64) -> f64 {
    let (n, total): (f64, f64) = (sorted.len() as f64, sorted.iter().sum());
    let (mut below, mut best) = (0.0, (0.0, mode));
    for (i, v) in sorted.iter().enumerate().take(sorted.len().saturating_sub(1)) {
        below += v;
        let (weight, rest) = ((i + 1) as f64, n - (i + 1) as f64);
        let difference = below / weight - (total - below) / rest;
        let between = weight * rest * difference * difference;
        if between > best.0 && sorted[i + 1] > *v {
            best = (between, *v);
        }
    }
    mode + 0.6 * (best.1 - mode)
}
