//! What is to be seen, and what of it decides pixels: a volume scene graph, lights, a camera, and the settings of the
//! picture.
//!
//! Nothing here says how the work is done; threads, memory and input are the business of `trace`.

mod camera;
mod colormap;
mod error;
mod graph;
mod light;
mod material;
mod noise;
mod path;
mod procedural;
mod solid;
mod transfer;

use std::sync::Arc;

pub use crate::field::Kernel;
use crate::geometry::Aabb;
use crate::setters::setters;

pub(crate) use camera::RayMaker;
pub use camera::{Camera, CameraError, Projection};
pub use colormap::Colormap;
pub use error::{MOST_ATTRIBUTES, SceneError};
pub(crate) use graph::check_transform;
#[cfg(feature = "internals")]
#[doc(hidden)]
pub use graph::largest_stretch;
#[cfg(not(feature = "internals"))]
pub(crate) use graph::largest_stretch;
pub use graph::{
    Channel, CloudObject, GRID_ATTRIBUTE, GridObject, MOST_PLACES, Node, Operator, Shape, Transfer,
};
pub use light::{Light, LightKind, Lighting};
pub use material::Material;
pub use noise::NoiseCloud;
pub use path::{CameraPath, PathError};
pub use procedural::{Pattern, Procedural, ProceduralSample};
pub use solid::{Form, Solid};
pub use transfer::{
    ColorMap, ColorRule, MAX_OPACITY, MapInput, OpacityRule, Palette, TransferError, TransferFunction,
};
#[cfg(feature = "internals")]
#[doc(hidden)]
pub use transfer::{curve_at, max_extinction};
#[cfg(not(feature = "internals"))]
pub(crate) use transfer::{curve_at, max_extinction};

/// Coordinates and lengths reach this far.
pub const FARTHEST: f64 = 1e18;
/// Lengths and directions are at least so long.
pub const SHORTEST: f64 = 1e-18;
/// Most stops of a colour map, and points of a curve in a scene file.
pub const MOST_STOPS: usize = 4096;
/// The brightest colour or light, in any channel.
pub const BRIGHTEST: f64 = 1e12;
/// What solids, noise and grids hold that is finer than this part of the diagonal of them all is not sampled more finely:
/// thin things are missed rather than waited for.
pub const FINEST_DETAIL: f64 = 1.0 / (1 << 14) as f64;
/// Most samples of a ray along that diagonal, however fine a cloud in it is.
pub const MOST_STEPS_IN_SOLIDS: f64 = (1_u64 << 20) as f64;
/// Most samples along the diagonal of a scene: few enough to be counted exactly. What is empty is passed over.
pub const MOST_STEPS: f64 = (1_u64 << 40) as f64;

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
        if !(SHORTEST..=FARTHEST).contains(&self.unit_distance) {
            return Err(SceneError::UnitDistance);
        }
        self.root.check()?;
        self.lighting.check()?;
        if let Some(&value) =
            self.background.iter().flatten().find(|v| !(0.0..=BRIGHTEST as f32).contains(*v))
        {
            let (what, value) = ("background", f64::from(value));
            return Err(SceneError::Number { what, value, expected: "0 to 1e12" });
        }
        let bounds = self.root.bounds();
        if bounds.is_empty() {
            return Ok(());
        }
        if !bounds.size().is_finite() {
            return Err(SceneError::Unbounded);
        }
        // A little more than coordinates: what stands at the farthest place may have an extent.
        let farthest = bounds.min.abs().max(bounds.max.abs()).max_element();
        if farthest > 10.0 * FARTHEST {
            let what = "the farthest coordinate of the scene";
            return Err(SceneError::Number { what, value: farthest, expected: "at most 1e19" });
        }
        let extent = bounds.size().max_element();
        if extent < SHORTEST {
            let what = "the extent of the scene";
            return Err(SceneError::Number { what, value: extent, expected: "at least 1e-18" });
        }
        Ok(())
    }

    /// Checks a distance between samples: it must leave few enough of them on a ray to be counted, and in solids, noise
    /// and grids, where every one of them is evaluated, few enough to wait for.
    ///
    /// # Errors
    /// [`SceneError::Step`] that says what would do, or [`SceneError::Number`].
    pub fn check_step(&self, step: Step) -> Result<(), SceneError> {
        let step = match step {
            Step::Automatic { fraction } if (1e-3..=4.0).contains(&fraction) => return Ok(()),
            Step::Automatic { fraction: value } => {
                return Err(SceneError::Number { what: "the step fraction", value, expected: "0.001 to 4" });
            }
            Step::Fixed(step) => step,
        };
        if !(SHORTEST..=FARTHEST).contains(&step) {
            return Err(SceneError::Number { what: "the step", value: step, expected: "1e-18 to 1e18" });
        }
        let diagonal = |bounds: Aabb| if bounds.is_empty() { 0.0 } else { bounds.size().length() };
        let least = (diagonal(self.root.bounds()) / MOST_STEPS)
            .max(diagonal(self.root.bounds_of_solids()) / MOST_STEPS_IN_SOLIDS);
        if step < least { Err(SceneError::Step { step, least }) } else { Ok(()) }
    }
}

