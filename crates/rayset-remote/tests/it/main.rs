//! Promises about addresses, kept against a server of ranges that may be slow and wrong.

mod addresses;
mod child;
mod common;
mod credentials;
mod faults;
mod inputs;
#[allow(dead_code, reason = "the tests of the library and of the program use more of it")]
#[path = "../../../rayset/tests/it/las_writer.rs"]
mod las_writer;
mod processes;
#[path = "../../examples/range_server/server.rs"]
mod range_server;
mod secrets;
mod silence;
