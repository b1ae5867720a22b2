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

/// Lets children hear signals although whoever started these tests ignores them, as shells do with
/// SIGINT for what runs in the background, and `nohup` with SIGHUP: a signal that is caught is not
/// ignored in children.
#[cfg(target_os = "linux")]
pub(crate) fn let_children_be_interrupted() {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let ignored =
        status.lines().find_map(|line| u64::from_str_radix(line.strip_prefix("SigIgn:")?.trim(), 16).ok());
    for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGHUP] {
        if ignored.is_some_and(|signals| signals >> (signal - 1) & 1 == 1) {
            signal_hook::flag::register(signal, std::sync::Arc::default()).expect("it can be caught");
        }
    }
}

/// Sends a signal to a child.
#[cfg(target_os = "linux")]
pub(crate) fn send(signal: &str, child: &std::process::Child) {
    let sent = std::process::Command::new("/bin/sh")
        .args(["-c", &format!("kill -{signal} {}", child.id())])
        .status();
    assert!(sent.expect("a shell").success());
}

/// The names of what is in a folder, sorted.
pub(crate) fn names(folder: &std::path::Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).expect("the folder lists");
    let mut names: Vec<String> =
        entries.map(|e| e.expect("an entry").file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}
