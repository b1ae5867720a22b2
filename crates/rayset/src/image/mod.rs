//! Pictures: bands of rows in linear light, and PNG.

mod develop;
mod png_out;

pub use develop::{Development, ToneMapping};
pub use png_out::{PngBands, PngError};

/// Rows of a picture: premultiplied colour and opacity in linear light.
#[derive(Clone, Debug, PartialEq)]
pub struct Band {
    /// Number of the first row.
    pub first_row: u32,
    /// Pixels across.
    pub width: u32,
    /// Pixels, row after row: red, green, blue (premultiplied, linear light) and opacity.
    pub pixels: Vec<[f32; 4]>,
}

impl Band {
    /// A transparent band.
    #[must_use]
    pub fn new(first_row: u32, width: u32, rows: u32) -> Self {
        Self { first_row, width, pixels: vec![[0.0; 4]; width as usize * rows as usize] }
    }

    /// Number of rows.
    #[must_use]
    pub fn rows(&self) -> u32 {
        (self.pixels.len() / self.width.max(1) as usize) as u32
    }

    /// A pixel, by its place in the whole picture. Panics where it lies in another band.
    #[must_use]
    pub fn pixel(&self, x: u32, y: u32) -> [f32; 4] {
        self.pixels[(y - self.first_row) as usize * self.width as usize + x as usize]
    }
}

/// Encodes linear light for display (IEC 61966-2-1), 0 to 1.
#[must_use]
pub fn srgb_from_linear(v: f64) -> f64 {
    if v <= 0.003_130_8 { v * 12.92 } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 }
}
