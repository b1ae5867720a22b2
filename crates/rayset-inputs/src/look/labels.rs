//! The look of label maps: a colour for each label, none of them mixed, and names where the file
//! has them.

use rayset::file::GridHeader;
use serde_json::{Value, json};

use super::palettes;

/// Fewer voxels side by side than these, on average, are no regions.
const LEAST_RUN: f64 = 2.0;
/// The same, where values are more than a few: the plateaus of smooth values are as long as that.
const LEAST_RUN_OF_MANY: f64 = 4.0;
/// So many values are a few.
const FEW: usize = 32;
/// The background has more than this part of the voxels, if it is not 0.
const MOST_COMMON: f64 = 0.5;
/// The opacity of a label: whole, so that a ray sees one alone.
const SOLID: f64 = 1.0;
/// Names of labels that a line says.
const NAMED: usize = 4;

/// The labels of a grid.
pub(super) struct LabelLook {
    /// Those that are shown, ascending.
    shown: Vec<Label>,
    background: Option<f64>,
    /// Whether the file says that its values are labels.
    said: bool,
    /// Whether voxels of one value lie side by side, as in regions.
    are_regions: bool,
}

/// A label in a colour.
#[derive(Clone, Debug)]
struct Label {
    value: f64,
    name: String,
    color: String,
}

impl LabelLook {
    /// `None` if the voxels have many values, or values that are not whole.
    pub(super) fn of(header: &GridHeader) -> Option<Self> {
        let known = &header.labels;
        let voxels: f64 = known.values.iter().map(|label| label.voxels as f64).sum();
        let common = known.values.iter().max_by_key(|label| label.voxels)?;
        let has_zero = known.values.iter().any(|label| label.value == 0.0);
        let is_common = common.voxels as f64 > MOST_COMMON * voxels;
        let background = if has_zero { Some(0.0) } else { is_common.then_some(common.value) };
        let mut shown: Vec<Label> = Vec::new();
        for label in known.values.iter().filter(|label| Some(label.value) != background) {
            let given = label.color.map(|[r, g, b]| format!("#{r:02x}{g:02x}{b:02x}"));
            let color = given.unwrap_or_else(|| palettes::of_label(shown.len()));
            let name = if label.name.is_empty() { label.value.to_string() } else { label.name.clone() };
            shown.push(Label { value: label.value, name, color });
        }
        let least_run = if known.values.len() > FEW { LEAST_RUN_OF_MANY } else { LEAST_RUN };
        let (said, are_regions) = (known.said, known.mean_run_without(background) >= least_run);
        (!shown.is_empty()).then_some(Self { shown, background, said, are_regions })
    }

    /// Whether the grid is to be seen so, if nothing else is said; `are_known` is whether its
    /// values are known to be others.
    pub(super) fn is_suggested(&self, are_known: bool) -> bool {
        self.said || self.are_regions && !are_known
    }

    /// Whether voxels of a value are shown.
    pub(super) fn shows(&self, value: f64) -> bool {
        Some(value) != self.background
    }

    /// The values that are shown, with their names.
    pub(super) fn classes(&self) -> Vec<(f64, String)> {
        self.shown.iter().map(|label| (label.value, label.name.clone())).collect()
    }

    /// The object of the scene.
    pub(super) fn root(&self, file: &str) -> Value {
        let (first, last) = (self.shown[0].value - 0.5, self.shown[self.shown.len() - 1].value + 0.5);
        let place = |value: f64| (value - first) / (last - first);
        let color: Vec<Value> = (self.shown.iter())
            .flat_map(|Label { value, color, .. }| [-0.5, 0.5].map(|by| json!([place(value + by), color])))
            .collect();
        json!({
            "type": "grid",
            "file": file,
            "interpolation": "label",
            "transferFunction": {"opacity": self.opacity(), "color": color, "valueRange": [first, last]},
            "material": {"ambient": 0.5, "diffuse": 0.6, "specular": 0.1, "shininess": 24}
        })
    }

    /// Solid but for the background.
    fn opacity(&self) -> Value {
        match self.background {
            None => json!([[self.shown[0].value, SOLID]]),
            Some(at) => {
                json!([[at - 0.75, SOLID], [at - 0.25, 0], [at + 0.25, 0], [at + 0.75, SOLID]])
            }
        }
    }

    /// `12 labels: spleen, liver, kidney and 9 others, without 0, the background`
    pub(super) fn what(&self) -> String {
        let count = self.shown.len();
        let labels = if count == 1 { "1 label".to_owned() } else { format!("{count} labels") };
        let names: Vec<&str> = self.shown.iter().take(NAMED).map(|label| label.name.as_str()).collect();
        let others = match count.saturating_sub(NAMED) {
            0 => String::new(),
            1 => " and another".to_owned(),
            more => format!(" and {more} others"),
        };
        let without =
            self.background.map_or_else(String::new, |value| format!(", without {value}, the background"));
        format!("{labels}, a colour each: {}{others}{without}", names.join(", "))
    }
}
