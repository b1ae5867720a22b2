//! MetaImage (ITK): `.mha` with its voxels, `.mhd` beside them; plain or zlib.

use std::io::BufRead;
use std::path::Path;

use super::{Described, ReadError, Stored, VolumeSource, counts, data_at, numbers, zlib};
use crate::geometry::{DAffine3, DMat3, DVec3};

pub(super) fn open(path: &Path) -> Result<VolumeSource, ReadError> {
    let io = |source| ReadError::Io { path: path.to_owned(), source };
    let wrong = |place: &str, what: &str| ReadError::Header {
        path: path.to_owned(),
        place: place.to_owned(),
        what: what.to_owned(),
    };
    let mut file = data_at(path, 0)?;
    let (mut size, mut stored, mut data_file) = (None, None, None);
    let (mut spacing, mut offset, mut matrix) = ([1.0; 3], [0.0; 3], DMat3::IDENTITY);
    let (mut big_endian, mut compressed, mut skip) = (false, false, 0_i64);
    let (mut line, mut header_bytes) = (String::new(), 0_u64);
    for number in 1.. {
        line.clear();
        let mut limited = std::io::Read::take(&mut file, 1 << 16);
        let read = limited.read_line(&mut line).map_err(io)?;
        header_bytes += read as u64;
        if read == 0 {
            return Err(wrong(&format!("line {number}"), "the header ends without ElementDataFile"));
        }
        let Some((key, value)) = line.split_once('=').map(|(k, v)| (k.trim(), v.trim())) else {
            return Err(wrong(&format!("line {number}"), "expected `Key = value`"));
        };
        let bad = |what: &str| wrong(&format!("line {number}, {key}"), what);
        let truth = || value.eq_ignore_ascii_case("true");
        match key {
            "NDims" if value != "3" => return Err(bad("only volumes of three dimensions are read")),
            "DimSize" => size = Some(counts(value).ok_or_else(|| bad("expected three numbers of voxels"))?),
            "ElementSpacing" | "ElementSize" => {
                spacing = numbers(value).ok_or_else(|| bad("expected three numbers"))?;
            }
            "Offset" | "Position" | "Origin" => {
                offset = numbers(value).ok_or_else(|| bad("expected three numbers"))?;
            }
            "TransformMatrix" | "Rotation" | "Orientation" => {
                let all: [f64; 9] = numbers(value).ok_or_else(|| bad("expected nine numbers"))?;
                matrix = DMat3::from_cols_array(&all);
            }
            "ElementNumberOfChannels" if value != "1" => return Err(bad("only one number a voxel is read")),
            "BinaryData" if !truth() => return Err(bad("only binary voxels are read")),
            "BinaryDataByteOrderMSB" | "ElementByteOrderMSB" => big_endian = truth(),
            "CompressedData" => compressed = truth(),
            "HeaderSize" => skip = value.parse().map_err(|_| bad("expected a number of bytes"))?,
            "ElementType" => {
                stored = Some(element(value).ok_or_else(|| bad("expected a type like MET_USHORT"))?);
            }
            "ElementDataFile" => {
                data_file = Some(value.to_owned());
                break;
            }
            _ => {}
        }
    }
    let size = size.ok_or_else(|| wrong("DimSize", "missing"))?;
    let stored = stored.ok_or_else(|| wrong("ElementType", "missing"))?;
    let name = data_file.unwrap_or_default();
    if name == "LIST" || name.contains('%') {
        return Err(wrong("ElementDataFile", "volumes in several files are not read"));
    }
    let local = name.eq_ignore_ascii_case("local");
    let data_path = if local { path.to_owned() } else { path.with_file_name(&name) };
    let bytes = size.iter().product::<u64>().saturating_mul(stored.bytes() as u64);
    let start = match (local, skip) {
        (true, _) => header_bytes,
        (false, skip) if skip >= 0 => skip as u64,
        (false, _) => std::fs::metadata(&data_path).map_err(io)?.len().saturating_sub(bytes),
    };
    let data = data_at(&data_path, start)?;
    let linear = matrix * DMat3::from_diagonal(DVec3::from_array(spacing));
    let described = Described {
        size,
        stored,
        big_endian,
        scale: 1.0,
        offset: 0.0,
        space_from_voxel: DAffine3::from_mat3_translation(linear, DVec3::from_array(offset)),
    };
    Ok(VolumeSource::new(&data_path, described, if compressed { zlib(data) } else { Box::new(data) }))
}

fn element(name: &str) -> Option<Stored> {
    Some(match name {
        "MET_CHAR" => Stored::I8,
        "MET_UCHAR" => Stored::U8,
        "MET_SHORT" => Stored::I16,
        "MET_USHORT" => Stored::U16,
        "MET_INT" | "MET_LONG" => Stored::I32,
        "MET_UINT" | "MET_ULONG" => Stored::U32,
        "MET_FLOAT" => Stored::F32,
        "MET_DOUBLE" => Stored::F64,
        _ => return None,
    })
}
