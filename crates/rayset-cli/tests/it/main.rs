//! What rayset promises, tested: the program, in one binary.
#![allow(missing_docs, reason = "tests are named after what they promise")]
#![allow(clippy::print_stderr, reason = "a test that is skipped says so")]
#![allow(clippy::type_complexity, reason = "tables of cases are clearest written out")]

mod annotations;
mod cloud_parts;
mod columns;
mod common;
#[cfg(all(target_os = "linux", target_arch = "x86_64"))]
mod faults;
mod first_looks;
mod info;
mod inputs;
mod interrupted;
mod kept;
mod labels;
mod las_files;
mod las_times;
mod limits;
mod lod;
mod looks;
mod manual;
mod memory;
mod outputs;
mod owned;
mod parts;
mod pictures;
mod program;
mod secrets;
mod settings;
mod snapshot_inputs;
mod splats_and_meshes;
mod styles;
mod tiles;
#[cfg(all(target_os = "linux", target_arch = "x86_64"))]
mod tracer;
mod turntables;
mod unfinished;
mod value_ranges;
mod volume_builds;
mod volume_looks;
mod words;

#[allow(dead_code, reason = "the library's tests use the rest")]
#[path = "../../../rayset/tests/it/las_writer.rs"]
mod las_writer;
#[allow(dead_code, reason = "the library's tests use the rest")]
#[path = "../../../rayset/tests/it/vti_text.rs"]
mod vti_text;
