//! Promises about addresses, kept against a server of ranges that may be slow and wrong.

mod addresses;
mod inputs;
#[path = "../../examples/range_server/server.rs"]
mod range_server;
