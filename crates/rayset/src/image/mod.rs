//! Pictures: bands of rows in linear light; PNG, and OpenEXR with layers.

mod display;
#[cfg(feature = "exr")]
mod exr_out;
mod png_out;

#[cfg(feature = "internals")]
#[doc(hidden)]
pub use display::srgb_from_linear;
#[cfg(not(feature = "internals"))]
pub(crate) use display::srgb_from_linear;
pub use display::{DisplayTransform, ToneMapping};
#[cfg(feature = "exr")]
pub use exr_out::{ExrBands, ExrError};
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
    /// What else is known of each pixel, where it was asked for; else empty.
    pub layers: Vec<LayerPixel>,
}

/// What is known of a pixel besides its colour: of what its rays meet before they are reflected or bent.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(not(feature = "internals"), non_exhaustive)]
pub struct LayerPixel {
    /// What of the background is hidden, 0 to 1.
    pub opacity: f32,
    /// Mean distance from the eye, each sample weighted by what it adds to the pixel; infinite where there is nothing.
    pub depth: f32,
    /// Mean shading vector, world space, of length one or zero.
    pub normal: [f32; 3],
    /// Mean colour before light, linear.
    pub albedo: [f32; 3],
    /// The leaf whose sample adds most, counted from 1 in the order of the graph; 0 where there is nothing.
    pub instance: u32,
    /// Samples that were not transparent.
    pub samples: u32,
    /// Bytes of pages that were asked for on behalf of the pixel's tile, over the tile's pixels. It says how the work went,
    /// and is the one number of a picture that may differ with the way it is done.
    pub bytes: f32,
}

impl Default for LayerPixel {
    /// Nothing.
    fn default() -> Self {
        let (depth, normal, albedo) = (f32::INFINITY, [0.0; 3], [0.0; 3]);
        Self { opacity: 0.0, depth, normal, albedo, instance: 0, samples: 0, bytes: 0.0 }
    }
}

impl Band {
    /// A transparent band.
    #[must_use]
    pub fn new(first_row: u32, width: u32, rows: u32, layers: bool) -> Self {
        let pixels = width as usize * rows as usize;
        let layers = vec![LayerPixel::default(); if layers { pixels } else { 0 }];
        Self { first_row, width, pixels: vec![[0.0; 4]; pixels], layers }
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
