//! Files of NumPy: arrays (`.npy`), and archives of arrays (`.npz`). What points and volumes are
//! made of them is said where these are read.

mod array;
mod fault;
mod header;
mod literal;
mod zip;

pub(crate) use self::array::Array;
pub(crate) use self::fault::Fault;
pub(crate) use self::header::{Header, MAGIC, Scalar, text_place};
pub(crate) use self::zip::{Member, begins_with_array, is_archive, members};
