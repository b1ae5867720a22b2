//! What a page of the viewer can make of a cloud or grid: the options of `rayset render`, by the same code.

use std::path::{Path, PathBuf};

use anyhow::Result;
use clap::Parser;
use rayset::scene::Colormap;
use rayset::storage::address_of;
use rayset_view::{Attribute, Choices, Command, Histogram, Looks as ForPages, Style, Styled};

use crate::histogram;
use rayset_inputs::look::{CameraArgs, Chosen, ImageChoices, LookArgs, Looks, expose};
use rayset_inputs::units;
use serde_json::Value;

/// Colours of a map that a page is told.
const PALETTE_COLORS: usize = 33;
/// Size for which a look is chosen; no part of it but the first camera depends on it.
const SIZE: (u32, u32) = (1280, 720);
/// The part of the values at either end of a range that is left out at first.
const LEFT_OUT: f64 = 0.01;

/// The looks of a cloud or grid.
pub(super) struct LooksOfFile {
    looks: Looks,
    /// What was said when the program was started.
    look: LookArgs,
    camera: CameraArgs,
    /// Options that decide what is built of the inputs.
    building: Vec<String>,
    inputs: Vec<PathBuf>,
}

/// The options of a style, read as the command line's are.
#[derive(Parser)]
#[command(no_binary_name = true)]
struct Words {
    #[command(flatten)]
    look: LookArgs,
}

/// The options of a camera, likewise.
#[derive(Parser)]
#[command(no_binary_name = true)]
struct CameraWords {
    #[command(flatten)]
    camera: CameraArgs,
}

impl LooksOfFile {
    pub(super) fn new(
        looks: Looks,
        look: LookArgs,
        camera: CameraArgs,
        building: Vec<String>,
        inputs: &[PathBuf],
    ) -> Self {
        let whole = |path: &PathBuf| match address_of(path) {
            Some(_) => path.clone(),
            None => std::path::absolute(path).unwrap_or_else(|_| path.clone()),
        };
        Self { looks, look, camera, building, inputs: inputs.iter().map(whole).collect() }
    }

    /// The scene as it was asked for on the command line, and what was chosen.
    pub(super) fn first(&self) -> Result<Chosen> {
        self.looks.chosen(&self.look, &self.camera, SIZE)
    }

    /// The options of a style.
    fn look_of(&self, style: &Style) -> Result<LookArgs, String> {
        let words = self.other_words(style).into_iter().chain(style.words());
        Ok(Words::try_parse_from(words).map_err(|error| first_line(&error.to_string()))?.look)
    }

    /// What was said when the program was started, as far as pages can say it.
    fn first_style(&self) -> Style {
        let mut style = Style::default();
        for word in self.look.words() {
            let (name, text) = word.split_once('=').unwrap_or((&word, ""));
            let text = text.to_owned();
            match name {
                "--look" => style.look = Some(text),
                "--color" => style.color = Some(text),
                "--color-by" => style.color_by = Some(text),
                "--colormap" => style.colormap = Some(text),
                "--value-range" => style.value_range = pair(&text),
                "--radius-scale" => style.radius_scale = text.parse().ok(),
                "--opacity" => style.opacity = text.split(',').map(pair).collect(),
                "--log" => style.log = true,
                _ => {}
            }
        }
        style
    }

    /// What was said when the program was started and a style does not say: what pages cannot say, and what a style that keeps the look
    /// cannot express.
    fn other_words(&self, style: &Style) -> Vec<String> {
        let first = self.first_style();
        let (said, own) = (first.words(), style.words());
        let name = |word: &String| word.split_once('=').map_or(word.clone(), |(name, _)| name.to_owned());
        let is_of_look = |word: &String| ["--opacity", "--value-range"].contains(&name(word).as_str());
        let mut words = self.look.words();
        words.retain(|word| {
            !said.contains(word)
                && !own.iter().any(|own| name(own) == name(word))
                && !(is_of_look(word) && style.look != first.look)
        });
        words
    }

    fn attribute(&self, name: &str, unit: &str) -> Option<Attribute> {
        let sorted = self.looks.values(name);
        let at = |part: f64| {
            sorted.get((part * (sorted.len().saturating_sub(1)) as f64).round() as usize).copied()
        };
        let range = [at(LEFT_OUT)?, at(1.0 - LEFT_OUT)?];
        let histogram = spread(sorted.iter().copied());
        Some(Attribute { name: name.into(), unit: unit.into(), range, histogram })
    }
}

