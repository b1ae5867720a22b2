//! What rayset promises, tested: the library and the program together, in one binary.
#![allow(missing_docs, reason = "tests are named after what they promise")]
#![allow(clippy::print_stderr, reason = "a test that is skipped says so")]
#![allow(clippy::type_complexity, reason = "tables of cases are clearest written out")]

mod bad_bytes;
mod bounces;
mod build_is_pure;
mod common;
mod edges;
mod figures;
mod golden;
mod graph;
mod grids;
mod house;
mod interrupted;
mod layers;
mod memory;
mod program;
mod readers;
mod right_picture;
mod same_picture;
mod scattered;
mod schema;
mod working_set;
mod wrong_scenes;
