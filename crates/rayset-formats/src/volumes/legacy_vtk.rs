//! VTK's legacy files (`.vtk`) of a regular grid, `STRUCTURED_POINTS`, or a `RECTILINEAR_GRID` that
//! is evenly spaced: the first array of one number each of its points, otherwise of its cells at
//! their centres; as text or big-endian.

use std::io::Read;
use std::path::Path;

use super::data::{VoxelSpan, data_at, regular_file_bytes};
use super::fields::{Lines, counts, numbers};
use super::rectilinear::{Coordinates, Even};
use rayset_base::geometry::{DAffine3, DMat3, DVec3};
use rayset_base::numbers::Stored;
use rayset_base::text_numbers::{Behind, TextNumbers};
use rayset_files::grid::VolumeError;
use rayset_files::grid::{Described, VolumeSource, Voxels};

const FIRST_LINE: &str = "# vtk DataFile Version";
const REGULAR: &str = "STRUCTURED_POINTS";
/// Grids with coordinates along each axis.
const RECTILINEAR: &str = "RECTILINEAR_GRID";
/// Grids of other shapes, which are recognized to be refused.
const OTHER: &str = "STRUCTURED_GRID";

/// Whether a file begins as one of VTK's that has a grid of voxels, regular or not.
pub(super) fn is_grid(head: &[u8]) -> bool {
    let text = String::from_utf8_lossy(head).to_ascii_uppercase();
    let kind = text.lines().filter_map(|line| line.strip_prefix("DATASET ")).map(str::trim).next();
    head.starts_with(FIRST_LINE.as_bytes())
        && kind.is_some_and(|kind| [REGULAR, RECTILINEAR, OTHER].contains(&kind))
}

/// What arrays belong to.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Group {
    /// Nothing in space.
    Dataset,
    Points,
    Cells,
}

/// An array in the file.
struct Array {
    stored: Stored,
    /// The offset of its first number, or of the text before it.
    at: u64,
    /// The numbers of all its tuples.
    count: u64,
}

/// A file while it is read through.
struct File<'a> {
    path: &'a Path,
    lines: Lines,
    text: bool,
    size: Option<([u64; 3], String)>,
    even: Even,
    axes_place: String,
    group: Group,
    /// Tuples of each array of the group.
    tuples: u64,
    points: Option<Array>,
    cells: Option<Array>,
}

pub(super) fn open(path: &Path) -> Result<VolumeSource, VolumeError> {
    let mut file = File::open(path)?;
    while file.points.is_none() && file.next()? {}
    let (size, size_place) = file.size.clone().ok_or_else(|| file.wrong("DIMENSIONS: missing"))?;
    let (array, of_cells) = match (&file.points, &file.cells) {
        (Some(array), _) => (array, false),
        (None, Some(array)) => (array, true),
        (None, None) => return Err(file.wrong("the file has no array of one number for each point or cell")),
    };
    let size = if of_cells { size.map(|n| n.saturating_sub(1)) } else { size };
    let Even { first, spacing } = file.even;
    let origin = first + spacing * if of_cells { 0.5 } else { 0.0 };
    let described = Described {
        size,
        stored: array.stored,
        big_endian: !file.text,
        scale: 1.0,
        offset: 0.0,
        space_from_voxel: DAffine3::from_mat3_translation(DMat3::from_diagonal(spacing), origin),
        size_place: size_place.clone(),
        axes_place: file.axes_place.clone(),
    };
    let bytes = described.check(path)?;
    let count = bytes / array.stored.bytes() as u64;
    if array.count != count {
        let what =
            format!("{} voxels were expected from the dimensions, and the array has {}", count, array.count);
        return Err(VolumeError::header(path, &size_place, &what));
    }
    let voxels = if file.text {
        text(path, array)?
    } else {
        VoxelSpan { path, start: array.at, bytes, rest: None }.plain()?
    };
    Ok(VolumeSource::new(&described, bytes, voxels))
}

fn text(path: &Path, array: &Array) -> Result<Voxels, VolumeError> {
    let left = regular_file_bytes(path)?.saturating_sub(array.at);
    // At least one digit each, and one separator between two numbers.
    if array.count > left / 2 + 1 {
        let what =
            format!("the file ends before all voxels are there: {left} bytes for {} numbers", array.count);
        return Err(VolumeError::Data { path: path.to_owned(), offset: 0, what });
    }
    let data = TextNumbers::new(data_at(path, array.at)?, array.stored, array.count, Behind::Anything);
    Ok(Voxels { path: path.to_owned(), data: Box::new(data), rest: None })
}

