//! Pictures in parts, rendered by many processes and joined to the very picture of one.
//!
//! A [`Share`] is one of `n` shares of a picture's blocks.
//! [`View::render_part`](crate::trace::View::render_part) renders a share and writes a *part*:
//! colours and layers in linear light as tiles have them, and what proves that scene, files,
//! settings, view, program and arithmetic are the same. [`Joined::join`] takes all parts of a
//! picture and refuses what is missing, double or foreign; [`Joined::bands`] hands the picture on
//! band by band, as [`View::render_bands`](crate::trace::View::render_bands) does, without the
//! scene and its files. Ambient occlusion, which looks at neighbouring pixels, is computed then.
//!
//! Parts know nothing of what runs the processes. A part that was lost is rendered again by itself.

mod block;
mod error;
mod fetch;
mod header;
mod join;
mod part;
mod same;
mod share;
mod write;

pub use self::error::PartError;
pub use self::header::PART_MAGIC;
pub use self::join::Joined;
pub use self::part::Part;
pub use self::share::Share;
pub use self::write::PartOptions;
