//! Point input: streaming readers for common file formats, and generators for the standard workloads.
//!
//! A [`PointSource`] delivers points in batches and never holds a whole file in memory. Positions are `f64` in the file's
//! own coordinates; everything else is a column with a name and a type. The builder decides what a column means (radius,
//! weight, colour) and what happens to invalid records.

mod array;
mod column;
mod decimal_mark;
#[cfg(feature = "e57")]
mod e57;
mod error;
mod formats;
mod gadget;
mod geographic;
mod in_turn;
#[cfg(feature = "las")]
mod las;
mod lines;
mod lzf;
mod mesh;
mod npy;
mod packed;
mod particles;
mod pcd;
mod plain;
mod ply;
mod ply_body;
mod ply_header;
mod ply_write;
mod ptx;
mod quiet;
mod reading;
mod refusals;
mod refused_kinds;
mod roles;
mod siblings;
mod slices;
#[cfg(feature = "hdf5")]
mod snapshot;
mod source;
mod splats;
mod stream;
mod stretch;
mod synthetic;
mod text;
mod unnamed;
mod velodyne;
mod vtk;

#[cfg(feature = "internals")]
#[doc(hidden)]
pub use self::array::ArraySource;
#[cfg(not(feature = "internals"))]
pub(crate) use self::array::ArraySource;
pub use self::column::{ColumnInfo, ColumnType, Values};
pub use self::error::{Place, ReadError};
pub use self::formats::{ReadOptions, open};
#[doc(hidden)]
pub use self::in_turn::InTurn;
#[cfg(all(feature = "internals", feature = "las"))]
#[doc(hidden)]
pub use self::las::LasSource;
pub use self::mesh::MeshSource;
#[cfg(feature = "internals")]
#[doc(hidden)]
pub use self::ply::PlySource;
pub use self::ply_write::PlyWriter;
pub use self::slices::{ColumnLengthError, ColumnSlice, PositionSlice, SliceSource};
pub use self::source::{ColorDepth, PointBatch, PointSource, Schema};
pub use self::synthetic::{View, Workload};
#[cfg(feature = "internals")]
#[doc(hidden)]
pub use self::text::TextSource;
