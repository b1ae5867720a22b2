//! The formats that volumes are read from, and how the format of a file is recognized: by its first
//! bytes, and only where these say nothing by its name.

use std::io::Read;
use std::path::Path;

use flate2::read::MultiGzDecoder;

use super::data::io_error;
use super::series::Series;
use super::{dx, legacy_vtk, meta, nifti, npy, nrrd, slc, vdb, vti};
use crate::refusals;
use rayset_files::grid::{VolumeError, VolumeSource};
use rayset_store::storage::input_file::{InputFile, Named, look};

/// Bytes from the start of a file by which its format is recognized.
const HEAD_BYTES: u64 = 4096;
/// A NIfTI header has its name at this byte.
const NIFTI_MAGIC: usize = 344;

/// A format that volumes are read from.
struct Format {
    /// Endings of the names of its files, without the dot, in lower case.
    extensions: &'static [&'static str],
    /// Whether a file that begins with these bytes, [`HEAD_BYTES`] or all that there are, is of
    /// this format, whatever its name. The bytes of a compressed file are those of what is
    /// compressed. Where the beginning says too little, more of the file is read.
    begins: fn(&[u8], &Path) -> Result<bool, VolumeError>,
    /// Whether a file may be compressed by gzip as a whole.
    zipped: bool,
    open: fn(&Path, Option<u64>) -> Result<VolumeSource, VolumeError>,
}

/// A format whose files are not compressed as a whole.
const fn format(
    extensions: &'static [&'static str],
    begins: fn(&[u8], &Path) -> Result<bool, VolumeError>,
    open: fn(&Path, Option<u64>) -> Result<VolumeSource, VolumeError>,
) -> Format {
    Format { extensions, begins, zipped: false, open }
}

/// In this order: the first that recognizes the beginning of a file reads it.
const FORMATS: &[Format] = &[
    format(&["nrrd", "nhdr"], |head, _| Ok(head.starts_with(b"NRRD000")), nrrd::open),
    format(
        &["mha", "mhd"],
        |head, _| Ok(head.starts_with(b"ObjectType = Image") || head.starts_with(b"NDims = ")),
        meta::open,
    ),
    Format { zipped: true, ..format(&["nii", "nii.gz"], |head, _| Ok(is_nifti(head)), nifti::open) },
    format(&["vdb"], |head, _| Ok(head.starts_with(VDB_MAGIC)), |path, index| alone(path, index, vdb::open)),
    // Arrays of other dimensions are no volumes, so the name does not tell.
    format(&[], npy::is_volume, npy::open),
    format(&["slc"], |head, _| Ok(slc::is_slc(head)), |path, index| alone(path, index, slc::open)),
    // Files of other datasets have the same name.
    format(&[], |head, _| Ok(legacy_vtk::is_grid(head)), |path, index| alone(path, index, legacy_vtk::open)),
    format(&["dx"], |head, _| Ok(dx::is_dx(head)), |path, index| alone(path, index, dx::open)),
    format(&["vti", "vtr"], |head, _| Ok(is_vti(head)), |path, index| alone(path, index, vti::open)),
];

fn is_nifti(head: &[u8]) -> bool {
    head.get(NIFTI_MAGIC..).is_some_and(|name| name.starts_with(b"n+1\0"))
}

/// Other files of VTK begin as these do.
fn is_vti(head: &[u8]) -> bool {
    VTI_TYPES.iter().any(|kind| head.windows(kind.len()).any(|part| part == *kind))
}

/// What is expected of a file that is no volume.
const EXPECTED: &str = "expected NRRD, MetaImage, NIfTI, OpenVDB, VTI, VTR, legacy VTK of structured points, OpenDX, SLC, an \
                        array of NumPy of three dimensions, or a --raw layout";

