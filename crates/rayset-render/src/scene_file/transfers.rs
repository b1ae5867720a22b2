//! Transfer functions and colours of scene files: what density, values, opacity and attributes look
//! like.

use super::error::SceneFileError;
use super::json::Json;
use super::preset::Preset;
use super::reader::{Cursor, Object, listed, nearest, shortened};
use crate::scene::{
    Channel, CloudObject, ColorMap, ColorRule, FARTHEST, GridObject, MOST_STOPS, MapInput, Node, OpacityRule,
    Palette, Pattern, SHORTEST, Transfer,
};

/// A transfer function applied to the output of a node: opacity, colour or both.
pub(super) fn transfers(at: &Cursor<'_>, node: &Node) -> Result<Vec<Transfer>, SceneFileError> {
    let object = at.object(&["input", "opacity", "color", "valueRange", "preset"])?;
    let preset = object.get("preset").map(|at| Preset::load(&at)).transpose()?;
    let (preset_map, preset_curve) = preset.map_or((None, None), |preset| (preset.map, preset.opacity));
    let plain = (Channel::Opacity, (0.0, 1.0));
    let (input, known_range) = object.read_or("input", plain, |at| transfer_input(at, node))?;
    let mut made = Vec::new();
    let curve = object.get("opacity").map(|at| curve(&at)).transpose()?.or(preset_curve);
    let known_range = preset_map.as_ref().map_or(known_range, |map| map.range);
    let range = object.read_or("valueRange", known_range, value_range)?;
    let palette =
        object.get("color").map(|at| palette(&at)).transpose()?.or(preset_map.map(|map| map.palette));
    made.extend(curve.map(|curve| Transfer::Opacity { input: input.clone(), curve }));
    made.extend(palette.map(|palette| Transfer::Color { input, map: ColorMap { palette, range } }));
    if made.is_empty() {
        Err(at.error("expected \"opacity\", \"color\", both or a \"preset\""))
    } else {
        Ok(made)
    }
}

/// The input of a node's transfer function, and the range of its values.
fn transfer_input(at: &Cursor<'_>, node: &Node) -> Result<(Channel, (f64, f64)), SceneFileError> {
    let channel = match at.text()? {
        "opacity" => Channel::Opacity,
        "red" => Channel::Red,
        "green" => Channel::Green,
        "blue" => Channel::Blue,
        name => {
            let known = node.attributes();
            let Some(&(low, high)) = known.get(name) else {
                let own: Vec<&str> = known.keys().map(String::as_str).collect();
                let all = [&["opacity", "red", "green", "blue"], &own[..]].concat();
                let meant =
                    nearest(name, &all).map(|n| format!("; did you mean \"{n}\"?")).unwrap_or_default();
                let (all, name) = (listed(&all), shortened(name));
                return Err(
                    at.error(format!("nothing here has an attribute \"{name}\"; there are {all}{meant}"))
                );
            };
            return Ok((Channel::Attribute(name.into()), (low, if high > low { high } else { low + 1.0 })));
        }
    };
    Ok((channel, (0.0, 1.0)))
}

pub(super) fn read_transfer_function(at: &Cursor<'_>, made: &mut CloudObject) -> Result<(), SceneFileError> {
    let object = at.object(&["opacity", "color", "input", "valueRange", "preset"])?;
    let preset = object.get("preset").map(|at| Preset::load(&at)).transpose()?;
    if let Some(opacity) = preset.as_ref().and_then(|preset| preset.opacity.clone()) {
        made.transfer.opacity = OpacityRule::Curve(opacity);
    }
    if let Some(at) = object.get("opacity") {
        made.transfer.opacity = opacity(&at)?;
    }
    let input = object.get("input");
    let header = made.cloud.header();
    let (input, known_range) = match &input {
        None => (MapInput::Density, (0.0, 1.0)),
        Some(at) if at.text()? == "density" => (MapInput::Density, (0.0, 1.0)),
        Some(at) => {
            let name = at.text()?;
            let stored: Vec<&str> = header.attributes.iter().map(|a| a.name.as_str()).collect();
            let index = header.attribute_number(name).ok_or_else(|| {
                let (all, name) =
                    (listed(&[&["density"], &stored[..], &["x", "y", "z"]].concat()), shortened(name));
                at.error(format!("the cloud stores no \"{name}\"; it has {all}"))
            })?;
            let (low, high) = header.attribute_range(index);
            (MapInput::Attribute(index), (low, if high > low { high } else { low + 1.0 }))
        }
    };
    let preset_map = preset.and_then(|preset| preset.map);
    let known_range = preset_map.as_ref().map_or(known_range, |map| map.range);
    let range = object.read_or("valueRange", known_range, value_range)?;
    if let Some(map) = preset_map {
        made.transfer.color = ColorRule::Map { map: ColorMap { range, ..map }, input };
    }
    if let Some(at) = object.get("color") {
        made.transfer.color = match at.value.as_str() {
            Some("points") if header.has_color => ColorRule::Points,
            Some("points") => return Err(at.error("the cloud stores no colours")),
            Some(text) if !text.starts_with('#') => {
                ColorRule::Map { map: ColorMap { palette: palette(&at)?, range }, input }
            }
            None if is_stops(&at) => {
                ColorRule::Map { map: ColorMap { palette: palette(&at)?, range }, input }
            }
            _ => ColorRule::Uniform(at.color()?.map(|v| v as f32)),
        };
    }
    Ok(())
}

/// Whether a value is a list that begins with a list, as a palette's stops do.
fn is_stops(at: &Cursor<'_>) -> bool {
    at.value.as_list().and_then(|items| items.first()).is_some_and(Json::is_list)
}

