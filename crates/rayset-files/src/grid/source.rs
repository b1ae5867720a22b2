//! A volume that is being read, and what a header says of it.

use std::io::{self, Read};
use std::path::{Path, PathBuf};

use rayset_base::geometry::{DAffine3, DVec3};
use rayset_base::numbers::Stored;

use super::error::VolumeError;
use super::format::VoxelKind;
use super::labels::NamedLabels;

/// Largest number of voxels along an axis.
const MOST_VOXELS: u64 = 1 << 24;

/// A volume that is being read.
pub struct VolumeSource {
    /// Voxels along each axis.
    pub size: [u64; 3],
    /// The type in which they are stored after reading.
    pub kind: VoxelKind,
    /// A value is `scale`·stored + `offset`.
    pub scale: f64,
    /// See `scale`.
    pub offset: f64,
    /// Transforms voxel coordinates (voxel centres at integers) to the space of the file.
    pub space_from_voxel: DAffine3,
    /// The direction in the space of the file that is up: a patient's head. `None` if the format
    /// does not say.
    pub up: Option<DVec3>,
    /// The direction in the space of the file in which a viewer looks who sees the front: from a
    /// patient's chest to the back. `None` if the format does not say.
    pub facing: Option<DVec3>,
    /// Sentences about the choices of the reader: which of several arrays is read, what its values
    /// mean.
    pub about: Vec<String>,
    labels: NamedLabels,
    stored: Stored,
    big_endian: bool,
    voxels: Voxels,
    header_path: PathBuf,
    /// Bytes of all voxels as stored in the file, and of those read so far.
    bytes: u64,
    position: u64,
    scratch: Vec<u8>,
    memory_bytes: u64,
}

/// The bytes of all voxels, as they are stored in a file.
pub struct Voxels {
    /// The file, for messages.
    pub path: PathBuf,
    /// Reads them, x fastest, as they are stored.
    pub data: Box<dyn Read + Send>,
    /// Number of bytes that must follow the voxels in `data`: 0 if the voxels come last. `None` if
    /// anything may follow.
    pub rest: Option<u64>,
}

/// The description of the voxels in a header.
#[derive(Clone)]
pub struct Described {
    /// Voxels along each axis.
    pub size: [u64; 3],
    /// The type in which the file has them.
    pub stored: Stored,
    /// Whether the first byte of a number is the highest.
    pub big_endian: bool,
    /// See [`VolumeSource::scale`].
    pub scale: f64,
    /// See [`VolumeSource::offset`].
    pub offset: f64,
    /// See [`VolumeSource::space_from_voxel`].
    pub space_from_voxel: DAffine3,
    /// Where the header gives the size, for messages.
    pub size_place: String,
    /// Where the header gives the axes, for messages.
    pub axes_place: String,
}

impl Described {
    /// Checks that a grid can be built from this. Returns the number of bytes of its voxels in the
    /// file.
    pub fn check(&self, path: &Path) -> Result<u64, VolumeError> {
        let bytes = self.size.iter().try_fold(self.stored.bytes() as u64, |all, n| all.checked_mul(*n));
        if self.size.iter().any(|n| !(2..=MOST_VOXELS).contains(n)) {
            let what = format!("{:?} voxels: 2 to {MOST_VOXELS} are needed along each axis", self.size);
            return Err(VolumeError::header(path, &self.size_place, &what));
        }
        let last = DVec3::from_array(self.size.map(|n| (n - 1) as f64));
        let voxel_from_space = self.space_from_voxel.inverse();
        let determinant = self.space_from_voxel.matrix3.determinant();
        let usable = self.space_from_voxel.is_finite()
            && voxel_from_space.is_finite()
            && determinant.is_finite()
            && determinant != 0.0
            && self.space_from_voxel.transform_point3(last).is_finite();
        if !usable {
            let what = "the axes are not independent, a spacing is 0, or a number is not finite or far too large \
                        or small";
            return Err(VolumeError::header(path, &self.axes_place, what));
        }
        bytes.ok_or_else(|| {
            VolumeError::header(path, &self.size_place, "the voxels have more bytes than any file holds")
        })
    }
}

impl VolumeSource {
    /// The files that are read: the one with the header, and the one with the voxels, which may be
    /// the same.
    #[must_use]
    pub fn paths(&self) -> [&Path; 2] {
        [&self.header_path, &self.voxels.path]
    }

    /// A volume whose voxels are read from anywhere: `size` along x, y and z, x fastest,
    /// little-endian, of one of the kinds that grids store. `name` stands for its path in errors.
    /// Voxel centres are at integers, which `space_from_voxel` maps to the space of the grid.
    ///
    /// # Errors
    /// [`VolumeError::Header`] if there are fewer than two voxels along an axis, or the transform
    /// flattens space.
    pub fn from_reader(
        name: &str,
        size: [u64; 3],
        kind: VoxelKind,
        space_from_voxel: DAffine3,
        voxels: Box<dyn Read + Send>,
    ) -> Result<Self, VolumeError> {
        let stored = match kind {
            VoxelKind::U8 => Stored::U8,
            VoxelKind::I16 => Stored::I16,
            VoxelKind::U16 => Stored::U16,
            VoxelKind::F32 => Stored::F32,
        };
        let described = Described {
            size,
            stored,
            big_endian: false,
            scale: 1.0,
            offset: 0.0,
            space_from_voxel,
            size_place: "size".into(),
            axes_place: "transform".into(),
        };
        let bytes = described.check(Path::new(name))?;
        Ok(Self::new(&described, bytes, Voxels { path: name.into(), data: voxels, rest: Some(0) }))
    }

