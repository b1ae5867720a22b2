//! Readers of points and of voxels, in the formats that people have. A part of the library
//! `rayset`, which says what of it is public.
#![deny(unsafe_code)]

mod array_file;
pub mod points;
mod refusals;
pub mod volumes;
mod vtk_xml;
mod words;
