//! Ray-traces point clouds larger than memory, as volumes, inside a memory budget that holds.
#![deny(unsafe_code)]
pub mod geometry;
pub mod points;
pub mod octree;
pub mod working_set;
pub mod field;
pub mod scene;
pub mod image;
pub mod trace;
