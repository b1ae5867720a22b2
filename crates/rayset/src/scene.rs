//! Scene description: the volume scene graph, lights, the camera, and the settings that determine
//! the pixels of the picture.
//!
//! Nothing here says how the work is done: threads, memory and input are those of a
//! [`Session`](crate::Session).

pub use rayset_render::field::{Kernel, SplatFilter};
#[cfg(feature = "internals")]
#[doc(hidden)]
pub use rayset_render::scene::*;
pub use rayset_render::scene::{
    BRIGHTEST, Camera, CameraError, CameraPath, Channel, CloudObject, ColorMap, ColorRule, Compositing,
    FARTHEST, FINEST_DETAIL, Form, GRID_ATTRIBUTE, GridObject, Light, LightKind, Lighting, Lod, MAX_OPACITY,
    MOST_ATTRIBUTES, MOST_PLACES, MOST_STEPS, MOST_STEPS_IN_SOLIDS, MOST_STOPS, MapInput, Material,
    NamedPalette, Node, NoiseCloud, OpacityRule, Operator, Palette, PathError, Pattern, Procedural,
    ProceduralSample, Projection, RenderSettings, SHORTEST, SampleOffset, Samples, Sampling, Scene,
    SceneError, Shadows, Shape, Solid, Step, Transfer, TransferError, TransferFunction,
};
