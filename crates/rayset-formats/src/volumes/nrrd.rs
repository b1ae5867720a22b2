//! NRRD (teem), attached or detached: raw and gzip encodings, three axes, or four of a series.
//!
//! Of four axes, that of the series is the one without a direction in space, otherwise the one
//! whose `kinds` is no `domain` or `space`, otherwise the last. It must be the first, where the
//! voxels of all volumes lie side by side, or the last.
//!
//! Skipping follows the format's own library (teem, `formatNRRD.c` and `encodingGzip.c`): first
//! `line skip` lines of the file as stored, then `byte skip` bytes, which are counted in the
//! decompressed data if the data are compressed. A `byte skip` of −1 means that the voxels are at
//! the end of the data, and −n − 1 that n bytes follow them. Nothing else may follow voxels in the
//! file of the header, or in compressed data; a separate file of plain data may continue.

use std::path::Path;

use super::data::{Begin, Compression, VoxelSpan, regular_file_bytes, skip_lines};
use super::fields::Lines;
use super::orientation::Orientation;
use super::segments::Segments;
use super::series::Series;
use rayset_base::geometry::{DAffine3, DMat3, DVec3};
use rayset_base::numbers::Stored;
use rayset_files::grid::VolumeError;
use rayset_files::grid::{Described, VolumeSource, Voxels};

#[derive(Default)]
struct Header {
    /// The keys seen so far, so that repeated ones are detected, and their places.
    keys: Vec<(&'static str, String)>,
    sizes: Option<Vec<u64>>,
    stored: Option<Stored>,
    big_endian: Option<bool>,
    encoding: String,
    spacings: Option<Vec<f64>>,
    /// `None` for an axis that has none in space.
    directions: Option<Vec<Option<DVec3>>>,
    kinds: Vec<String>,
    origin: Option<DVec3>,
    data_file: Option<String>,
    byte_skip: i64,
    line_skip: u64,
    orientation: Orientation,
    segments: Segments,
}

pub(super) fn open(path: &Path, index: Option<u64>) -> Result<VolumeSource, VolumeError> {
    let mut lines = Lines::open(path)?;
    let mut header = Header::default();
    if !lines.next()?.is_some_and(|first| first.starts_with("NRRD000")) {
        let what = "this is not NRRD: a file begins with NRRD000 and its version";
        return Err(VolumeError::header(path, "line 1", what));
    }
    while let Some(text) = lines.next()? {
        let text = text.trim_end();
        if text.is_empty() {
            break;
        }
        if text.starts_with('#') {
            continue;
        }
        if let Some((key, value)) = text.split_once(":=") {
            header.segments.take(key.trim(), value.trim());
            continue;
        }
        let (key, value) = text
            .split_once(':')
            .ok_or_else(|| VolumeError::header(path, &lines.place(""), "expected `key: value`"))?;
        let place = lines.place(key.trim());
        header
            .take(key.trim(), value.trim(), &place)
            .map_err(|what| VolumeError::header(path, &place, what))?;
    }
    let described = header.described(path)?;
    let bytes = described.check(path)?;
    let axis = header.series_axis();
    let volumes = axis.and_then(|axis| header.sizes.as_ref()?.get(axis).copied()).unwrap_or(1);
    let series = Series::new(path, volumes, index)?;
    let too_long = || VolumeError::header(path, &header.place("sizes"), "a series longer than any file");
    let all = series.bytes(bytes).ok_or_else(too_long)?;
    let voxels = header.voxels(path, lines.bytes, all)?;
    let voxels = match axis {
        Some(0) => series
            .interleaved(voxels, bytes, described.stored.bytes())
            .map_err(|what| VolumeError::header(path, &header.place("sizes"), &what))?,
        Some(3) => series.in_sequence(voxels, bytes)?,
        _ => voxels,
    };
    let source = header.orientation.applied_to(VolumeSource::new(&described, bytes, voxels));
    Ok(series.said_by(source).with_labels(header.segments.of_layer(series.index)))
}

impl Header {
    /// The place of a key in the header; the key itself if it is missing.
    fn place(&self, wanted: &'static str) -> String {
        self.keys.iter().find(|(key, _)| *key == wanted).map_or_else(|| wanted.into(), |(_, at)| at.clone())
    }