impl ForPages for LooksOfFile {
    fn choices(&self) -> Choices {
        let attributes = match self.looks.cloud() {
            Some(cloud) => {
                let stored = &cloud.header().attributes;
                let stored =
                    stored.iter().filter_map(|a| self.attribute(&a.name, &units::readable(&a.name, &a.unit)));
                stored.chain(["x", "y", "z"].iter().filter_map(|axis| self.attribute(axis, ""))).collect()
            }
            None => Vec::new(),
        };
        let palettes = Colormap::all().map(|map| (map.to_string(), colors(map))).collect();
        Choices {
            looks: self.looks.names().into_iter().map(str::to_owned).collect(),
            attributes,
            palettes,
            style: self.first_style(),
        }
    }

    fn styled(&self, style: &Style) -> Result<Styled, String> {
        let look = self.look_of(style)?;
        let chosen = self.looks.chosen(&look, &self.camera, SIZE).map_err(|error| format!("{error:#}"))?;
        Ok(Styled {
            scene: chosen.scene,
            look: chosen.look.to_owned(),
            line: chosen.line,
            classes: chosen.classes,
            densities: spread((chosen.densities)().into_iter()),
        })
    }

    fn expose(&self, scene: &mut Value, stops: f64) {
        expose(scene, stops);
    }

    fn command(&self, style: &Style, camera: &[String], exposure: Option<f64>) -> Result<Command, String> {
        let look = self.look_of(style)?.with_image(ImageChoices { samples: None, exposure });
        let read = CameraWords::try_parse_from(camera).map_err(|error| first_line(&error.to_string()))?;
        let chosen = self.looks.chosen(&look, &read.camera, SIZE).map_err(|error| format!("{error:#}"))?;
        let mut words = vec!["rayset".to_owned(), "render".to_owned()];
        words.extend(self.inputs.iter().map(|path: &PathBuf| text(path)));
        words.extend(self.building.iter().cloned());
        words.extend(look.words());
        words.extend(camera.iter().cloned());
        Ok(Command { words, scene: chosen.scene })
    }
}

/// Two numbers, as `0:10`; `None` of percentiles and other words.
fn pair(text: &str) -> Option<[f64; 2]> {
    let (low, high) = text.split_once(':')?;
    Some([low.parse().ok()?, high.parse().ok()?])
}

fn text(path: &Path) -> String {
    path.to_string_lossy().into_owned()
}

/// What is wrong, without how the command is used.
fn first_line(message: &str) -> String {
    message.lines().next().unwrap_or_default().trim_start_matches("error: ").to_owned()
}

fn spread(values: impl Iterator<Item = f64>) -> Option<Histogram> {
    let histogram::Histogram { low, high, logarithmic, counts } = histogram::Histogram::of(values)?;
    Some(Histogram { low, high, logarithmic, counts })
}

fn colors(map: Colormap) -> Vec<String> {
    let at = |i: usize| map.display_color(i as f64 / (PALETTE_COLORS - 1) as f64);
    let hex = |[r, g, b]: [f64; 3]| {
        let [r, g, b] = [r, g, b].map(|v| (v * 255.0).round() as u8);
        format!("#{r:02x}{g:02x}{b:02x}")
    };
    (0..PALETTE_COLORS).map(at).map(hex).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_words_of_options_mean_the_options_again() {
        let words = [
            "--look=gas",
            "--colormap=magma_r",
            "--color-by=T",
            "--value-range=1%:99%",
            "--log",
            "--opacity=0:0,1:0.5",
        ];
        let read = |words: &[String]| Words::try_parse_from(words).map(|words| words.look);
        let first = read(&words.map(str::to_owned)).expect("options");
        let again = read(&first.words()).expect("options again");
        assert_eq!(first.words(), again.words());
        assert_eq!(first.words().len(), words.len());
    }

    #[test]
    fn a_style_is_nothing_but_options_of_looks() {
        let style = |look: &str| Style { look: Some(look.into()), ..Style::default() };
        assert!(Words::try_parse_from(style("surface").words()).is_ok());
        for odd in ["nonsense", "--help", "gas --background=red", ""] {
            assert!(Words::try_parse_from(style(odd).words()).is_err(), "{odd}");
        }
    }
}
