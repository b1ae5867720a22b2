//! Point input: streaming readers for common file formats, and generators for the standard workloads.
//!
//! A [`PointSource`] delivers points in batches and never holds a whole file in memory. Positions are `f64` in the file's
//! own coordinates; everything else is a column with a name and a type. The builder decides what a column means (radius,
//! weight, colour) and what happens to invalid records.

mod array;
mod column;
mod error;
#[cfg(feature = "las")]
mod las;
mod mesh;
mod ply;
mod ply_body;
mod ply_header;
mod ply_write;
mod roles;
mod slices;
mod source;
mod synthetic;
mod text;

use std::path::Path;

#[cfg(feature = "internals")]
#[doc(hidden)]
pub use self::array::ArraySource;
#[cfg(not(feature = "internals"))]
pub(crate) use self::array::ArraySource;
pub use self::column::{ColumnInfo, ColumnType, Values};
pub use self::error::{Place, ReadError};
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
pub use self::source::{ColorDepth, PointBatch, PointSource, Schema};
pub use self::synthetic::{View, Workload};
#[cfg(feature = "internals")]
#[doc(hidden)]
pub use self::text::TextSource;
#[cfg(not(feature = "internals"))]
use self::text::TextSource;
use crate::setters::setters;

/// Information for a reader that some formats do not contain.
#[derive(Clone, Debug, Default)]
#[cfg_attr(not(feature = "internals"), non_exhaustive)]
pub struct ReadOptions {
    /// Names of all columns of text files, overriding their header; `-` or an empty name skips a column.
    pub text_columns: Option<Vec<String>>,
}

setters!(ReadOptions { with_text_columns => text_columns: Option<Vec<String>> });

/// Opens a file, in the format that its extension indicates.
///
/// # Errors
/// [`ReadError`] if the file cannot be opened, its header is malformed, or its extension is unknown.
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
