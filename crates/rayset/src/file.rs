//! Headers of cloud and grid files, and checks that the files are complete and undamaged.

pub use rayset_files::grid::format::{GridHeader, VoxelKind};
pub use rayset_files::octree::format::{AttributeInfo, Column, Header};
pub use rayset_files::octree::verify::{Depth, VerifyError, VerifyReport};
pub use rayset_store::container::{FileKind, HeaderError, Identity, LEAST_FILE_BYTES, PageError, ScanError};
