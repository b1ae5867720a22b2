//! The ray tracer: packets of rays through slabs of samples, over a working set of pages.
//!
//! A [`Session`] outlives its scenes, a [`PreparedScene`] its views, and a [`View`] its renders.
//! [`View::render`] is the entry point: it creates a `job`, which the session's threads
//! (`scheduler`) process tile by tile; `packet_tracer` takes over from there.
//! [`RenderSettings`](crate::scene::RenderSettings), scene and camera determine the picture; of the
//! [`ExecSettings`], only fused multiply–add changes its last bits.

mod access;
mod ambient_occlusion;
mod bands;
mod bounce;
mod cloud;
mod compiler;
mod composite;
mod counts;
mod engine;
mod grid;
mod inside;
mod interior;
mod job;
mod layers;
mod march;
mod march_bytes;
mod math;
pub mod memory;
pub mod memory_plan;
mod node_samples;
mod operators;
mod packet_tracer;
pub mod parts;
pub mod predict;
mod prepared;
mod procedural;
mod program;
mod ray_tree;
pub mod reference;
mod scheduler;
mod secondary;
mod session;
mod shade;
mod shadow;
mod sink;
mod steps;
mod surfaces;
mod tiles;
mod transfer;
mod unopened;
mod view;
mod work;
mod world;

use std::io;
use std::path::PathBuf;

pub use self::counts::RenderCounts;
pub use self::engine::ExecSettings;
pub use self::predict::Prediction;
pub use self::prepared::PreparedScene;
pub use self::session::{Session, SessionBuilder, render_once};
pub use self::sink::{BandSink, FinishedTile, Picture, SinkError, TileSink};
pub use self::view::View;
pub use self::work::{MAX_TILE_PIXELS, Region, Tile, Work};
use crate::scene::{CameraError, SceneError};
use rayset_store::storage::shown;
use rayset_store::working_set::PageFault;

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
    #[error("{setting}: {what}")]
    Setting {
        /// The setting.
        setting: &'static str,
        /// What is wrong with it, and what is expected.
        what: String,
    },
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
