//! Points in: streaming readers for the files people have, and generators for the standard workloads.
//!
//! A [`PointSource`] hands out points in batches and never holds a whole file. Positions are `f64` in the file's own
//! coordinates; everything else is a column with a name and a type. What a column means (radius, weight, colour) is
//! decided by the builder, and so is what happens to invalid records.

mod array;
mod column;
#[cfg(feature = "las")]
mod las;
mod mesh;
mod ply;
mod ply_body;
mod ply_header;
mod ply_write;
mod roles;
mod slices;
mod synthetic;
mod text;

use std::path::{Path, PathBuf};
use std::{fmt, io};

#[cfg(feature = "internals")]
#[doc(hidden)]
pub use self::array::ArraySource;
#[cfg(not(feature = "internals"))]
pub(crate) use self::array::ArraySource;
pub use self::column::{ColumnInfo, ColumnType, Values};
#[cfg(all(feature = "internals", feature = "las"))]
#[doc(hidden)]
pub use self::las::LasSource;
#[cfg(all(not(feature = "internals"), feature = "las"))]
use self::las::LasSource;
pub use self::mesh::MeshSource;
#[cfg(feature = "internals")]
#[doc(hidden)]
pub use self::ply::PlySource;
#[cfg(not(feature = "internals"))]
use self::ply::PlySource;
pub use self::ply_write::PlyWriter;
pub use self::slices::{ColumnLengthError, ColumnSlice, PositionSlice, SliceSource};
pub use self::synthetic::{View, Workload};
#[cfg(feature = "internals")]
#[doc(hidden)]
pub use self::text::TextSource;
#[cfg(not(feature = "internals"))]
use self::text::TextSource;

/// How the numbers of the colour columns of a source are to be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ColorDepth {
    /// 0 to 1.
    Unit,
    /// 0 to 255.
    Byte,
    /// 0 to 65535.
    Word,
    /// Not stated by the format: decided from the largest value of the whole input (≤ 1, ≤ 255, or larger).
    Guess,
}

/// What a source offers besides positions.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Schema {
    /// Columns, in the order of [`PointBatch::columns`] before any selection. Colours are `red`, `green`, `blue`, as
    /// names or as roles.
    pub columns: Vec<ColumnInfo>,
    /// What columns are for that have other names: `red` of the column `r`. Each a role and the index of a column.
    pub roles: Vec<(String, usize)>,
    /// How to read the colour columns, if there are any.
    pub color_depth: ColorDepth,
    /// The coordinate reference system as the file has it (WKT, or GeoTIFF keys in words); empty where it has none.
    pub crs: String,
    /// What the file says of itself: format, version, the program that wrote it. Empty where it says nothing.
    pub description: String,
}

impl Schema {
    /// Columns alone.
    #[must_use]
    pub fn new(columns: Vec<ColumnInfo>, color_depth: ColorDepth) -> Self {
        Self { columns, roles: Vec::new(), color_depth, crs: String::new(), description: String::new() }
    }

    /// Index of the column that `name` means: the one of that name, else the one that has it as its role, else the one of
    /// that name in other letter case. Several names may mean one column.
    #[must_use]
    pub fn find(&self, name: &str) -> Option<usize> {
        roles::find(&self.columns, &self.roles, name)
    }

    /// Names of all columns.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.columns.iter().map(|c| c.name.as_str())
    }
}

/// A batch of points in columns; buffers are reused from one fill to the next.
#[derive(Clone, Debug, Default)]
pub struct PointBatch {
    /// Positions in the coordinates of the file, possibly not finite: readers pass on what they find.
    pub position: Vec<[f64; 3]>,
    /// One column for each selected column of the schema, of its type, and as long as `position`.
    pub columns: Vec<Values>,
}

impl PointBatch {
    /// Empties the batch and gives it the `selected` columns of a schema, keeping the buffers where types agree.
    ///
    /// Panics where an index is not one of the schema's.
    pub fn reset(&mut self, schema: &Schema, selected: &[usize]) {
        self.position.clear();
        self.columns.truncate(selected.len());
        for (place, &index) in selected.iter().enumerate() {
            let kind = schema.columns[index].kind;
            match self.columns.get_mut(place) {
                Some(column) if column.kind() == kind => column.clear(),
                Some(column) => *column = Values::empty(kind),
                None => self.columns.push(Values::empty(kind)),
            }
        }
    }

