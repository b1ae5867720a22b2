//! A cloud on disk: a loose octree and its pages, in one checked file, and the builder that makes
//! it.
//!
//! [`mod@format`] and [`page`] encode and decode bytes and do no input or output; [`mod@file`]
//! opens and checks a file; [`build`] makes one from points, in bounded memory. The layout is
//! described byte by byte in `docs/format.md`.

pub mod aggregates;
pub mod build;
pub mod file;
pub mod format;
pub mod harmonics;
pub mod layout;
mod near;
pub mod node;
pub mod page;
mod pipeline;
pub mod run_encoder;
mod sample;
pub mod shape;
pub mod verify;
pub mod walk;

pub use file::Cloud;
pub use rayset_store::container::OpenError;
