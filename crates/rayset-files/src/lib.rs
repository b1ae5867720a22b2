//! Cloud and grid files: what they are built from ([`points::PointSource`],
//! [`grid::VolumeSource`]), how they are built, opened and verified, and their pages as the working
//! set has them. A part of the library `rayset`, which says what of it is public.
#![deny(unsafe_code)]

pub mod grid;
pub mod octree;
pub mod paged_file;
mod paged_files;
pub mod points;

pub use self::grid::Grid;
pub use self::octree::Cloud;
pub use self::paged_files::PagedFiles;
