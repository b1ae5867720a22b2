//! Scene description: the volume scene graph, lights, the camera, and the settings that determine
//! the pixels of the picture.
//!
//! Nothing here says how the work is done: threads, memory and input are handled by `trace`.

mod bytes;
mod camera;
mod colormap;
mod compositing;
mod error;
mod graph;
mod light;
mod material;
mod noise;
mod path;
mod procedural;
mod solid;
mod transfer;
mod transform;

use std::sync::Arc;

pub use crate::field::{Kernel, SplatFilter};
use rayset_base::geometry::Aabb;
use rayset_base::setters;

pub use camera::{Camera, CameraError, Projection};
pub(crate) use camera::{Footprint, RayMaker};
pub use colormap::NamedPalette;
pub use compositing::Compositing;
pub use error::{MOST_ATTRIBUTES, SceneError};
pub use graph::{
    Channel, CloudObject, GRID_ATTRIBUTE, GridObject, MOST_PLACES, Node, Operator, Shape, Transfer,
};
pub use light::{Light, LightKind, Lighting};
pub use material::Material;
pub use noise::NoiseCloud;
pub use path::{CameraPath, PathError};
pub use procedural::{Pattern, Procedural, ProceduralSample};
pub use solid::{Form, Solid};
pub(crate) use transfer::SOLID_OPACITY;
pub use transfer::{
    ColorMap, ColorRule, MAX_OPACITY, MapInput, OpacityRule, Palette, TransferError, TransferFunction,
};
pub use transfer::{curve_at, max_extinction};
pub(crate) use transform::check_transform;
pub use transform::largest_stretch;

/// Largest absolute value of coordinates and lengths.
pub const FARTHEST: f64 = 1e18;
/// Smallest length, of distances and of direction vectors.
pub const SHORTEST: f64 = 1e-18;
/// Most stops of a colour map, and most points of a curve in a scene file.
pub const MOST_STOPS: usize = 4096;
/// Largest value of any channel of a colour or light.
pub const BRIGHTEST: f64 = 1e12;
/// Features of solids, noise and grids smaller than this fraction of the diagonal of their common
/// bounds do not reduce the step further: thin features may be missed, but rendering time stays
/// bounded.
pub const FINEST_DETAIL: f64 = 1.0 / (1 << 14) as f64;
/// Most samples of a ray along that diagonal, however fine a cloud within it is.
pub const MOST_STEPS_IN_SOLIDS: f64 = (1_u64 << 20) as f64;
/// Most samples along the diagonal of a scene, few enough to be counted exactly. Empty space is
/// skipped.
pub const MOST_STEPS: f64 = (1_u64 << 40) as f64;

/// A volume scene graph, and how it is lit.
#[derive(Clone, Debug)]
pub struct Scene {
    /// The graph.
    pub root: Arc<Node>,
    /// The lighting.
    pub lighting: Lighting,
    /// Background colour in linear light; if `None`, the background of the picture is transparent.
    pub background: Option<[f32; 3]>,
    /// The length that all opacities refer to, world space.
    pub unit_distance: f64,
    /// In which values light is added up along rays.
    pub compositing: Compositing,
}

impl Scene {
    /// A scene of a single cloud in its original position, lit by a headlight. The unit distance is
    /// the mean radius of its points.
    #[must_use]
    pub fn of_cloud(object: CloudObject) -> Self {
        let unit_distance = object.cloud.header().radius_mean;
        Self {
            root: Arc::new(Node::new(Shape::Cloud(object))),
            lighting: Lighting::headlight(),
            background: None,
            unit_distance,
            compositing: Compositing::Linear,
        }
    }

    /// Checks everything that can be checked before rays are traced.
    ///
    /// # Errors
    /// [`SceneError`] if the graph, the lights, the background, the unit distance or the extent of
    /// the scene is invalid.
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
        // The limit is somewhat larger than that of coordinates: an object at the farthest position
        // may have an extent.
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

    /// Checks that the values in which light is added up go with the materials and settings.
    ///
    /// # Errors
    /// [`SceneError::Compositing`] if they do not.
    pub(crate) fn check_compositing(&self, settings: &RenderSettings) -> Result<(), SceneError> {
        if self.compositing == Compositing::Linear {
            return Ok(());
        }
        let (mut reflects, mut refracts) = (false, false);
        self.root.for_each(&mut |node: &Node| {
            let material = node.material.unwrap_or_default();
            reflects |= material.reflectance > 0.0;
            refracts |= material.refractive_index != 1.0;
        });
        let follows_rays = settings.max_depth > 0 && self.lighting != Lighting::Unlit;
        let what = match (reflects && follows_rays, refracts && follows_rays) {
            (true, _) => "reflectance",
            (_, true) => "refraction",
            _ if settings.ambient_occlusion > 0.0 => "ambient occlusion",
            _ => return Ok(()),
        };
        Err(SceneError::Compositing { what })
    }

