//! MetaImage (ITK): `.mha` that contains its voxels, `.mhd` with the voxels in another file; plain
//! or zlib. Of more than three dimensions, the first three are those of space, and the others those
//! of a series of volumes.
//!
//! As in ITK's own library, `HeaderSize` counts from the start of the file that holds the voxels,
//! whichever that is, and −1 means that the voxels are its last bytes. Compressed data end after
//! `CompressedDataSize` bytes, or with the file if that is not given. Nothing may follow voxels in
//! the file of the header, or compressed data; a separate file of plain voxels may continue.

use std::path::Path;
use std::str::FromStr;

use super::data::{Begin, Compression, VoxelSpan, regular_file_bytes};
use super::fields::Lines;
use super::orientation::Orientation;
use super::series::Series;
use rayset_base::geometry::{DAffine3, DMat3, DVec3};
use rayset_base::numbers::Stored;
use rayset_files::grid::VolumeError;
use rayset_files::grid::{Described, VolumeSource, Voxels};

/// Most dimensions of a file.
const MOST_DIMENSIONS: usize = 10;

#[derive(Default)]
struct Header {
    /// Numbers of each list of axes: `NDims`, which stands before the others.
    dimensions: usize,
    /// Of all dimensions, with its place.
    size: Option<(Vec<u64>, String)>,
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

pub(super) fn open(path: &Path, index: Option<u64>) -> Result<VolumeSource, VolumeError> {
    let mut lines = Lines::open(path)?;
    let mut header = Header { dimensions: 3, axes_place: "ElementSpacing".into(), ..Header::default() };
    let name = loop {
        let Some(line) = lines.next()? else {
            let what = "the header ends without ElementDataFile; is this a MetaImage?";
            return Err(VolumeError::header(path, &lines.place(""), what));
        };
        let Some((key, value)) = line.split_once('=').map(|(key, value)| (key.trim(), value.trim())) else {
            return Err(VolumeError::header(path, &lines.place(""), "expected `Key = value`"));
        };
        if key == "ElementDataFile" {
            break value.to_owned();
        }
        let place = lines.place(key);
        header.take(key, value, &place).map_err(|what| VolumeError::header(path, &place, what))?;
    };
    if name.is_empty() || name.starts_with("LIST") || name.contains('%') {
        let what = "expected LOCAL or the name of one file; volumes in several files are not read";
        return Err(VolumeError::header(path, &lines.place("ElementDataFile"), what));
    }
    let described = header.described(path)?;
    let bytes = described.check(path)?;
    let too_long = || VolumeError::header(path, &described.size_place, "a series longer than any file");
    let series = Series::new(path, header.volumes().ok_or_else(too_long)?, index)?;
    let all = series.bytes(bytes).ok_or_else(too_long)?;
    let voxels = if name.eq_ignore_ascii_case("local") {
        header.voxels(path, lines.bytes, all, Some(0))?
    } else {
        header.voxels(&path.with_file_name(&name), 0, all, None)?
    };
    let source = VolumeSource::new(&described, bytes, series.in_sequence(voxels, bytes)?);
    Ok(series.said_by(header.orientation.applied_to(source)))
}

impl Header {
    fn take(&mut self, key: &str, value: &str, place: &str) -> Result<(), &'static str> {
        let three = || {
            let all = self.finite(value, 1).ok_or("expected a finite number for each of NDims dimensions")?;
            Ok::<_, &str>([all[0], all[1], all[2]])
        };
        match key {
            "NDims" => {
                let dimensions = value.parse().ok().filter(|n| (3..=MOST_DIMENSIONS).contains(n));
                self.dimensions =
                    dimensions.ok_or("only volumes of three dimensions are read, and series of them")?;
            }
            "DimSize" => {
                let all = self.list(value, 1);
                let all = all.ok_or("expected a number of voxels for each of NDims dimensions")?;
                self.size = Some((all, place.to_owned()));
            }
            "ElementSpacing" => self.spacing = Some(three()?),
            "ElementSize" => self.element_size = Some(three()?),
            "Offset" | "Position" | "Origin" => self.offset = DVec3::from_array(three()?),
            "TransformMatrix" | "Rotation" | "Orientation" => {
                let all = self
                    .finite(value, self.dimensions)
                    .ok_or("expected as many finite numbers as a matrix of NDims dimensions has")?;
                let of_axis = |axis: usize| DVec3::from_slice(&all[axis * self.dimensions..]);
                self.matrix = DMat3::from_cols(of_axis(0), of_axis(1), of_axis(2));
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
            // It names the sides from which the axes of the voxels come, and the matrix says the
            // same more exactly. Whatever it is, positions are ITK's: to the left, to the back, up.
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

    /// A list of as many numbers as there are dimensions, `times` over.
    fn list<T: FromStr>(&self, value: &str, times: usize) -> Option<Vec<T>> {
        let count = self.dimensions * times;
        let words = value.split_ascii_whitespace().take(count + 1);
        let all: Option<Vec<T>> = words.map(|word| word.parse().ok()).collect();
        all.filter(|all| all.len() == count)
    }

    /// As [`list`](Self::list), of finite numbers.
    fn finite(&self, value: &str, times: usize) -> Option<Vec<f64>> {
        self.list(value, times).filter(|all: &Vec<f64>| all.iter().all(|v| v.is_finite()))
    }

    /// The number of volumes: a product of sizes; `None` if no file has so many.
    fn volumes(&self) -> Option<u64> {
        let (sizes, _) = self.size.as_ref()?;
        sizes[3..].iter().try_fold(1_u64, |all, n| all.checked_mul(*n))
    }

    fn described(&self, path: &Path) -> Result<Described, VolumeError> {
        let missing = |key: &str| VolumeError::header(path, key, "missing");
        let (sizes, size_place) = self.size.as_ref().ok_or_else(|| missing("DimSize"))?;
        let size = [sizes[0], sizes[1], sizes[2]];
        let spacing = DVec3::from_array(self.spacing.or(self.element_size).unwrap_or([1.0; 3]));
        let linear = self.matrix * DMat3::from_diagonal(spacing);
        Ok(Described {
            size,
            stored: self.stored.ok_or_else(|| missing("ElementType"))?,
            big_endian: self.big_endian,
            scale: 1.0,
            offset: 0.0,
            space_from_voxel: DAffine3::from_mat3_translation(linear, self.offset),
            size_place: size_place.clone(),
            axes_place: self.axes_place.clone(),
        })
    }

    /// Opens the voxels in a file whose first `least` bytes are the header.
    fn voxels(&self, path: &Path, least: u64, bytes: u64, rest: Option<u64>) -> Result<Voxels, VolumeError> {
        let (skip, place) = self.skip.clone().unwrap_or_default();
        let start = match u64::try_from(skip) {
            Ok(0) => least,
            Ok(skip) if skip >= least => skip,
            Ok(_) => return Err(VolumeError::header(path, &place, "the voxels begin in the header")),
            Err(_) if self.compressed => {
                return Err(VolumeError::header(path, &place, "-1 is for voxels that are not compressed"));
            }
            // If the file is too short, the error is reported for the earliest place at which the
            // voxels could begin.
            Err(_) => regular_file_bytes(path)?.saturating_sub(bytes).max(least),
        };
        let place = VoxelSpan { path, start, bytes, rest };
        if self.compressed {
            let limit = self.compressed_bytes.filter(|bytes| *bytes > 0);
            return VoxelSpan { rest: Some(0), ..place }.compressed(
                Compression::Zlib,
                limit,
                Begin::After(0),
            );
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
