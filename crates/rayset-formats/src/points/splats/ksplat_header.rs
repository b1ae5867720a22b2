//! The headers of a `.ksplat` file: one of 4096 bytes for the file, and one of 1024 bytes for each
//! of its sections, which tell where the parts of the sections lie.
//!
//! Format: mkkellogg, *GaussianSplats3D*, version 0.1 of its `SplatBuffer`.

use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

use super::harmonics;
use super::splat::float;
use crate::points::{Place, ReadError};
use rayset_base::numbers::half;
use rayset_files::points::harmonics::CHANNELS;

const FILE_HEADER_BYTES: u64 = 4096;
const SECTION_HEADER_BYTES: u64 = 1024;
/// Bytes of a header that are read.
const HEADER_PART: usize = 64;
/// Bytes of the size of a bucket that is not full.
const BUCKET_SIZE_BYTES: u64 = 4;
/// Bytes of the centre of a bucket.
const CENTER_BYTES: u64 = 12;

/// How the numbers of a Gaussian are stored, the same in the whole file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Level {
    /// In single precision.
    Full,
    /// Positions in 16 bits relative to the centre of a bucket, deviations in half precision.
    /// Coefficients of view-dependent colours take two bytes, or one.
    Packed { harmonic_bytes: u64 },
}

impl Level {
    /// Bytes of a Gaussian without the coefficients: position, deviations, rotation, colour.
    pub(super) fn record_bytes(self) -> u64 {
        if self == Self::Full { 12 + 12 + 16 + 4 } else { 6 + 6 + 8 + 4 }
    }

    fn harmonic_bytes(self) -> u64 {
        if let Self::Packed { harmonic_bytes } = self { harmonic_bytes } else { 4 }
    }
}

/// The file's header.
#[derive(Clone, Copy, Debug)]
pub(super) struct KsplatHeader {
    pub(super) level: Level,
    pub(super) count: u64,
    pub(super) sections: u64,
    /// The largest degree of the harmonics of a section.
    pub(super) degree: u8,
    /// Coefficients that the bytes 0 and 255 stand for.
    harmonic_range: (f64, f64),
    file_bytes: u64,
}

/// Where the Gaussians of a section lie, and what their positions are relative to.
#[derive(Clone, Copy, Debug)]
pub(super) struct Section {
    pub(super) count: u64,
    /// Gaussians of a full bucket, and the number of these.
    pub(super) bucket_size: u64,
    pub(super) full_buckets: u64,
    pub(super) buckets: u64,
    /// Sizes of the buckets that are not full, centres of all, and Gaussians.
    pub(super) sizes_at: u64,
    pub(super) centers_at: u64,
    pub(super) center_stride: u64,
    pub(super) records_at: u64,
    pub(super) record_stride: u64,
    /// Coefficients of a channel besides the constant one.
    pub(super) coefficients: usize,
    pub(super) end: u64,
    /// Length of a step of a position, and the number of steps that stands for the centre.
    pub(super) step: f64,
    pub(super) range: u32,
}

/// The first bytes of a header.
struct Fields([u8; HEADER_PART]);

impl Fields {
    fn read(path: &Path, file: &mut (impl Read + Seek), at: u64) -> Result<Self, ReadError> {
        let mut bytes = [0; HEADER_PART];
        let read = file.seek(SeekFrom::Start(at)).and_then(|_| file.read_exact(&mut bytes));
        read.map_err(ReadError::io(path))?;
        Ok(Self(bytes))
    }

    fn short(&self, at: usize) -> u64 {
        u64::from(self.0[at]) | u64::from(self.0[at + 1]) << 8
    }

    fn word(&self, at: usize) -> u64 {
        self.short(at) | self.short(at + 2) << 16
    }

    fn float(&self, at: usize) -> f64 {
        f32::from_bits(self.word(at) as u32).into()
    }
}

