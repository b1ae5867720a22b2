//! Promise 5: no half file. Builds are killed at random moments.

#![cfg(unix)]

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use rayset::grid::Grid;
use rayset::octree::Cloud;
use rayset::octree::verify::Depth;

use crate::common::{Random, folder, mebibytes};

fn program() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_rayset"));
    command.stdout(Stdio::null()).stderr(Stdio::null());
    command
}

fn build(folder: &Path) -> Command {
    let mut command = program();
    command.current_dir(folder).args([
        "build",
        "points.ply",
        "-o",
        "c.rset",
        "--memory",
        "24MiB",
        "--threads",
        "2",
    ]);
    command
}

fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).expect("the folder lists");
    let mut names: Vec<String> =
        entries.map(|e| e.expect("an entry").file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

/// Kills a run at random moments, until `wanted` runs were ended in the middle, however fast the
/// machine is. `begin` is told the number of the round; `look` looks at what is left.
fn kill_at_random(
    (seed, wanted): (u64, usize),
    whole: Duration,
    mut begin: impl FnMut(usize) -> Command,
    mut look: impl FnMut(usize),
) {
    const MOST_ROUNDS: usize = 1000;
    let (mut random, mut span, mut interrupted) = (Random(seed), whole, 0);
    for round in 0..MOST_ROUNDS {
        let mut child = begin(round).spawn().expect("the program runs");
        std::thread::sleep(span.mul_f64(random.unit()));
        child.kill().expect("it can be killed");
        let was_ended = !child.wait().expect("it ends").success();
        look(round);
        // The machine may be quicker now than it was, or slower again.
        span = if was_ended { whole.min(span.mul_f64(1.25)) } else { span / 2 };
        interrupted += usize::from(was_ended);
        if interrupted == wanted {
            return;
        }
    }
    panic!("of {MOST_ROUNDS} builds {interrupted} were interrupted");
}

#[test]
fn a_build_killed_at_any_moment_leaves_no_file_that_opens_and_the_next_one_cleans_up() {
    let folder = folder();
    let generated =
        program().current_dir(folder.path()).args(["generate", "sphere-600k", "-o", "points.ply"]).status();
    assert!(generated.expect("the program runs").success());
    let started = Instant::now();
    assert!(build(folder.path()).status().expect("the program runs").success());
    let whole = started.elapsed();
    let reference = std::fs::read(folder.path().join("c.rset")).expect("the cloud reads");
    std::fs::remove_file(folder.path().join("c.rset")).expect("it goes");

    let path = folder.path().join("c.rset");
    let had_file = std::cell::Cell::new(false);
    let begin = |round| {
        if round == 6 {
            // From now on there is an earlier file.
            assert!(build(folder.path()).status().expect("the program runs").success());
        }
        had_file.set(path.exists());
        build(folder.path())
    };
    let look = |round| {
        if path.exists() {
            // Either the build had ended, or this is the file of an earlier one: whole in both
            // cases.
            assert!(std::fs::read(&path).expect("the cloud reads") == reference, "round {round}");
        } else {
            assert!(!had_file.get(), "round {round}: the earlier file is gone");
        }
        for name in names(folder.path()).iter().filter(|n| n.contains("rayset-")) {
            // A file that was whole but for its name may open; half a file may not.
            if Cloud::open(folder.path().join(name)).is_ok() {
                let bytes = std::fs::read(folder.path().join(name)).expect("it reads");
                assert!(bytes == reference, "round {round}: {name} is half a file, and opens");
            }
        }
    };
    kill_at_random((5, 12), whole, begin, look);
    assert!(build(folder.path()).status().expect("the program runs").success());
    assert_eq!(names(folder.path()), ["c.rset", "points.ply"]);
    let cloud = Cloud::open(folder.path().join("c.rset")).expect("the cloud opens");
    cloud.verify(Depth::Deep).expect("the cloud is whole");
}

#[test]
fn a_grid_killed_at_any_moment_leaves_no_file_that_opens_and_the_next_one_cleans_up() {
    let folder = folder();
    let voxels: Vec<u8> = (0..700 * 700 * 64).map(|i: u32| (i >> 5) as u8).collect();
    std::fs::write(folder.path().join("v.raw"), voxels).expect("a write");
    let build = || {
        let mut command = program();
        let arguments =
            ["build", "v.raw", "--raw", "700x700x64,u8", "-o", "v.rset", "--memory", &mebibytes(17.0).0];
        command.current_dir(folder.path()).args(arguments);
        command
    };
    let path = folder.path().join("v.rset");
    let started = Instant::now();
    assert!(build().status().expect("the program runs").success());
    let whole = started.elapsed();
    let reference = std::fs::read(&path).expect("the grid reads");
    let begin = |_| {
        let _ = std::fs::remove_file(&path);
        build()
    };
    let look = |round| {
        for name in names(folder.path()).iter().filter(|n| n.contains(".rset")) {
            if Grid::open(folder.path().join(name)).is_ok() {
                let bytes = std::fs::read(folder.path().join(name)).expect("it reads");
                assert!(bytes == reference, "round {round}: {name} is half a file, and opens");
            }
        }
    };
    kill_at_random((6, 8), whole, begin, look);
    assert!(build().status().expect("the program runs").success());
    assert_eq!(names(folder.path()), ["v.raw", "v.rset"]);
}

#[test]
fn a_build_that_fails_leaves_what_was_there() {
    let folder = folder();
    std::fs::write(folder.path().join("c.rset"), b"precious").expect("a write");
    std::fs::write(folder.path().join("points.ply"), b"ply\nformat ascii 1.0\nelement vertex 9\nproperty float x\nproperty float y\nproperty float z\nend_header\n1 2 3\n")
        .expect("a write");
    assert!(!build(folder.path()).status().expect("the program runs").success());
    assert_eq!(names(folder.path()), ["c.rset", "points.ply"]);
    assert_eq!(std::fs::read(folder.path().join("c.rset")).expect("it reads"), b"precious");
}

#[test]
fn temporary_folders_of_killed_runs_are_removed_by_the_next_and_those_in_use_stay() {
    let folder = folder();
    let temporary = folder.path().join("temporary");
    std::fs::create_dir(&temporary).expect("a folder");
    let generated =
        program().current_dir(folder.path()).args(["generate", "sphere-600k", "-o", "points.ply"]).status();
    assert!(generated.expect("the program runs").success());
    // A folder of somebody else's that is called alike, and one that a program of before has left.
    for name in ["rayset-notes", "rayset-input-1-0"] {
        std::fs::create_dir(temporary.join(name)).expect("a folder");
        std::fs::write(temporary.join(name).join("file"), "").expect("a file");
    }
    let render = || {
        let mut command = program();
        command.current_dir(folder.path()).env("TMPDIR", &temporary);
        command.args(["render", "points.ply", "-o", "a.png", "--size", "16x16", "--no-cache"]);
        command
    };
    let own = || {
        let mut own = names(&temporary);
        own.retain(|name| !matches!(name.as_str(), "rayset-notes" | "rayset-input-1-0"));
        own
    };
    // Killed in the middle of a build: a run that ended sooner is tried again.
    let killed = (0..100).any(|_| {
        let mut child = render().spawn().expect("the program runs");
        // The run may end, and its folder with it.
        let files = |name: &String| std::fs::read_dir(temporary.join(name)).map_or(0, Iterator::count);
        while own().iter().all(|name| files(name) < 2) {
            if child.try_wait().expect("a status").is_some() {
                break;
            }
        }
        child.kill().expect("it can be killed");
        !child.wait().expect("it ends").success() && own().len() == 1
    });
    assert!(killed, "no run was killed while it had a temporary folder");
    let left = own();
    let mut other = render().spawn().expect("the program runs");
    while own().iter().all(|name| left.contains(name)) {
        assert!(other.try_wait().expect("a status").is_none(), "it has ended without a folder");
    }
    while own().contains(&left[0]) {
        assert!(other.try_wait().expect("a status").is_none(), "it has ended, and {left:?} is there");
    }
    // Held, as long as the next run goes.
    let pid = rustix::process::Pid::from_child(&other);
    rustix::process::kill_process(pid, rustix::process::Signal::STOP).expect("a signal");
    let in_use = own();
    assert!(render().status().expect("the program runs").success());
    assert_eq!(own(), in_use);
    rustix::process::kill_process(pid, rustix::process::Signal::CONT).expect("a signal");
    assert!(other.wait().expect("it ends").success());
    assert_eq!(names(&temporary), ["rayset-input-1-0", "rayset-notes"]);
}
