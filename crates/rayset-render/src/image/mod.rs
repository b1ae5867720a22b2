//! Pictures: bands of rows in linear light, and writers for PNG and for OpenEXR with layers.

mod display;
mod error;
#[cfg(feature = "exr")]
mod exr_out;
mod png_out;

pub use display::srgb_from_linear;
pub use display::{DisplayTransform, ToneMapping};
pub use error::ImageError;
#[cfg(feature = "exr")]
pub use exr_out::ExrBands;
pub use png_out::PngBands;

/// Rows of a picture: premultiplied colour and opacity, in linear light.
#[derive(Clone, Debug, PartialEq)]
pub struct Band {
    /// Number of the first row, counted from the top of the whole picture (also if only a region of
    /// it is rendered).
    pub first_row: u32,
    /// Width in pixels.
    pub width: u32,
    /// Pixels row by row: red, green, blue (premultiplied, linear light) and opacity.
    pub pixels: Vec<[f32; 4]>,
    /// Layers of each pixel if requested, otherwise empty.
    pub layers: Vec<LayerPixel>,
}

/// Layers of a pixel besides its colour. They describe what its rays meet before they are reflected
/// or refracted.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(not(feature = "internals"), non_exhaustive)]
pub struct LayerPixel {
    /// Fraction of the background that is hidden, 0 to 1.
    pub opacity: f32,
    /// Mean distance from the eye, with samples weighted by their contribution to the pixel;
    /// infinite if there are none.
    pub depth: f32,
    /// Mean shading vector, world space, of length one or zero.
    pub normal: [f32; 3],
    /// Mean colour without lighting, linear light.
    pub albedo: [f32; 3],
    /// The leaf whose sample contributes most, counted from 1 in the order of the graph; 0 if there
    /// is none.
    pub instance: u32,
    /// Number of samples that are not transparent.
    pub samples: u32,
    /// Bytes of the pages requested for the pixel's tile, divided by the number of pixels of the
    /// tile; those for tables of shadows are not counted. This describes how the work was done, and
    /// is the only value of a picture that may depend on it: on how the picture is divided into
    /// tiles.
    pub bytes: f32,
    /// By how much the opacity differs at most from that by many rays because of what is seen from
    /// afar: an estimate, which holds in 95 of 100 pixels. 0 where nothing is seen so.
    pub lod_error: f32,
}

impl Default for LayerPixel {
    /// An empty pixel.
    fn default() -> Self {
        let (depth, normal, albedo) = (f32::INFINITY, [0.0; 3], [0.0; 3]);
        Self { opacity: 0.0, depth, normal, albedo, instance: 0, samples: 0, bytes: 0.0, lod_error: 0.0 }
    }
}

impl Band {
    /// A transparent band, with or without layers.
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

    /// A pixel, by its position in the whole picture. Panics if the pixel lies in another band.
    #[must_use]
    pub fn pixel(&self, x: u32, y: u32) -> [f32; 4] {
        self.pixels[(y - self.first_row) as usize * self.width as usize + x as usize]
    }
}
