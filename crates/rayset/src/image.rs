//! Pictures: bands of rows in linear light, and writers for PNG and for OpenEXR with layers.

#[cfg(feature = "exr")]
pub use rayset_render::image::ExrBands;
#[cfg(feature = "internals")]
#[doc(hidden)]
pub use rayset_render::image::*;
pub use rayset_render::image::{Band, DisplayTransform, ImageError, LayerPixel, PngBands, ToneMapping};
