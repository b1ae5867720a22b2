//! Converts linear light to display values: exposure and tone mapping.

use crate::field::linear_from_srgb;
pub use rayset_base::srgb::srgb_from_linear;

/// How linear light is mapped to the range of a display.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum ToneMapping {
    /// No mapping: values above 1 are clipped when the picture is encoded.
    #[default]
    None,
    /// A filmic curve that compresses highlights: Narkowicz's fit (2015) of the ACES curve.
    Filmic,
}

/// Exposure and tone mapping for pictures that are meant for display. OpenEXR files hold linear
/// light, without it.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct DisplayTransform {
    /// Exposure in stops: light is multiplied by two to this power.
    pub exposure: f64,
    /// Tone mapping, applied after the exposure.
    pub tone_mapping: ToneMapping,
}

impl DisplayTransform {
    /// Converts a display-encoded sRGB colour, as used by screens and painting programs, to linear
    /// light; 0 to 1.
    #[must_use]
    pub fn linear_from_srgb(color: [f64; 3]) -> [f32; 3] {
        color.map(|v| linear_from_srgb(v) as f32)
    }

    /// What encodes pixels as PNG files have them: of linear light, premultiplied with the opacity,
    /// makes 8-bit sRGB with straight alpha.
    pub fn rgba8(&self) -> impl Fn([f32; 4]) -> [u8; 4] + Send + Sync + use<> {
        let encoder = Rgba8::new(*self);
        move |pixel| encoder.encode(pixel)
    }

    /// Applies exposure and tone mapping to a component of straight (not premultiplied) colour; the
    /// result is still linear.
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

/// Entries of the table from linear light to bytes. Near black, one entry is a fifth of a byte
/// step.
const TABLE: usize = 1 << 14;

/// Encodes pixels for screens.
pub(super) struct Rgba8 {
    table: Vec<u8>,
    display_transform: DisplayTransform,
}

impl Rgba8 {
    pub(super) fn new(display_transform: DisplayTransform) -> Self {
        let byte = |i| (srgb_from_linear(i as f64 / (TABLE - 1) as f64) * 255.0).round() as u8;
        Self { table: (0..TABLE).map(byte).collect(), display_transform }
    }

    /// Encodes a pixel of linear light, premultiplied with its opacity.
    pub(super) fn encode(&self, [r, g, b, opacity]: [f32; 4]) -> [u8; 4] {
        let straight = if opacity > 0.0 { 1.0 / opacity } else { 0.0 };
        // A component that is NaN becomes 0 in the cast.
        let byte = |v: f32| {
            let shown = self.display_transform.apply(v * straight).clamp(0.0, 1.0);
            self.table[(shown * (TABLE - 1) as f32).round() as usize]
        };
        [byte(r), byte(g), byte(b), (opacity.clamp(0.0, 1.0) * 255.0).round() as u8]
    }
}
