//! What rayset promises, tested: the library and the program together, in one binary.
#![allow(missing_docs, reason = "tests are named after what they promise")]
#![allow(clippy::print_stderr, reason = "a test that is skipped says so")]
#![allow(clippy::type_complexity, reason = "tables of cases are clearest written out")]

mod bad_bytes;
mod bounces;
mod build_control;
mod build_is_pure;
mod colormaps;
mod columns;
mod common;
mod corpus;
mod edges;
#[cfg(all(target_os = "linux", target_arch = "x86_64"))]
mod faults;
mod figures;
mod format;
mod golden;
mod graph;
mod grid_borders;
mod grids;
mod house;
mod interrupted;
mod las_files;
mod las_times;
mod las_writer;
mod layers;
mod limits;
mod memory;
mod outputs;
mod ply_files;
mod program;
mod readers;
mod right_picture;
mod same_picture;
mod scattered;
mod schema;
mod sessions;
mod settings;
mod shadows;
mod tables;
#[cfg(all(target_os = "linux", target_arch = "x86_64"))]
mod tracer;
mod volumes;
mod vti;
mod vti_text;
mod words;
mod working_set;
mod wrong_scenes;
