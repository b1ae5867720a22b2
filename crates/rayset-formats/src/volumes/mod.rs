//! Readers of volumes: NRRD, MetaImage, NIfTI, OpenVDB, VTK's, OpenDX, SLC, arrays of NumPy, and raw files with a given
//! layout. Voxels are read once, in order, x fastest, in pieces of any size.
//!
//! Before any voxel is read, a file is checked to be large enough for the voxels that its header promises. Compressed data
//! are read to their end, so that their checksums are verified, and must contain nothing after the voxels but what the
//! header states.

mod data;
mod dx;
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
mod vdb;
mod vti;

use std::path::Path;

use rayset_files::grid::{Described, Voxels, what_of};
pub use rayset_files::grid::{ReadError, VolumeSource};

pub use self::formats::{extensions, is_volume};
pub use self::raw::RawLayout;

/// Opens a volume in its own format, which its first bytes tell or, where these say nothing, the extension of its name: of a
/// file with a series of volumes, as arrays of four dimensions are, that of an index, counted from 0, or the first.
///
/// # Errors
/// [`ReadError`] if it cannot be opened, its header is invalid, it is too small for the voxels that its header promises, or
/// has no volume of the index.
pub fn open(path: impl AsRef<Path>, index: Option<u64>) -> Result<VolumeSource, ReadError> {
    formats::open(path.as_ref(), index)
}