    /// Checks a distance between samples: along a ray there must be few enough samples to be
    /// counted exactly, and in solids, noise and grids, where every sample is evaluated, few enough
    /// to be evaluated in reasonable time.
    ///
    /// # Errors
    /// [`SceneError::Step`], with the smallest step allowed, if the step is too small;
    /// [`SceneError::Number`] if it is out of range.
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
    /// The same on all rays, world space.
    Fixed(f64),
    /// Different from place to place along a ray: `fraction` of the largest detail of the scene
    /// times the largest 2^k, k ≤ 0, that is at most `fraction` of the finest detail there
    /// (`docs/rendering.md`, samples of a ray).
    Automatic {
        /// Step as a fraction of that detail: of a radius, of two voxels.
        fraction: f64,
    },
}

impl Default for Step {
    /// A quarter of a radius.
    fn default() -> Self {
        Self::Automatic { fraction: 0.25 }
    }
}

/// Offset of the first sample of a ray from its origin, in steps.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum SampleOffset {
    /// Half a step, on every ray.
    #[default]
    Half,
    /// A fraction of a step that is a hash of the pixel: turns banding into noise.
    Hashed,
}

/// Where the rays of a pixel pass through it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Sampling {
    /// Through the centres of the cells of a regular lattice.
    #[default]
    Fixed,
    /// Through one position in each cell of the lattice, a hash of pixel and cell: turns aliasing
    /// at edges into noise.
    Stratified,
}

/// How many rays a pixel has.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum Samples {
    /// So many along each side of the pixel, 1 to 64: this number squared.
    Fixed(u32),
    /// One through the middle of the pixel, and two along each side instead where the picture
    /// varies: where the light or the opacity of the one ray is not midway between those of
    /// opposite neighbours. Of whole pictures and regions: tiles that are handed out one by one
    /// have two along each side.
    Auto {
        /// Light is compared as it is shown: multiplied by two to this power, −32 to 32.
        exposure: f32,
    },
}

impl Samples {
    /// The most rays along a side of a pixel.
    #[must_use]
    pub fn along_a_side(self) -> u32 {
        match self {
            Self::Fixed(number) => number,
            Self::Auto { .. } => 2,
        }
    }

    /// The same of a picture that is shown with an exposure in stops.
    #[must_use]
    pub fn shown_with(self, stops: f64) -> Self {
        match self {
            Self::Auto { .. } => Self::Auto { exposure: stops as f32 },
            fixed => fixed,
        }
    }
}

impl From<u32> for Samples {
    fn from(number: u32) -> Self {
        Self::Fixed(number)
    }
}

/// How the transmittance between a light and a sample is determined.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Shadows {
    /// By a shadow ray from the sample to the light, or from one just before it on its ray.
    Exact,
    /// From deep shadow maps, traced from the light.
    Cached {
        /// Resolution of a light's map in its finest level: cells along each side, 1 to 16384.
        resolution: u32,
    },
}

/// How wide pixels are taken to be where points are seen from afar.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
#[non_exhaustive]
pub enum Lod {
    /// Every point is seen, however small it is.
    #[default]
    Off,
    /// Cells as wide as a pixel times this factor, 1/16 to 64, are seen in place of their points,
    /// of clouds whose files have aggregates.
    Footprint(f32),
    /// The same, but what is seen of a cell is spread over a pixel, not over one that is taken to
    /// be so wide, and points are densities from a pixel on: as sharp, and traced in less time.
    /// With cells of four pixels and more it is grainy, and thin surfaces let light through.
    Coarse(f32),
}

impl Lod {
    /// Cells as wide as a pixel.
    pub const AUTO: Self = Self::Footprint(1.0);
    /// Cells as wide as two pixels, for gas: hardly to be told from [`AUTO`](Self::AUTO) there.
    pub const COARSE: Self = Self::Coarse(2.0);
    /// The least and the largest factor.
    pub const FACTORS: (f32, f32) = (1.0 / 16.0, 64.0);

    /// How wide pixels are taken to be, in pixels, and over which part of that what is seen is
    /// spread; `None` if every point is seen.
    pub(crate) fn pixels(self) -> Option<(f64, f64)> {
        match self {
            Self::Off => None,
            Self::Footprint(factor) => Some((factor.into(), 1.0)),
            Self::Coarse(factor) => Some((factor.into(), 1.0 / f64::from(factor))),
        }
    }

    /// Pixels taken to be so many times as wide; `None` if the factor is out of range.
    #[must_use]
    pub fn footprint(factor: f64) -> Option<Self> {
        let (least, most) = Self::FACTORS;
        (f64::from(least)..=f64::from(most)).contains(&factor).then_some(Self::Footprint(factor as f32))
    }
}

