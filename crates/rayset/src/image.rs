//! Pictures: bands of rows in linear light, and writers for PNG and for OpenEXR with layers.

#[cfg(feature = "internals")]
#[doc(hidden)]
pub use rayset_render::image::*;
pub use rayset_render::image::{Band, DisplayTransform, LayerPixel, PngBands, PngError, ToneMapping};
#[cfg(feature = "exr")]
pub use rayset_render::image::{ExrBands, ExrError};
