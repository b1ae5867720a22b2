//! Ray-traces point clouds larger than memory as volumes, within a fixed memory budget.
//!
//! Points become a [`Cloud`] ([`build`]): a file, or bytes in memory. A [`Session`] owns a memory
//! budget, threads, and the pages of clouds that are in memory; a [`scene::Scene`] combines clouds,
//! grids and solids by constructive operators and has lights; [`Session::prepare`] compiles it, and
//! [`PreparedScene::view`] looks at it through a camera, as often as you like.
//!
//! ```
//! use std::sync::Arc;
//! use rayset::points::SliceSource;
//! use rayset::scene::{Camera, CloudObject, RenderSettings, Scene};
//! use rayset::{Cloud, Session};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let turns = (0..1000).map(|i| f64::from(i) * 0.1);
//! let positions: Vec<[f64; 3]> = turns.map(|t| [t.cos(), 0.02 * t - 1.0, t.sin()]).collect();
//! let source = SliceSource::new(&positions);
//! let cloud = Cloud::builder().source(source).build()?;
//! let scene = Scene::of_cloud(CloudObject::plain(Arc::new(cloud)));
//! let (view, up) = ([0.0, -0.3, -1.0].into(), [0.0, 1.0, 0.0].into());
//! let camera = Camera::framing(&scene.root.bounds(), view, up, 0.8, 1.0, false);
//! let session = Session::builder().memory(256 << 20).build()?;
//! let settings = RenderSettings::default().with_size(64, 64);
//! let picture = session.prepare(&scene, &settings)?.view(&camera)?.picture()?;
//! picture.save_png("spring.png")?;
//! # assert!(picture.pixels.iter().any(|pixel| pixel[3] > 0.5));
//! # std::fs::remove_file("spring.png")?;
//! # Ok(())
//! # }
//! ```
//!
//! The picture is the same, bit for bit, for every budget, number of threads, way of reading and
//! order of tiles.
//!
//! | to | see |
//! | --- | --- |
//! | read points from files, or supply your own | [`points`] |
//! | build a cloud or a grid | [`build`], [`volumes`] |
//! | open it, list what is in it, verify it | [`Cloud`], [`Grid`], [`mod@file`] |
//! | describe a scene | [`scene`], [`scene_file`] |
//! | render it: whole, in tiles, in passes; cancel it | [`Session`], [`View`], [`CancelToken`] |
//! | write the picture | [`image`], [`output`] |
//! | render it in parts, by many processes | `parts`, with the feature of that name |
//! | set a memory budget, and see how it was used | [`memory`] |
//! | read from somewhere else | [`storage`] |
#![forbid(unsafe_code)]

pub mod build;
pub mod file;
pub mod geometry;
pub mod image;
pub mod memory;
pub mod output;
#[cfg(feature = "parts")]
pub mod parts;
pub mod points;
pub mod scene;
pub mod scene_file;
pub mod storage;
pub mod volumes;

pub use rayset_base::CancelToken;
pub use rayset_base::parse::ParseError;
pub use rayset_files::{Cloud, Grid};
pub use rayset_render::field::{SimdLevel, SplatCounts};
pub use rayset_render::trace::{
    BandSink, FinishedTile, LodErrors, Picture, Prediction, PreparedScene, Region, RenderCounts, RenderError,
    Session, SessionBuilder, SettingError, SinkError, Tile, TileSink, View, Work,
};
pub use rayset_store::container::OpenError;

/// What is behind the public surface, for this project's own tests, benches and fuzzers.
#[cfg(feature = "internals")]
#[doc(hidden)]
pub use {
    rayset_base::{cancel, regular_file},
    rayset_files::{PagedFiles, grid, octree, paged_file},
    rayset_render::{field, trace},
    rayset_store::{container, working_set},
};
