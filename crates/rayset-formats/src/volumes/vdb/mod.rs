//! OpenVDB (`.vdb`), file versions 222 to 225: one grid of floats or doubles, in a tree of the
//! standard shape 5-4-3; plain, zip or Blosc (LZ4 or zlib inside), with or without masks of active
//! values, in single or half precision.
//!
//! The file is a tree: a root with nodes of 4096³ voxels, which have nodes of 128³, which have
//! leaves of 8³. A region with one value is a tile of a node. The volume is the box of all active
//! voxels and one voxel around it; what the tree does not mention in it has the grid's background
//! value, and inactive voxels the values that they are stored with.
//!
//! Memory: where the nodes and leaves are in the file, 24 bytes each, and the voxels of [`Dense`]'s
//! window.
//!
//! The layout is that of the OpenVDB library (`io/Archive.cc`, `io/Compression.h`, `tree/*.h` of
//! version 10).

mod blosc;
mod dense;
mod grids;
mod open;
mod stream;
mod transform;
mod tree;
mod values;
mod zip;

pub(super) use self::open::open;
