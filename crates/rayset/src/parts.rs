//! Pictures in parts, rendered by many processes and joined to the very picture of one.
//!
//! [`View::render_part`](crate::View::render_part) renders a [`Share`] of a picture into a
//! [`Part`]; [`Joined`] is all parts of one.

pub use rayset_render::trace::parts::{Joined, PART_MAGIC, Part, PartError, PartOptions, Share};
