//! What determines the picture: its options, and the scene and settings that they yield.

use std::sync::Arc;

use anyhow::{Result, anyhow, bail, ensure};
use clap::{Args, ValueEnum};
use rayset::Cloud;
use rayset::Region;
use rayset::file::Header;
use rayset::image::DisplayTransform;
use rayset::scene::Kernel;
use rayset::scene::{
    CloudObject, ColorMap, ColorRule, Colormap, Lighting, MapInput, RenderSettings, SampleOffset, Scene,
    Step, TransferFunction,
};

use crate::values;

#[derive(Args, Clone, Default)]
#[command(next_help_heading = "Picture")]
pub(crate) struct PictureArgs {
    /// Width and height in pixels; 512x512 by default
    #[arg(long, value_parser = values::dimensions)]
    pub(crate) size: Option<(u32, u32)>,
    /// Only a part of the picture: left,top,width,height
    #[arg(long, value_delimiter = ',')]
    crop: Option<Vec<u32>>,
    /// Rays along each side of a pixel, 1 to 64; 1 by default
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=64))]
    samples: Option<u32>,
    /// Exposure in stops, -32 to 32: light is multiplied by two to this power
    #[arg(long, value_parser = exposure, allow_hyphen_values = true)]
    exposure: Option<f64>,
}

/// What a cloud is to look like; a scene says all of this itself.
#[derive(Args, Clone, Default)]
#[command(next_help_heading = "Look of a cloud (a scene file says this itself)")]
pub(crate) struct LookArgs {
    /// Kernel: wyvill (by default), chen, gaussian, cubic-spline, wendland-c2, epanechnikov, triweight
    #[arg(long)]
    kernel: Option<Kernel>,
    /// Kernels integrate to one (smoothed-particle hydrodynamics)
    #[arg(long)]
    normalised: bool,
    /// Opacity from density: clamp (by default), extinction:K, or a curve like 0:0,1:0.5,4:1
    #[arg(long)]
    opacity: Option<String>,
    /// Length that opacity refers to, in units of the cloud; the mean radius by default
    #[arg(long, value_parser = values::length)]
    unit_distance: Option<f64>,
    /// One colour for all, as #c8b090
    #[arg(long, value_parser = values::color, conflicts_with_all = ["colormap", "color_by"])]
    color: Option<[f64; 3]>,
    /// Colour map: viridis, inferno, magma, plasma, turbo, grey, coolwarm; with _r reversed
    #[arg(long)]
    colormap: Option<Colormap>,
    /// What the colour map shows: density, or a stored attribute
    #[arg(long)]
    color_by: Option<String>,
    /// Values at the ends of the colour map, as 0:10
    #[arg(long, value_parser = values::range)]
    value_range: Option<(f64, f64)>,
    /// Light: from the eye (by default), or none
    #[arg(long, value_enum)]
    shading: Option<ShadingArg>,
    /// Background colour; transparent by default
    #[arg(long, value_parser = values::color)]
    background: Option<[f64; 3]>,
    /// Distance between samples, in units of the cloud, or `auto` (by default)
    #[arg(long)]
    step: Option<String>,
    /// Automatic distance between samples as a fraction of the radius, 0.001 to 4; 0.25 by default
    #[arg(long, value_parser = step_fraction)]
    step_fraction: Option<f64>,
    /// Samples of a ray begin half a step from the eye (by default), or a different fraction for each pixel
    #[arg(long, value_enum)]
    phase: Option<PhaseArg>,
    /// Rays end where less than this is seen through, 0 to 0.999; 0.01 by default
    #[arg(long, value_parser = stop)]
    stop: Option<f32>,
}

fn exposure(text: &str) -> Result<f64, String> {
    values::number_within(text, -32.0, 32.0)
}

fn step_fraction(text: &str) -> Result<f64, String> {
    values::number_within(text, 1e-3, 4.0)
}

fn stop(text: &str) -> Result<f32, String> {
    values::number_within(text, 0.0, 0.999).map(|v| v as f32)
}

#[derive(Clone, Copy, ValueEnum)]
enum ShadingArg {
    None,
    Headlight,
}

#[derive(Clone, Copy, ValueEnum)]
enum PhaseArg {
    Half,
    Hashed,
}

impl PictureArgs {
    /// Overrides the settings of a scene with those given on the command line.
    pub(super) fn apply(&self, settings: &mut RenderSettings, display_transform: &mut DisplayTransform) {
        if let Some((width, height)) = self.size {
            (settings.width, settings.height) = (width, height);
        }
        settings.samples = self.samples.unwrap_or(settings.samples);
        display_transform.exposure = self.exposure.unwrap_or(display_transform.exposure);
    }

