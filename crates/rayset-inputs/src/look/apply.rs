//! A style in the place of what a look says: options override what was chosen.

use anyhow::{Result, bail};
use rayset::scene::{Kernel, NamedPalette, OpacityRule};
use serde_json::{Value, json};

use super::ranges::over_logarithm;
use crate::style::kinds::{Detail, Kind, Rays};
use crate::style::{Background, Compositing, Phase, Shading, StepLength, Style, ValueRange};
use crate::values;

/// What options of a look need to know of a cloud or grid.
pub(super) struct Input<'a> {
    /// Whether there is an attribute of a name.
    pub(super) has: &'a dyn Fn(&str) -> bool,
    /// Which attributes there are, in words.
    pub(super) stored: &'a str,
    /// The values of an attribute in ascending order, or of `density`; `None` if they are not
    /// known.
    pub(super) sorted: &'a dyn Fn(&str) -> Option<Vec<f64>>,
    /// Whether the density is shown over its logarithm by default.
    pub(super) logarithmic: bool,
}

impl Input<'_> {
    /// The values of an attribute, or of the density, in ascending order; for a logarithm those
    /// above 0.
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
    color.is_array() || color.as_str().is_some_and(|name| name.parse::<NamedPalette>().is_ok())
}

impl Style {
    /// Whether the colours that a look would show give way to others.
    pub(super) fn recolors(&self) -> bool {
        self.color.is_some() || self.colormap.is_some() || self.color_by.is_some()
    }

    /// Sets the samples and the exposure of a scene to which everything else has been applied.
    /// `automatic` is the exposure if none is asked for. The background is a colour of the display:
    /// it looks the same under any exposure.
    pub(super) fn apply_image(&self, scene: &mut Value, automatic: f64) {
        if let Some(samples) = self.samples {
            scene["image"]["samples"] = Rays.json(&samples);
        }
        if let Some(lod) = self.lod {
            scene["rendering"]["lod"] = Detail.json(&lod);
        }
        expose(scene, self.exposure.unwrap_or(automatic));
    }

    /// Puts the options that were given in the place of what a scene of one cloud or grid says.
    pub(super) fn apply(&self, scene: &mut Value, input: &Input<'_>) -> Result<()> {
        let transfer = &mut scene["root"]["transferFunction"];
        if let Some(opacity) = &self.opacity {
            transfer["opacity"] = opacity_value(opacity);
        }
        if let Some(color) = self.color {
            transfer["color"] = json!(color.to_string());
            remove(transfer, &["input", "valueRange"]);
        }
        if self.colormap.is_some() || self.color_by.is_some() {
            let map = self.colormap.map_or_else(|| "viridis".to_owned(), |map| map.to_string());
            // Other colours for what the look shows already, if it shows anything in colours of a
            // map.
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
        if let Some(filter) = self.splat_filter {
            if root["kernel"] != Kernel::Splat.name() {
                bail!("--splat-filter is for Gaussian splats: for the kernel `splat`");
            }
            root["splatFilter"] = json!(filter.to_string());
        }
        if self.normalised.is_some() {
            root["normalised"] = json!(true);
        }
        if let Some(scale) = self.radius_scale {
            if root["type"] != "cloud" {
                bail!("--radius-scale is for points; the input has voxels");
            }
            root["radiusScale"] = json!(scale);
        }
        match self.shading {
            Some(Shading::None) => scene["lights"] = json!("none"),
            Some(Shading::Headlight) => remove(scene, &["lights"]),
            None => {}
        }
        match self.background {
            Some(Background::Transparent) => remove(scene, &["background"]),
            Some(Background::Color(color)) => scene["background"] = json!(color.to_string()),
            None => {}
        }
        self.apply_rendering(&mut scene["rendering"]);
        Ok(())
    }

    /// The range of the colour map, and its logarithm.
    fn apply_range(&self, transfer: &mut Value, input: &Input<'_>) -> Result<()> {
        let shown = transfer["input"].as_str().unwrap_or("density").to_owned();
        // The map of gas is over the logarithm already: it is made anew for other colours, or
        // another range.
        let of_gas = input.logarithmic && shown == "density" && self.color.is_none();
        if of_gas && self.colormap.is_none() {
            if self.value_range.is_none() {
                return Ok(());
            }
            transfer["color"] = json!("inferno");
        }
        let logarithmic =
            self.log.is_some() || of_gas && (self.colormap.is_some() || self.value_range.is_some());
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

    fn apply_rendering(&self, rendering: &mut Value) {
        if let Some(unit) = self.unit_distance {
            rendering["unitDistance"] = json!(unit);
        }
        if let Some(StepLength::Length(step)) = self.step {
            rendering["step"] = json!(step);
        }
        if let Some(fraction) = self.step_fraction {
            rendering["stepFraction"] = json!(fraction);
        }
        if let Some(phase) = self.phase {
            rendering["phase"] = json!(if phase == Phase::Half { "half" } else { "hashed" });
        }
        if let Some(compositing) = self.compositing {
            let is_linear = compositing == Compositing::Linear;
            rendering["compositing"] = json!(if is_linear { "linear" } else { "display" });
            // What the look would have goes where it does not go with what is asked for.
            if !is_linear && self.ambient_occlusion.is_none() {
                remove(rendering, &["ambientOcclusion"]);
            }
        } else if self.ambient_occlusion.is_some_and(|strength| strength > 0.0) {
            remove(rendering, &["compositing"]);
        }
        if let Some(occlusion) = self.ambient_occlusion {
            rendering["ambientOcclusion"] = json!(occlusion);
        }
        if let Some(stop) = self.stop {
            rendering["stopTransmittance"] = json!(stop);
        }
    }
}

fn remove(object: &mut Value, keys: &[&str]) {
    if let Some(object) = object.as_object_mut() {
        keys.iter().for_each(|key| drop(object.remove(*key)));
    }
}

/// An opacity rule as a scene file writes it.
fn opacity_value(rule: &OpacityRule) -> Value {
    match rule {
        OpacityRule::Extinction(kappa) => json!({"extinction": kappa}),
        OpacityRule::Curve(points) => points.iter().map(|&(d, o)| json!([d, o])).collect::<Vec<_>>().into(),
        _ => json!("clamp"),
    }
}

/// Gives a scene that was chosen another exposure, in stops, under which its background looks the
/// same.
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
