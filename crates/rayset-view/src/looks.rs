//! Looks of what was opened: what a page may choose among, and the scene that its choice gives.

use rayset_inputs::style::Style;
use serde::Serialize;
use serde_json::Value;

/// Makes scenes of what was opened in the looks that pages choose.
pub trait Looks: Send + Sync {
    /// What there is to choose among.
    fn choices(&self) -> Choices;

    /// The scene in a style, which says nothing of the camera.
    ///
    /// # Errors
    /// What is wrong with the style, for the person who chose it.
    fn styled(&self, style: &Style) -> Result<Styled, String>;

    /// Gives a scene in a style another exposure, in stops, as the command does.
    fn expose(&self, scene: &mut Value, stops: f64);

    /// The command that renders it in a style with a camera, and the scene that this command
    /// renders.
    ///
    /// # Errors
    /// As of [`styled`](Self::styled).
    fn command(&self, style: &Style) -> Result<Command, String>;
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
    /// What was said when the program was started; pages change it and send the whole.
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