impl KsplatHeader {
    /// Reads the file's header, and checks those of all sections.
    pub(super) fn read(
        path: &Path,
        file: &mut (impl Read + Seek),
        file_bytes: u64,
    ) -> Result<Self, ReadError> {
        let fail = |byte: u64, what: String| ReadError::malformed(path, Place::Byte(byte), what);
        if file_bytes < FILE_HEADER_BYTES {
            return Err(fail(
                file_bytes,
                format!("the file ends within its header of {FILE_HEADER_BYTES} bytes"),
            ));
        }
        let fields = Fields::read(path, file, 0)?;
        let (major, minor) = (fields.0[0], fields.0[1]);
        if (major, minor) != (0, 1) {
            return Err(fail(0, format!("version {major}.{minor} of ksplat; version 0.1 can be read")));
        }
        let level = match fields.short(20) {
            0 => Level::Full,
            1 => Level::Packed { harmonic_bytes: 2 },
            2 => Level::Packed { harmonic_bytes: 1 },
            other => return Err(fail(20, format!("compression level {other}; expected 0, 1 or 2"))),
        };
        let (sections, count) = (fields.word(4), fields.word(16));
        if FILE_HEADER_BYTES + sections * SECTION_HEADER_BYTES > file_bytes {
            return Err(fail(4, format!("{sections} sections, whose headers the file does not have")));
        }
        let or = |value: f64, or: f64| if value == 0.0 { or } else { value };
        let harmonic_range = (or(fields.float(36), -1.5), or(fields.float(40), 1.5));
        let mut header = Self { level, count, sections, degree: 0, harmonic_range, file_bytes };
        let (mut found, mut start) = (0, header.first());
        for index in 0..sections {
            let section = header.section(path, file, index, start)?;
            header.degree = header.degree.max(harmonics::degree(section.coefficients));
            (found, start) = (found + section.count, section.end);
        }
        if found != count {
            return Err(fail(16, format!("{count} splats, of which the sections have {found}")));
        }
        Ok(header)
    }

    /// The coefficient with a number among those of a record.
    pub(super) fn coefficient(&self, bytes: &[u8], number: usize) -> f64 {
        match self.level {
            Level::Full => float(&bytes[4 * number..]),
            Level::Packed { harmonic_bytes: 2 } => {
                half::from_le_bytes([bytes[2 * number], bytes[2 * number + 1]]).into()
            }
            Level::Packed { .. } => {
                let (low, high) = self.harmonic_range;
                low + f64::from(bytes[number]) / 255.0 * (high - low)
            }
        }
    }

    /// The first byte of the first section.
    pub(super) fn first(&self) -> u64 {
        FILE_HEADER_BYTES + self.sections * SECTION_HEADER_BYTES
    }

    /// Reads the header of section `index`, which starts at byte `start`.
    pub(super) fn section(
        &self,
        path: &Path,
        file: &mut (impl Read + Seek),
        index: u64,
        start: u64,
    ) -> Result<Section, ReadError> {
        let at = FILE_HEADER_BYTES + index * SECTION_HEADER_BYTES;
        let fail = |byte: u64, what: String| ReadError::malformed(path, Place::Byte(at + byte), what);
        let fields = Fields::read(path, file, at)?;
        let (count, most) = (fields.word(0), fields.word(4));
        let (bucket_size, buckets, center_stride) = (fields.word(8), fields.word(12), fields.short(20));
        let (full_buckets, partial_buckets) = (fields.word(32), fields.word(36));
        let harmonics = [0, 9, 24, 45].get(fields.short(40) as usize).copied();
        let harmonics: u64 = harmonics.ok_or_else(|| {
            fail(40, format!("spherical harmonics of degree {}; expected 0 to 3", fields.short(40)))
        })?;
        if count > most {
            return Err(fail(0, format!("{count} splats in a section for {most}")));
        }
        if self.level != Level::Full
            && count > 0
            && (full_buckets + partial_buckets > buckets || center_stride < CENTER_BYTES)
        {
            return Err(fail(
                12,
                format!(
                    "{buckets} buckets of {center_stride} bytes, of which {full_buckets} are full and {partial_buckets} are not"
                ),
            ));
        }
        let range = if fields.word(24) == 0 { 32767 } else { fields.word(24) };
        let centers_at = start + partial_buckets * BUCKET_SIZE_BYTES;
        let records_at = centers_at + buckets * center_stride;
        let record_stride = self.level.record_bytes() + harmonics * self.level.harmonic_bytes();
        let end = records_at + most * record_stride;
        if end > self.file_bytes {
            let what = format!("the section ends at byte {end}, but the file at byte {}", self.file_bytes);
            return Err(fail(0, what));
        }
        Ok(Section {
            count,
            bucket_size,
            full_buckets,
            buckets,
            sizes_at: start,
            centers_at,
            center_stride,
            records_at,
            record_stride,
            coefficients: harmonics as usize / CHANNELS,
            end,
            step: fields.float(16) / 2.0 / range as f64,
            range: range as u32,
        })
    }
}
