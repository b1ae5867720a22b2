//! What clouds and grids look like, by the options of the program and the same code.

use clap::Parser;
use pyo3::prelude::*;
use rayset::file::ScanError;
use rayset::scene::Colormap;
use rayset_inputs::look::{CameraArgs, Chosen, LookArgs};
use rayset_inputs::values;

use crate::errors::{self, Kind};
use crate::room;

/// A place on the axis that the cameras of a turntable turn about, and its direction.
pub(crate) type TurnsAbout = ([f64; 3], [f64; 3]);

/// A scene as JSON, what is said of it, the name of the look, what is up, and of the first picture of a turntable what its cameras
/// turn about.
pub(crate) type ChosenLook = (String, String, String, String, Option<TurnsAbout>);

/// Options of the program that say what something looks like.
#[derive(Parser)]
#[command(no_binary_name = true, disable_help_flag = true)]
pub(crate) struct Words {
    #[command(flatten)]
    pub(crate) look: LookArgs,
    #[command(flatten)]
    pub(crate) camera: CameraArgs,
}

/// What was said; `turns` if it is of the first picture of a turntable.
pub(crate) fn parse(py: Python<'_>, words: Vec<String>, turns: bool) -> PyResult<Words> {
    let parsed = Words::try_parse_from(words).map(|mut words| {
        words.camera.turns = turns;
        words
    });
    parsed.map_err(|error| {
        let text = error.to_string();
        // Without how the program is used.
        let lines: Vec<&str> =
            text.lines().map(str::trim).take_while(|line| !line.starts_with("For more")).collect();
        let said = lines.iter().filter(|line| !line.is_empty()).copied().collect::<Vec<_>>().join("; ");
        errors::error(py, Kind::Scene, said.trim_start_matches("error: ").to_owned())
    })
}

/// What was chosen, as texts.
pub(crate) fn texts(chosen: Chosen) -> anyhow::Result<ChosenLook> {
    let about = chosen.turntable.map(|about| (about.center.to_array(), about.axis.to_array()));
    Ok((chosen.scene.to_string(), chosen.line, chosen.look.to_owned(), chosen.up, about))
}

pub(crate) fn chosen(py: Python<'_>, chosen: anyhow::Result<ChosenLook>) -> PyResult<ChosenLook> {
    chosen.map_err(|error| {
        // What is wrong may be the file that is looked at.
        let kind = if error.is::<ScanError>() { Kind::Input } else { Kind::Scene };
        errors::error(py, kind, format!("{error:#}"))
    })
}

/// The colours of a map at `count` places, as screens show them, 0 to 1.
#[pyfunction]
pub(crate) fn colormap(py: Python<'_>, name: &str, count: usize) -> PyResult<Vec<[f64; 3]>> {
    let map: Colormap = name
        .parse()
        .map_err(|error: rayset::ParseError| errors::error(py, Kind::Scene, error.to_string()))?;
    room::check(count as u64, 256, "the list of the colours", "ask for fewer")?;
    let last = count.saturating_sub(1).max(1) as f64;
    Ok((0..count).map(|i| map.display_color(i as f64 / last)).collect())
}

/// The names of all maps.
#[pyfunction]
pub(crate) fn colormaps() -> Vec<String> {
    Colormap::all().map(|map| map.to_string()).collect()
}

/// The number of bytes that a text such as `8GiB` means.
#[pyfunction]
pub(crate) fn size_of(text: &str) -> PyResult<u64> {
    values::size(text).map_err(errors::value)
}
