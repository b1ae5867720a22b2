//! Making clouds of points and grids of voxels, in bounded memory.
//!
//! [`to_file`] and [`in_memory`] make the same bytes, which depend on the points and on those [`BuildOptions`] that say so,
//! and on nothing else: not on memory, threads, or the order of the inputs.

pub use crate::grid::build::{GridBuildError, GridBuildOptions, build as grid_to_file};
pub use crate::octree::build::{
    BuildControl, BuildError, BuildOptions, BuildReport, InvalidPolicy, Precision, Progress, Quantity, Rule,
    Skipped, Stage, run as to_file, run_in_memory as in_memory,
};
