//! NIfTI-1 (`n+1`), plain or gzip: one volume of the file, the first unless another is asked for,
//! placed by its sform, otherwise its qform, otherwise its spacing.
//!
//! As in the format's own library, a spacing that is not positive counts as 1. Voxels are scaled if
//! `scl_slope` is finite and not 0. Before and after the volume there are the other volumes of its
//! series, and nothing else.

use std::io::Read;
use std::path::Path;

use flate2::bufread::MultiGzDecoder;

use super::data::{Begin, Compression, VoxelSpan, data_at};
use super::label_table;
use super::orientation::Orientation;
use super::series::Series;
use rayset_base::geometry::{DAffine3, DMat3, DQuat, DVec3};
use rayset_base::numbers::Stored;
use rayset_files::grid::VolumeError;
use rayset_files::grid::labels::NamedLabels;
use rayset_files::grid::{Described, VolumeSource};

const HEADER_BYTES: usize = 348;

/// Byte offsets of the fields.
const DIM: usize = 40;
const INTENT: usize = 68;
const DATATYPE: usize = 70;
const PIXDIM: usize = 76;
const VOX_OFFSET: usize = 108;
const SCL_SLOPE: usize = 112;
const SCL_INTER: usize = 116;
const QFORM_CODE: usize = 252;
const SFORM_CODE: usize = 254;
const QUATERN: usize = 256;
const QOFFSET: usize = 268;
const SROW: usize = 280;
const MAGIC: usize = 344;

/// The fields of a header, in the byte order of the file.
struct Fields<'a> {
    path: &'a Path,
    bytes: [u8; HEADER_BYTES],
    big_endian: bool,
}

impl Fields<'_> {
    fn array<const N: usize>(&self, at: usize) -> [u8; N] {
        let mut out = [0; N];
        out.copy_from_slice(&self.bytes[at..at + N]);
        if self.big_endian {
            out.reverse();
        }
        out
    }

    fn i16(&self, at: usize) -> i16 {
        i16::from_le_bytes(self.array(at))
    }

    fn f32(&self, at: usize) -> f64 {
        f64::from(f32::from_le_bytes(self.array(at)))
    }

    /// `N` consecutive numbers, all of which must be finite.
    fn finite<const N: usize>(&self, at: usize, name: &str) -> Result<[f64; N], VolumeError> {
        let all = std::array::from_fn(|i| self.f32(at + 4 * i));
        match all.iter().position(|v| !v.is_finite()) {
            None => Ok(all),
            Some(i) => Err(self.wrong(at + 4 * i, name, "expected a finite number")),
        }
    }

    fn wrong(&self, byte: usize, name: &str, what: &str) -> VolumeError {
        let place = if name.is_empty() { format!("byte {byte}") } else { format!("byte {byte}, {name}") };
        VolumeError::header(self.path, &place, what)
    }
}

pub(super) fn open(path: &Path, index: Option<u64>) -> Result<VolumeSource, VolumeError> {
    let zipped = super::data::is_gzip(path);
    let fields = fields(path, zipped)?;
    let (size, volumes) = size(&fields)?;
    let stored = match fields.i16(DATATYPE) {
        2 => Stored::U8,
        4 => Stored::I16,
        8 => Stored::I32,
        16 => Stored::F32,
        64 => Stored::F64,
        256 => Stored::I8,
        512 => Stored::U16,
        768 => Stored::U32,
        _ => {
            let what = "expected voxels of one real number (2, 4, 8, 16, 64, 256, 512 or 768)";
            return Err(fields.wrong(DATATYPE, "datatype", what));
        }
    };
    let slope = fields.f32(SCL_SLOPE);
    let (scale, offset) = if slope != 0.0 && slope.is_finite() {
        let [intercept] = fields.finite(SCL_INTER, "scl_inter")?;
        (slope, intercept)
    } else {
        (1.0, 0.0)
    };
    let (space_from_voxel, axes) = place(&fields)?;
    let described = Described {
        size,
        stored,
        big_endian: fields.big_endian,
        scale,
        offset,
        space_from_voxel,
        size_place: format!("byte {}, dim", DIM + 2),
        axes_place: axes.into(),
    };
    let bytes = described.check(path)?;
    let [start] = fields.finite(VOX_OFFSET, "vox_offset")?;
    if start < HEADER_BYTES as f64 || start.fract() != 0.0 {
        let what = "expected a whole number of bytes; voxels begin at 348 or later";
        return Err(fields.wrong(VOX_OFFSET, "vox_offset", what));
    }
    let series = Series::new(path, volumes, index)?;
    let all = bytes.checked_mul(volumes).ok_or_else(|| fields.wrong(DIM, "dim", "the series is too long"))?;
    let before = bytes * series.index;
    let (first, rest) = ((start as u64).saturating_add(before), all - before - bytes);
    let place = VoxelSpan { path, start: if zipped { 0 } else { first }, bytes, rest: Some(rest) };
    let voxels = if zipped {
        place.compressed(Compression::Gzip, None, Begin::After(first))?
    } else {
        place.plain()?
    };
    // The axes of every space that has a code point to the right, to the front and up.
    let of_patient = fields.i16(SFORM_CODE) > 0 || fields.i16(QFORM_CODE) > 0;
    let orientation = Orientation::of_patient("RAS").filter(|_| of_patient).unwrap_or_default();
    let source = orientation.applied_to(VolumeSource::new(&described, bytes, voxels));
    Ok(series.said_by(source).with_labels(labels(&fields, zipped, start as u64)))
}

