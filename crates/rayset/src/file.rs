//! Headers of cloud and grid files, and checks that the files are complete and undamaged.

pub use crate::container::{FileKind, HeaderError, Identity, LEAST_FILE_BYTES, PageError, ScanError};
pub use crate::grid::format::{GridHeader, VoxelKind};
pub use crate::octree::format::{AttributeInfo, Column, Header};
pub use crate::octree::verify::{Depth, VerifyError, VerifyReport};
