//! Readers of volumes: NRRD, MetaImage, NIfTI, VTI, and raw files that contain nothing but voxels.

pub use crate::grid::read::{RawLayout, ReadError, VolumeSource};
