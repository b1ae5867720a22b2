//! What is to be seen, and what of it decides pixels: a volume scene graph, lights, a camera, and the settings of the
//! picture.
//!
//! Nothing here says how the work is done; threads, memory and input are the business of `trace`.

mod camera;
mod colormap;
mod graph;
mod light;
mod material;
mod noise;
mod procedural;
mod solid;
mod transfer;

use std::sync::Arc;

pub(crate) use camera::RayMaker;
pub use camera::{Camera, CameraError, Projection};
pub use colormap::{Colormap, UnknownColormap};
pub use graph::{Channel, CloudObject, Node, Operator, SceneError, Shape, Transfer, largest_stretch};
pub use light::{Light, LightKind, Lighting};
pub use material::Material;
pub use noise::NoiseCloud;
pub use procedural::{Pattern, Procedural, ProceduralSample};
pub use solid::{Form, Solid};
pub use transfer::{
    ColorMap, ColorRule, MAX_OPACITY, MapInput, OpacityRule, Palette, TransferError, TransferFunction,
    curve_at, max_extinction,
};

/// A volume scene graph, and how it is lit.
#[derive(Clone, Debug)]
pub struct Scene {
    /// The graph.
    pub root: Arc<Node>,
    /// Light.
    pub lighting: Lighting,
    /// Colour behind everything, in linear light; `None` leaves the picture transparent there.
    pub background: Option<[f32; 3]>,
    /// The length that every opacity refers to, world space.
    pub unit_distance: f64,
}

impl Scene {
    /// A single cloud, where its file has it, lit by a headlight. Opacity refers to its mean radius.
    #[must_use]
    pub fn of_cloud(object: CloudObject) -> Self {
        let unit_distance = object.cloud.header().radius_mean;
        Self {
            root: Arc::new(Node::new(Shape::Cloud(object))),
            lighting: Lighting::headlight(),
            background: None,
            unit_distance,
        }
    }

    /// Checks everything that can be known before rays are traced.
    ///
    /// # Errors
    /// [`SceneError`] that says what is wrong.
    pub fn check(&self) -> Result<(), SceneError> {
        if !(self.unit_distance > 0.0 && self.unit_distance.is_finite()) {
            return Err(SceneError::UnitDistance);
        }
        self.root.check()?;
        self.lighting.check()?;
        let bounds = self.root.bounds();
        if bounds.is_empty() || bounds.size().is_finite() { Ok(()) } else { Err(SceneError::Unbounded) }
    }
}

/// Distance between samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Step {
    /// The same on every ray, world space.
    Fixed(f64),
    /// For each ray the largest `fraction · r_max · 2^k`, k a whole number, that is at most `fraction` of the
    /// smallest radius whose bounds the ray meets.
    Automatic {
        /// Part of a radius.
        fraction: f64,
    },
}

impl Default for Step {
    /// A quarter of a radius.
    fn default() -> Self {
        Self::Automatic { fraction: 0.25 }
    }
}

/// Where the lattice of samples of a ray begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Phase {
    /// Half a step from the origin, on every ray.
    #[default]
    Half,
    /// A fraction of a step that is a hash of the pixel: turns bands into noise.
    Hashed,
}

/// What decides pixels besides the scene and the camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RenderSettings {
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
    /// Distance between samples.
    pub step: Step,
    /// Beginning of the samples of a ray.
    pub phase: Phase,
    /// A ray ends at its first sample behind which less than this is seen. 0: rays go on to the end.
    pub stop_transmittance: f32,
}

impl Default for RenderSettings {
    fn default() -> Self {
        Self { width: 512, height: 512, step: Step::default(), phase: Phase::Half, stop_transmittance: 0.01 }
    }
}

impl RenderSettings {
    /// ξ of the ray through a pixel.
    #[must_use]
    pub fn phase_of(&self, x: u32, y: u32) -> f64 {
        match self.phase {
            Phase::Half => 0.5,
            Phase::Hashed => {
                // Two rounds of a multiplicative hash (splitmix64's finaliser) of the pixel's number.
                let mut z = u64::from(y) << 32 | u64::from(x);
                z = (z ^ z >> 30).wrapping_add(0x9e37_79b9_7f4a_7c15).wrapping_mul(0xbf58_476d_1ce4_e5b9);
                z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
                ((z ^ z >> 31) >> 40) as f64 / f64::from(1 << 24)
            }
        }
    }
}
