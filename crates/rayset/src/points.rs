//! Point input: streaming readers for common file formats, and generators for the standard
//! workloads.
//!
//! A [`PointSource`] delivers points in batches and never holds a whole file in memory. Positions
//! are `f64` in the file's own coordinates; everything else is a column with a name and a type. The
//! builder decides what a column means (radius, weight, colour) and what happens to invalid
//! records.

#[doc(hidden)]
pub use rayset_files::points::WorkloadView;
pub use rayset_files::points::{
    ColorDepth, ColumnInfo, ColumnLengthError, ColumnSlice, ColumnType, HARMONIC, HARMONIC_CONSTANTS, Place,
    PointBatch, PointSource, PositionSlice, ROUND_RADIUS, ReadError, SHAPE_COLUMNS, Schema, SliceSource,
    Values, Workload,
};
#[doc(hidden)]
pub use rayset_formats::points::InTurn;
#[cfg(feature = "internals")]
#[doc(hidden)]
pub use rayset_formats::points::*;
pub use rayset_formats::points::{MeshSource, PlyWriter, ReadOptions, open};
