//! The options of a look, each of which overrides what would be chosen.

use anyhow::{Result, anyhow, bail};
use clap::{Args, ValueEnum};
use rayset::scene::{Colormap, Kernel};
use serde_json::{Value, json};

use super::ranges::{ValueRange, over_logarithm};
use crate::values;

/// What a cloud or grid is to look like; a scene says all of this itself.
#[derive(Args, Clone, Default)]
#[command(next_help_heading = "Look of a cloud or grid (a scene file says this itself)")]
pub struct LookArgs {
    /// Look; chosen from the data by default, and said
    #[arg(long, value_enum)]
    pub(super) look: Option<LookName>,
    /// Kernel: wyvill (by default), chen, gaussian, cubic-spline, wendland-c2, epanechnikov, triweight
    #[arg(long)]
    pub(super) kernel: Option<Kernel>,
    /// Kernels integrate to one (smoothed-particle hydrodynamics); left out where weights are densities already, as those of
    /// snapshots are
    #[arg(long)]
    pub(super) normalised: bool,
    /// Radii of the points, as a factor of those in the file, 0.001 to 1000
    #[arg(long, value_parser = radius_scale)]
    pub(super) radius_scale: Option<f64>,
    /// Opacity from density, or from a grid's values: clamp, extinction:K, or a curve like 0:0,1:0.5,4:1
    #[arg(long)]
    pub(super) opacity: Option<String>,
    /// Length that opacity refers to, in units of the input
    #[arg(long, value_parser = values::length)]
    pub(super) unit_distance: Option<f64>,
    /// One colour for all, as #c8b090
    #[arg(long, value_parser = color, conflicts_with_all = ["colormap", "color_by"])]
    pub(super) color: Option<String>,
    /// Colour map: viridis, inferno, magma, plasma, turbo, grey, coolwarm, cividis, thermal, haline, deep, dense, ice,
    /// balance, RdBu, terrain; with _r reversed
    #[arg(long)]
    pub(super) colormap: Option<Colormap>,
    /// What the colour map shows: density, a stored attribute, or a coordinate: x, y, z, height
    #[arg(long)]
    pub(super) color_by: Option<String>,
    /// Values at the ends of the colour map: numbers, as 0:10, or percentiles of what it shows, as 1%:99%
    #[arg(long, value_parser = ValueRange::parse, allow_hyphen_values = true)]
    pub(super) value_range: Option<ValueRange>,
    /// The colour map is over the logarithm; from 1 % to 99 % of the positive values, if --value-range says nothing
    #[arg(long)]
    pub(super) log: bool,
    /// Light: from the eye, or none
    #[arg(long, value_enum)]
    pub(super) shading: Option<ShadingArg>,
    /// How much darker creases and what lies close behind edges become, 0 to 4
    #[arg(long, value_parser = occlusion)]
    pub(super) ambient_occlusion: Option<f64>,
    /// Background colour, or `none`: transparent
    #[arg(long, value_parser = background)]
    pub(super) background: Option<String>,
    /// Distance between samples, in units of the input, or `auto` (by default)
    #[arg(long)]
    pub(super) step: Option<String>,
    /// Automatic distance between samples as a fraction of the radius, 0.001 to 4; 0.25 by default
    #[arg(long, value_parser = step_fraction)]
    pub(super) step_fraction: Option<f64>,
    /// Samples of a ray begin half a step from the eye (by default), or a different fraction for each pixel
    #[arg(long, value_enum)]
    pub(super) phase: Option<PhaseArg>,
    /// Rays end where less than this is seen through, 0 to 0.999; 0.01 by default
    #[arg(long, value_parser = stop)]
    pub(super) stop: Option<f64>,
    /// What else is said of the picture, which is part of the scene that is written.
    #[arg(skip)]
    pub(super) image: ImageChoices,
}

/// Settings of a picture that a scene has, too.
#[derive(Clone, Copy, Default)]
pub struct ImageChoices {
    /// Rays along each side of a pixel.
    pub samples: Option<u32>,
    /// Exposure in stops.
    pub exposure: Option<f64>,
}

