//! Readers of volumes: NRRD, MetaImage, NIfTI, OpenVDB, VTK's, OpenDX, SLC, arrays of NumPy, and
//! raw files that contain nothing but voxels.

pub use rayset_files::grid::{VolumeError, VolumeSource};
pub use rayset_formats::volumes::{RawLayout, open};
#[doc(hidden)]
pub use rayset_formats::volumes::{extensions, is_volume};
