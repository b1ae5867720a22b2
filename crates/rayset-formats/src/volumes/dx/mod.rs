//! OpenDX in its native format (`.dx`), as APBS, VMD and OpenDX write it: a regular grid of three
//! dimensions and one number for each of its points or cells, as text or binary, in the file itself
//! or another.
//!
//! The last index is the fastest, so the axes of the volume are those of the file in reverse, and
//! nothing is moved. The format is described in the User's Guide of OpenDX, appendix B.

mod objects;
mod open;
mod words;

pub(super) use self::open::{is_dx, open};