/// A look.
#[derive(Clone, Copy, ValueEnum, PartialEq, Eq, Debug)]
pub(super) enum LookName {
    /// The field itself: density up to 1 is opacity, lit from the eye
    Density,
    /// Solid surfaces in the points' own colours, or plain
    Surface,
    /// Surfaces, each class of points in a colour of its own
    Classes,
    /// Surfaces, coloured by height
    Height,
    /// Surfaces, grey by intensity
    Intensity,
    /// Glowing gas: colours and opacity by the logarithm of the density
    Gas,
    /// Voxels, by their values
    Volume,
    /// Voxels whose values are labels: a colour each, none between two
    Labels,
    /// Gaussian splats: their own colours, unlit
    Splats,
}

impl LookName {
    /// Whether it is one of voxels.
    pub(super) fn is_of_voxels(self) -> bool {
        matches!(self, Self::Volume | Self::Labels)
    }

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Density => "density",
            Self::Surface => "surface",
            Self::Classes => "classes",
            Self::Height => "height",
            Self::Intensity => "intensity",
            Self::Gas => "gas",
            Self::Volume => "volume",
            Self::Labels => "labels",
            Self::Splats => "splats",
        }
    }
}

/// What options of a look need to know of a cloud or grid.
pub(super) struct Input<'a> {
    /// Whether there is an attribute of a name.
    pub(super) has: &'a dyn Fn(&str) -> bool,
    /// Which attributes there are, in words.
    pub(super) stored: &'a str,
    /// The values of an attribute in ascending order, or of `density`; `None` if they are not known.
    pub(super) sorted: &'a dyn Fn(&str) -> Option<Vec<f64>>,
    /// Whether the density is shown over its logarithm by default.
    pub(super) logarithmic: bool,
}

impl Input<'_> {
    /// The values of an attribute, or of the density, in ascending order; for a logarithm those above 0.
    fn values(&self, name: &str, logarithmic: bool) -> Result<Vec<f64>> {
        let Some(mut values) = (self.sorted)(name) else {
            bail!("the values of {name} are not known before it is rendered; say --value-range LOW:HIGH")
        };
        values.retain(|value| !logarithmic || *value > 0.0);
        Ok(values)
    }
}

/// Whether a colour, as a scene file writes it, is a map.
fn is_map(color: &Value) -> bool {
    color.is_array() || color.as_str().is_some_and(|name| name.parse::<Colormap>().is_ok())
}

#[derive(Clone, Copy, ValueEnum)]
pub(super) enum ShadingArg {
    None,
    Headlight,
}

#[derive(Clone, Copy, ValueEnum)]
pub(super) enum PhaseArg {
    Half,
    Hashed,
}

fn color(text: &str) -> Result<String, String> {
    let [red, green, blue] = values::color(text)?.map(|v| (v * 255.0).round() as u8);
    Ok(format!("#{red:02x}{green:02x}{blue:02x}"))
}

fn background(text: &str) -> Result<String, String> {
    if text == "none" { Ok(text.to_owned()) } else { color(text) }
}

fn step_fraction(text: &str) -> Result<f64, String> {
    values::number_within(text, 1e-3, 4.0)
}

fn radius_scale(text: &str) -> Result<f64, String> {
    values::number_within(text, 1e-3, 1e3)
}

fn occlusion(text: &str) -> Result<f64, String> {
    values::number_within(text, 0.0, 4.0)
}

fn stop(text: &str) -> Result<f64, String> {
    values::number_within(text, 0.0, 0.999)
}

