//! Why a scene cannot be prepared or rendered.

use std::io;
use std::path::PathBuf;

use super::sink::SinkError;
use super::work::{MAX_TILE_PIXELS, Tile};
use crate::scene::{CameraError, SceneError};
use rayset_store::storage::shown;
use rayset_store::working_set::PageFault;

/// Most pixels along a side of a picture.
pub(super) const MOST_PIXELS: u32 = 1 << 20;
/// Most threads of a session.
pub(super) const MOST_THREADS: usize = 4096;
/// Most rays along a side of a table of shadows.
pub(super) const FINEST_SHADOWS: u32 = 1 << 14;

/// A setting that is out of range.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SettingError {
    /// The size of the picture in pixels.
    #[error("size: {width}x{height} is not between 1x1 and {MOST_PIXELS}x{MOST_PIXELS}")]
    Size {
        /// Pixels of a row.
        width: u32,
        /// Number of rows.
        height: u32,
    },
    /// A region of the picture is empty, or not within it.
    #[error("region: empty, or not within the picture")]
    Region,
    /// A tile is not within the picture, or too large.
    #[error(
        "tile: {}x{} pixels at ({}, {}); expected 1x1 to {MAX_TILE_PIXELS}x{MAX_TILE_PIXELS} pixels within a picture of \
         {width}x{height}", tile.width, tile.height, tile.x, tile.y
    )]
    Tile {
        /// The tile.
        tile: Tile,
        /// Pixels of a row of the picture.
        width: u32,
        /// Number of rows of the picture.
        height: u32,
    },
    /// The number of rays along a side of a pixel.
    #[error("samples: {0} is not between 1 and 64 along a side of a pixel")]
    Samples(u32),
    /// The length of a step in world units.
    #[error("step: {0} is not a positive number")]
    Step(f64),
    /// A step in world units that would make too many samples of the scene.
    #[error("step: {step:e} is too small for a scene {extent:e} wide; at least {least:e} will do")]
    SmallStep {
        /// The step.
        step: f64,
        /// The longest side of the scene.
        extent: f64,
        /// The smallest step for this scene.
        least: f64,
    },
    /// The transmittance at which a ray ends.
    #[error("stop transmittance: {0} is not in [0, 1)")]
    StopTransmittance(f32),
    /// The number of rays along a side of a table of shadows.
    #[error("shadows: {0} rays a side are not between 1 and {FINEST_SHADOWS}")]
    Shadows(u32),
    /// The number of cells along a side of a cap.
    #[error("cap resolution: {0} is not between 8 and 1024")]
    CapResolution(u32),
    /// The strength of ambient occlusion.
    #[error("ambient occlusion: {0} is not between 0 and 4")]
    AmbientOcclusion(f32),
    /// How wide pixels are taken to be where points are seen from afar.
    #[error("level of detail: a footprint of {0} pixels is not between 1/16 and 64")]
    Lod(f32),
    /// The number of threads.
    #[error("threads: {0} are more than {MOST_THREADS}")]
    Threads(usize),
    /// The pixels along a side of a tile, or the samples of a slab.
    #[error("tile or slab: tiles have edges of 1 to 8 pixels, slabs 1 to 32 samples")]
    TileOrSlab,
    /// A file of the scene that is in no working set.
    #[error("scene: {} is in no working set", shown(.0))]
    NotOpen(PathBuf),
}

/// Why a scene cannot be prepared or rendered.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RenderError {
    /// A page could not be obtained.
    #[error(transparent)]
    Page(PageFault),
    /// The camera is invalid.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// The scene is invalid.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// A setting is out of range.
    #[error(transparent)]
    Setting(#[from] SettingError),
    /// A file of the scene cannot be opened.
    #[error("cannot open {}: {source}", shown(path))]
    Open {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        r#source: io::Error,
    },
    /// The requested way to read pages is not available.
    #[error("io_uring is not available here: {0}")]
    Io(io::Error),
    /// The session's memory budget is too small for the scenes prepared in it.
    #[error("a memory budget of {given} bytes is too small: this scene needs at least {needed}")]
    Memory {
        /// The budget.
        given: u64,
        /// The smallest sufficient budget, including the other scenes prepared in the session.
        needed: u64,
    },
    /// The system cannot start a thread.
    #[error("cannot start a thread: {0}")]
    Threads(io::Error),
    /// The sink refused a part of the picture.
    #[error("the picture could not be written: {0}")]
    Sink(SinkError),
    /// The render was cancelled.
    #[error("cancelled")]
    Cancelled,
}

impl From<PageFault> for RenderError {
    fn from(fault: PageFault) -> Self {
        if let PageFault::Cancelled = fault { Self::Cancelled } else { Self::Page(fault) }
    }
}
