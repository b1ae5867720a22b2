//! Every file operation of a small run fails once, in each way that it can: the run ends with one line that says why, or
//! well; what has the name of the output is the old file or the new one, whole; and nothing else is left.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;

use nix::errno::Errno;

use crate::common::folder;
use crate::tracer::{self, Disturbance, Operation};

/// What stood under the name of the output before.
const OLD: &[u8] = b"an older file";

fn succeeds(folder: &Path, arguments: &[&str]) {
    let output = Command::new(env!("CARGO_BIN_EXE_rayset")).current_dir(folder).args(arguments).output();
    let output = output.expect("the program runs");
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
}

/// A folder with some points, a volume and a cloud of them.
fn prepared() -> tempfile::TempDir {
    let folder = folder();
    let f = folder.path();
    succeeds(f, &["generate", "sphere-300", "-o", "p.ply"]);
    succeeds(f, &["build", "p.ply", "-o", "c.rset", "--threads", "1"]);
    std::fs::write(f.join("v.raw"), (0..20 * 20 * 20).map(|i| i as u8).collect::<Vec<_>>()).expect("a write");
    folder
}

fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let entries = std::fs::read_dir(folder).expect("the folder lists").map(|entry| {
        let path = entry.expect("an entry").path();
        let bytes = std::fs::read(&path).expect("it reads");
        (path.file_name().expect("a name").to_string_lossy().into_owned(), bytes)
    });
    entries.collect()
}

/// A run that makes `output`, disturbed at every operation in every way.
struct Trial<'a> {
    folder: &'a Path,
    arguments: &'a [&'a str],
    output: &'a str,
    before: BTreeMap<String, Vec<u8>>,
    new: Vec<u8>,
}

