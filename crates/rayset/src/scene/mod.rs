//! What is to be seen, and what of it decides pixels: a cloud as a volume object, a camera, a transfer function, and the
//! settings of the picture.
//!
//! Nothing here says how the work is done; threads, memory and input are the business of `trace`.

mod camera;
mod colormap;
mod transfer;

use std::sync::Arc;

pub(crate) use camera::RayMaker;
pub use camera::{Camera, CameraError, Projection};
pub use colormap::{Colormap, UnknownColormap};
pub use transfer::{ColorRule, MAX_OPACITY, MapInput, OpacityRule, TransferError, TransferFunction};

use crate::field::{AttributeSource, Kernel};
use crate::octree::Cloud;

/// A cloud seen as a volume object, and how it is lit.
#[derive(Clone, Debug)]
pub struct Scene {
    /// The cloud.
    pub cloud: Arc<Cloud>,
    /// Its radial basis function.
    pub kernel: Kernel,
    /// Whether kernels integrate to one, so that weight = mass (or mass·value/density) as in SPH.
    pub normalised: bool,
    /// Opacity and colour from density and attributes.
    pub transfer: TransferFunction,
    /// Light.
    pub shading: Shading,
    /// Colour behind everything, in linear light; `None` leaves the picture transparent there.
    pub background: Option<[f32; 3]>,
}

/// How samples are lit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Shading {
    /// Not at all: samples have the colour of the transfer function.
    None,
    /// By a light at the eye, two-sided, from the gradient of the density.
    #[default]
    Headlight,
}

/// Parts of a headlight's shading; with |cos| the cosine between normal and ray.
pub mod headlight {
    /// Always there.
    pub const AMBIENT: f32 = 0.25;
    /// Times |cos|.
    pub const DIFFUSE: f32 = 0.75;
    /// White, times |cos|³².
    pub const SPECULAR: f32 = 0.10;
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

impl Scene {
    /// Checks that the cloud has the columns that the transfer function reads.
    ///
    /// # Errors
    /// [`TransferError::Missing`] where it has not.
    pub fn check_channels(&self) -> Result<(), TransferError> {
        let header = self.cloud.header();
        match self.attribute_source() {
            AttributeSource::Color if !header.has_color => Err(TransferError::Missing("colours")),
            AttributeSource::Scalar(i) if i >= header.attributes.len() => {
                Err(TransferError::Missing("such attribute"))
            }
            _ => Ok(()),
        }
    }

    /// What attribute channels the field has to carry.
    #[must_use]
    pub fn attribute_source(&self) -> AttributeSource {
        match &self.transfer.color {
            ColorRule::Points => AttributeSource::Color,
            ColorRule::Map { input: MapInput::Attribute(index), .. } => AttributeSource::Scalar(*index),
            ColorRule::Map { .. } | ColorRule::Uniform(_) => AttributeSource::None,
        }
    }
}