/// Distance between samples.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
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
#[non_exhaustive]
pub enum SampleOffset {
    /// Half a step from the origin, on every ray.
    #[default]
    Half,
    /// A fraction of a step that is a hash of the pixel: turns bands into noise.
    Hashed,
}

/// Where in a pixel its rays go.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Sampling {
    /// Through the middles of a lattice.
    #[default]
    Fixed,
    /// Through a place in each cell of the lattice that is a hash of pixel and cell: turns steps at edges into noise.
    Stratified,
}

/// How it is found what of a light reaches a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Shadows {
    /// By a ray from the sample to the light: the reference.
    Exact,
    /// From tables of the light's own rays.
    Cached {
        /// Rays of a light along each side of what it lights.
        resolution: u32,
    },
}

/// What decides pixels besides the scene and the camera.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(not(feature = "internals"), non_exhaustive)]
pub struct RenderSettings {
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
    /// Distance between samples.
    pub step: Step,
    /// Beginning of the samples of a ray.
    pub sample_offset: SampleOffset,
    /// A ray ends at its first sample behind which less than this is seen. 0: rays go on to the end.
    pub stop_transmittance: f32,
    /// Rays through a pixel are this number squared.
    pub samples: u32,
    /// And go there.
    pub sampling: Sampling,
    /// Shadows.
    pub shadows: Shadows,
    /// How often the light of a ray is followed on where it is reflected or refracted.
    pub max_depth: u32,
    /// Whether depth, shading vectors and the like are found besides colours.
    pub layers: bool,
}

impl Default for RenderSettings {
    fn default() -> Self {
        Self {
            width: 512,
            height: 512,
            step: Step::default(),
            sample_offset: SampleOffset::Half,
            stop_transmittance: 0.01,
            samples: 1,
            sampling: Sampling::Fixed,
            shadows: Shadows::Exact,
            max_depth: 4,
            layers: false,
        }
    }
}

setters!(RenderSettings {
    with_step => step: Step,
    with_sample_offset => sample_offset: SampleOffset,
    with_stop_transmittance => stop_transmittance: f32,
    with_samples => samples: u32,
    with_sampling => sampling: Sampling,
    with_shadows => shadows: Shadows,
    with_max_depth => max_depth: u32,
    with_layers => layers: bool,
});

impl RenderSettings {
    /// Sets the size of the picture in pixels.
    #[must_use]
    pub fn with_size(self, width: u32, height: u32) -> Self {
        Self { width, height, ..self }
    }

    /// The sample offset, in steps, of the ray through a pixel, or through a cell of a pixel where there are several: then cells are counted.
    #[must_use]
    pub fn sample_offset_of(&self, x: u32, y: u32) -> f64 {
        match self.sample_offset {
            SampleOffset::Half => 0.5,
            SampleOffset::Hashed => hash(x, y, 0),
        }
    }

    /// Where a ray goes through the picture, in pixels: the one through cell (`i`, `j`) of pixel (`x`, `y`).
    #[must_use]
    pub fn ray_place(&self, x: u32, y: u32, i: u32, j: u32) -> (f64, f64) {
        let cells = f64::from(self.samples);
        let (u, v) = match self.sampling {
            Sampling::Fixed => (0.5, 0.5),
            Sampling::Stratified => {
                let (column, row) = (x * self.samples + i, y * self.samples + j);
                (hash(column, row, 1), hash(column, row, 2))
            }
        };
        (f64::from(x) + (f64::from(i) + u) / cells, f64::from(y) + (f64::from(j) + v) / cells)
    }
}

/// A number from 0 to 1 that looks random: two rounds of a multiplicative hash (splitmix64's finaliser).
fn hash(x: u32, y: u32, stream: u64) -> f64 {
    let mut z = (u64::from(y) << 32 | u64::from(x)).wrapping_add(stream.wrapping_mul(0xd1b5_4a32_d192_ed03));
    z = (z ^ z >> 30).wrapping_add(0x9e37_79b9_7f4a_7c15).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((z ^ z >> 31) >> 40) as f64 / f64::from(1 << 24)
}
