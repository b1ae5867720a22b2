//! The values of voxels where they are few and whole, as of label maps: the section `LABL` of a
//! grid file, with the names and colours that the input gives them.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// Most values that are counted. Of more, colours could not be told apart, and maps hold two stops
/// for each.
pub(super) const MOST_VALUES: usize = 2048;
/// Longest name of a label that is kept, in characters.
const MOST_NAME: usize = 64;

/// The values that voxels of a grid have; none where they are many, or not whole.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
#[doc(hidden)]
pub struct GridLabels {
    /// Whether the input says that its values are labels.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub said: bool,
    /// Every value of a voxel, ascending.
    pub values: Vec<GridLabel>,
}

/// A value that voxels of a grid have.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
#[doc(hidden)]
pub struct GridLabel {
    /// As the header scales it; whole.
    pub value: f64,
    /// How many voxels have it.
    pub voxels: u64,
    /// How many rows of voxels along x they form, each as long as it can be.
    pub runs: u64,
    /// What the input calls it; empty if it has no name.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub name: String,
    /// The colour that the input gives it, as displays have it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub color: Option<[u8; 3]>,
}

impl GridLabels {
    /// How many voxels follow each other along x with the same value, on average, without those of
    /// one value.
    #[must_use]
    pub fn mean_run_without(&self, background: Option<f64>) -> f64 {
        let others = self.values.iter().filter(|label| Some(label.value) != background);
        // A file may say any numbers.
        let (voxels, runs) =
            others.fold((0.0, 0.0), |(v, r), label| (v + label.voxels as f64, r + label.runs as f64));
        voxels / f64::max(runs, 1.0)
    }

    /// The section's bytes; `None` if there is nothing to keep.
    pub(super) fn encode(&self) -> Option<Vec<u8>> {
        if self.values.is_empty() { None } else { serde_json::to_vec(self).ok() }
    }

    /// `None` if the bytes are no such section.
    pub(super) fn decode(bytes: &[u8]) -> Option<Self> {
        let mut labels: Self = serde_json::from_slice(bytes).ok()?;
        let ascend = labels.values.is_sorted_by(|a, b| a.value < b.value);
        let finite = labels.values.iter().all(|label| label.value.is_finite());
        labels.values.iter_mut().for_each(|label| label.name = readable(&label.name));
        (ascend && finite && labels.values.len() <= MOST_VALUES).then_some(labels)
    }
}

/// What an input says of its labels.
#[derive(Clone, Debug, Default)]
pub struct NamedLabels {
    /// Whether its values are labels.
    pub said: bool,
    /// Names and colours, by value.
    pub names: BTreeMap<i64, (String, Option<[u8; 3]>)>,
}

impl NamedLabels {
    /// Names a label, which then is one.
    pub fn name(&mut self, value: i64, name: &str, color: Option<[u8; 3]>) {
        self.said = true;
        if self.names.len() < MOST_VALUES {
            self.names.insert(value, (readable(name), color));
        }
    }
}

/// A name without what would spoil a line of text.
fn readable(name: &str) -> String {
    name.trim().chars().filter(|c| !c.is_control()).take(MOST_NAME).collect()
}

/// A colour of shares from 0 to 1, as displays have it; `None` if one is out of range.
pub fn color_of_shares(shares: [f64; 3]) -> Option<[u8; 3]> {
    let fits = shares.iter().all(|share| (0.0..=1.0).contains(share));
    fits.then(|| shares.map(|share| (share * 255.0).round() as u8))
}
