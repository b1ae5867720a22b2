//! Readers of volumes: NRRD, MetaImage, NIfTI, VTI, and raw files with a given layout. Voxels are read once, in order, x
//! fastest, in pieces of any size.
//!
//! Before any voxel is read, a file is checked to be large enough for the voxels that its header promises. Compressed data
//! are read to their end, so that their checksums are verified, and must contain nothing after the voxels but what the
//! header states.

mod data;
mod error;
mod fields;
mod meta;
mod nifti;
mod nrrd;
mod raw;
mod source;
mod stored;
mod vti;

use std::path::Path;

pub use self::error::ReadError;
pub use self::raw::RawLayout;
pub use self::source::VolumeSource;

impl VolumeSource {
    /// Opens a volume in the format of its file name extension.
    ///
    /// # Errors
    /// [`ReadError`] if it cannot be opened, its header is invalid, or it is too small for the voxels that its header
    /// promises.
    pub fn open(path: &Path) -> Result<Self, ReadError> {
        let name = path.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
        let ends = |endings: &[&str]| endings.iter().any(|ending| name.ends_with(ending));
        let source = if ends(&[".nrrd", ".nhdr"]) {
            nrrd::open(path)
        } else if ends(&[".mha", ".mhd"]) {
            meta::open(path)
        } else if ends(&[".nii", ".nii.gz"]) {
            nifti::open(path)
        } else if ends(&[".vti"]) {
            vti::open(path)
        } else {
            Err(ReadError::Format { path: path.to_owned() })
        };
        Ok(source?.with_header(path))
    }

    /// Opens a raw file, which contains nothing but voxels.
    ///
    /// # Errors
    /// [`ReadError`] if it cannot be opened, its layout is invalid, or it is shorter than the layout requires.
    pub fn open_raw(path: &Path, layout: &RawLayout) -> Result<Self, ReadError> {
        raw::open(path, layout)
    }

    /// Whether a file name has the extension of a volume format.
    #[must_use]
    pub fn is_volume(path: &Path) -> bool {
        let name = path.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
        [".nrrd", ".nhdr", ".mha", ".mhd", ".nii", ".nii.gz", ".vti"].iter().any(|end| name.ends_with(end))
    }
}
