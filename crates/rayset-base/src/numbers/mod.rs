//! The types of numbers in files, of points and of voxels.

pub mod half;
mod stored;
mod values;

pub use self::stored::Stored;
