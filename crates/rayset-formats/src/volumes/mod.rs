//! Readers of volumes: NRRD, MetaImage, NIfTI, OpenVDB, VTK's, OpenDX, SLC, arrays of NumPy, and
//! raw files with a given layout. Voxels are read once, in order, x fastest, in pieces of any size.
//!
//! Before any voxel is read, a file is checked to be large enough for the voxels that its header
//! promises. Compressed data are read to their end, so that their checksums are verified, and must
//! contain nothing after the voxels but what the header states.

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
mod segments;
mod series;
mod slc;
mod vdb;
mod vti;

pub use self::formats::{extensions, is_volume, open};
pub use self::raw::RawLayout;
