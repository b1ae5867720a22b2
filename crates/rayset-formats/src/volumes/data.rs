//! Locates the voxels of a volume in a file, plain or compressed, and checks that the file can hold
//! all of them.

use std::io::{self, BufRead, BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use flate2::bufread::{MultiGzDecoder, ZlibDecoder};

use rayset_base::regular_file;
use rayset_files::grid::{VolumeError, Voxels, what_of};
use rayset_store::storage::input_file::{InputFile, Named, look};

/// Upper bound on the compression ratio of Deflate, which needs at least 2 bits to encode at most
/// 258 bytes.
pub(super) const MOST_DEFLATED: u64 = 1032;

/// Whether a file begins as those of gzip do. Errors are left to whoever opens it.
pub(super) fn is_gzip(path: &Path) -> bool {
    let mut magic = [0; 2];
    InputFile::open(path).is_ok_and(|mut file| file.read_exact(&mut magic).is_ok()) && magic == [0x1f, 0x8b]
}

/// How the data are compressed.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Compression {
    /// One or several members in a row.
    Gzip,
    Zlib,
}

/// Where the voxels begin in the decompressed data.
#[derive(Clone, Copy)]
pub(super) enum Begin {
    /// After this number of bytes.
    After(u64),
    /// At the place from which exactly this number of bytes follow the last voxel.
    BeforeLast(u64),
}

/// Where the voxels of a volume are expected.
pub(super) struct VoxelSpan<'a> {
    pub(super) path: &'a Path,
    /// Offset in the file of their first byte.
    pub(super) start: u64,
    /// Bytes of all voxels of the volume.
    pub(super) bytes: u64,
    /// See [`Voxels::rest`].
    pub(super) rest: Option<u64>,
}

impl VoxelSpan<'_> {
    fn wrong(&self, offset: u64, what: String) -> VolumeError {
        VolumeError::Data { path: self.path.to_owned(), offset, what }
    }

    /// Opens uncompressed voxels.
    pub(super) fn plain(self) -> Result<Voxels, VolumeError> {
        let length = regular_file_bytes(self.path)?;
        let Self { start, bytes, .. } = self;
        let end = start.saturating_add(bytes).saturating_add(self.rest.unwrap_or(0));
        if length < end {
            let what = format!(
                "the file ends before all voxels are there: its header asks for bytes {start} to {end}, and it has \
                 {length}"
            );
            return Err(self.wrong(length.saturating_sub(start).min(bytes), what));
        }
        if self.rest.is_some() && length > end {
            let what = format!(
                "the file goes on behind the voxels: its header asks for bytes {start} to {end}, and it has {length}"
            );
            return Err(self.wrong(bytes, what));
        }
        let data = Box::new(data_at(self.path, start)?.take(bytes));
        Ok(Voxels { path: self.path.to_owned(), data, rest: None })
    }

    /// Opens voxels in compressed data of at most `limit` bytes. The data are read to their end, so
    /// that their checksum is verified.
    pub(super) fn compressed(
        self,
        compression: Compression,
        limit: Option<u64>,
        begin: Begin,
    ) -> Result<Voxels, VolumeError> {
        let length = regular_file_bytes(self.path)?.saturating_sub(self.start);
        let limit = limit.unwrap_or(u64::MAX);
        let open = || -> Result<Box<dyn Read + Send>, VolumeError> {
            let file = data_at(self.path, self.start)?.take(limit);
            Ok(match compression {
                Compression::Gzip => Box::new(MultiGzDecoder::new(file)),
                Compression::Zlib => Box::new(ZlibDecoder::new(file)),
            })
        };
        let wrong = |error: io::Error| self.wrong(0, what_of(&error));
        let (Begin::After(around) | Begin::BeforeLast(around)) = begin;
        let needed = around.saturating_add(self.bytes).saturating_add(self.rest.unwrap_or(0));
        if needed / MOST_DEFLATED > length.min(limit) {
            let what = format!(
                "the file ends before all voxels are there: {} compressed bytes cannot hold the {needed} bytes that \
                 its header asks for",
                length.min(limit)
            );
            return Err(self.wrong(0, what));
        }
        let (before, rest) = match begin {
            Begin::After(before) => (before, self.rest),
            Begin::BeforeLast(behind) => {
                // The decompressed length is only known after reading all of it.
                let all = io::copy(&mut open()?, &mut io::sink()).map_err(wrong)?;
                let before = all.checked_sub(behind.saturating_add(self.bytes));
                let short = || {
                    let what =
                        format!("the file ends before all voxels are there: it holds {all} bytes of data");
                    self.wrong(0, what)
                };
                (before.ok_or_else(short)?, Some(behind))
            }
        };
        let mut data = open()?;
        let skipped = io::copy(&mut Read::by_ref(&mut data).take(before), &mut io::sink()).map_err(wrong)?;
        if skipped < before {
            let what =
                format!("the data end after {skipped} bytes, before the {before} that are to be skipped");
            return Err(self.wrong(0, what));
        }
        Ok(Voxels { path: self.path.to_owned(), data, rest })
    }
}

pub(super) fn io_error(path: &Path) -> impl Fn(io::Error) -> VolumeError {
    move |source| VolumeError::Io { path: path.to_owned(), source }
}

/// The length in bytes of a regular file; an error for a pipe, a device or a folder.
pub(super) fn regular_file_bytes(path: &Path) -> Result<u64, VolumeError> {
    match look(path).map_err(io_error(path))? {
        Named::File(bytes) => Ok(bytes),
        _ => Err(VolumeError::NotRegular { path: path.to_owned() }),
    }
}

/// A buffered reader that starts at a byte of a file.
pub(super) fn data_at(path: &Path, offset: u64) -> Result<BufReader<InputFile>, VolumeError> {
    // Checked before it is opened: opening a pipe waits for its other end.
    regular_file_bytes(path)?;
    let mut file = InputFile::open(path).map_err(io_error(path))?;
    file.seek(SeekFrom::Start(offset)).map_err(io_error(path))?;
    Ok(BufReader::with_capacity(1 << 16, file))
}

/// The number of bytes in the `lines` lines that begin at byte `start`, including their ends.
/// `None` if there are fewer lines.
pub(super) fn skip_lines(path: &Path, start: u64, lines: u64) -> Result<Option<u64>, VolumeError> {
    let mut file = data_at(path, start)?;
    let (mut left, mut bytes) = (lines, 0);
    while left > 0 {
        let held = regular_file::held(&mut file).map_err(io_error(path))?;
        if held.is_empty() {
            return Ok(None);
        }
        let end = held.iter().position(|&byte| byte == b'\n');
        left -= u64::from(end.is_some());
        let used = end.map_or(held.len(), |end| end + 1);
        file.consume(used);
        bytes += used as u64;
    }
    Ok(Some(bytes))
}
