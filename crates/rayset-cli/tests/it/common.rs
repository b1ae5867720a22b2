//! What tests of the program share, with those of the library.

#[allow(dead_code, reason = "the library's tests use the rest")]
#[path = "../../../rayset/tests/it/common.rs"]
mod library;

pub(crate) use library::{Random, build_at, folder, mixed_points, real_data};
use rayset_terminal::memory::PROCESS_BYTES;

/// The program.
pub(crate) fn program() -> std::process::Command {
    std::process::Command::new(env!("CARGO_BIN_EXE_rayset"))
}

/// Runs the program in a folder, which has its cache, too.
pub(crate) fn run(folder: &std::path::Path, arguments: &[&str]) -> std::process::Output {
    let mut command = program();
    command.current_dir(folder).env("XDG_CACHE_HOME", folder.join("home"));
    command.args(arguments).output().expect("the program runs")
}

/// What a run that succeeds says on standard error.
pub(crate) fn succeeds(folder: &std::path::Path, arguments: &[&str]) -> String {
    let output = run(folder, arguments);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{arguments:?}: {said}");
    said
}

/// `--memory` of so many mebibytes for an optimised program that opens files alone, and what code
/// this one has more in memory.
pub(crate) fn mebibytes(memory: f64) -> (String, f64) {
    const OPTIMISED_BYTES: u64 = 10 << 20;
    let memory = memory + (PROCESS_BYTES - OPTIMISED_BYTES) as f64 / f64::from(1 << 20);
    (format!("{memory}MiB"), memory * f64::from(1 << 20))
}
