//! Readers of volumes: NRRD, MetaImage, NIfTI, OpenVDB, VTK's, OpenDX, SLC, arrays of NumPy, and raw files with a given
//! layout. Voxels are read once, in order, x fastest, in pieces of any size.
//!
//! Before any voxel is read, a file is checked to be large enough for the voxels that its header promises. Compressed data
//! are read to their end, so that their checksums are verified, and must contain nothing after the voxels but what the
//! header states.

mod data;
mod dx;
mod error;
mod fields;
mod formats;
mod label_table;
mod legacy_vtk;
mod meta;
mod nifti;
mod npy;
mod nrrd;
mod orientation;
mod raw;
mod rectilinear;
mod refused;
mod segments;
mod series;
mod slc;
mod source;
mod stored;
mod vdb;
mod vti;

use std::path::Path;

pub use self::error::ReadError;
pub use self::raw::RawLayout;
pub use self::source::VolumeSource;

impl VolumeSource {
    /// Opens a volume in its own format, which its first bytes tell or, where these say nothing, the extension of its name.
    ///
    /// # Errors
    /// [`ReadError`] if it cannot be opened, its header is invalid, or it is too small for the voxels that its header
    /// promises.
    pub fn open(path: &Path) -> Result<Self, ReadError> {
        formats::open(path, None)
    }

    /// As [`open`](Self::open), of a file with a series of volumes, as arrays of four dimensions are, that of an index,
    /// counted from 0; the first if `None`.
    ///
    /// # Errors
    /// As [`open`](Self::open), and if the file has no volume of the index.
    pub fn open_of_series(path: &Path, index: Option<u64>) -> Result<Self, ReadError> {
        formats::open(path, index)
    }

    /// Opens a raw file, which contains nothing but voxels.
    ///
    /// # Errors
    /// [`ReadError`] if it cannot be opened, its layout is invalid, or it is shorter than the layout requires.
    pub fn open_raw(path: &Path, layout: &RawLayout) -> Result<Self, ReadError> {
        raw::open(path, layout)
    }

    /// Endings of the names of files of volumes, without the dot, in lower case.
    pub fn extensions() -> impl Iterator<Item = &'static str> {
        formats::extensions()
    }

    /// Whether a file is a volume, by its first bytes or, where these say nothing, by the extension of its name.
    ///
    /// # Errors
    /// [`ReadError::Io`] if the operating system refuses to read it.
    pub fn is_volume(path: &Path) -> Result<bool, ReadError> {
        formats::is_volume(path)
    }
}
