//! What the files of clouds and grids say of themselves, and whether they are whole.

pub use crate::container::{FileKind, HeaderError, Identity, LEAST_FILE_BYTES, PageError, ScanError};
pub use crate::grid::format::{GridHeader, VoxelKind};
pub use crate::octree::format::{AttributeInfo, Column, Header};
pub use crate::octree::verify::{Depth, VerifyError, VerifyReport};
