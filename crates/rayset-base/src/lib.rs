//! What all crates of rayset stand on: geometry, cancelling, errors of names, regular files, and
//! numbers as files have them. A part of the library `rayset`, which says what of it is public.
#![deny(unsafe_code)]

pub mod bytes;
pub mod cancel;
pub mod geometry;
pub mod kernel;
pub mod nearest_first;
pub mod numbers;
pub mod parse;
pub mod regular_file;
mod setters;
pub mod srgb;
pub mod sync;
pub mod text_numbers;

pub use self::cancel::CancelToken;
