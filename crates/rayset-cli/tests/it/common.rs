//! What tests of the program share, with those of the library.

#[allow(dead_code, reason = "the library's tests use the rest")]
#[path = "../../../rayset/tests/it/common.rs"]
mod library;

pub(crate) use library::{Random, build_at, folder, mixed_points, real_data};

/// The program.
pub(crate) fn program() -> std::process::Command {
    std::process::Command::new(env!("CARGO_BIN_EXE_rayset"))
}

/// `--memory` of so many mebibytes. A program that opens remote objects takes two more by itself, though it opens none.
pub(crate) fn mebibytes(memory: f64) -> (String, f64) {
    let memory = if cfg!(feature = "far") { memory + 2.0 } else { memory };
    (format!("{memory}MiB"), memory * f64::from(1 << 20))
}
