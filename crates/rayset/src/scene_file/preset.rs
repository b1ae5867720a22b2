//! ParaView's colour-map presets: a JSON list of maps with `Name`, `RGBPoints` (value, red, green, blue, …) and
//! `Points` (value, opacity, midpoint, sharpness, …), as its colour map editor exports them. Colours between points lie
//! on straight lines in RGB, whatever `ColorSpace` says; midpoints and sharpness are left out of account.

use serde_json::Value;

use super::SceneFileError;
use super::reader::Cursor;
use crate::scene::{ColorMap, Palette};

/// A map of a preset file.
pub(super) struct Preset {
    pub(super) map: Option<ColorMap>,
    pub(super) opacity: Option<Vec<(f64, f64)>>,
}

impl Preset {
    /// Loads what `{"file": …, "name": …}` names; without a name, the first map of the file.
    pub(super) fn load(at: &Cursor<'_>) -> Result<Self, SceneFileError> {
        let object = at.object(&["file", "name"])?;
        let file_at = object.require("file")?;
        let path = at.document.beside(file_at.text()?);
        let wrong = |what: String| file_at.error(format!("{}: {what}", path.display()));
        let text = std::fs::read_to_string(&path).map_err(|e| wrong(format!("cannot read it: {e}")))?;
        let value: Value =
            serde_json::from_str(&text).map_err(|e| wrong(format!("this is not JSON: {e}")))?;
        let maps = match &value {
            Value::Array(maps) => maps.as_slice(),
            one => std::slice::from_ref(one),
        };
        let found = match object.get("name") {
            None => maps.first(),
            Some(name_at) => {
                let name = name_at.text()?;
                let found = maps.iter().find(|map| map["Name"].as_str() == Some(name));
                let names: Vec<&str> = maps.iter().filter_map(|map| map["Name"].as_str()).collect();
                Some(found.ok_or_else(|| {
                    name_at.error(format!("no map has this name; there are {}", names.join(", ")))
                })?)
            }
        };
        let map = found.ok_or_else(|| wrong("it holds no map".into()))?;
        Ok(Self {
            map: color_map(map).map_err(|what| wrong(what.into()))?,
            opacity: opacity(map).map_err(|what| wrong(what.into()))?,
        })
    }
}

/// Numbers of a list, in groups.
fn groups<const N: usize>(list: &Value) -> Option<Vec<[f64; N]>> {
    let numbers: Option<Vec<f64>> = list.as_array()?.iter().map(Value::as_f64).collect();
    let numbers = numbers?;
    let (groups, rest) = numbers.as_chunks::<N>();
    (rest.is_empty() && !groups.is_empty()).then(|| groups.to_vec())
}

fn color_map(map: &Value) -> Result<Option<ColorMap>, &'static str> {
    const WRONG: &str = "RGBPoints is no list of ascending value, red, green, blue";
    let Some(list) = map.get("RGBPoints") else { return Ok(None) };
    let points = groups::<4>(list).ok_or(WRONG)?;
    let (low, high) = (points[0][0], points[points.len() - 1][0]);
    let ascending = points.windows(2).all(|w| w[0][0] < w[1][0]);
    if !(low < high) || !ascending {
        return Err(WRONG);
    }
    let stops =
        points.iter().map(|&[v, r, g, b]| ((v - low) / (high - low), [r, g, b].map(|c| c.clamp(0.0, 1.0))));
    Ok(Some(ColorMap { palette: Palette::Stops(stops.collect()), range: (low, high) }))
}

fn opacity(map: &Value) -> Result<Option<Vec<(f64, f64)>>, &'static str> {
    const WRONG: &str = "Points is no list of ascending value, opacity, midpoint, sharpness";
    let Some(list) = map.get("Points") else { return Ok(None) };
    let points = groups::<4>(list).ok_or(WRONG)?;
    if points.windows(2).any(|w| w[0][0] >= w[1][0]) {
        return Err(WRONG);
    }
    Ok(Some(points.iter().map(|&[v, o, ..]| (v, o.clamp(0.0, 1.0))).collect()))
}