impl<'a> Trial<'a> {
    fn new(folder: &'a Path, arguments: &'a [&'a str], output: &'a str) -> (Self, Vec<Operation>) {
        succeeds(folder, arguments);
        let new = std::fs::read(folder.join(output)).expect("the output reads");
        std::fs::write(folder.join(output), OLD).expect("a write");
        let before = files(folder);
        let traced = tracer::run(folder, arguments, None);
        assert_eq!(traced.code, Some(0), "{}", traced.said);
        let trial = Self { folder, arguments, output, before, new };
        trial.restore();
        (trial, traced.operations)
    }

    fn restore(&self) {
        std::fs::write(self.folder.join(self.output), OLD).expect("a write");
    }

    fn fails_cleanly(&self, number: usize, disturbance: Disturbance) {
        let traced = tracer::run(self.folder, self.arguments, Some((number, disturbance)));
        let met = traced.operations.get(number);
        let what =
            format!("{:?}: {disturbance:?} of operation {number}, {met:?}: {}", self.arguments, traced.said);
        let mut after = files(self.folder);
        let found =
            after.insert(self.output.into(), OLD.to_vec()).unwrap_or_else(|| panic!("{what}: it is gone"));
        let changed: Vec<&String> =
            after.keys().filter(|name| after.get(*name) != self.before.get(*name)).collect();
        assert!(after == self.before, "{what}: {changed:?} is left or changed");
        match traced.code {
            Some(0) => assert!(found == self.new, "{what}: a wrong output is taken for right"),
            Some(1) => {
                assert!(found == OLD || found == self.new, "{what}: half an output");
                let lines = traced.said.trim_end().lines();
                let lines: Vec<&str> = lines.skip_while(|line| line.starts_with("look: ")).collect();
                assert!(lines.len() == 1 && lines[0].starts_with("error: "), "{what}");
                let line = lines[0];
                let cause = match disturbance {
                    Disturbance::Fail(Errno::ENOSPC) => "No space left",
                    Disturbance::Fail(_) => "Input/output error",
                    _ => panic!("{what}: half a read or write is nothing wrong"),
                };
                assert_eq!(line.matches(cause).count(), 1, "{what}");
                assert!(disturbance != Disturbance::Fail(Errno::EINTR), "{what}");
            }
            other => panic!("{what}: ended with {other:?}"),
        }
        self.restore();
    }

    /// A killed run may leave files, which the next one removes.
    fn is_survived(&self, number: usize) {
        let traced = tracer::run(self.folder, self.arguments, Some((number, Disturbance::Kill)));
        let what = format!("{:?}: killed at operation {number}", self.arguments);
        assert_eq!(traced.code, None, "{what}");
        let found = std::fs::read(self.folder.join(self.output)).expect("the output is there");
        assert!(found == OLD || found == self.new, "{what}: half an output");
        succeeds(self.folder, self.arguments);
        let mut after = files(self.folder);
        let found = after.insert(self.output.into(), OLD.to_vec());
        assert!(found.as_ref() == Some(&self.new), "{what}: the next run did not make it");
        assert!(after == self.before, "{what}: the next run left {:?}", after.keys());
        self.restore();
    }
}

fn every_operation_fails_once(arguments: &[&str], output: &str, least: &[(Operation, usize)]) {
    let folder = prepared();
    if !tracer::can_trace(folder.path()) {
        return;
    }
    let (trial, operations) = Trial::new(folder.path(), arguments, output);
    for (operation, count) in least {
        let found = operations.iter().filter(|o| *o == operation).count();
        assert!(found >= *count, "{found} of {operation:?} were met in {operations:?}");
    }
    for (number, operation) in operations.iter().enumerate() {
        operation.disturbances().iter().for_each(|d| trial.fails_cleanly(number, *d));
    }
}

const BUILD: [&str; 7] = ["build", "p.ply", "-o", "out.rset", "--threads", "1", "--json"];
const GRID: [&str; 6] = ["build", "v.raw", "--raw", "20x20x20,u8", "-o", "out.rset"];
const PICTURE: [&str; 10] =
    ["render", "c.rset", "--size", "16x16", "--threads", "1", "--io", "pool", "-o", "out.png"];

#[test]
fn a_cloud_is_built_or_not_whatever_file_operation_fails() {
    use Operation::{Create, Lock, Open, Read, Rename, Sync, Write};
    // Temporary files are opened in their folder, without a name.
    let least = [(Create, 1), (Lock, 1), (Open, 3), (Read, 4), (Write, 4), (Sync, 2), (Rename, 1)];
    every_operation_fails_once(&BUILD, "out.rset", &least);
}

#[test]
fn a_grid_is_built_or_not_whatever_file_operation_fails() {
    use Operation::{Create, Lock, Read, Rename, Sync, Write};
    every_operation_fails_once(
        &GRID,
        "out.rset",
        &[(Create, 1), (Lock, 1), (Read, 1), (Write, 3), (Sync, 2), (Rename, 1)],
    );
}

#[test]
fn a_picture_is_right_or_an_error_whatever_file_operation_fails() {
    use Operation::{Create, Open, Read, Rename, Write};
    let least = [(Create, 1), (Open, 2), (Read, 3), (Write, 1), (Rename, 1)];
    every_operation_fails_once(&PICTURE, "out.png", &least);
    let exr = [&PICTURE[..9], &["out.exr"]].concat();
    every_operation_fails_once(&exr, "out.exr", &least);
}

#[test]
fn points_are_generated_or_not_whatever_file_operation_fails() {
    use Operation::{Create, Rename, Write};
    let arguments = ["generate", "sphere-300", "-o", "out.ply"];
    every_operation_fails_once(&arguments, "out.ply", &[(Create, 1), (Write, 1), (Rename, 1)]);
}

#[test]
fn a_run_killed_at_any_file_operation_leaves_the_old_output_or_the_new_one_and_the_next_run_cleans_up() {
    for (arguments, output) in [(&BUILD[..], "out.rset"), (&PICTURE[..], "out.png")] {
        let folder = prepared();
        if !tracer::can_trace(folder.path()) {
            return;
        }
        let (trial, operations) = Trial::new(folder.path(), arguments, output);
        // Between two reads nothing changes.
        let changes = |operation: &Operation| !matches!(operation, Operation::Read | Operation::Look);
        let numbers = operations.iter().enumerate().filter(|(_, operation)| changes(operation));
        numbers.for_each(|(number, _)| trial.is_survived(number));
    }
}
