//! Volumes as they come: NRRD, MetaImage, NIfTI, VTI, and raw files with a described layout. Voxels are read once, in
//! order, x fastest; only slices that are being worked on are held.

mod meta;
mod nifti;
mod nrrd;
mod raw;
mod vti;

use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use flate2::read::{MultiGzDecoder, ZlibDecoder};

pub use self::raw::{RawLayout, UnknownLayout};
use super::VoxelKind;
use crate::geometry::DAffine3;

/// Why a volume cannot be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReadError {
    /// The operating system refused.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        r#source: io::Error,
    },
    /// The file ends early, or is damaged.
    #[error("{}, byte {offset} of the voxels: {what}", path.display())]
    Data {
        /// The file.
        path: PathBuf,
        /// Bytes of voxels before.
        offset: u64,
        /// What is wrong.
        what: String,
    },
    /// The header.
    #[error("{}, {place}: {what}", path.display())]
    Header {
        /// The file.
        path: PathBuf,
        /// Line, key or byte.
        place: String,
        /// What is wrong, and what was expected.
        what: String,
    },
    /// A format that is not known.
    #[error("{}: expected a name that ends in nrrd, nhdr, mha, mhd, nii, nii.gz or vti, or a --raw layout", path.display())]
    Format {
        /// The file.
        path: PathBuf,
    },
}

/// A volume that is being read.
pub struct VolumeSource {
    path: PathBuf,
    /// Voxels along each axis.
    pub size: [u64; 3],
    /// How they are stored, after reading.
    pub kind: VoxelKind,
    /// A value is `scale`·stored + `offset`.
    pub scale: f64,
    /// See `scale`.
    pub offset: f64,
    /// From voxel coordinates to the space of the file.
    pub space_from_voxel: DAffine3,
    stored: Stored,
    big_endian: bool,
    data: Box<dyn Read + Send>,
    position: u64,
    scratch: Vec<u8>,
}

/// How numbers stand in the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stored {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Stored {
    fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// What it is kept as. Whole numbers of 32 bits and double precision lose digits.
    fn kind(self) -> VoxelKind {
        match self {
            Self::U8 => VoxelKind::U8,
            Self::I8 | Self::I16 => VoxelKind::I16,
            Self::U16 => VoxelKind::U16,
            Self::I32 | Self::U32 | Self::F32 | Self::F64 => VoxelKind::F32,
        }
    }
}

/// What a header says of the voxels.
#[derive(Clone, Copy)]
struct Described {
    size: [u64; 3],
    stored: Stored,
    big_endian: bool,
    scale: f64,
    offset: f64,
    space_from_voxel: DAffine3,
}

impl VolumeSource {
    /// Opens a volume by its name.
    ///
    /// # Errors
    /// [`ReadError`] where it cannot be opened or its header is wrong.
    pub fn open(path: &Path) -> Result<Self, ReadError> {
        let name = path.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
        let ends = |endings: &[&str]| endings.iter().any(|ending| name.ends_with(ending));
        if ends(&[".nrrd", ".nhdr"]) {
            nrrd::open(path)
        } else if ends(&[".mha", ".mhd"]) {
            meta::open(path)
        } else if ends(&[".nii", ".nii.gz"]) {
            nifti::open(path)
        } else if ends(&[".vti"]) {
            vti::open(path)
        } else {
            Err(ReadError::Format { path: path.to_owned() })
        }
    }

    /// Opens a file of nothing but voxels.
    ///
    /// # Errors
    /// [`ReadError`] where it cannot be opened.
    pub fn open_raw(path: &Path, layout: &RawLayout) -> Result<Self, ReadError> {
        raw::open(path, layout)
    }

    /// Whether a name is that of a volume.
    #[must_use]
    pub fn is_volume(path: &Path) -> bool {
        let name = path.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
        [".nrrd", ".nhdr", ".mha", ".mhd", ".nii", ".nii.gz", ".vti"].iter().any(|end| name.ends_with(end))
    }