/// The settings that determine pixels, besides the scene and the camera.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(not(feature = "internals"), non_exhaustive)]
pub struct RenderSettings {
    /// Width of the picture in pixels.
    pub width: u32,
    /// Height of the picture in pixels.
    pub height: u32,
    /// Distance between samples.
    pub step: Step,
    /// Offset of the first sample of a ray.
    pub sample_offset: SampleOffset,
    /// A ray ends at the first sample behind which its transmittance is below this. 0: rays never
    /// end early.
    pub stop_transmittance: f32,
    /// How many rays a pixel has.
    pub samples: Samples,
    /// Where these rays pass through the pixel.
    pub sampling: Sampling,
    /// How shadows are computed.
    pub shadows: Shadows,
    /// Largest number of successive reflections and refractions that are followed.
    pub max_depth: u32,
    /// Whether depth, shading vectors and other layers are computed besides colours.
    pub layers: bool,
    /// Whether of layers depth and opacity alone are computed, if not all are: for tiles, and not
    /// for bands or parts. It takes less time.
    pub depths: bool,
    /// How much darker surfaces become in creases and close behind edges, 0 (not at all, the
    /// default) to 4. Of whole pictures and regions alone: tiles that are handed out one by one are
    /// as they were traced.
    pub ambient_occlusion: f32,
    /// Cells along the longest side of the lattice on which it is decided what a cap fills, 8
    /// to 1024. Less than two bytes of memory are set aside for each, of at most this number cubed
    /// for every cap.
    pub cap_resolution: u32,
    /// What is seen of points from afar.
    pub lod: Lod,
}

impl Default for RenderSettings {
    fn default() -> Self {
        Self {
            width: 512,
            height: 512,
            step: Step::default(),
            sample_offset: SampleOffset::Half,
            stop_transmittance: 0.01,
            samples: Samples::Fixed(1),
            sampling: Sampling::Fixed,
            shadows: Shadows::Exact,
            max_depth: 4,
            layers: false,
            depths: false,
            ambient_occlusion: 0.0,
            cap_resolution: 256,
            lod: Lod::Off,
        }
    }
}

setters!(RenderSettings {
    with_step => step: Step,
    with_sample_offset => sample_offset: SampleOffset,
    with_stop_transmittance => stop_transmittance: f32,
    with_sampling => sampling: Sampling,
    with_shadows => shadows: Shadows,
    with_max_depth => max_depth: u32,
    with_layers => layers: bool,
    with_depths => depths: bool,
    with_ambient_occlusion => ambient_occlusion: f32,
    with_cap_resolution => cap_resolution: u32,
    with_lod => lod: Lod,
});

impl RenderSettings {
    /// Whether layers are computed, or of them depth and opacity, for the caller or for ambient
    /// occlusion.
    pub(crate) fn records_layers(&self) -> bool {
        self.layers || self.depths || self.ambient_occlusion > 0.0
    }

    /// Sets how many rays a pixel has: a number along each side, or [`Samples::Auto`].
    #[must_use]
    pub fn with_samples(self, samples: impl Into<Samples>) -> Self {
        Self { samples: samples.into(), ..self }
    }

    /// Sets the size of the picture in pixels.
    #[must_use]
    pub fn with_size(self, width: u32, height: u32) -> Self {
        Self { width, height, ..self }
    }

    /// The sample offset, in steps, of the ray through a pixel. If a pixel has several rays, `x`
    /// and `y` are the column and row of the ray's cell in the whole picture.
    #[must_use]
    pub fn sample_offset_of(&self, x: u32, y: u32) -> f64 {
        match self.sample_offset {
            SampleOffset::Half => 0.5,
            SampleOffset::Hashed => hash(x, y, 0),
        }
    }

    /// Where the ray of cell (`i`, `j`) of pixel (`x`, `y`) passes through the picture, in pixels
    /// from its upper left corner.
    #[must_use]
    pub fn ray_place(&self, x: u32, y: u32, i: u32, j: u32) -> (f64, f64) {
        let side = self.samples.along_a_side();
        let cells = f64::from(side);
        let (u, v) = match self.sampling {
            Sampling::Fixed => (0.5, 0.5),
            Sampling::Stratified => {
                let (column, row) = (x * side + i, y * side + j);
                (hash(column, row, 1), hash(column, row, 2))
            }
        };
        (f64::from(x) + (f64::from(i) + u) / cells, f64::from(y) + (f64::from(j) + v) / cells)
    }
}

/// A pseudo-random number from 0 to below 1: two multiplicative rounds with the constants of
/// splitmix64's finaliser.
fn hash(x: u32, y: u32, stream: u64) -> f64 {
    let mut z = (u64::from(y) << 32 | u64::from(x)).wrapping_add(stream.wrapping_mul(0xd1b5_4a32_d192_ed03));
    z = (z ^ z >> 30).wrapping_add(0x9e37_79b9_7f4a_7c15).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((z ^ z >> 31) >> 40) as f64 / f64::from(1 << 24)
}
