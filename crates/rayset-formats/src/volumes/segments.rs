//! Names and colours of segments in NRRD, as 3D Slicer writes them (its "Segmentation" file format,
//! `.seg.nrrd`): key/value pairs `Segment0_Name`, `Segment0_LabelValue`, `Segment0_Color` (three
//! shares of sRGB), `Segment0_Layer`.

use std::collections::BTreeMap;

use super::fields::parsed;
use rayset_files::grid::labels::{NamedLabels, color_of_shares};

/// More segments than these are not remembered.
const MOST_SEGMENTS: usize = 2048;

/// Segments by their numbers.
#[derive(Default)]
pub(super) struct Segments(BTreeMap<u32, Segment>);

#[derive(Default)]
struct Segment {
    name: String,
    value: Option<i64>,
    color: Option<[u8; 3]>,
    /// The volume of the series that has it.
    layer: u64,
}

impl Segments {
    /// Takes a key and its value, if they are of a segment.
    pub(super) fn take(&mut self, key: &str, value: &str) {
        let named = key.strip_prefix("Segment").and_then(|rest| rest.split_once('_'));
        let Some((Ok(number), field)) = named.map(|(number, field)| (number.parse(), field)) else { return };
        if self.0.len() >= MOST_SEGMENTS && !self.0.contains_key(&number) {
            return;
        }
        let segment = self.0.entry(number).or_default();
        match field {
            "Name" => segment.name = value.to_owned(),
            "LabelValue" => segment.value = value.parse().ok(),
            "Color" => segment.color = parsed(value).and_then(color_of_shares),
            "Layer" => segment.layer = value.parse().unwrap_or(0),
            _ => {}
        }
    }

    /// The labels of a volume of the series. Segments of old files, which state no value, have one
    /// volume each, in which they are 1.
    pub(super) fn of_layer(&self, layer: u64) -> NamedLabels {
        let mut labels = NamedLabels::default();
        for (number, segment) in &self.0 {
            let (value, of_layer) = match segment.value {
                Some(value) => (value, segment.layer),
                None => (1, u64::from(*number)),
            };
            if of_layer == layer {
                labels.name(value, &segment.name, segment.color);
            }
        }
        labels
    }
}