fn opacity(at: &Cursor<'_>) -> Result<OpacityRule, SceneFileError> {
    if at.value.as_str() == Some("clamp") {
        return Ok(OpacityRule::Clamp);
    }
    if at.value.is_object() {
        let kappa = at.object(&["extinction"])?.require("extinction")?.number(0.0, FARTHEST)?;
        return Ok(OpacityRule::Extinction(kappa));
    }
    if at.value.is_list() {
        return Ok(OpacityRule::Curve(curve(at)?));
    }
    Err(at.expected("\"clamp\", {\"extinction\": 2.5} or a curve like [[0, 0], [1, 0.5]]"))
}

/// An opacity curve: values that never descend, each with an opacity from 0 to 1.
fn curve(at: &Cursor<'_>) -> Result<Vec<(f64, f64)>, SceneFileError> {
    let mut curve: Vec<(f64, f64)> = Vec::new();
    for item in at.list(MOST_STOPS)? {
        let [value, opacity] = item.numbers::<2>()?;
        if !(0.0..=1.0).contains(&opacity) {
            return Err(item.error(format!("expected an opacity from 0 to 1, found {opacity}")));
        }
        if curve.last().is_some_and(|last| last.0 > value) {
            return Err(item.error("expected values in ascending order"));
        }
        curve.push((value, opacity));
    }
    if curve.is_empty() { Err(at.error("expected at least one [value, opacity]")) } else { Ok(curve) }
}

fn value_range(at: &Cursor<'_>) -> Result<(f64, f64), SceneFileError> {
    let [low, high] = at.numbers::<2>()?;
    let apart = (high - low).abs();
    if apart >= SHORTEST && apart >= 1e-15 * low.abs().max(high.abs()) {
        Ok((low, high))
    } else {
        Err(at.error("expected two different numbers"))
    }
}

/// A palette, given by name or as a list of places and colours.
fn palette(at: &Cursor<'_>) -> Result<Palette, SceneFileError> {
    if let Some(name) = at.value.as_str() {
        return name
            .parse()
            .map(Palette::Named)
            .map_err(|e: rayset_base::parse::ParseError| at.error(e.to_string()));
    }
    let mut stops: Vec<(f64, [f64; 3])> = Vec::new();
    for item in at.list(MOST_STOPS)? {
        let pair = item.list(usize::MAX)?;
        let [place, color] = pair.as_slice() else {
            return Err(item.expected("a place from 0 to 1 and a colour, like [0.5, \"#c8b090\"]"));
        };
        let place_at = place.number(0.0, 1.0)?;
        if stops.last().is_some_and(|last| last.0 > place_at) {
            return Err(place.error("expected places in ascending order"));
        }
        stops.push((place_at, color.color()?.map(crate::image::srgb_from_linear)));
    }
    if stops.is_empty() {
        Err(at.error("expected at least one [place, colour]"))
    } else {
        Ok(Palette::Stops(stops.into()))
    }
}

pub(super) fn pattern(object: &Object<'_>) -> Result<Pattern, SceneFileError> {
    let Some(at) = object.get("color") else { return Ok(Pattern::Uniform([1.0; 3])) };
    if !at.value.is_object() {
        return at.color().map(Pattern::Uniform);
    }
    if at.any_object()?.require("type")?.one_of(&[("checker", true), ("gradient", false)])? {
        let object = at.object(&["type", "colors", "size"])?;
        let colors_at = object.require("colors")?;
        let colors = colors_at.list(usize::MAX)?;
        let [first, second] = colors.as_slice() else {
            return Err(colors_at.expected("two colours"));
        };
        let size = object.require("size")?.positive()?;
        return Ok(Pattern::Checker { colors: [first.color()?, second.color()?], size });
    }
    let object = at.object(&["type", "from", "to", "color", "valueRange"])?;
    let (from, to) = (object.require("from")?.vector()?, object.require("to")?.vector()?);
    if from.distance(to) < SHORTEST {
        return Err(at.error("\"from\" and \"to\" are the same place"));
    }
    let range = object.read_or("valueRange", (0.0, 1.0), value_range)?;
    Ok(Pattern::Gradient { from, to, map: ColorMap { palette: palette(&object.require("color")?)?, range } })
}

/// Reads the transfer function of a grid, over its values.
pub(super) fn read_value_transfer(at: &Cursor<'_>, made: &mut GridObject) -> Result<(), SceneFileError> {
    let object = at.object(&["opacity", "color", "valueRange", "preset"])?;
    let preset = object.get("preset").map(|at| Preset::load(&at)).transpose()?;
    let known = preset.as_ref().and_then(|p| p.map.as_ref()).map(|map| map.range);
    let range =
        object.read_or("valueRange", known.unwrap_or(made.grid.header().value_range()), value_range)?;
    if let Some(preset) = preset {
        if let Some(curve) = preset.opacity {
            made.transfer.opacity = OpacityRule::Curve(curve);
        }
        if let Some(map) = preset.map {
            made.transfer.color = ColorRule::Map { map: ColorMap { range, ..map }, input: MapInput::Density };
        }
    }
    if let Some(at) = object.get("opacity") {
        made.transfer.opacity = opacity(&at)?;
    }
    if let Some(at) = object.get("color") {
        let named = at.value.as_str().is_some_and(|text| !text.starts_with('#'));
        made.transfer.color = if named || is_stops(&at) {
            ColorRule::Map { map: ColorMap { palette: palette(&at)?, range }, input: MapInput::Density }
        } else {
            ColorRule::Uniform(at.color()?.map(|v| v as f32))
        };
    }
    Ok(())
}