    fn described(&self, path: &Path) -> Result<Described, VolumeError> {
        let missing =
            |key: &str, what: &str| VolumeError::header(path, key, &format!("missing; expected {what}"));
        let sizes = self.sizes.clone().ok_or_else(|| missing("sizes", "three numbers of voxels"))?;
        let axis = self.series_axis();
        if let Some(1 | 2) = axis {
            let what = "the axis of the series is between those of space; only the first or the last is read";
            return Err(VolumeError::header(path, &self.place("sizes"), what));
        }
        let of_space = |place: &usize| Some(*place) != axis;
        let in_space: Vec<u64> = (0..sizes.len()).filter(of_space).map(|place| sizes[place]).collect();
        let size = in_space.try_into().map_err(|_| missing("sizes", "three numbers of voxels"))?;
        let stored = self.stored.ok_or_else(|| missing("type", "a type of numbers, as in unsigned char"))?;
        if self.big_endian.is_none() && stored.bytes() > 1 {
            return Err(missing("endian", "little or big, as numbers have several bytes"));
        }
        let (linear, axes) = match (&self.directions, &self.spacings) {
            (Some(directions), _) => {
                let columns: Vec<DVec3> = directions.iter().copied().flatten().collect();
                let [x, y, z] = columns.try_into().unwrap_or([DVec3::ZERO; 3]);
                (DMat3::from_cols(x, y, z), "space directions")
            }
            (None, Some(spacings)) => {
                let series = axis.filter(|_| spacings.len() == sizes.len());
                let places = (0..spacings.len()).filter(|place| Some(*place) != series);
                let spacing: Option<[f64; 3]> =
                    places.map(|place| spacings[place]).collect::<Vec<_>>().try_into().ok();
                let spacing = spacing.filter(|spacing| spacing.iter().all(|v| v.is_finite()));
                let wrong =
                    || VolumeError::header(path, &self.place("spacings"), "expected three finite numbers");
                (DMat3::from_diagonal(DVec3::from_array(spacing.ok_or_else(wrong)?)), "spacings")
            }
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

    /// The axis of a series of volumes; `None` if there is one volume.
    fn series_axis(&self) -> Option<usize> {
        self.sizes.as_ref().filter(|sizes| sizes.len() == 4)?;
        let directions = self.directions.as_ref().filter(|directions| directions.len() == 4);
        let without = directions.and_then(|directions| directions.iter().position(Option::is_none));
        let in_space = |kind: &String| ["domain", "space"].contains(&kind.as_str());
        let kind = || self.kinds.iter().position(|kind| !in_space(kind)).filter(|_| self.kinds.len() == 4);
        Some(without.or_else(kind).unwrap_or(3))
    }

    fn voxels(&self, path: &Path, header_bytes: u64, bytes: u64) -> Result<Voxels, VolumeError> {
        let wrong = |key: &'static str, what: &str| VolumeError::header(path, &self.place(key), what);
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
            return VoxelSpan { path, start, bytes, rest: Some(0) }.compressed(
                Compression::Gzip,
                None,
                begin,
            );
        }
        if self.byte_skip < 0 {
            let behind = (-1 - self.byte_skip) as u64;
            let first = regular_file_bytes(path)?.checked_sub(bytes.saturating_add(behind));
            let start = first.filter(|first| *first >= start).unwrap_or(start);
            return VoxelSpan { path, start, bytes, rest: Some(behind) }.plain();
        }
        let start = start.saturating_add(self.byte_skip as u64);
        VoxelSpan { path, start, bytes, rest: beside.is_none().then_some(0) }.plain()
    }

    fn take(&mut self, key: &str, value: &str, place: &str) -> Result<(), &'static str> {
        let Some(known) = KEYS.iter().find(|names| names.contains(&key)) else { return Ok(()) };
        let key = known[0];
        if self.keys.iter().any(|(seen, _)| *seen == key) {
            return Err("this was said before; every key stands in a header once");
        }
        self.keys.push((key, place.to_owned()));
        match key {
            "dimension" if !["3", "4"].contains(&value) => {
                return Err("only volumes of three dimensions are read, and series of them");
            }
            "sizes" => {
                let sizes = list::<u64>(value).filter(|sizes| (3..=4).contains(&sizes.len()));
                self.sizes = Some(sizes.ok_or("expected three numbers of voxels, or four of a series")?);
            }
            "kinds" => self.kinds = value.split_ascii_whitespace().map(str::to_lowercase).collect(),
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
            "spacings" => {
                let spacings = list::<f64>(value).filter(|all| (3..=4).contains(&all.len()));
                self.spacings = Some(spacings.ok_or("expected three finite numbers")?);
            }
            "space directions" => {
                let columns = vectors(value).filter(|all| all.iter().flatten().count() == 3);
                let columns = columns.ok_or("expected three vectors of finite numbers like (1,0,0)")?;
                self.directions = Some(columns);
            }
            "space origin" => {
                let origin = vectors(value).filter(|v| v.len() == 1);
                let origin = origin.and_then(|origin| origin[0]);
                self.origin = Some(origin.ok_or("expected a vector of finite numbers like (0,0,0)")?);
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
const KEYS: [&[&str]; 13] = [
    &["kinds"],
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

/// What the name of a space says of its axes, by its initials or in words: those of patients name
/// the sides to which the axes point. Other spaces, like `scanner-xyz`, say nothing of up.
fn orientation(space: &str) -> Orientation {
    let words = space.split('-').filter_map(|word| word.chars().next());
    let initials: String = if space.contains('-') { words.collect() } else { space.to_owned() };
    Orientation::of_patient(&initials.to_ascii_uppercase()).unwrap_or_default()
}

/// Vectors like `(1,0,0) (0,1,0)`; `none`, or one that is nothing but NaN, is none.
fn vectors(text: &str) -> Option<Vec<Option<DVec3>>> {
    let mut all = Vec::new();
    let mut rest = text.trim();
    while !rest.is_empty() {
        if let Some(behind) = rest.strip_prefix("none") {
            all.push(None);
            rest = behind.trim_start();
            continue;
        }
        let (inside, behind) = rest.strip_prefix('(')?.split_once(')')?;
        let numbers: Option<Vec<f64>> = inside.split(',').map(|n| n.trim().parse().ok()).collect();
        let vector = DVec3::from_array(<[f64; 3]>::try_from(numbers?).ok()?);
        all.push(match vector {
            vector if vector.is_finite() => Some(vector),
            vector if vector.to_array().iter().all(|v| v.is_nan()) => None,
            _ => return None,
        });
        rest = behind.trim_start();
    }
    Some(all)
}

/// All words as numbers.
fn list<T: std::str::FromStr>(text: &str) -> Option<Vec<T>> {
    text.split_ascii_whitespace().take(5).map(|word| word.parse().ok()).collect()
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
