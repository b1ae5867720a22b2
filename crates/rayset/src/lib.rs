//! Ray-traces point clouds larger than memory, as volumes, inside a memory budget that holds.
//!
//! Points become a cloud file ([`octree::build`]); a [`working_set`] brings its pages into memory, never more than it
//! may; a [`scene::Scene`] combines clouds and procedural solids by constructive operators, lit; [`trace::View::render`] marches
//! packets of rays through it.
//!
//! ```
//! use std::sync::Arc;
//! use rayset::{geometry::{DAffine3, DVec3}, octree::{Cloud, build}, points::Workload, scene::*, trace, working_set::*};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let folder = std::env::temp_dir().join("rayset-doc");
//! std::fs::create_dir_all(&folder)?;
//! let path = folder.join("ball.rset");
//!
//! // A thousand points on a sphere, built into a file.
//! let ball: Workload = "sphere-1k".parse()?;
//! let options = build::BuildOptions { radius: Some(build::Rule::Number(0.3)), ..Default::default() };
//! build::run(vec![ball.source()], &path, &options, &build::BuildControl::default())?;
//!
//! // A working set of at most one mebibyte over its pages.
//! let cloud = Arc::new(Cloud::open(&path)?);
//! let set = WorkingSet::new(Limits::total(1 << 20), read::backend(read::BackendKind::Auto)?);
//! let session = trace::Session::over(PagedFiles::new(set), Default::default())?;
//!
//! // The ball with a corner cut away, in a picture of 16 × 16 pixels.
//! let ball = Node::new(Shape::Cloud(CloudObject::plain(cloud)));
//! let block = Solid::new(Form::Box { size: DVec3::ONE });
//! let block = Node::new(Shape::Procedural(Arc::new(block))).moved(DAffine3::from_translation(DVec3::ONE));
//! let root = Arc::new(Node::operator(Operator::Difference, [ball, block]));
//! let scene = Scene { root, lighting: Lighting::headlight(), background: None, unit_distance: 0.3 };
//! let camera = Camera::look_at(DVec3::new(0.0, 0.0, 3.0), DVec3::ZERO, DVec3::Y, 1.0);
//! let settings = RenderSettings { width: 16, height: 16, ..Default::default() };
//! let picture = session.prepare(&scene, &settings)?.view(&camera)?.picture()?;
//! assert!(picture.pixels[8 * 16 + 8][3] > 0.9 && picture.pixels[0][3] == 0.0);
//! # std::fs::remove_dir_all(&folder)?;
//! # Ok(())
//! # }
//! ```
#![deny(unsafe_code)]

pub mod cancel;
pub mod container;
pub mod field;
pub mod geometry;
pub mod grid;
pub mod image;
pub mod octree;
pub mod output;
pub mod points;
pub mod regular_file;
pub mod scene;
pub mod scene_file;
mod spill;
pub mod storage;
mod sync;
pub mod trace;
pub mod working_set;