impl<'a> File<'a> {
    fn open(path: &'a Path) -> Result<Self, VolumeError> {
        let mut lines = Lines::open(path)?;
        let first = lines.next()?.unwrap_or_default();
        if !first.starts_with(FIRST_LINE) {
            return Err(VolumeError::header(path, "line 1", &format!("expected `{FIRST_LINE}`")));
        }
        lines.next()?;
        let text = match lines.next()?.unwrap_or_default().trim().to_ascii_uppercase().as_str() {
            "ASCII" => true,
            "BINARY" => false,
            _ => return Err(VolumeError::header(path, "line 3", "expected ASCII or BINARY")),
        };
        Ok(Self {
            path,
            lines,
            text,
            size: None,
            even: Even { first: DVec3::ZERO, spacing: DVec3::ONE },
            axes_place: "SPACING".into(),
            group: Group::Dataset,
            tuples: 0,
            points: None,
            cells: None,
        })
    }

    fn wrong(&self, what: &str) -> VolumeError {
        VolumeError::header(self.path, &self.lines.place(""), what)
    }

    /// Reads a line and what belongs to it; false at the end of the file.
    fn next(&mut self) -> Result<bool, VolumeError> {
        let Some(line) = self.lines.next()? else { return Ok(false) };
        let (key, rest) = line.trim().split_once(char::is_whitespace).unwrap_or((line.trim(), ""));
        let three = |what: &str| {
            numbers(rest)
                .map(DVec3::from_array)
                .ok_or_else(|| self.wrong(&format!("{what}: expected three finite numbers")))
        };
        let words: Vec<&str> = rest.split_ascii_whitespace().collect();
        let number = |at: usize| words.get(at).and_then(|word| word.parse::<u64>().ok());
        match key.to_ascii_uppercase().as_str() {
            "" => {}
            "DATASET" => self.dataset(rest)?,
            "DIMENSIONS" => {
                let size = counts(rest).ok_or_else(|| self.wrong("expected three numbers of points"))?;
                self.size = Some((size, self.lines.place("DIMENSIONS")));
            }
            "ORIGIN" => self.even.first = three("ORIGIN")?,
            "SPACING" | "ASPECT_RATIO" => {
                self.even.spacing = three("SPACING")?;
                self.axes_place = self.lines.place("SPACING");
            }
            "X_COORDINATES" => self.coordinates(0, &words)?,
            "Y_COORDINATES" => self.coordinates(1, &words)?,
            "Z_COORDINATES" => self.coordinates(2, &words)?,
            "POINT_DATA" | "CELL_DATA" => {
                self.tuples = number(0).ok_or_else(|| self.wrong("expected a number of points or cells"))?;
                let points = key.eq_ignore_ascii_case("POINT_DATA");
                self.group = if points { Group::Points } else { Group::Cells };
            }
            "SCALARS" => self.scalars(&words)?,
            "FIELD" => {
                let count = number(1).ok_or_else(|| self.wrong("expected a name and a number of arrays"))?;
                for _ in 0..count {
                    self.array_of_field()?;
                }
            }
            "METADATA" => while self.lines.next()?.is_some_and(|line| !line.trim().is_empty()) {},
            "VECTORS" | "NORMALS" => self.array(words.get(1), 3, self.tuples)?,
            "TENSORS" => self.array(words.get(1), 9, self.tuples)?,
            "TEXTURE_COORDINATES" => self.array(words.get(2), number(1).unwrap_or(0), self.tuples)?,
            "GLOBAL_IDS" | "PEDIGREE_IDS" => self.array(words.get(1), 1, self.tuples)?,
            // Colours are bytes, or as text fractions of 1.
            "COLOR_SCALARS" => self.colors(number(1), self.tuples)?,
            "LOOKUP_TABLE" => self.colors(Some(4), number(1).unwrap_or(0))?,
            other => return Err(self.wrong(&format!("unknown keyword `{}`", other.escape_debug()))),
        }
        Ok(true)
    }

    fn dataset(&self, kind: &str) -> Result<(), VolumeError> {
        let kind = kind.trim().to_ascii_uppercase();
        if [REGULAR, RECTILINEAR].contains(&kind.as_str()) {
            return Ok(());
        }
        let what = format!(
            "the dataset is a {kind}, and {REGULAR} and evenly spaced {RECTILINEAR} are read as volumes; resample it to a regular grid, as \
             ParaView's filter Resample To Image does"
        );
        Err(self.wrong(&what))
    }

    /// Reads the coordinates of the points along an axis.
    fn coordinates(&mut self, axis: usize, words: &[&str]) -> Result<(), VolumeError> {
        let count = words.first().and_then(|word| word.parse::<u64>().ok());
        let kind = words.get(1).map(|kind| kind.to_ascii_lowercase()).unwrap_or_default();
        let (Some(count), Some(stored)) = (count, stored(&kind)) else {
            return Err(self.wrong("expected a number of coordinates and their type"));
        };
        let expected = self.size.as_ref().map(|(size, _)| size[axis]);
        if expected != Some(count) || count == 0 {
            let expected =
                expected.map_or("no DIMENSIONS before".to_owned(), |n| format!("{n} in DIMENSIONS"));
            return Err(self.wrong(&format!("{count} coordinates, and {expected}")));
        }
        let (place, path) = (self.lines.place(""), self.path);
        let array = Array { stored, at: self.lines.bytes, count };
        let is_text = self.text;
        let coordinates = Coordinates { axis, stored, big_endian: !is_text, count };
        // The file is checked to have all numbers before they are read.
        self.skip(count, count.saturating_mul(stored.bytes() as u64))?;
        let open = || -> Result<Box<dyn Read + Send>, VolumeError> {
            if is_text { Ok(text(path, &array)?.data) } else { Ok(Box::new(data_at(path, array.at)?)) }
        };
        let read = coordinates.read(&mut self.even, open)?;
        read.map_err(|what| VolumeError::header(path, &place, &what))?;
        self.axes_place = place;
        Ok(())
    }

