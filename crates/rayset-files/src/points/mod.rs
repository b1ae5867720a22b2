//! Points as builds take them: a [`PointSource`] delivers them in batches. Readers of formats are
//! in `rayset-formats`.

mod array;
mod column;
mod error;
pub mod harmonics;
pub mod roles;
mod slices;
mod source;
mod synthetic;

pub use self::array::ArraySource;
pub use self::column::{ColumnInfo, ColumnType, Values};
pub use self::error::{Place, ReadError};
pub use self::harmonics::{HARMONIC, HARMONIC_CONSTANTS};
pub use self::slices::{ColumnLengthError, ColumnSlice, PositionSlice, SliceSource};
pub use self::source::{ColorDepth, PointBatch, PointSource, ROUND_RADIUS, SHAPE_COLUMNS, Schema};
pub use self::synthetic::{Workload, WorkloadView};