    /// The file that voxels are read from; headers may stand in another.
    #[must_use]
    pub fn data_path(&self) -> &Path {
        &self.path
    }

    fn new(path: &Path, described: Described, data: Box<dyn Read + Send>) -> Self {
        Self {
            path: path.to_owned(),
            size: described.size,
            kind: described.stored.kind(),
            scale: described.scale,
            offset: described.offset,
            space_from_voxel: described.space_from_voxel,
            stored: described.stored,
            big_endian: described.big_endian,
            data,
            position: 0,
            scratch: Vec::new(),
        }
    }

    /// Fills a buffer with the next voxels, little-endian, as [`VoxelKind`] has them. What is not a number becomes 0.
    ///
    /// # Errors
    /// [`ReadError::Data`] where the file ends early or is damaged.
    pub fn read(&mut self, voxels: &mut [u8]) -> Result<(), ReadError> {
        let (width, out_width) = (self.stored.bytes(), self.kind.bytes());
        let bytes = voxels.len() / out_width * width;
        self.scratch.resize(bytes, 0);
        let read = self.data.read_exact(&mut self.scratch);
        read.map_err(|e| {
            let early = e.kind() == io::ErrorKind::UnexpectedEof;
            let what = if early { "the file ends before all voxels are there".into() } else { e.to_string() };
            ReadError::Data { path: self.path.clone(), offset: self.position, what }
        })?;
        self.position += bytes as u64;
        for (from, to) in self.scratch.chunks_exact_mut(width).zip(voxels.chunks_exact_mut(out_width)) {
            if self.big_endian {
                from.reverse();
            }
            convert(self.stored, from, to);
        }
        Ok(())
    }
}

/// One number, little-endian.
fn convert(stored: Stored, from: &[u8], to: &mut [u8]) {
    let four = || [from[0], from[1], from[2], from[3]];
    let number = |v: f32| if v.is_finite() { v } else { 0.0 };
    match stored {
        Stored::U8 | Stored::I16 | Stored::U16 => to.copy_from_slice(from),
        Stored::I8 => to.copy_from_slice(&i16::from(from[0] as i8).to_le_bytes()),
        Stored::I32 => to.copy_from_slice(&(i32::from_le_bytes(four()) as f32).to_le_bytes()),
        Stored::U32 => to.copy_from_slice(&(u32::from_le_bytes(four()) as f32).to_le_bytes()),
        Stored::F32 => to.copy_from_slice(&number(f32::from_le_bytes(four())).to_le_bytes()),
        Stored::F64 => {
            let mut eight = [0; 8];
            eight.copy_from_slice(from);
            to.copy_from_slice(&number(f64::from_le_bytes(eight) as f32).to_le_bytes());
        }
    }
}

/// A reader from some byte of a file on.
fn data_at(path: &Path, offset: u64) -> Result<BufReader<File>, ReadError> {
    let io = |source| ReadError::Io { path: path.to_owned(), source };
    let mut file = File::open(path).map_err(io)?;
    file.seek(SeekFrom::Start(offset)).map_err(io)?;
    Ok(BufReader::with_capacity(1 << 16, file))
}

fn gzip(data: BufReader<File>) -> Box<dyn Read + Send> {
    Box::new(MultiGzDecoder::new(data))
}

fn zlib(data: BufReader<File>) -> Box<dyn Read + Send> {
    Box::new(ZlibDecoder::new(data))
}

/// Whitespace-separated numbers, exactly so many.
fn numbers<const N: usize>(text: &str) -> Option<[f64; N]> {
    let all: Option<Vec<f64>> = text.split_whitespace().map(|word| word.parse().ok()).collect();
    all.and_then(|all| all.try_into().ok())
}

/// Three counts of voxels.
fn counts(text: &str) -> Option<[u64; 3]> {
    let all: Option<Vec<u64>> = text.split_whitespace().map(|word| word.parse().ok()).collect();
    all.and_then(|all| all.try_into().ok())
}