    fn scalars(&mut self, words: &[&str]) -> Result<(), VolumeError> {
        let components = words.get(2).map_or(Some(1), |word| word.parse().ok());
        let components = components.ok_or_else(|| self.wrong("expected a number of components"))?;
        let table = self.lines.next()?.unwrap_or_default();
        if !table.trim_start().to_ascii_uppercase().starts_with("LOOKUP_TABLE") {
            return Err(self.wrong("expected LOOKUP_TABLE and its name behind SCALARS"));
        }
        self.array(words.get(1), components, self.tuples)
    }

    fn array_of_field(&mut self) -> Result<(), VolumeError> {
        let line = loop {
            let line = self.lines.next()?.ok_or_else(|| self.wrong("the file ends within a FIELD"))?;
            match line.trim() {
                "" => {}
                // It belongs to the array before.
                "METADATA" => while self.lines.next()?.is_some_and(|line| !line.trim().is_empty()) {},
                _ => break line,
            }
        };
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        let [_, components, tuples, kind] = words[..] else {
            return Err(self.wrong("expected a name, numbers of components and of tuples, and a type"));
        };
        let (Ok(components), Ok(tuples)) = (components.parse(), tuples.parse()) else {
            return Err(self.wrong("expected numbers of components and of tuples"));
        };
        self.array(Some(&kind), components, tuples)
    }

    /// Notes an array that begins here, if it is the first of one number for each point or cell,
    /// and goes on behind it.
    fn array(&mut self, kind: Option<&&str>, components: u64, tuples: u64) -> Result<(), VolumeError> {
        let kind = kind.map(|kind| kind.to_ascii_lowercase()).unwrap_or_default();
        let count = components.checked_mul(tuples);
        let count = count.ok_or_else(|| self.wrong("an array of more numbers than any file holds"))?;
        let wanted = components == 1 && tuples == self.tuples && self.group != Group::Dataset;
        let Some(stored) = stored(&kind) else {
            return self.skip_other(&kind, tuples, count);
        };
        let array = Array { stored, at: self.lines.bytes, count };
        match self.group {
            Group::Points if wanted => {
                self.points.get_or_insert(array);
                // Nothing behind it is of interest.
                return Ok(());
            }
            Group::Cells if wanted => drop(self.cells.get_or_insert(array)),
            _ => {}
        }
        self.skip(count, count.saturating_mul(stored.bytes() as u64))
    }

    /// Skips an array that is not of numbers: of bits, or of texts, which are a line each.
    fn skip_other(&mut self, kind: &str, tuples: u64, count: u64) -> Result<(), VolumeError> {
        match kind {
            "bit" => self.skip(count, count.div_ceil(8)),
            "string" if self.text => {
                for _ in 0..tuples {
                    self.lines.next()?;
                }
                Ok(())
            }
            _ => Err(self.wrong(&format!("unknown type `{}` of an array", kind.escape_debug()))),
        }
    }

    fn colors(&mut self, components: Option<u64>, tuples: u64) -> Result<(), VolumeError> {
        let count = components.and_then(|n| n.checked_mul(tuples));
        let count = count.ok_or_else(|| self.wrong("expected a number of components"))?;
        self.skip(count, count)
    }

    /// Goes on behind numbers, which are words of text, or so many bytes.
    fn skip(&mut self, words: u64, bytes: u64) -> Result<(), VolumeError> {
        let whole = if self.text { self.lines.skip_words(words)? } else { self.lines.skip_bytes(bytes)? };
        if whole { Ok(()) } else { Err(self.wrong("the file ends within an array")) }
    }
}

fn stored(kind: &str) -> Option<Stored> {
    Some(match kind {
        "unsigned_char" => Stored::U8,
        "char" | "signed_char" => Stored::I8,
        "unsigned_short" => Stored::U16,
        "short" => Stored::I16,
        "unsigned_int" => Stored::U32,
        // Identities are written with 32 bits, whatever they have in memory.
        "int" | "vtkidtype" => Stored::I32,
        "unsigned_long" | "vtktypeuint64" => Stored::U64,
        "long" | "vtktypeint64" => Stored::I64,
        "float" => Stored::F32,
        "double" => Stored::F64,
        _ => return None,
    })
}