impl LookArgs {
    /// The first option of these that was given.
    pub fn given(&self) -> Option<&'static str> {
        let options = [
            ("--look", self.look.is_some()),
            ("--kernel", self.kernel.is_some()),
            ("--normalised", self.normalised),
            ("--radius-scale", self.radius_scale.is_some()),
            ("--opacity", self.opacity.is_some()),
            ("--unit-distance", self.unit_distance.is_some()),
            ("--color", self.color.is_some()),
            ("--colormap", self.colormap.is_some()),
            ("--color-by", self.color_by.is_some()),
            ("--value-range", self.value_range.is_some()),
            ("--log", self.log),
            ("--shading", self.shading.is_some()),
            ("--ambient-occlusion", self.ambient_occlusion.is_some()),
            ("--background", self.background.is_some()),
            ("--step", self.step.is_some()),
            ("--step-fraction", self.step_fraction.is_some()),
            ("--phase", self.phase.is_some()),
            ("--stop", self.stop.is_some()),
        ];
        options.into_iter().find(|(_, given)| *given).map(|(name, _)| name)
    }

    /// The options as one would type them.
    pub fn words(&self) -> Vec<String> {
        let named =
            |value: Option<clap::builder::PossibleValue>| value.map(|value| value.get_name().to_owned());
        let number = |value: Option<f64>| value.map(|value| value.to_string());
        let texts = [
            ("look", self.look.map(|look| look.name().to_owned())),
            ("kernel", self.kernel.map(|kernel| kernel.to_string())),
            ("radius-scale", number(self.radius_scale)),
            ("opacity", self.opacity.clone()),
            ("unit-distance", number(self.unit_distance)),
            ("color", self.color.clone()),
            ("colormap", self.colormap.map(|map| map.to_string())),
            ("color-by", self.color_by.clone()),
            ("value-range", self.value_range.map(|range| range.to_string())),
            ("shading", named(self.shading.and_then(|shading| shading.to_possible_value()))),
            ("ambient-occlusion", number(self.ambient_occlusion)),
            ("background", self.background.clone()),
            ("step", self.step.clone()),
            ("step-fraction", number(self.step_fraction)),
            ("phase", named(self.phase.and_then(|phase| phase.to_possible_value()))),
            ("stop", number(self.stop)),
        ];
        let with_values = texts.into_iter().filter_map(|(name, text)| Some(format!("--{name}={}", text?)));
        let flags = [("normalised", self.normalised), ("log", self.log)];
        let flags = flags.into_iter().filter(|(_, given)| *given).map(|(name, _)| format!("--{name}"));
        with_values.chain(flags).collect()
    }

    /// The same, with settings of the picture.
    #[must_use]
    pub fn with_image(self, image: ImageChoices) -> Self {
        Self { image, ..self }
    }

    /// Whether the colours that a look would show give way to others.
    pub(super) fn recolors(&self) -> bool {
        self.color.is_some() || self.colormap.is_some() || self.color_by.is_some()
    }

    /// Sets the samples and the exposure of a scene to which everything else has been applied. `automatic` is the exposure if none is
    /// asked for. The background is a colour of the display: it looks the same under any exposure.
    pub(super) fn apply_image(&self, scene: &mut Value, automatic: f64) {
        if let Some(samples) = self.image.samples {
            scene["image"]["samples"] = json!(samples);
        }
        expose(scene, self.image.exposure.unwrap_or(automatic));
    }

    /// Puts the options that were given in the place of what a scene of one cloud or grid says.
    pub(super) fn apply(&self, scene: &mut Value, input: &Input<'_>) -> Result<()> {
        let transfer = &mut scene["root"]["transferFunction"];
        if let Some(opacity) = &self.opacity {
            transfer["opacity"] = opacity_value(opacity)?;
        }
        if let Some(color) = &self.color {
            transfer["color"] = json!(color);
            remove(transfer, &["input", "valueRange"]);
        }
        if self.colormap.is_some() || self.color_by.is_some() {
            let map = self.colormap.map_or_else(|| "viridis".to_owned(), |map| map.to_string());
            // Other colours for what the look shows already, if it shows anything in colours of a map.
            if self.color_by.is_some() || !is_map(&transfer["color"]) {
                remove(transfer, &["input", "valueRange"]);
            }
            transfer["color"] = json!(map);
            if let Some(name) = self.color_by.as_deref().filter(|name| *name != "density") {
                if !(input.has)(name) {
                    bail!("--color-by {name}: there is no such attribute; {}", input.stored);
                }
                transfer["input"] = json!(name);
            }
        }
        self.apply_range(transfer, input)?;
        let root = &mut scene["root"];
        if let Some(kernel) = self.kernel {
            root["kernel"] = json!(kernel.to_string());
        }
        if self.normalised {
            root["normalised"] = json!(true);
        }
        if let Some(scale) = self.radius_scale {
            if root["type"] != "cloud" {
                bail!("--radius-scale is for points; the input has voxels");
            }
            root["radiusScale"] = json!(scale);
        }
        match self.shading {
            Some(ShadingArg::None) => scene["lights"] = json!("none"),
            Some(ShadingArg::Headlight) => remove(scene, &["lights"]),
            None => {}
        }
        match self.background.as_deref() {
            Some("none") => remove(scene, &["background"]),
            Some(color) => scene["background"] = json!(color),
            None => {}
        }
        self.apply_rendering(&mut scene["rendering"])
    }

    /// The range of the colour map, and its logarithm.
    fn apply_range(&self, transfer: &mut Value, input: &Input<'_>) -> Result<()> {
        let shown = transfer["input"].as_str().unwrap_or("density").to_owned();
        // The map of gas is over the logarithm already: it is made anew for other colours, or another range.
        let of_gas = input.logarithmic && shown == "density" && self.color.is_none();
        if of_gas && self.colormap.is_none() {
            if self.value_range.is_none() {
                return Ok(());
            }
            transfer["color"] = json!("inferno");
        }
        let logarithmic = self.log || of_gas && (self.colormap.is_some() || self.value_range.is_some());
        if self.value_range.is_none() && !logarithmic {
            return Ok(());
        }
        let chosen = [0, 1].map(|end| transfer["valueRange"][end].as_f64().unwrap_or(0.0));
        let (low, high) = match self.value_range {
            Some(range) if range.is_relative() => range.of(&input.values(&shown, logarithmic)?)?,
            Some(range) => range.of(&[])?,
            None if chosen.iter().all(|value| *value > 0.0) => (chosen[0], chosen[1]),
            None => ValueRange::customary(&input.values(&shown, logarithmic)?)?,
        };
        if logarithmic {
            transfer["color"] = over_logarithm(&transfer["color"], (low, high))?;
        }
        transfer["valueRange"] = json!([low, high]);
        Ok(())
    }

    fn apply_rendering(&self, rendering: &mut Value) -> Result<()> {
        if let Some(unit) = self.unit_distance {
            rendering["unitDistance"] = json!(unit);
        }
        match self.step.as_deref() {
            None | Some("auto") => {}
            Some(number) => {
                let step = values::length(number).map_err(|what| anyhow!("--step: {what}, or `auto`"))?;
                rendering["step"] = json!(step);
            }
        }
        if let Some(fraction) = self.step_fraction {
            rendering["stepFraction"] = json!(fraction);
        }
        if let Some(phase) = self.phase {
            rendering["phase"] = json!(if matches!(phase, PhaseArg::Half) { "half" } else { "hashed" });
        }
        if let Some(occlusion) = self.ambient_occlusion {
            rendering["ambientOcclusion"] = json!(occlusion);
        }
        if let Some(stop) = self.stop {
            rendering["stopTransmittance"] = json!(stop);
        }
        Ok(())
    }
}

