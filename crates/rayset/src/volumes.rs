//! Voxels in: readers for the files that people have (NRRD, MetaImage, NIfTI, VTI) and for nothing but voxels.

pub use crate::grid::read::{RawLayout, ReadError, VolumeSource};
