//! What points or voxels look like if nobody says so: a scene chosen from what is in the file.
//!
//! A look is a scene file, the same as one that a person would write (`--write-scene` keeps it),
//! and everything in it is a function of the file and of the options: a sample of the points, the
//! header, the size of the picture. Crops, parts and execution settings have no influence.

mod apply;
mod choose;
mod classes;
mod cloud;
mod evidence;
mod framing;
mod gas;
mod grid;
mod labels;
mod palettes;
mod ranges;
mod shape;
mod splats;
mod statistics;
mod turntable;
mod upright;
mod view;
mod voxels;

pub use self::apply::expose;
pub use self::choose::{Chosen, Looks, MANY_POINTS, Picture, Stance, of_cloud, of_grid};
pub use self::classes::class_name;
pub use self::turntable::{Turntable, standing_back, turned};
