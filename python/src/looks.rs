//! What clouds and grids look like, by the options of the program and the same code.

use pyo3::prelude::*;
use rayset::file::ScanError;
use rayset::scene::NamedPalette;
use rayset_inputs::look::{Chosen, Picture};
use rayset_inputs::style::{Group, OPTIONS, Spelling, Style};
use rayset_inputs::values;

use crate::errors::{self, Kind};
use crate::room;

/// A place on the axis that the cameras of a turntable turn about, and its direction.
pub(crate) type TurnsAbout = ([f64; 3], [f64; 3]);

/// A scene as JSON, what is said of it, the name of the look, what is up, and of the first picture
/// of a turntable what its cameras turn about.
pub(crate) type ChosenLook = (String, String, String, String, Option<TurnsAbout>);

/// The style of an object of JSON whose keys are names of arguments.
fn style(py: Python<'_>, arguments: &str) -> PyResult<Style> {
    let wrong = |what: String| errors::error(py, Kind::Scene, what);
    let object = serde_json::from_str(arguments).map_err(|error| wrong(error.to_string()))?;
    Style::from_object(&object, Spelling::Snake).map_err(|error| wrong(error.to_string()))
}

/// The names of the options of looks, as arguments.
#[pyfunction]
pub(crate) fn look_options() -> Vec<String> {
    let options = OPTIONS.iter().filter(|option| option.group == Group::Look);
    options.map(|option| Spelling::Snake.of(option.name).into_owned()).collect()
}

/// What is chosen by arguments, as texts.
pub(crate) fn chosen(
    py: Python<'_>,
    arguments: &str,
    picture: Picture,
    choose: impl FnOnce(&Style, Picture) -> anyhow::Result<Chosen> + Send,
) -> PyResult<ChosenLook> {
    let style = style(py, arguments)?;
    let texts = |chosen: Chosen| {
        let about = chosen.turntable.map(|about| (about.center.to_array(), about.axis.to_array()));
        (chosen.scene.to_string(), chosen.line, chosen.look.to_owned(), chosen.up, about)
    };
    py.detach(|| choose(&style, picture).map(texts)).map_err(|error| {
        // What is wrong may be the file that is looked at.
        let kind = if error.is::<ScanError>() { Kind::Input } else { Kind::Scene };
        errors::error(py, kind, format!("{error:#}"))
    })
}

/// The colours of a map at `count` places, as screens show them, 0 to 1.
#[pyfunction]
pub(crate) fn colormap(py: Python<'_>, name: &str, count: usize) -> PyResult<Vec<[f64; 3]>> {
    let map: NamedPalette = name
        .parse()
        .map_err(|error: rayset::ParseError| errors::error(py, Kind::Scene, error.to_string()))?;
    room::check(count as u64, 256, "the list of the colours", "ask for fewer")?;
    let last = count.saturating_sub(1).max(1) as f64;
    Ok((0..count).map(|i| map.display_color(i as f64 / last)).collect())
}

/// The names of all maps.
#[pyfunction]
pub(crate) fn colormaps() -> Vec<String> {
    NamedPalette::all().map(|map| map.to_string()).collect()
}

/// The number of bytes that a text such as `8GiB` means.
#[pyfunction]
pub(crate) fn size_of(text: &str) -> PyResult<u64> {
    values::size(text).map_err(errors::value)
}
