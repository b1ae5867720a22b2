//! Builds in parts by the program: the bytes of a local build, also when parts are killed.

#![cfg(unix)]

use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::Duration;

use crate::common::{Random, folder, program};

const STEPS: [&str; 8] = [
    "read",
    "spacing-count",
    "spacing-scatter",
    "spacing-sort",
    "spacing-measure",
    "count",
    "scatter",
    "order",
];

fn in_folder(folder: &Path, arguments: &[&str]) -> Command {
    let mut command = program();
    command.current_dir(folder).args(arguments).stdin(Stdio::null());
    command
}

fn run(folder: &Path, arguments: &[&str]) -> Output {
    in_folder(folder, arguments).output().expect("the program runs")
}

fn must(folder: &Path, arguments: &[&str]) -> String {
    let output = run(folder, arguments);
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8_lossy(&output.stdout).into_owned()
}

fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).expect("the folder lists");
    let mut names: Vec<String> =
        entries.map(|e| e.expect("an entry").file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

const BUILD: [&str; 7] = ["build", "points.ply", "-o", "c.rset", "--memory", "24MiB", "--threads"];

/// A folder with points, and the bytes of the cloud of them that a local build writes.
fn with_points(workload: &str) -> (tempfile::TempDir, Vec<u8>) {
    let folder = folder();
    must(folder.path(), &["generate", workload, "-o", "points.ply"]);
    must(folder.path(), &[&BUILD[..], &["2"]].concat());
    let whole = std::fs::read(folder.path().join("c.rset")).expect("it reads");
    std::fs::remove_file(folder.path().join("c.rset")).expect("it goes");
    (folder, whole)
}

#[test]
fn parts_and_their_merge_that_are_killed_and_run_again_leave_the_right_bytes_and_nothing_else() {
    let (folder, whole) = with_points("sphere-150k");
    let folder = folder.path();
    let merge = ["merge", "c.rset.parts", "-o", "c.rset", "--memory", "24MiB"];
    let mut random = Random(11);
    // The longest time that a run is given: on a quick machine, less.
    let (mut killed, mut longest) = (0, 0.05);
    let mut disturbed = |arguments: &[&str]| {
        let mut child = in_folder(folder, arguments)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("the program runs");
        std::thread::sleep(Duration::from_secs_f64(longest * random.unit()));
        child.kill().expect("it can be killed");
        let was_killed = !child.wait().expect("it ends").success();
        killed += usize::from(was_killed);
        longest *= if was_killed { 1.2 } else { 0.5 };
        must(folder, arguments);
    };
    for step in STEPS {
        for part in ["1/2", "2/2"] {
            disturbed(&[&BUILD[..], &["1", "--part", part, "--step", step]].concat());
            assert!(!folder.join("c.rset").exists(), "{step}: no part writes the output");
            let left = names(&folder.join("c.rset.parts"));
            assert!(!left.iter().any(|name| name.starts_with('.')), "{step}: {left:?}");
        }
    }
    disturbed(&[&merge[..], &["--keep"]].concat());
    must(folder, &merge);
    assert!(std::fs::read(folder.join("c.rset")).expect("it reads") == whole);
    assert_eq!(names(folder), ["c.rset", "points.ply"]);
    assert!(killed >= 4, "{killed} were killed");
}

#[test]
fn a_part_without_a_step_does_the_next_one_and_says_for_whom_it_waits() {
    let (folder, whole) = with_points("knot-30k");
    let folder = folder.path();
    let part = |number: &'static str| [&BUILD[..], &["1", "--part", number]].concat();
    for (turn, step) in ["read", "count", "scatter", "order"].into_iter().enumerate() {
        assert!(must(folder, &part("1/2")).contains(&format!("part 1 of 2: {step} done")));
        if turn < 3 {
            let waits = run(folder, &part("1/2"));
            let said = String::from_utf8_lossy(&waits.stderr).into_owned();
            assert!(
                !waits.status.success() && said.contains(&format!("part 2 of 2 of step `{step}` has not")),
                "{said}"
            );
        }
        assert!(must(folder, &part("2/2")).contains(&format!("part 2 of 2: {step} done")));
    }
    assert!(must(folder, &part("1/2")).contains("rayset merge c.rset.parts -o c.rset"));
    must(folder, &["merge", "c.rset.parts", "-o", "c.rset"]);
    assert!(std::fs::read(folder.join("c.rset")).expect("it reads") == whole);
}

#[test]
fn parts_of_other_options_are_refused_and_what_is_no_part_is_said_so() {
    let (folder, _) = with_points("knot-5k");
    let folder = folder.path();
    let refused = |arguments: &[&str]| {
        let output = run(folder, arguments);
        assert!(!output.status.success(), "{arguments:?}");
        String::from_utf8_lossy(&output.stderr).into_owned()
    };
    must(folder, &[&BUILD[..], &["1", "--part", "1/2"]].concat());
    let said = refused(&[&BUILD[..], &["1", "--part", "1/2", "--radius-scale", "2"]].concat());
    assert!(said.contains("with other options"), "{said}");
    for wrong in ["0/2", "3/2", "2", "a/b"] {
        let said = refused(&[&BUILD[..], &["1", "--part", wrong]].concat());
        assert!(said.contains("from 1/8 to 8/8"), "{said}");
    }
    assert!(refused(&[&BUILD[..], &["1", "--step", "read"]].concat()).contains("--part"));
    assert!(refused(&["merge", "points.ply", "-o", "c.rset"]).contains("not a part"));
    assert!(refused(&["merge", ".", "-o", "c.rset"]).contains("no parts of a build"));
}
