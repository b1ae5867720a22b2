//! The types of numbers in files, of points and of voxels.

pub(crate) mod half;
mod stored;

pub(crate) use self::stored::Stored;
