//! Grid volumes on disk: voxels in bricks, one brick per page, with the value range of each; `docs/format.md` specifies the
//! layout.

pub mod build;
mod census;
pub mod file;
pub mod format;
pub mod labels;
pub mod read;
mod slices;

pub use self::file::Grid;
pub use self::format::{GridHeader, VoxelKind};
