//! MetaImage (ITK): `.mha` that contains its voxels, `.mhd` with the voxels in another file; plain or zlib.
//!
//! As in ITK's own library, `HeaderSize` counts from the start of the file that holds the voxels, whichever that is, and −1
//! means that the voxels are its last bytes. Compressed data end after `CompressedDataSize` bytes, or with the file if that
//! is not given. Nothing may follow voxels in the file of the header, or compressed data; a separate file of plain voxels
//! may continue.

use std::path::Path;

use super::data::{Begin, Compression, Place, Voxels, regular_file_bytes};
use super::error::ReadError;
use super::fields::{Lines, counts, numbers};
use super::orientation::Orientation;
use super::source::{Described, VolumeSource};
use crate::geometry::{DAffine3, DMat3, DVec3};
use crate::numbers::Stored;

#[derive(Default)]
struct Header {
    size: Option<([u64; 3], String)>,
    stored: Option<Stored>,
    /// `ElementSpacing`, which takes precedence, and `ElementSize`.
    spacing: Option<[f64; 3]>,
    element_size: Option<[f64; 3]>,
    offset: DVec3,
    matrix: DMat3,
    /// Where the spacing or the directions were last given.
    axes_place: String,
    big_endian: bool,
    compressed: bool,
    compressed_bytes: Option<u64>,
    /// `HeaderSize` and its place in the header.
    skip: Option<(i64, String)>,
    orientation: Orientation,
}

pub(super) fn open(path: &Path) -> Result<VolumeSource, ReadError> {
    let mut lines = Lines::open(path)?;
    let mut header = Header { axes_place: "ElementSpacing".into(), ..Header::default() };
    let name = loop {
        let Some(line) = lines.next()? else {
            let what = "the header ends without ElementDataFile; is this a MetaImage?";
            return Err(ReadError::header(path, &lines.place(""), what));
        };
        let Some((key, value)) = line.split_once('=').map(|(key, value)| (key.trim(), value.trim())) else {
            return Err(ReadError::header(path, &lines.place(""), "expected `Key = value`"));
        };
        if key == "ElementDataFile" {
            break value.to_owned();
        }
        let place = lines.place(key);
        header.take(key, value, &place).map_err(|what| ReadError::header(path, &place, what))?;
    };
    if name.is_empty() || name.starts_with("LIST") || name.contains('%') {
        let what = "expected LOCAL or the name of one file; volumes in several files are not read";
        return Err(ReadError::header(path, &lines.place("ElementDataFile"), what));
    }
    let described = header.described(path)?;
    let bytes = described.check(path)?;
    let voxels = if name.eq_ignore_ascii_case("local") {
        header.voxels(path, lines.bytes, bytes, Some(0))?
    } else {
        header.voxels(&path.with_file_name(&name), 0, bytes, None)?
    };
    Ok(VolumeSource::new(&described, bytes, voxels).with_orientation(header.orientation))
}

impl Header {
    fn take(&mut self, key: &str, value: &str, place: &str) -> Result<(), &'static str> {
        let three = || numbers(value).ok_or("expected three finite numbers");
        match key {
            "NDims" if value != "3" => return Err("only volumes of three dimensions are read"),
            "DimSize" => {
                self.size =
                    Some((counts(value).ok_or("expected three numbers of voxels")?, place.to_owned()));
            }
            "ElementSpacing" => self.spacing = Some(three()?),
            "ElementSize" => self.element_size = Some(three()?),
            "Offset" | "Position" | "Origin" => self.offset = DVec3::from_array(three()?),
            "TransformMatrix" | "Rotation" | "Orientation" => {
                let all: [f64; 9] = numbers(value).ok_or("expected nine finite numbers")?;
                self.matrix = DMat3::from_cols_array(&all);
            }
            "ElementNumberOfChannels" if value != "1" => return Err("only one number a voxel is read"),
            "BinaryData" if !truth(value)? => return Err("only binary voxels are read"),
            "BinaryDataByteOrderMSB" | "ElementByteOrderMSB" => self.big_endian = truth(value)?,
            "CompressedData" => self.compressed = truth(value)?,
            "CompressedDataSize" => {
                self.compressed_bytes = Some(value.parse().map_err(|_| "expected a number of bytes")?);
            }
            "HeaderSize" => {
                let skip: i64 = value.parse().map_err(|_| "expected a number of bytes, or -1")?;
                if skip < -1 {
                    return Err("expected a number of bytes, or -1");
                }
                self.skip = Some((skip, place.to_owned()));
            }
            // It names the sides from which the axes of the voxels come, and the matrix says the same more exactly. Whatever
            // it is, positions are ITK's: to the left, to the back, up.
            "AnatomicalOrientation" if Orientation::of_patient(value).is_some() => {
                self.orientation = Orientation::of_patient("LPS").unwrap_or_default();
            }
            "ElementType" => {
                self.stored = Some(element(value).ok_or("expected a type like MET_USHORT")?);
            }
            _ => {}
        }
        if matches!(key, "ElementSpacing" | "ElementSize" | "TransformMatrix" | "Rotation" | "Orientation") {
            place.clone_into(&mut self.axes_place);
        }
        Ok(())
    }

    fn described(&self, path: &Path) -> Result<Described, ReadError> {
        let missing = |key: &str| ReadError::header(path, key, "missing");
        let (size, size_place) = self.size.clone().ok_or_else(|| missing("DimSize"))?;
        let spacing = DVec3::from_array(self.spacing.or(self.element_size).unwrap_or([1.0; 3]));
        let linear = self.matrix * DMat3::from_diagonal(spacing);
        Ok(Described {
            size,
            stored: self.stored.ok_or_else(|| missing("ElementType"))?,
            big_endian: self.big_endian,
            scale: 1.0,
            offset: 0.0,
            space_from_voxel: DAffine3::from_mat3_translation(linear, self.offset),
            size_place,
            axes_place: self.axes_place.clone(),
        })
    }

    /// Opens the voxels in a file whose first `least` bytes are the header.
    fn voxels(&self, path: &Path, least: u64, bytes: u64, rest: Option<u64>) -> Result<Voxels, ReadError> {
        let (skip, place) = self.skip.clone().unwrap_or_default();
        let start = match u64::try_from(skip) {
            Ok(0) => least,
            Ok(skip) if skip >= least => skip,
            Ok(_) => return Err(ReadError::header(path, &place, "the voxels begin in the header")),
            Err(_) if self.compressed => {
                return Err(ReadError::header(path, &place, "-1 is for voxels that are not compressed"));
            }
            // If the file is too short, the error is reported for the earliest place at which the voxels could begin.
            Err(_) => regular_file_bytes(path)?.saturating_sub(bytes).max(least),
        };
        let place = Place { path, start, bytes, rest };
        if self.compressed {
            let limit = self.compressed_bytes.filter(|bytes| *bytes > 0);
            return Place { rest: Some(0), ..place }.compressed(Compression::Zlib, limit, Begin::After(0));
        }
        place.plain()
    }
}

/// Parses a truth value by its first letter, as ITK's library does.
fn truth(value: &str) -> Result<bool, &'static str> {
    match value.as_bytes().first() {
        Some(b'T' | b't' | b'1') => Ok(true),
        Some(b'F' | b'f' | b'0') => Ok(false),
        _ => Err("expected True or False"),
    }
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
