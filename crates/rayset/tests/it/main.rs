//! What rayset promises, tested: the library by itself, in one binary.
#![allow(missing_docs, reason = "tests are named after what they promise")]
#![allow(clippy::print_stderr, reason = "a test that is skipped says so")]
#![allow(clippy::type_complexity, reason = "tables of cases are clearest written out")]

mod ambient_occlusion;
mod automatic_radii;
mod bad_bytes;
mod bounces;
mod build_control;
mod build_is_pure;
mod build_parts;
mod caps;
mod circles;
mod colormaps;
mod common;
mod corpus;
mod e57;
mod edges;
mod far_storage;
mod figures;
mod fixture;
mod fixtures;
mod format;
mod gadget;
mod golden;
mod graph;
mod grid_borders;
mod grids;
mod house;
mod inner_loop;
mod las_peer;
#[allow(dead_code, reason = "the program's tests use the rest")]
mod las_writer;
mod layers;
mod many_threads;
mod meshes;
mod npy;
mod other_volumes;
mod other_writers;
mod packed;
mod page_reads;
mod parts;
mod pcd;
mod ply_files;
mod ptx;
mod readers;
mod refusals;
mod right_picture;
mod same_picture;
mod samples;
mod scattered;
mod schema;
mod session_memory;
mod sessions;
mod shadows;
mod skips;
mod snapshots;
mod splats;
mod tables;
mod vdb;
mod volume_fixtures;
mod volumes;
mod vti;
mod vti_text;
mod vtk;
mod working_set;
mod wrong_scenes;