fn remove(object: &mut Value, keys: &[&str]) {
    if let Some(object) = object.as_object_mut() {
        keys.iter().for_each(|key| drop(object.remove(*key)));
    }
}

/// An opacity rule as a scene file writes it.
fn opacity_value(text: &str) -> Result<Value> {
    use rayset::scene::OpacityRule;
    Ok(match values::opacity(text)? {
        OpacityRule::Extinction(kappa) => json!({"extinction": kappa}),
        OpacityRule::Curve(points) => points.iter().map(|&(d, o)| json!([d, o])).collect::<Vec<_>>().into(),
        _ => json!("clamp"),
    })
}

/// Gives a scene that was chosen another exposure, in stops, under which its background looks the same.
pub fn expose(scene: &mut Value, stops: f64) {
    let before = scene["image"]["exposure"].as_f64().unwrap_or(0.0);
    let background = &mut scene["background"];
    if let Some(color) = background.as_array() {
        let light = |v: &Value| v.as_f64().unwrap_or(0.0) * (before - stops).exp2();
        *background = color.iter().map(light).collect();
    } else if let Some(Ok(color)) = background.as_str().map(values::color)
        && stops != 0.0
    {
        *background = json!(color.map(|v| linear(v) / stops.exp2()));
    }
    if background.is_null() {
        remove(scene, &["background"]);
    }
    if stops == 0.0 {
        remove(&mut scene["image"], &["exposure"]);
    } else {
        scene["image"]["exposure"] = json!(stops);
    }
}

/// The light that a display makes of a value of sRGB (IEC 61966-2-1).
fn linear(display: f64) -> f64 {
    if display <= 0.04045 { display / 12.92 } else { ((display + 0.055) / 1.055).powf(2.4) }
}
