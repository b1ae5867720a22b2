//! Ray-traces point clouds larger than memory, as volumes, inside a memory budget that holds.
#![deny(unsafe_code)]
pub mod field;
pub mod geometry;
pub mod image;
pub mod octree;
pub mod points;
pub mod scene;
pub mod trace;
pub mod working_set;
