//! NRRD (teem), attached or detached: raw and gzip encodings, three axes.
//!
//! Skipping follows the format's own library (teem, `formatNRRD.c` and `encodingGzip.c`): first `line skip` lines of the
//! file as stored, then `byte skip` bytes, which are counted in the decompressed data if the data are compressed. A `byte
//! skip` of −1 means that the voxels are at the end of the data, and −n − 1 that n bytes follow them. Nothing else may
//! follow voxels in the file of the header, or in compressed data; a separate file of plain data may continue.

use std::path::Path;

use super::data::{Begin, Compression, Place, Voxels, regular_file_bytes, skip_lines};
use super::error::ReadError;
use super::fields::{Lines, counts, numbers};
use super::orientation::Orientation;
use super::source::{Described, VolumeSource};
use crate::geometry::{DAffine3, DMat3, DVec3};
use crate::numbers::Stored;

#[derive(Default)]
struct Header {
    /// The keys seen so far, so that repeated ones are detected, and their places.
    keys: Vec<(&'static str, String)>,
    size: Option<[u64; 3]>,
    stored: Option<Stored>,
    big_endian: Option<bool>,
    encoding: String,
    spacings: Option<[f64; 3]>,
    directions: Option<DMat3>,
    origin: Option<DVec3>,
    data_file: Option<String>,
    byte_skip: i64,
    line_skip: u64,
    orientation: Orientation,
}

pub(super) fn open(path: &Path) -> Result<VolumeSource, ReadError> {
    let mut lines = Lines::open(path)?;
    let mut header = Header::default();
    if !lines.next()?.is_some_and(|first| first.starts_with("NRRD000")) {
        let what = "this is not NRRD: a file begins with NRRD000 and its version";
        return Err(ReadError::header(path, "line 1", what));
    }
    while let Some(text) = lines.next()? {
        let text = text.trim_end();
        if text.is_empty() {
            break;
        }
        if text.starts_with('#') || text.contains(":=") {
            continue;
        }
        let (key, value) = text
            .split_once(':')
            .ok_or_else(|| ReadError::header(path, &lines.place(""), "expected `key: value`"))?;
        let place = lines.place(key.trim());
        header
            .take(key.trim(), value.trim(), &place)
            .map_err(|what| ReadError::header(path, &place, what))?;
    }
    let described = header.described(path)?;
    let bytes = described.check(path)?;
    let voxels = header.voxels(path, lines.bytes, bytes)?;
    Ok(VolumeSource::new(&described, bytes, voxels).with_orientation(header.orientation))
}

impl Header {
    /// The place of a key in the header; the key itself if it is missing.
    fn place(&self, wanted: &'static str) -> String {
        self.keys.iter().find(|(key, _)| *key == wanted).map_or_else(|| wanted.into(), |(_, at)| at.clone())
    }

    fn described(&self, path: &Path) -> Result<Described, ReadError> {
        let missing =
            |key: &str, what: &str| ReadError::header(path, key, &format!("missing; expected {what}"));
        let size = self.size.ok_or_else(|| missing("sizes", "three numbers of voxels"))?;
        let stored = self.stored.ok_or_else(|| missing("type", "a type of numbers, as in unsigned char"))?;
        if self.big_endian.is_none() && stored.bytes() > 1 {
            return Err(missing("endian", "little or big, as numbers have several bytes"));
        }
        let (linear, axes) = match (self.directions, self.spacings) {
            (Some(directions), _) => (directions, "space directions"),
            (None, Some(spacings)) => (DMat3::from_diagonal(DVec3::from_array(spacings)), "spacings"),
            (None, None) => (DMat3::IDENTITY, "space origin"),
        };
        Ok(Described {
            size,
            stored,
            big_endian: self.big_endian.unwrap_or(false),
            scale: 1.0,
            offset: 0.0,
            space_from_voxel: DAffine3::from_mat3_translation(linear, self.origin.unwrap_or(DVec3::ZERO)),
            size_place: self.place("sizes"),
            axes_place: self.place(axes),
        })
    }

