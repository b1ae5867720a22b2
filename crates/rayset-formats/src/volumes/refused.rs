//! Formats of volumes that are not read: what a file is, and what converts it.

use std::io::Read;
use std::path::Path;

use super::data::data_at;

/// A format that is not read.
struct Refused {
    /// As in the formats that are read.
    extensions: &'static [&'static str],
    begins: fn(&[u8]) -> bool,
    what: &'static str,
}

/// DICOM files have their name at this byte.
const DICOM_MAGIC: usize = 128;
const NIFTI_MAGIC: usize = 344;
/// Files of a folder that are looked at.
const MOST_ENTRIES: usize = 32;

const DICOM: Refused = Refused {
    extensions: &["dcm", "dicom"],
    begins: |head| head.get(DICOM_MAGIC..).is_some_and(|name| name.starts_with(b"DICM")),
    what: "this is DICOM, a slice in each file, which is not read; `dcm2niix FOLDER` makes a NIfTI file of a series, and \
           3D Slicer an NRRD",
};
const ZARR: Refused = Refused {
    extensions: &["zarr", "zarr.zip", "n5"],
    begins: |_| false,
    what: "this is Zarr, which is not read; from Python, `numpy.save(\"volume.npy\", zarr.open(\"FOLDER\")[:])` makes an \
           array that is, of one level of three dimensions",
};

const REFUSED: [Refused; 5] = [
    DICOM,
    ZARR,
    Refused {
        extensions: &["tif", "tiff"],
        begins: |head| {
            [&b"II*\0"[..], b"MM\0*", b"II+\0", b"MM\0+"].iter().any(|magic| head.starts_with(magic))
        },
        what: "this is TIFF, which is not read; from Python, `numpy.save(\"volume.npy\", tifffile.imread(\"FILE\"))` makes \
               an array that is, of one channel and time; of a map of heights, `gdal2xyz.py FILE points.xyz` makes points",
    },
    Refused {
        extensions: &["hdr", "img"],
        begins: |head| {
            let pair = head.get(NIFTI_MAGIC..).is_some_and(|name| name.starts_with(b"ni1\0"));
            let second =
                head.get(4..).is_some_and(|name| name.starts_with(b"n+2\0") || name.starts_with(b"ni2\0"));
            pair || second
        },
        what: "this is Analyze, NIfTI in two files, or NIfTI-2, and NIfTI-1 in one file is read; from Python, \
               `nibabel.Nifti1Image.from_image(nibabel.load(\"FILE\")).to_filename(\"volume.nii.gz\")` makes one",
    },
    Refused {
        extensions: &["vts", "pvti", "pvtr", "pvts"],
        begins: |_| false,
        what: "this is a grid of VTK that is not regular, or in several files; ParaView's filter Resample To Image makes a \
               regular one, and `.vti` of one piece is read",
    },
];

/// What a file or folder is that no reader knows, and what converts it. `None` if it is nothing of
/// these either.
pub(super) fn refused(path: &Path, head: &[u8], is_named: impl Fn(&[&str]) -> bool) -> Option<&'static str> {
    if path.is_dir() {
        return folder(path).or_else(|| is_named(ZARR.extensions).then_some(ZARR.what));
    }
    let named = || REFUSED.iter().find(|refused| is_named(refused.extensions)).map(|refused| refused.what);
    refused_by_content(head).or_else(named)
}

/// What a file is by its first bytes, whatever its name.
pub(super) fn refused_by_content(head: &[u8]) -> Option<&'static str> {
    REFUSED.iter().find(|refused| (refused.begins)(head)).map(|refused| refused.what)
}

/// What a folder is: the files of Zarr, or slices of DICOM.
fn folder(path: &Path) -> Option<&'static str> {
    if [".zgroup", ".zarray", "zarr.json"].iter().any(|name| path.join(name).is_file()) {
        return Some(ZARR.what);
    }
    let entries = std::fs::read_dir(path).ok()?.take(MOST_ENTRIES).filter_map(Result::ok);
    let mut files = entries.filter(|entry| entry.file_type().is_ok_and(|kind| kind.is_file()));
    files.any(|entry| is_dicom(&entry.path())).then_some(DICOM.what)
}

fn is_dicom(path: &Path) -> bool {
    let mut head = Vec::new();
    let read = data_at(path, 0).map(|file| file.take(DICOM_MAGIC as u64 + 4).read_to_end(&mut head));
    read.is_ok() && (DICOM.begins)(&head)
}