const VDB_MAGIC: &[u8] = b" BDV\0\0\0\0";
const VTI_TYPES: [&[u8]; 4] = [
    b"<VTKFile type=\"ImageData\"",
    b"<VTKFile type='ImageData'",
    b"<VTKFile type=\"RectilinearGrid\"",
    b"<VTKFile type='RectilinearGrid'",
];

/// Opens a volume of a format that has one in a file.
fn alone(
    path: &Path,
    index: Option<u64>,
    open: fn(&Path) -> Result<VolumeSource, VolumeError>,
) -> Result<VolumeSource, VolumeError> {
    Series::new(path, 1, index)?;
    open(path)
}

/// What a file is.
enum Kind {
    Read(&'static Format),
    /// A volume that is not read. It is said what it is, and what to do.
    Refused(String),
    Unknown,
}

fn kind_of(path: &Path) -> Result<Kind, VolumeError> {
    let (head, zipped) = head(path).map_err(io_error(path))?;
    let name = path.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
    let is_named = |extensions: &[&str]| extensions.iter().any(|e| name.ends_with(&format!(".{e}")));
    for format in FORMATS {
        if !(format.begins)(&head, path)? {
            continue;
        }
        if zipped && !format.zipped {
            let what =
                "this is a volume that is compressed as a whole; decompress it first, as `gunzip FILE` does";
            return Ok(Kind::Refused(what.to_owned()));
        }
        return Ok(Kind::Read(format));
    }
    if let Some(advice) = refusals::of_volume_marked(&head) {
        return Ok(Kind::Refused(advice));
    }
    if let Some(format) = FORMATS.iter().find(|format| is_named(format.extensions)) {
        return Ok(Kind::Read(format));
    }
    Ok(refusals::of_volume_named(path, &name).map_or(Kind::Unknown, Kind::Refused))
}

/// Endings of the names of files of volumes, without the dot, in lower case.
pub fn extensions() -> impl Iterator<Item = &'static str> {
    FORMATS.iter().flat_map(|format| format.extensions).copied()
}

/// Whether a file is a volume, by its first bytes or, where these say nothing, by the extension of
/// its name.
///
/// # Errors
/// [`VolumeError::Io`] if the operating system refuses to read it.
pub fn is_volume(path: &Path) -> Result<bool, VolumeError> {
    Ok(!matches!(kind_of(path)?, Kind::Unknown))
}

/// Opens a volume in its own format, which its first bytes tell or, where these say nothing, the
/// extension of its name: of a file with a series of volumes, as arrays of four dimensions are,
/// that of an index, counted from 0, or the first.
///
/// # Errors
/// [`VolumeError`] if it cannot be opened, its header is invalid, it is too small for the voxels
/// that its header promises, or has no volume of the index.
pub fn open(path: impl AsRef<Path>, index: Option<u64>) -> Result<VolumeSource, VolumeError> {
    let path = path.as_ref();
    let refuse = |what: String| Err(VolumeError::Format { path: path.to_owned(), what });
    match kind_of(path)? {
        Kind::Read(format) => Ok((format.open)(path, index)?.with_header(path)),
        Kind::Refused(what) => refuse(what),
        Kind::Unknown => refuse(EXPECTED.to_owned()),
    }
}

/// The first bytes of a file, decompressed if they are gzip's, and whether they are. Empty if it is
/// a pipe, a device or a folder.
fn head(path: &Path) -> std::io::Result<(Vec<u8>, bool)> {
    let mut head = Vec::new();
    if !matches!(look(path)?, Named::File(_)) {
        return Ok((head, false));
    }
    InputFile::open(path)?.take(HEAD_BYTES).read_to_end(&mut head)?;
    if head.starts_with(&[0x1f, 0x8b]) {
        let mut plain = Vec::new();
        // The end is cut off, which is no error here.
        let _ = MultiGzDecoder::new(&head[..]).take(HEAD_BYTES).read_to_end(&mut plain);
        return Ok((plain, true));
    }
    Ok((head, false))
}
