//! Why a volume cannot be read, and where.

use std::io;
use std::path::{Path, PathBuf};

use rayset_store::storage::shown;

/// Why a volume cannot be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum VolumeError {
    /// The operating system refused.
    #[error("cannot read {}: {source}", shown(path))]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        r#source: io::Error,
    },
    /// A pipe, a device or a folder.
    #[error("{}: this is not a regular file; volumes are read from files alone", shown(path))]
    NotRegular {
        /// The file.
        path: PathBuf,
    },
    /// The voxel data end early, are too long, or are damaged.
    #[error("{}, byte {offset} of the voxels: {what}", shown(path))]
    Data {
        /// The file.
        path: PathBuf,
        /// Offset of the error in the bytes of the voxels.
        offset: u64,
        /// What is wrong.
        what: String,
    },
    /// The header is invalid, or describes something that is not supported.
    #[error("{}, {place}: {what}", shown(path))]
    Header {
        /// The file.
        path: PathBuf,
        /// The line, key or byte in the header.
        place: String,
        /// What is wrong, and what was expected.
        what: String,
    },
    /// The file is of no format that is read.
    #[error("{}: {what}", shown(path))]
    Format {
        /// The file.
        path: PathBuf,
        /// What it is and what converts it, or what was expected.
        what: String,
    },
}

impl VolumeError {
    /// An error at a place of a header.
    #[doc(hidden)]
    pub fn header(path: &Path, place: &str, what: &str) -> Self {
        Self::Header { path: path.to_owned(), place: place.to_owned(), what: what.to_owned() }
    }
}
