//! NRRD (teem), attached or detached: raw and gzip encodings, three axes.

use std::io::BufRead;
use std::path::Path;

use super::{Described, ReadError, Stored, VolumeSource, counts, data_at, gzip, numbers};
use crate::geometry::{DAffine3, DMat3, DVec3};

#[derive(Default)]
struct Header {
    size: Option<[u64; 3]>,
    stored: Option<Stored>,
    big_endian: bool,
    encoding: String,
    spacings: Option<[f64; 3]>,
    directions: Option<DMat3>,
    origin: Option<DVec3>,
    data_file: Option<String>,
    byte_skip: i64,
    line_skip: u64,
}

pub(super) fn open(path: &Path) -> Result<VolumeSource, ReadError> {
    let io = |source| ReadError::Io { path: path.to_owned(), source };
    let wrong = |place: &str, what: &str| ReadError::Header {
        path: path.to_owned(),
        place: place.to_owned(),
        what: what.to_owned(),
    };
    let mut file = data_at(path, 0)?;
    let (mut header, mut offset, mut line) = (Header::default(), 0_u64, String::new());
    for number in 1.. {
        line.clear();
        // A header line is short; this bounds what a file without any line ends costs.
        let mut limited = std::io::Read::take(&mut file, 1 << 16);
        let read = limited.read_line(&mut line).map_err(io)?;
        offset += read as u64;
        let text = line.trim_end();
        let place = format!("line {number}");
        if number == 1 {
            if !text.starts_with("NRRD000") {
                return Err(wrong(&place, "this is not NRRD: a file begins with NRRD000 and its version"));
            }
        } else if text.is_empty() {
            break;
        } else if !text.starts_with('#') && !text.contains(":=") {
            let (key, value) = text.split_once(':').ok_or_else(|| wrong(&place, "expected `key: value`"))?;
            let place = format!("line {number}, {}", key.trim());
            header.take(key.trim(), value.trim()).map_err(|what| wrong(&place, what))?;
        }
    }
    let size = header.size.ok_or_else(|| wrong("sizes", "missing; expected three numbers of voxels"))?;
    let stored = header.stored.ok_or_else(|| wrong("type", "missing"))?;
    let linear = match (header.directions, header.spacings) {
        (Some(directions), _) => directions,
        (None, Some(spacings)) => DMat3::from_diagonal(DVec3::from_array(spacings)),
        (None, None) => DMat3::IDENTITY,
    };
    let space_from_voxel = DAffine3::from_mat3_translation(linear, header.origin.unwrap_or(DVec3::ZERO));
    let (data_path, mut start) = match &header.data_file {
        Some(name) => (path.with_file_name(name), 0),
        None => (path.to_owned(), offset),
    };
    if header.line_skip > 0 {
        return Err(wrong("line skip", "only 0 is read"));
    }
    let bytes = size.iter().product::<u64>().saturating_mul(stored.bytes() as u64);
    if header.byte_skip < 0 {
        let length = std::fs::metadata(&data_path).map_err(io)?.len();
        start = length.saturating_sub(bytes);
    } else if header.encoding == "raw" {
        start += header.byte_skip as u64;
    }
    let data = data_at(&data_path, start)?;
    let data = match header.encoding.as_str() {
        "raw" => Box::new(data),
        "gzip" | "gz" => gzip(data),
        _ => return Err(wrong("encoding", "expected raw or gzip")),
    };
    let big_endian = header.big_endian;
    let described = Described { size, stored, big_endian, scale: 1.0, offset: 0.0, space_from_voxel };
    Ok(VolumeSource::new(&data_path, described, data))
}

impl Header {
    fn take(&mut self, key: &str, value: &str) -> Result<(), &'static str> {
        match key {
            "dimension" if value != "3" => return Err("only volumes of three dimensions are read"),
            "sizes" => self.size = Some(counts(value).ok_or("expected three numbers of voxels")?),
            "type" => {
                self.stored = Some(stored(value).ok_or("expected a type of numbers, as in unsigned char")?);
            }
            "endian" => self.big_endian = value == "big",
            "encoding" => self.encoding = value.to_lowercase(),
            "spacings" => self.spacings = Some(numbers(value).ok_or("expected three numbers")?),
            "space directions" => {
                let columns = vectors(value).and_then(|v| <[DVec3; 3]>::try_from(v).ok());
                let [x, y, z] = columns.ok_or("expected three vectors like (1,0,0)")?;
                self.directions = Some(DMat3::from_cols(x, y, z));
            }
            "space origin" => {
                let origin =
                    vectors(value).filter(|v| v.len() == 1).ok_or("expected a vector like (0,0,0)")?;
                self.origin = Some(origin[0]);
            }
            "data file" | "datafile" => self.data_file = Some(value.to_owned()),
            "byte skip" | "byteskip" => {
                self.byte_skip = value.parse().map_err(|_| "expected a number of bytes")?;
            }
            "line skip" | "lineskip" => {
                self.line_skip = value.parse().map_err(|_| "expected a number of lines")?;
            }
            _ => {}
        }
        Ok(())
    }
}

/// Vectors like `(1,0,0) (0,1,0)`; `none` is left out.
fn vectors(text: &str) -> Option<Vec<DVec3>> {
    let words = text.split_inclusive(')').map(str::trim).filter(|word| !word.is_empty() && *word != "none");
    words
        .map(|word| {
            let inside = word.trim_start_matches("none").trim().strip_prefix('(')?.strip_suffix(')')?;
            let all: Option<Vec<f64>> = inside.split(',').map(|n| n.trim().parse().ok()).collect();
            all.and_then(|all| <[f64; 3]>::try_from(all).ok()).map(DVec3::from_array)
        })
        .collect()
}

fn stored(name: &str) -> Option<Stored> {
    Some(match name {
        "signed char" | "int8" | "int8_t" => Stored::I8,
        "uchar" | "unsigned char" | "uint8" | "uint8_t" => Stored::U8,
        "short" | "short int" | "signed short" | "signed short int" | "int16" | "int16_t" => Stored::I16,
        "ushort" | "unsigned short" | "unsigned short int" | "uint16" | "uint16_t" => Stored::U16,
        "int" | "signed int" | "int32" | "int32_t" => Stored::I32,
        "uint" | "unsigned int" | "uint32" | "uint32_t" => Stored::U32,
        "float" => Stored::F32,
        "double" => Stored::F64,
        _ => return None,
    })
}
