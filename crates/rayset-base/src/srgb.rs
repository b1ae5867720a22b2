//! Values of displays and linear light (sRGB, IEC 61966-2-1).

/// Decodes a display-encoded value from 0 to 1 to linear light.
#[must_use]
pub fn linear_from_srgb(v: f64) -> f64 {
    if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
}

/// Encodes linear light from 0 to 1 for display.
#[must_use]
pub fn srgb_from_linear(v: f64) -> f64 {
    if v <= 0.003_130_8 { v * 12.92 } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 }
}
