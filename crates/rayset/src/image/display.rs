//! From light to the numbers of a picture: exposure and tone mapping.

use crate::field::linear_from_srgb;

/// How bright light becomes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum ToneMapping {
    /// Up to 1 as it is; what is brighter is white.
    #[default]
    None,
    /// Like film: highlights are compressed. The fit of the ACES curve by Narkowicz (2015).
    Filmic,
}

/// Exposure and tone mapping, for pictures that are to be looked at. Files of light (OpenEXR) are written without it.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct DisplayTransform {
    /// Stops: light is multiplied by two to this power.
    pub exposure: f64,
    /// What follows.
    pub tone_mapping: ToneMapping,
}

impl DisplayTransform {
    /// Linear light of a colour as screens and painting programs say it: red, green and blue of sRGB, 0 to 1.
    #[must_use]
    pub fn linear_from_srgb(color: [f64; 3]) -> [f32; 3] {
        color.map(|v| linear_from_srgb(v) as f32)
    }

    /// A value of straight (not premultiplied) linear light as the picture shows it, still linear.
    #[must_use]
    pub fn apply(&self, light: f32) -> f32 {
        let x = light * self.exposure.exp2() as f32;
        match self.tone_mapping {
            ToneMapping::None => x,
            ToneMapping::Filmic => {
                let x = x.max(0.0);
                x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14)
            }
        }
    }
}

/// Encodes linear light for display (IEC 61966-2-1), 0 to 1.
#[must_use]
pub fn srgb_from_linear(v: f64) -> f64 {
    if v <= 0.003_130_8 { v * 12.92 } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 }
}
