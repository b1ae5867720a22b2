//! Scenes and pictures: the volume scene graph, fields of points, rays through them, and pictures
//! in linear light. A part of the library `rayset`, which says what of it is public.
#![deny(unsafe_code)]

pub mod field;
pub mod image;
mod lod;
mod math;
pub mod scene;
pub mod scene_file;
pub mod trace;
