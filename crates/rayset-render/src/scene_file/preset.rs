//! ParaView's colour-map presets: a JSON list of maps with `Name`, `RGBPoints` (value, red, green,
//! blue, …) and `Points` (value, opacity, midpoint, sharpness, …), as exported by its colour map
//! editor. Colours are interpolated linearly in RGB, whatever `ColorSpace` says; midpoints and
//! sharpness are ignored.

use super::error::SceneFileError;
use super::json::Json;
use super::reader::{Cursor, listed};
use super::text::read_text;
use crate::scene::{ColorMap, FARTHEST, MOST_STOPS, Palette};
use rayset_store::storage::shown;

/// A map of a preset file.
pub(super) struct Preset {
    pub(super) map: Option<ColorMap>,
    pub(super) opacity: Option<Vec<(f64, f64)>>,
}

impl Preset {
    /// Loads the map that `{"file": …, "name": …}` refers to; without a name, the first map of the
    /// file.
    pub(super) fn load(at: &Cursor<'_>) -> Result<Self, SceneFileError> {
        let object = at.object(&["file", "name"])?;
        let file_at = object.require("file")?;
        let path = at.document.beside(file_at.text()?);
        let wrong = |what: String| file_at.error(format!("{}: {what}", shown(&path)));
        let text = read_text(&path).map_err(|e| wrong(format!("cannot read it: {e}")))?;
        let value = Json::parse(&text).map_err(|e| wrong(format!("this is not JSON: {e}")))?;
        let maps = value.as_list().unwrap_or(std::slice::from_ref(&value));
        let found = match object.get("name") {
            None => maps.first(),
            Some(name_at) => {
                let name = name_at.text()?;
                let found = maps.iter().find(|map| name_of(map) == Some(name));
                let names: Vec<&str> = maps.iter().filter_map(name_of).collect();
                Some(found.ok_or_else(|| {
                    name_at.error(format!("no map has this name; there are {}", listed(&names)))
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

fn name_of<'m>(map: &'m Json<'_>) -> Option<&'m str> {
    map.get("Name")?.as_str()
}

/// The numbers of a list in groups of `N` whose first numbers never descend; `None` if the list is
/// empty, too long or has any other form.
fn groups<const N: usize>(list: &Json<'_>) -> Option<Vec<[f64; N]>> {
    let numbers = list.as_list().filter(|items| items.len() <= N * MOST_STOPS)?;
    let in_range = |v: &f64| v.abs() <= FARTHEST;
    let numbers: Vec<f64> = numbers.iter().map(|v| v.as_f64().filter(in_range)).collect::<Option<_>>()?;
    let (groups, rest) = numbers.as_chunks::<N>();
    let ascending = groups.windows(2).all(|w| w[0][0] <= w[1][0]);
    (rest.is_empty() && !groups.is_empty() && ascending).then(|| groups.to_vec())
}

fn color_map(map: &Json<'_>) -> Result<Option<ColorMap>, &'static str> {
    const WRONG: &str = "RGBPoints is no list of ascending value, red, green, blue, of at most 4096 values";
    let Some(list) = map.get("RGBPoints") else { return Ok(None) };
    let points = groups::<4>(list).ok_or(WRONG)?;
    let (low, high) = (points[0][0], points[points.len() - 1][0]);
    if !(low < high) {
        return Err(WRONG);
    }
    let stops =
        points.iter().map(|&[v, r, g, b]| ((v - low) / (high - low), [r, g, b].map(|c| c.clamp(0.0, 1.0))));
    Ok(Some(ColorMap { palette: Palette::Stops(stops.collect()), range: (low, high) }))
}

fn opacity(map: &Json<'_>) -> Result<Option<Vec<(f64, f64)>>, &'static str> {
    const WRONG: &str =
        "Points is no list of ascending value, opacity, midpoint, sharpness, of at most 4096 values";
    let Some(list) = map.get("Points") else { return Ok(None) };
    let points = groups::<4>(list).ok_or(WRONG)?;
    Ok(Some(points.iter().map(|&[v, o, ..]| (v, o.clamp(0.0, 1.0))).collect()))
}
