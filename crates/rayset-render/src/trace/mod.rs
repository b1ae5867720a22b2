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
mod costs;
mod counts;
mod display_values;
mod engine;
mod error;
mod evaluate;
mod grid;
mod inside;
mod interior;
mod job;
mod knots;
mod layers;
mod march;
mod march_bytes;
pub mod memory;
pub mod memory_plan;
mod node_samples;
mod operators;
mod packet_tracer;
#[cfg(feature = "parts")]
pub mod parts;
pub mod predict;
mod prepared;
mod procedural;
mod program;
mod progress;
mod ray_tree;
pub mod reference;
mod regions;
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

pub use self::counts::{LodErrors, RenderCounts};
pub use self::engine::ExecSettings;
pub use self::error::{RenderError, SettingError};
pub use self::predict::Prediction;
pub use self::prepared::PreparedScene;
pub use self::session::{Session, SessionBuilder, render_once};
pub use self::sink::{BandSink, FinishedTile, Picture, SinkError, TileSink};
pub use self::view::View;
pub use self::work::{MAX_TILE_PIXELS, Region, Tile, Work};