    /// The same volume, whose header is in a file of its own.
    #[doc(hidden)]
    pub fn with_header(self, path: &Path) -> Self {
        Self { header_path: path.to_owned(), ..self }
    }

    /// The same volume, with a sentence about a choice of its reader.
    #[doc(hidden)]
    pub fn with_about(mut self, sentence: String) -> Self {
        self.about.push(sentence);
        self
    }

    /// The same volume, of whose values the format says that they are labels, or does not.
    #[doc(hidden)]
    pub fn with_labels(self, labels: NamedLabels) -> Self {
        Self { labels, ..self }
    }

    /// What the format says of labels.
    #[doc(hidden)]
    pub fn labels(&self) -> &NamedLabels {
        &self.labels
    }

    /// The same volume, whose reader holds this many bytes beside the buffers that all have.
    #[doc(hidden)]
    pub fn with_memory_bytes(self, memory_bytes: u64) -> Self {
        Self { memory_bytes, ..self }
    }

    /// Bytes that the reader of this format holds beside the buffers that all have.
    #[doc(hidden)]
    pub fn memory_bytes(&self) -> u64 {
        self.memory_bytes
    }

    /// `bytes` is the value that [`Described::check`] returned.
    #[doc(hidden)]
    pub fn new(described: &Described, bytes: u64, voxels: Voxels) -> Self {
        Self {
            size: described.size,
            kind: VoxelKind::of(described.stored),
            scale: described.scale,
            offset: described.offset,
            space_from_voxel: described.space_from_voxel,
            up: None,
            facing: None,
            about: Vec::new(),
            labels: NamedLabels::default(),
            stored: described.stored,
            big_endian: described.big_endian,
            header_path: voxels.path.clone(),
            voxels,
            bytes,
            position: 0,
            scratch: Vec::new(),
            memory_bytes: 0,
        }
    }

    /// Fills a buffer with the next voxels, little-endian, in the type [`kind`](Self::kind).
    /// Infinities and NaN become 0. After the last voxel, the end of the file and the checksums of
    /// compressed data are checked.
    ///
    /// # Errors
    /// [`VolumeError::Data`] if the file ends early or late, is damaged, or has a finite number out
    /// of the range of single precision.
    pub fn read(&mut self, voxels: &mut [u8]) -> Result<(), VolumeError> {
        let (width, out_width) = (self.stored.bytes(), self.kind.bytes());
        let bytes = voxels.len() / out_width * width;
        self.scratch.resize(bytes, 0);
        let read = self.voxels.data.read_exact(&mut self.scratch);
        read.map_err(|error| self.wrong(self.position, what_of(&error)))?;
        for (number, (from, to)) in
            self.scratch.chunks_exact_mut(width).zip(voxels.chunks_exact_mut(out_width)).enumerate()
        {
            if self.big_endian {
                from.reverse();
            }
            if !self.stored.convert(from, to) {
                let offset = self.position + (number * width) as u64;
                return Err(self.wrong(offset, "a number is larger than single precision holds".into()));
            }
        }
        self.position += bytes as u64;
        if self.position == self.bytes { self.check_end() } else { Ok(()) }
    }

    /// Checks that exactly the expected bytes follow the voxels. The decoders verify checksums at
    /// the end of compressed data.
    fn check_end(&mut self) -> Result<(), VolumeError> {
        let Some(rest) = self.voxels.rest else { return Ok(()) };
        let found = io::copy(&mut (&mut self.voxels.data).take(rest.saturating_add(1)), &mut io::sink());
        match found {
            Ok(found) if found == rest => Ok(()),
            Ok(found) if found < rest => {
                let what = format!("{rest} bytes of data should follow the voxels, and {found} do");
                Err(self.wrong(self.bytes, what))
            }
            Ok(_) => {
                let what = "the data go on behind the voxels: they are not of the size that the header says";
                Err(self.wrong(self.bytes, what.into()))
            }
            Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => {
                Err(self.wrong(self.bytes, "the file ends before its data do; it is cut off".into()))
            }
            Err(error) => Err(self.wrong(self.bytes, error.to_string())),
        }
    }

    fn wrong(&self, offset: u64, what: String) -> VolumeError {
        VolumeError::Data { path: self.voxels.path.clone(), offset, what }
    }
}

/// A description of an error that is more specific than the system's.
pub fn what_of(error: &io::Error) -> String {
    if error.kind() == io::ErrorKind::UnexpectedEof {
        "the file ends before all voxels are there".into()
    } else {
        error.to_string()
    }
}
