//! Looks of what was opened: what a page may choose among, and the scene that its choice gives.

use serde::{Deserialize, Serialize};
use serde_json::Value;

/// Makes scenes of what was opened in the looks that pages choose.
pub trait Looks: Send + Sync {
    /// What there is to choose among.
    fn choices(&self) -> Choices;

    /// The scene in a style.
    ///
    /// # Errors
    /// What is wrong with the style, for the person who chose it.
    fn styled(&self, style: &Style) -> Result<Styled, String>;

    /// Gives a scene in a style another exposure, in stops, as the command does.
    fn expose(&self, scene: &mut Value, stops: f64);

    /// The command that renders it in a style, with options of the camera, and the scene that this command renders with an exposure in
    /// stops, if one is asked for.
    ///
    /// # Errors
    /// What is wrong with the options.
    fn command(&self, style: &Style, camera: &[String], exposure: Option<f64>) -> Result<Command, String>;
}

/// What a page can choose among.
#[derive(Clone, Debug, Default, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct Choices {
    /// Names of looks.
    pub looks: Vec<String>,
    /// Attributes and coordinates that can be shown in colours.
    pub attributes: Vec<Attribute>,
    /// Names of colour maps, each with colours evenly spaced along it, as `#rrggbb`.
    pub palettes: Vec<(String, Vec<String>)>,
    /// What was chosen when the program was started.
    pub style: Style,
}

/// An attribute or coordinate.
#[derive(Clone, Debug, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct Attribute {
    /// Its name.
    pub name: String,
    /// Its unit; empty if it is not known.
    pub unit: String,
    /// The values between which most of it lies.
    pub range: [f64; 2],
    /// How its values are spread; `None` if all are the same.
    pub histogram: Option<Histogram>,
}

/// How many values of a sample lie in each of some ranges.
#[derive(Clone, Debug, Serialize)]
#[serde(rename_all = "camelCase")]
pub struct Histogram {
    /// Lower end of the first range.
    pub low: f64,
    /// Upper end of the last range.
    pub high: f64,
    /// Whether the ranges have equal widths in the logarithm.
    pub logarithmic: bool,
    /// The number in each.
    pub counts: Vec<u64>,
}

/// How a cloud or grid is to look: options of `rayset render`. What is missing is chosen from the data.
#[derive(Clone, Debug, Default, Deserialize, Serialize, PartialEq)]
#[serde(rename_all = "camelCase", deny_unknown_fields, default)]
pub struct Style {
    /// Name of a look.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub look: Option<String>,
    /// One colour for all, `#rrggbb`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub color: Option<String>,
    /// The attribute or coordinate that colours show.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub color_by: Option<String>,
    /// Name of a colour map.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub colormap: Option<String>,
    /// Values at the ends of the map.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub value_range: Option<[f64; 2]>,
    /// The map is over the logarithm.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub log: bool,
    /// Radii of points, as a factor of those in the file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub radius_scale: Option<f64>,
    /// Opacity over density or value: points of a curve.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub opacity: Option<Vec<[f64; 2]>>,
}

impl Style {
    /// The options as one would type them.
    #[must_use]
    pub fn words(&self) -> Vec<String> {
        let pair = |[a, b]: [f64; 2]| format!("{a}:{b}");
        let curve = |points: &Vec<[f64; 2]>| points.iter().map(|&p| pair(p)).collect::<Vec<_>>().join(",");
        let texts = [
            ("look", self.look.clone()),
            ("color", self.color.clone()),
            ("color-by", self.color_by.clone()),
            ("colormap", self.colormap.clone()),
            ("value-range", self.value_range.map(pair)),
            ("radius-scale", self.radius_scale.map(|scale| scale.to_string())),
            ("opacity", self.opacity.as_ref().map(curve)),
        ];
        let words = texts.into_iter().filter_map(|(name, text)| Some(format!("--{name}={}", text?)));
        words.chain(self.log.then(|| "--log".to_owned())).collect()
    }
}

/// A scene in a style.
#[derive(Clone, Debug)]
pub struct Styled {
    /// As a scene file has it.
    pub scene: Value,
    /// The name of its look.
    pub look: String,
    /// What was chosen, and why.
    pub line: String,
    /// The classes or labels that colours tell apart: values and names.
    pub classes: Vec<(f64, String)>,
    /// How what opacity is over is spread, estimated.
    pub densities: Option<Histogram>,
}

/// A command and what it means.
#[derive(Clone, Debug)]
pub struct Command {
    /// Word by word, without size and output.
    pub words: Vec<String>,
    /// The scene that it renders, as a scene file has it; of its size nothing is meant.
    pub scene: Value,
}

/// How a cloud or grid stands in its coordinates.
#[derive(Clone, Debug, Serialize)]
pub struct Stance {
    /// What is up; length one.
    pub up: [f64; 3],
    /// The direction in which one looks at the front; length one, at a right angle to `up`.
    pub facing: [f64; 3],
    /// The least and the largest coordinates of what fills a picture of the whole.
    pub framed: [[f64; 3]; 2],
    /// Its outermost places, one in each of some directions.
    pub outline: Vec<[f64; 3]>,
    /// Whether the first camera frames it; not if somebody said where it stands.
    #[serde(rename = "isFramed")]
    pub is_framed: bool,
}
