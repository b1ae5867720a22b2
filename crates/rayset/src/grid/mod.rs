//! Grid volumes on disk: voxels in bricks, a brick a page, with the range of values of each; `docs/format.md` has the
//! bytes.

pub mod build;
pub mod file;
pub mod format;
pub mod read;
mod slices;

pub use self::file::Grid;
pub use self::format::{GridHeader, VoxelKind};