    pub(super) fn region(&self, settings: RenderSettings) -> Result<Region> {
        let Some(crop) = &self.crop else {
            return Ok(Region { columns: 0..settings.width, rows: 0..settings.height });
        };
        let &[x, y, width, height] = crop.as_slice() else {
            bail!("--crop takes four numbers: left,top,width,height")
        };
        let (right, bottom) = (x.saturating_add(width), y.saturating_add(height));
        ensure!(
            width > 0 && height > 0 && right <= settings.width && bottom <= settings.height,
            "--crop {x},{y},{width},{height} does not lie within the picture"
        );
        Ok(Region { columns: x..right, rows: y..bottom })
    }
}

impl LookArgs {
    /// The first option of these that was given.
    pub(super) fn given(&self) -> Option<&'static str> {
        let options = [
            ("--kernel", self.kernel.is_some()),
            ("--normalised", self.normalised),
            ("--opacity", self.opacity.is_some()),
            ("--unit-distance", self.unit_distance.is_some()),
            ("--color", self.color.is_some()),
            ("--colormap", self.colormap.is_some()),
            ("--color-by", self.color_by.is_some()),
            ("--value-range", self.value_range.is_some()),
            ("--shading", self.shading.is_some()),
            ("--background", self.background.is_some()),
            ("--step", self.step.is_some()),
            ("--step-fraction", self.step_fraction.is_some()),
            ("--phase", self.phase.is_some()),
            ("--stop", self.stop.is_some()),
        ];
        options.into_iter().find(|(_, given)| *given).map(|(name, _)| name)
    }

    pub(super) fn settings(&self) -> Result<RenderSettings> {
        let step = match self.step.as_deref() {
            None | Some("auto") => Step::Automatic { fraction: self.step_fraction.unwrap_or(0.25) },
            Some(number) => {
                Step::Fixed(values::length(number).map_err(|what| anyhow!("--step: {what}, or `auto`"))?)
            }
        };
        let sample_offset = match self.phase {
            None | Some(PhaseArg::Half) => SampleOffset::Half,
            Some(PhaseArg::Hashed) => SampleOffset::Hashed,
        };
        let plain = RenderSettings::default();
        let stop = self.stop.unwrap_or(plain.stop_transmittance);
        Ok(plain.with_step(step).with_sample_offset(sample_offset).with_stop_transmittance(stop))
    }

    pub(super) fn scene(&self, cloud: &Arc<Cloud>) -> Result<Scene> {
        let header = cloud.header();
        let linear = DisplayTransform::linear_from_srgb;
        let transfer = TransferFunction {
            opacity: values::opacity(self.opacity.as_deref().unwrap_or("clamp"))?,
            color: self.color_rule(header)?,
        };
        let object = CloudObject {
            cloud: cloud.clone(),
            kernel: self.kernel.unwrap_or_default(),
            normalised: self.normalised,
            transfer,
        };
        Ok(Scene {
            lighting: match self.shading {
                Some(ShadingArg::None) => Lighting::Unlit,
                None | Some(ShadingArg::Headlight) => Lighting::headlight(),
            },
            background: self.background.map(linear),
            unit_distance: self.unit_distance.unwrap_or(header.radius_mean),
            ..Scene::of_cloud(object)
        })
    }

    fn color_rule(&self, header: &Header) -> Result<ColorRule> {
        if let Some(color) = self.color {
            return Ok(ColorRule::Uniform(DisplayTransform::linear_from_srgb(color)));
        }
        if self.colormap.is_none() && self.color_by.is_none() {
            /// The colour of unpainted plaster.
            const PLAIN: [f64; 3] = [0.86, 0.80, 0.70];
            return Ok(if header.has_color {
                ColorRule::Points
            } else {
                ColorRule::Uniform(DisplayTransform::linear_from_srgb(PLAIN))
            });
        }
        let map = match self.colormap {
            Some(map) => map,
            None => "viridis".parse()?,
        };
        let (input, known_range) = match self.color_by.as_deref() {
            None | Some("density") => (MapInput::Density, (0.0, 1.0)),
            Some(name) => {
                let found = header.attributes.iter().position(|a| a.name == name);
                let index = found.ok_or_else(|| {
                    let stored: Vec<&str> = header.attributes.iter().map(|a| a.name.as_str()).collect();
                    anyhow!(
                        "--color-by {name}: the cloud stores {}; keep columns with `build --attributes`",
                        if stored.is_empty() { "no attributes".to_owned() } else { stored.join(", ") }
                    )
                })?;
                let attribute = &header.attributes[index];
                let (low, high) = (attribute.min, attribute.max);
                (MapInput::Attribute(index), (low, if high > low { high } else { low + 1.0 }))
            }
        };
        let map = ColorMap::named(map, self.value_range.unwrap_or(known_range));
        Ok(ColorRule::Map { map, input })
    }
}
