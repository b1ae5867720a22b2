//! Point input: streaming readers for common file formats, and generators for the standard
//! workloads.
//!
//! A [`PointSource`] delivers points in batches and never holds a whole file in memory. Positions
//! are `f64` in the file's own coordinates; everything else is a column with a name and a type. The
//! builder decides what a column means (radius, weight, colour) and what happens to invalid
//! records.

mod decimal_mark;
#[cfg(feature = "e57")]
mod e57;
mod file_source;
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
mod siblings;
#[cfg(feature = "hdf5")]
mod snapshot;
mod splats;
mod stream;
#[cfg_attr(not(feature = "las"), allow(dead_code, reason = "files of LAS need all of it"))]
mod stretch;
mod text;
mod unnamed;
mod velodyne;
mod vtk;

pub use rayset_files::points::{
    ArraySource, ColorDepth, ColumnInfo, ColumnLengthError, ColumnSlice, ColumnType, HARMONIC,
    HARMONIC_CONSTANTS, Place, PointBatch, PointSource, PositionSlice, ROUND_RADIUS, ReadError,
    SHAPE_COLUMNS, Schema, SliceSource, Values, Workload, WorkloadView, roles,
};

pub use self::formats::{ReadOptions, open};
pub use self::in_turn::InTurn;
#[cfg(feature = "las")]
pub use self::las::open_las;
pub use self::mesh::MeshSource;
pub use self::ply_write::PlyWriter;
