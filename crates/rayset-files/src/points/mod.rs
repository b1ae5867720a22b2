//! Points as builds take them: a [`PointSource`] delivers them in batches. Readers of formats are
//! in `rayset-formats`.

mod array;
mod column;
mod error;
pub mod harmonics;
pub mod roles;
mod shapes;
mod slices;
mod source;
mod synthetic;

pub use self::array::ArraySource;
pub use self::column::{ColumnInfo, ColumnType, Values};
pub use self::error::{Place, ReadError};
pub use self::harmonics::{HARMONIC, HARMONIC_CONSTANTS};
pub(crate) use self::shapes::ShapeOrigin;
pub use self::shapes::{ROUND_RADIUS, SHAPE_COLUMNS};
pub use self::slices::{ColumnLengthError, ColumnSlice, PositionSlice, SliceSource};
pub use self::source::{ColorDepth, PointBatch, PointSource, Schema};
pub use self::synthetic::{Workload, WorkloadView};
