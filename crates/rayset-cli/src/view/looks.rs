//! What a page of the viewer can make of a cloud or grid: the options of `rayset render`, by the
//! same code.

use std::path::{Path, PathBuf};

use anyhow::Result;
use rayset::scene::NamedPalette;
use rayset::storage::address_of;
use rayset_view::{Attribute, Choices, Command, Histogram, Looks as ForPages, Styled};

use crate::histogram;
use rayset_inputs::look::{Chosen, Looks, expose};
use rayset_inputs::style::{Group, OPTIONS, Style};
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
    said: Style,
    /// Options that decide what is built of the inputs.
    building: Vec<String>,
    inputs: Vec<PathBuf>,
}

impl LooksOfFile {
    pub(super) fn new(looks: Looks, said: Style, building: Vec<String>, inputs: &[PathBuf]) -> Self {
        let whole = |path: &PathBuf| match address_of(path) {
            Some(_) => path.clone(),
            None => std::path::absolute(path).unwrap_or_else(|_| path.clone()),
        };
        Self { looks, said, building, inputs: inputs.iter().map(whole).collect() }
    }

    /// The scene as it was asked for on the command line, and what was chosen.
    pub(super) fn first(&self) -> Result<Chosen> {
        self.looks.chosen(&self.said, SIZE)
    }

    /// What was said when the program was started of one group of options.
    fn said_of(&self, group: Group) -> Style {
        let mut style = Style::default();
        let options = OPTIONS.iter().filter(|option| option.group == group);
        options.for_each(|option| option.copy(&self.said, &mut style));
        style
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
        let palettes = NamedPalette::all().map(|map| (map.to_string(), colors(map))).collect();
        Choices {
            looks: self.looks.names().into_iter().map(str::to_owned).collect(),
            attributes,
            palettes,
            style: self.said_of(Group::Look),
        }
    }

    fn styled(&self, style: &Style) -> Result<Styled, String> {
        let other = [Group::Picture, Group::Camera].into_iter().find_map(|group| style.given(group));
        if let Some(option) = other {
            return Err(format!("{} is no option of a look", option.name));
        }
        let style = style.or(&self.said_of(Group::Camera));
        let chosen = self.looks.chosen(&style, SIZE).map_err(|error| format!("{error:#}"))?;
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

    fn command(&self, style: &Style) -> Result<Command, String> {
        let chosen = self.looks.chosen(style, SIZE).map_err(|error| format!("{error:#}"))?;
        let mut words = vec!["rayset".to_owned(), "render".to_owned()];
        words.extend(self.inputs.iter().map(|path: &PathBuf| text(path)));
        words.extend(self.building.iter().cloned());
        words.extend(style.words());
        Ok(Command { words, scene: chosen.scene })
    }
}

fn text(path: &Path) -> String {
    path.to_string_lossy().into_owned()
}

fn spread(values: impl Iterator<Item = f64>) -> Option<Histogram> {
    let histogram::Histogram { low, high, logarithmic, counts } = histogram::Histogram::of(values)?;
    Some(Histogram { low, high, logarithmic, counts })
}

fn colors(map: NamedPalette) -> Vec<String> {
    let at = |i: usize| map.display_color(i as f64 / (PALETTE_COLORS - 1) as f64);
    let hex = |[r, g, b]: [f64; 3]| {
        let [r, g, b] = [r, g, b].map(|v| (v * 255.0).round() as u8);
        format!("#{r:02x}{g:02x}{b:02x}")
    };
    (0..PALETTE_COLORS).map(at).map(hex).collect()
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use rayset::Cloud;
    use rayset::points::Workload;
    use rayset_inputs::style::Flag;

    use super::*;

    /// Options of looks, each with those without which it means nothing.
    const SAID: [&[(&str, &str)]; 21] = [
        &[],
        &[("look", "gas")],
        &[("kernel", "chen")],
        &[("splat-filter", "3dgs"), ("kernel", "splat"), ("opacity", "extinction:1")],
        &[("normalised", "")],
        &[("radius-scale", "1.5")],
        &[("opacity", "0:0,1:0.5")],
        &[("opacity", "extinction:2"), ("unit-distance", "0.5")],
        &[("color", "#1060a0")],
        &[("colormap", "magma_r"), ("color-by", "x")],
        &[("color-by", "y")],
        &[("color-by", "x"), ("value-range", "10%:60%")],
        &[("look", "gas"), ("log", "")],
        &[("shading", "none")],
        &[("compositing", "display")],
        &[("ambient-occlusion", "2")],
        &[("background", "none")],
        &[("step", "0.3")],
        &[("step-fraction", "2")],
        &[("phase", "hashed")],
        &[("stop", "0.5")],
    ];

    fn style(said: &[(&str, &str)]) -> Style {
        let mut style = Style::default();
        for (name, text) in said {
            let option = rayset_inputs::style::StyleOption::find(name).expect("an option");
            option.parse(text).expect("a value").make(&mut style);
        }
        style
    }

    #[test]
    fn what_a_page_shows_in_any_style_its_command_renders() {
        let folder = tempfile::tempdir().expect("a folder");
        let workload: Workload = "knot-6k".parse().expect("a workload");
        let cloud = crate::demo::make_cloud(&workload, 64 << 20, folder.path()).expect("a cloud");
        let cloud = Arc::new(Cloud::open(&cloud).expect("the cloud"));
        let options = OPTIONS.iter().filter(|option| option.group == Group::Look);
        for option in options {
            let is_said = |said: &&&[(&str, &str)]| said.iter().any(|(name, _)| *name == option.name);
            assert!(SAID.iter().any(|said| is_said(&said)), "{} is not said", option.name);
        }
        for said in SAID {
            let of_looks = style(said);
            let looks = Looks::of_cloud(cloud.clone()).expect("looks");
            let file = LooksOfFile::new(looks, of_looks.clone(), Vec::new(), &["c.rset".into()]);
            // A page is told what was said, and sends it again.
            let told = serde_json::to_string(&file.choices().style).expect("JSON");
            let sent: Style = serde_json::from_str(&told).expect("a style");
            assert_eq!(sent, of_looks);
            let mut shown = file.styled(&sent).expect("a scene").scene;
            expose(&mut shown, 1.25);
            let camera = Style {
                position: Some([3.0, -4.0, 2.5]),
                direction: Some([-3.0, 4.0, -2.5]),
                up: Some([0.0, 0.0, 1.0]),
                orthographic: Some(Flag),
                height: Some(2.0),
                exposure: Some(1.25),
                ..Style::default()
            };
            let command = file.command(&camera.or(&sent)).expect("a command");
            shown["camera"] = command.scene["camera"].clone();
            // Why this is up: somebody said so.
            shown["root"]["comment"] = command.scene["root"]["comment"].clone();
            assert_eq!(command.scene, shown, "{said:?}");
        }
    }

    #[test]
    fn pages_choose_looks_and_nothing_else() {
        let folder = tempfile::tempdir().expect("a folder");
        let workload: Workload = "knot-6k".parse().expect("a workload");
        let cloud = crate::demo::make_cloud(&workload, 64 << 20, folder.path()).expect("a cloud");
        let looks = Looks::of_cloud(Arc::new(Cloud::open(&cloud).expect("the cloud"))).expect("looks");
        let file = LooksOfFile::new(looks, style(&[("up", "x")]), Vec::new(), &["c.rset".into()]);
        assert_eq!(file.choices().style, Style::default(), "pages have a camera of their own");
        for said in [&[("samples", "64")][..], &[("up", "y")]] {
            assert!(file.styled(&style(said)).is_err_and(|what| what.contains("is no option of a look")));
        }
    }
}
