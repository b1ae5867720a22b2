//! Grids as volume objects in the world: trilinear samples from bricks that are read as rays reach
//! them.
//!
//! The samples of a slab are located in their bricks (`places`), and each ray is cut into
//! *segments*, its samples in one brick (`spans`). Brick by brick, nearest first, the samples whose
//! surroundings show anything (`visible`) are listed in groups of eight, and evaluated in batches
//! (`brick`, `batch`): values, opacities (`opacity`) and, where they are required and the ray still
//! goes on, gradients. Of voxels that are labels, none is between two (`labels`).

mod ahead;
mod batch;
mod brick;
mod field;
mod gradients;
mod labels;
mod opacity;
mod placement;
mod places;
mod rays;
mod shape;
mod spans;
mod visible;
mod volume;
mod voxels;

pub(super) use self::ahead::PagesAhead;
pub(super) use self::field::{GridMarch, GridRequest};
pub(super) use self::volume::{GridScratch, GridVolume};
