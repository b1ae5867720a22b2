//! Level of detail: what is seen of points from afar, in place of each of them, once a pixel is as
//! wide as the cell that they are in. How much of a cell is seen so is the *cut*. What aggregates
//! then absorb of a ray is their *closure*. It has two parts: the area that one takes of the light
//! (`cross_sections`), and what several in one place make of their areas (`closure`).
//!
//! The constants are those of an experiment with clouds of all kinds against the truth by many
//! rays. They may be changed without files becoming others.

mod closure;
mod clusters;
mod cross_sections;
mod cut;
mod error;

pub(crate) use self::closure::{Absorber, MOST_DEPTH, MOST_OPACITY, SPREAD, STACKING, STRETCH, Seen, Sums};
pub(crate) use self::clusters::ClusterCells;
pub(crate) use self::cross_sections::CrossSections;
pub(crate) use self::cut::{
    DENSITY_FADE, LEAST_PART, density_part, half_density, part_of_cell, part_of_last_cell,
};
pub(crate) use self::error::{MEAN_OF_BOUND, bound_of_error};