    fn voxels(&self, path: &Path, header_bytes: u64, bytes: u64) -> Result<Voxels, ReadError> {
        let wrong = |key: &'static str, what: &str| ReadError::header(path, &self.place(key), what);
        let compressed = match self.encoding.as_str() {
            "raw" => false,
            "gzip" | "gz" => true,
            _ => return Err(wrong("encoding", "expected raw or gzip")),
        };
        let beside = self.data_file.as_ref().map(|name| path.with_file_name(name));
        let (path, behind) = match &beside {
            Some(beside) => (beside.as_path(), 0),
            None => (path, header_bytes),
        };
        let lines = skip_lines(path, behind, self.line_skip)?
            .ok_or_else(|| wrong("line skip", "the file has fewer lines"))?;
        let start = behind + lines;
        if compressed {
            let begin = match u64::try_from(self.byte_skip) {
                Ok(before) => Begin::After(before),
                Err(_) => Begin::BeforeLast((-1 - self.byte_skip) as u64),
            };
            return Place { path, start, bytes, rest: Some(0) }.compressed(Compression::Gzip, None, begin);
        }
        if self.byte_skip < 0 {
            let behind = (-1 - self.byte_skip) as u64;
            let first = regular_file_bytes(path)?.checked_sub(bytes.saturating_add(behind));
            let start = first.filter(|first| *first >= start).unwrap_or(start);
            return Place { path, start, bytes, rest: Some(behind) }.plain();
        }
        let start = start.saturating_add(self.byte_skip as u64);
        Place { path, start, bytes, rest: beside.is_none().then_some(0) }.plain()
    }

    fn take(&mut self, key: &str, value: &str, place: &str) -> Result<(), &'static str> {
        let Some(known) = KEYS.iter().find(|names| names.contains(&key)) else { return Ok(()) };
        let key = known[0];
        if self.keys.iter().any(|(seen, _)| *seen == key) {
            return Err("this was said before; every key stands in a header once");
        }
        self.keys.push((key, place.to_owned()));
        match key {
            "dimension" if value != "3" => return Err("only volumes of three dimensions are read"),
            "sizes" => self.size = Some(counts(value).ok_or("expected three numbers of voxels")?),
            "type" => {
                self.stored = Some(stored(value).ok_or("expected a type of numbers, as in unsigned char")?);
            }
            "endian" => {
                self.big_endian = match value.to_ascii_lowercase().as_str() {
                    "big" => Some(true),
                    "little" => Some(false),
                    _ => return Err("expected little or big"),
                };
            }
            "encoding" => self.encoding = value.to_lowercase(),
            "spacings" => self.spacings = Some(numbers(value).ok_or("expected three finite numbers")?),
            "space directions" => {
                let columns = vectors(value).and_then(|v| <[DVec3; 3]>::try_from(v).ok());
                let [x, y, z] = columns.ok_or("expected three vectors of finite numbers like (1,0,0)")?;
                self.directions = Some(DMat3::from_cols(x, y, z));
            }
            "space origin" => {
                let origin = vectors(value).filter(|v| v.len() == 1);
                self.origin = Some(origin.ok_or("expected a vector of finite numbers like (0,0,0)")?[0]);
            }
            "space" => self.orientation = orientation(value),
            "data file" if value == "LIST" || value.starts_with("LIST ") || value.contains('%') => {
                return Err("volumes in several files are not read");
            }
            "data file" => self.data_file = Some(value.to_owned()),
            "byte skip" => self.byte_skip = value.parse().map_err(|_| "expected a number of bytes")?,
            "line skip" => self.line_skip = value.parse().map_err(|_| "expected a number of lines")?,
            _ => {}
        }
        Ok(())
    }
}

/// The keys that are used, each with its other spellings.
const KEYS: [&[&str]; 12] = [
    &["dimension"],
    &["sizes"],
    &["type"],
    &["endian"],
    &["encoding"],
    &["spacings"],
    &["space"],
    &["space directions"],
    &["space origin"],
    &["data file", "datafile"],
    &["byte skip", "byteskip"],
    &["line skip", "lineskip"],
];

/// What the name of a space says of its axes, by its initials or in words: those of patients name the sides to which the
/// axes point. Other spaces, like `scanner-xyz`, say nothing of up.
fn orientation(space: &str) -> Orientation {
    let words = space.split('-').filter_map(|word| word.chars().next());
    let initials: String = if space.contains('-') { words.collect() } else { space.to_owned() };
    Orientation::of_patient(&initials.to_ascii_uppercase()).unwrap_or_default()
}

/// Vectors like `(1,0,0) (0,1,0)`; `none` is skipped.
fn vectors(text: &str) -> Option<Vec<DVec3>> {
    let words = text.split_inclusive(')').map(str::trim).filter(|word| !word.is_empty() && *word != "none");
    words
        .map(|word| {
            let inside = word.trim_start_matches("none").trim().strip_prefix('(')?.strip_suffix(')')?;
            let all: Option<Vec<f64>> = inside.split(',').map(|n| n.trim().parse().ok()).collect();
            let vector = all.and_then(|all| <[f64; 3]>::try_from(all).ok()).map(DVec3::from_array);
            vector.filter(|vector| vector.is_finite())
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
