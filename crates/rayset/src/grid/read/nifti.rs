//! NIfTI-1 (`n+1`), plain or gzip: the first volume of the file, with its sform, else its qform, else its spacing.

use std::io::{BufReader, Read};
use std::path::Path;

use super::{Described, ReadError, Stored, VolumeSource, data_at, gzip};
use crate::geometry::{DAffine3, DMat3, DQuat, DVec3};

const HEADER_BYTES: usize = 348;

/// Numbers of a header, in the byte order of the file.
struct Fields {
    bytes: [u8; HEADER_BYTES],
    big_endian: bool,
}

impl Fields {
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
}

pub(super) fn open(path: &Path) -> Result<VolumeSource, ReadError> {
    let wrong = |byte: usize, what: &str| ReadError::Header {
        path: path.to_owned(),
        place: format!("byte {byte}"),
        what: what.to_owned(),
    };
    let file = data_at(path, 0)?;
    let zipped = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("gz"));
    let mut data: Box<dyn Read + Send> = if zipped { gzip(file) } else { Box::new(file) };
    let mut bytes = [0; HEADER_BYTES];
    let read = data.read_exact(&mut bytes);
    read.map_err(|_| wrong(0, "the file ends within the header of 348 bytes"))?;
    let little = i32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]) == HEADER_BYTES as i32;
    let fields = Fields { bytes, big_endian: !little };
    if i32::from_le_bytes(fields.array(0)) != HEADER_BYTES as i32 || &bytes[344..347] != b"n+1" {
        return Err(wrong(344, "this is not a NIfTI-1 file of one part (`n+1`)"));
    }
    let dimensions = fields.i16(40);
    let mut size = [0; 3];
    for (axis, n) in size.iter_mut().enumerate() {
        *n = u64::try_from(fields.i16(42 + 2 * axis)).map_err(|_| wrong(42, "a size is negative"))?;
    }
    if !(3..=7).contains(&dimensions) {
        return Err(wrong(40, "only volumes of three dimensions, or series of them, are read"));
    }
    let stored = match fields.i16(70) {
        2 => Stored::U8,
        4 => Stored::I16,
        8 => Stored::I32,
        16 => Stored::F32,
        64 => Stored::F64,
        256 => Stored::I8,
        512 => Stored::U16,
        768 => Stored::U32,
        _ => {
            return Err(wrong(
                70,
                "expected voxels of one real number (datatype 2, 4, 8, 16, 64, 256, 512 or 768)",
            ));
        }
    };
    let (slope, intercept) = (fields.f32(112), fields.f32(116));
    let scaled = slope != 0.0 && slope.is_finite() && intercept.is_finite();
    let start = fields.f32(108) as u64;
    let gap =
        start.checked_sub(HEADER_BYTES as u64).ok_or_else(|| wrong(108, "the voxels begin in the header"))?;
    let mut data = BufReader::new(data);
    let skipped = std::io::copy(&mut Read::by_ref(&mut data).take(gap), &mut std::io::sink());
    skipped.map_err(|source| ReadError::Io { path: path.to_owned(), source })?;
    let described = Described {
        size,
        stored,
        big_endian: fields.big_endian,
        scale: if scaled { slope } else { 1.0 },
        offset: if scaled { intercept } else { 0.0 },
        space_from_voxel: place(&fields),
    };
    Ok(VolumeSource::new(path, described, Box::new(data)))
}

/// Where the voxels are.
fn place(fields: &Fields) -> DAffine3 {
    let spacing =
        DVec3::new(fields.f32(80), fields.f32(84), fields.f32(88)).map(|v| if v > 0.0 { v } else { 1.0 });
    if fields.i16(254) > 0 {
        let row = |at: usize| [fields.f32(at), fields.f32(at + 4), fields.f32(at + 8), fields.f32(at + 12)];
        let rows = [row(280), row(296), row(312)];
        let column = |c: usize| DVec3::new(rows[0][c], rows[1][c], rows[2][c]);
        return DAffine3::from_mat3_translation(DMat3::from_cols(column(0), column(1), column(2)), column(3));
    }
    if fields.i16(252) > 0 {
        let (b, c, d) = (fields.f32(256), fields.f32(260), fields.f32(264));
        let a = (1.0 - b * b - c * c - d * d).max(0.0).sqrt();
        // The third axis is turned round where qfac, pixdim[0], is −1.
        let handed = if fields.f32(76) < 0.0 { -1.0 } else { 1.0 };
        let linear = DMat3::from_quat(DQuat::from_xyzw(b, c, d, a).normalize())
            * DMat3::from_diagonal(spacing * DVec3::new(1.0, 1.0, handed));
        let origin = DVec3::new(fields.f32(268), fields.f32(272), fields.f32(276));
        return DAffine3::from_mat3_translation(linear, origin);
    }
    DAffine3::from_scale(spacing)
}
