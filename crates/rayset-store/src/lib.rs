//! The bytes of rayset: where they are read from and written to, the frame that its files share,
//! and pages in memory within a hard budget. Nothing here knows what points or voxels are. A part
//! of the library `rayset`, which says what of it is public.
#![deny(unsafe_code)]

pub mod container;
pub mod output;
pub mod spill;
pub mod storage;
pub mod working_set;
