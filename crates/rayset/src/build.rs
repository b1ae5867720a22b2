//! Building clouds of points and grids of voxels in bounded memory.
//!
//! [`Cloud::builder`](crate::Cloud::builder) builds into memory or into a file, the same bytes.
//! They depend only on the points and on those [`BuildOptions`] that say so, not on the memory, the
//! number of threads or the order of the inputs.

pub use rayset_files::grid::build::{GridBuildError, GridBuildOptions, build as grid_to_file};
// For the program, as long as no picture is made of them.
#[doc(hidden)]
pub use rayset_files::octree::aggregates::{
    AggregateError, AggregateHeader, AggregateOptions, add_to_file as add_aggregates,
};
pub use rayset_files::octree::build::{
    BuildControl, BuildError, BuildOptions, BuildReport, CloudBuilder, InvalidPolicy, Precision, Progress,
    Quantity, Rule, ShapeRule, Skipped, Stage,
};
#[cfg(feature = "parts")]
pub use rayset_files::octree::build::{BuildParts, BuildStep};
