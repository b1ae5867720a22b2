//! Grid volumes on disk: voxels in bricks, one brick per page, with the value range of each;
//! `docs/format.md` specifies the layout.

pub mod build;
mod census;
mod error;
pub mod file;
pub mod format;
pub mod labels;
mod slices;
mod source;

pub use self::error::VolumeError;
pub use self::file::Grid;
pub use self::format::{GridHeader, VoxelKind};
pub use self::source::{Described, VolumeSource, Voxels, what_of};
