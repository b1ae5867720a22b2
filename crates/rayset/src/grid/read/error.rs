//! Why a volume cannot be read, and where.

use std::io;
use std::path::{Path, PathBuf};

/// Why a volume cannot be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReadError {
    /// The operating system refused.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        r#source: io::Error,
    },
    /// A pipe, a device or a folder.
    #[error("{}: this is not a regular file; volumes are read from files alone", path.display())]
    NotRegular {
        /// The file.
        path: PathBuf,
    },
    /// The file ends early, or is damaged.
    #[error("{}, byte {offset} of the voxels: {what}", path.display())]
    Data {
        /// The file.
        path: PathBuf,
        /// Bytes of voxels before.
        offset: u64,
        /// What is wrong.
        what: String,
    },
    /// The header.
    #[error("{}, {place}: {what}", path.display())]
    Header {
        /// The file.
        path: PathBuf,
        /// Line, key or byte.
        place: String,
        /// What is wrong, and what was expected.
        what: String,
    },
    /// A format that is not known.
    #[error("{}: expected a name that ends in nrrd, nhdr, mha, mhd, nii, nii.gz or vti, or a --raw layout", path.display())]
    Format {
        /// The file.
        path: PathBuf,
    },
}

impl ReadError {
    /// Something of a header.
    pub(super) fn header(path: &Path, place: &str, what: &str) -> Self {
        Self::Header { path: path.to_owned(), place: place.to_owned(), what: what.to_owned() }
    }
}