    /// Number of points.
    #[must_use]
    pub fn len(&self) -> usize {
        self.position.len()
    }

    /// Whether there are no points.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.position.is_empty()
    }
}

/// A stream of points. Anything that has points can be one: see [`SliceSource`] for a short example.
pub trait PointSource: Send {
    /// What the source offers.
    fn schema(&self) -> &Schema;
    /// Number of points that the file claims to hold; a claim, never trusted for an allocation.
    fn count_hint(&self) -> Option<u64>;
    /// The file that is read, if it is one: an output never replaces it.
    fn path(&self) -> Option<&Path> {
        None
    }
    /// Chooses the columns that [`fill`](Self::fill) delivers, by their index in the schema; one may be chosen more than
    /// once. Initially none.
    fn select(&mut self, columns: &[usize]);
    /// Bytes that reading holds at once besides the batch, at most. Sources that hold next to nothing say 0.
    fn memory_needed(&self) -> u64 {
        0
    }
    /// Replaces the contents of `batch` by up to `limit` further points; leaves it empty at the end.
    ///
    /// # Errors
    /// [`ReadError`] where the file cannot be read or breaks its format.
    fn fill(&mut self, batch: &mut PointBatch, limit: usize) -> Result<(), ReadError>;
}

/// A position in a file, for messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// One-based line of a text file.
    Line(u64),
    /// Byte offset from the start of the file.
    Byte(u64),
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Line(n) => write!(f, "line {n}"),
            Self::Byte(n) => write!(f, "byte {n}"),
        }
    }
}

/// Why points could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReadError {
    /// The operating system refused.
    #[error("cannot read {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        r#source: io::Error,
    },
    /// The file breaks the rules of its own format.
    #[error("{}, {place}: {what}", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// Where in it.
        place: Place,
        /// What was found and what was expected.
        what: String,
    },
    /// Points of a LAS or LAZ file could not be decoded.
    #[error("{}, byte {byte}: {what}; {read} of {count} points could be read", path.display())]
    Las {
        /// The file.
        path: PathBuf,
        /// Byte of the file, near where the damage is.
        byte: u64,
        /// What was found.
        what: String,
        /// Number of points before the damage.
        read: u64,
        /// Number of points that the header claims.
        count: u64,
    },
    /// This build of the library cannot read the format.
    #[error("{}: this build cannot read such files; compile it with the feature `{feature}`", path.display())]
    NotCompiled {
        /// The file.
        path: PathBuf,
        /// The cargo feature that it takes.
        feature: &'static str,
    },
    /// The extension names no format that can be read.
    #[error(
        "{}: unknown kind of file; expected .ply, .las, .laz, .xyz, .txt, .csv, .asc or .pts", path.display()
    )]
    UnknownFormat {
        /// The file.
        path: PathBuf,
    },
}

impl ReadError {
    fn malformed(path: &Path, place: Place, what: impl Into<String>) -> Self {
        Self::Malformed { path: path.to_owned(), place, what: what.into() }
    }
}

/// What a reader needs to be told because some formats do not say it.
#[derive(Clone, Debug, Default)]
pub struct ReadOptions {
    /// Names of all columns of text files, overriding their header; `-` or an empty name skips a column.
    pub text_columns: Option<Vec<String>>,
}

/// Opens a file by its extension.
///
/// # Errors
/// [`ReadError`] where the file cannot be opened, its header is malformed, or its extension is unknown.
pub fn open(path: &Path, options: &ReadOptions) -> Result<Box<dyn PointSource>, ReadError> {
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
    Ok(match extension.as_str() {
        "ply" => Box::new(PlySource::open(path)?),
        #[cfg(feature = "las")]
        "las" | "laz" => Box::new(LasSource::open(path)?),
        #[cfg(not(feature = "las"))]
        "las" | "laz" => return Err(ReadError::NotCompiled { path: path.to_owned(), feature: "las" }),
        "xyz" | "txt" | "csv" | "asc" | "pts" => {
            Box::new(TextSource::open(path, options.text_columns.as_deref())?)
        }
        _ => return Err(ReadError::UnknownFormat { path: path.to_owned() }),
    })
}