/// What the header and its extensions, which end where voxels begin, say of labels.
fn labels(fields: &Fields<'_>, zipped: bool, begin: u64) -> NamedLabels {
    /// The code for values that are labels (`NIFTI_INTENT_LABEL`).
    const LABEL: i16 = 1002;
    /// The header, and four bytes that say whether there are extensions.
    const BEFORE: u64 = HEADER_BYTES as u64 + 4;
    let length = begin.saturating_sub(BEFORE).min(label_table::MOST_BYTES);
    let read = || {
        let file = data_at(fields.path, 0).ok()?;
        let mut data: Box<dyn Read> =
            if zipped { Box::new(MultiGzDecoder::new(file)) } else { Box::new(file) };
        let mut head = [0; BEFORE as usize];
        data.read_exact(&mut head).ok()?;
        let mut extensions = Vec::new();
        data.take(length).read_to_end(&mut extensions).ok()?;
        (head[HEADER_BYTES] != 0).then_some(extensions)
    };
    let extensions = if length > 0 { read() } else { None };
    let mut labels = label_table::of_extensions(&extensions.unwrap_or_default(), fields.big_endian);
    labels.said |= fields.i16(INTENT) == LABEL;
    labels
}

fn fields(path: &Path, zipped: bool) -> Result<Fields<'_>, VolumeError> {
    let file = data_at(path, 0)?;
    let mut data: Box<dyn Read> = if zipped { Box::new(MultiGzDecoder::new(file)) } else { Box::new(file) };
    let mut bytes = [0; HEADER_BYTES];
    let read = data.read_exact(&mut bytes);
    read.map_err(|error| {
        let what = if error.kind() == std::io::ErrorKind::UnexpectedEof {
            "the file ends within the header of 348 bytes".into()
        } else {
            format!("the header of 348 bytes cannot be read: {error}")
        };
        VolumeError::header(path, "byte 0", &what)
    })?;
    let little = i32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]) == HEADER_BYTES as i32;
    let fields = Fields { path, bytes, big_endian: !little };
    if i32::from_le_bytes(fields.array(0)) != HEADER_BYTES as i32 || &bytes[MAGIC..MAGIC + 3] != b"n+1" {
        return Err(fields.wrong(MAGIC, "magic", "this is not a NIfTI-1 file of one part (`n+1`)"));
    }
    Ok(fields)
}

/// The number of voxels along each axis, and the number of volumes.
fn size(fields: &Fields<'_>) -> Result<([u64; 3], u64), VolumeError> {
    let dimensions = fields.i16(DIM);
    if !(3..=7).contains(&dimensions) {
        let what = "only volumes of three dimensions, or series of them, are read";
        return Err(fields.wrong(DIM, "dim", what));
    }
    let mut size = [0; 3];
    for (axis, n) in size.iter_mut().enumerate() {
        let at = DIM + 2 + 2 * axis;
        *n = u64::try_from(fields.i16(at)).map_err(|_| fields.wrong(at, "dim", "a size is negative"))?;
    }
    // The product of four 16-bit numbers fits in 64 bits.
    let volumes = (4..=dimensions as usize).map(|axis| fields.i16(DIM + 2 * axis).max(1) as u64).product();
    Ok((size, volumes))
}

/// The transform from voxels to space, and its place in the header.
fn place(fields: &Fields<'_>) -> Result<(DAffine3, &'static str), VolumeError> {
    if fields.i16(SFORM_CODE) > 0 {
        let all: [f64; 12] = fields.finite(SROW, "srow")?;
        let column = |c: usize| DVec3::new(all[c], all[4 + c], all[8 + c]);
        let linear = DMat3::from_cols(column(0), column(1), column(2));
        return Ok((DAffine3::from_mat3_translation(linear, column(3)), "byte 280, srow"));
    }
    let spacing: [f64; 3] = fields.finite(PIXDIM + 4, "pixdim")?;
    let spacing = DVec3::from_array(spacing.map(|v| if v > 0.0 { v } else { 1.0 }));
    if fields.i16(QFORM_CODE) > 0 {
        let [b, c, d] = fields.finite(QUATERN, "quatern")?;
        let origin: [f64; 3] = fields.finite(QOFFSET, "qoffset")?;
        let [handed] = fields.finite(PIXDIM, "pixdim")?;
        let a = (1.0 - b * b - c * c - d * d).max(0.0).sqrt();
        // The third axis is reversed if qfac, pixdim[0], is negative.
        let handed = if handed < 0.0 { -1.0 } else { 1.0 };
        let linear = DMat3::from_quat(DQuat::from_xyzw(b, c, d, a).normalize())
            * DMat3::from_diagonal(spacing * DVec3::new(1.0, 1.0, handed));
        let affine = DAffine3::from_mat3_translation(linear, DVec3::from_array(origin));
        return Ok((affine, "byte 256, quatern"));
    }
    Ok((DAffine3::from_scale(spacing), "byte 80, pixdim"))
}
