//! The formats that volumes are read from, and how the format of a file is recognized: by its first bytes, and only where
//! these say nothing by its name.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use flate2::read::MultiGzDecoder;

use super::{ReadError, VolumeSource, meta, nifti, nrrd, vdb, vti};

/// Bytes from the start of a file by which its format is recognized.
const HEAD_BYTES: u64 = 4096;
/// A NIfTI header has its name at this byte.
const NIFTI_MAGIC: usize = 344;

/// A format that volumes are read from.
struct Format {
    /// Endings of the names of its files, without the dot, in lower case.
    extensions: &'static [&'static str],
    /// Whether a file that begins with these bytes, [`HEAD_BYTES`] or all that there are, is of this format, whatever its
    /// name. The bytes of a compressed file are those of what is compressed.
    begins: fn(&[u8]) -> bool,
    open: fn(&Path) -> Result<VolumeSource, ReadError>,
}

/// In this order: the first that recognizes the beginning of a file reads it.
const FORMATS: &[Format] = &[
    Format { extensions: &["nrrd", "nhdr"], begins: |head| head.starts_with(b"NRRD000"), open: nrrd::open },
    Format {
        extensions: &["mha", "mhd"],
        begins: |head| head.starts_with(b"ObjectType = Image") || head.starts_with(b"NDims = "),
        open: meta::open,
    },
    Format {
        extensions: &["nii", "nii.gz"],
        begins: |head| head.get(NIFTI_MAGIC..).is_some_and(|name| name.starts_with(b"n+1\0")),
        open: nifti::open,
    },
    Format { extensions: &["vdb"], begins: |head| head.starts_with(VDB_MAGIC), open: vdb::open },
    Format {
        extensions: &["vti"],
        // Other files of VTK begin as this one does.
        begins: |head| {
            head.windows(VTI_TYPES[0].len()).any(|w| w == VTI_TYPES[0])
                || head.windows(VTI_TYPES[1].len()).any(|w| w == VTI_TYPES[1])
        },
        open: vti::open,
    },
];

const VDB_MAGIC: &[u8] = b" BDV\0\0\0\0";
const VTI_TYPES: [&[u8]; 2] = [b"<VTKFile type=\"ImageData\"", b"<VTKFile type='ImageData'"];

/// The format of a file; `None` if it is that of no volume, or the file cannot be read.
fn format_of(path: &Path) -> Option<&'static Format> {
    let head = head(path).unwrap_or_default();
    let name = path.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
    let named = |format: &&Format| format.extensions.iter().any(|e| name.ends_with(&format!(".{e}")));
    FORMATS.iter().find(|format| (format.begins)(&head)).or_else(|| FORMATS.iter().find(named))
}

/// Whether a file is a volume.
pub(super) fn is_volume(path: &Path) -> bool {
    format_of(path).is_some()
}

/// Opens a volume in its own format.
pub(super) fn open(path: &Path) -> Result<VolumeSource, ReadError> {
    match format_of(path) {
        Some(format) => Ok((format.open)(path)?.with_header(path)),
        None => Err(ReadError::Format { path: path.to_owned() }),
    }
}

/// The first bytes of a file, decompressed if they are gzip's. Empty if it is a pipe, a device or a folder.
fn head(path: &Path) -> std::io::Result<Vec<u8>> {
    let mut head = Vec::new();
    if !std::fs::metadata(path)?.is_file() {
        return Ok(head);
    }
    File::open(path)?.take(HEAD_BYTES).read_to_end(&mut head)?;
    if head.starts_with(&[0x1f, 0x8b]) {
        let mut plain = Vec::new();
        // The end is cut off, which is no error here.
        let _ = MultiGzDecoder::new(&head[..]).take(HEAD_BYTES).read_to_end(&mut plain);
        return Ok(plain);
    }
    Ok(head)
}
