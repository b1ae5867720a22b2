//! Every file operation of a small run fails once, in each way that it can: the run ends with one
//! line that says why, or well; what has the name of the output is the old file or the new one,
//! whole; and nothing else is left.

use std::collections::BTreeMap;
use std::io::Read;
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

/// A folder with some points, a volume, a cloud of the points and the parts of a picture of it.
fn prepared() -> tempfile::TempDir {
    let folder = folder();
    let f = folder.path();
    succeeds(f, &["generate", "sphere-300", "-o", "p.ply"]);
    succeeds(f, &["build", "p.ply", "-o", "c.rset", "--threads", "1"]);
    for (share, name) in [("1/2", "1.part"), ("2/2", "2.part")] {
        succeeds(f, &["render", "c.rset", "--size", "40x40", "--layers", "--part", share, "-o", name]);
    }
    std::fs::write(f.join("v.raw"), (0..20 * 20 * 20).map(|i| i as u8).collect::<Vec<_>>()).expect("a write");
    folder
}

fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let paths =
        std::fs::read_dir(folder).expect("the folder lists").map(|entry| entry.expect("an entry").path());
    let entries = paths.filter(|path| path.is_file()).map(|path| {
        let bytes = std::fs::read(&path).expect("it reads");
        (path.file_name().expect("a name").to_string_lossy().into_owned(), bytes)
    });
    entries.collect()
}

/// A run that makes `output`, disturbed at every operation in every way.
struct Trial<'a> {
    folder: &'a Path,
    /// Of the files in this folder operations are disturbed.
    watched: &'a Path,
    arguments: &'a [&'a str],
    output: &'a str,
    before: BTreeMap<String, Vec<u8>>,
    new: Vec<u8>,
}

impl<'a> Trial<'a> {
    fn new(folder: &'a Path, arguments: &'a [&'a str], output: &'a str) -> (Self, Vec<Operation>) {
        Self::watching(folder, folder, arguments, output)
    }

    fn watching(
        folder: &'a Path,
        watched: &'a Path,
        arguments: &'a [&'a str],
        output: &'a str,
    ) -> (Self, Vec<Operation>) {
        succeeds(folder, arguments);
        let new = std::fs::read(folder.join(output)).expect("the output reads");
        std::fs::write(folder.join(output), OLD).expect("a write");
        let before = files(folder);
        let traced = tracer::run_watching(folder, watched, arguments, None);
        assert_eq!(traced.code, Some(0), "{}", traced.said);
        let trial = Self { folder, watched, arguments, output, before, new };
        trial.restore();
        (trial, traced.operations)
    }

    fn restore(&self) {
        std::fs::write(self.folder.join(self.output), OLD).expect("a write");
    }

    fn fails_cleanly(&self, number: usize, disturbance: Disturbance) {
        let disturbed = Some((number, disturbance));
        let traced = tracer::run_watching(self.folder, self.watched, self.arguments, disturbed);
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
                // Before it, it is said what is lost of the input.
                let is_reader = self.watched != self.folder;
                let is_said_before =
                    |line: &&str| line.starts_with("look: ") || is_reader && !line.starts_with("error: ");
                let lines: Vec<&str> = lines.skip_while(is_said_before).collect();
                assert!(lines.len() == 1 && lines[0].starts_with("error: "), "{what}");
                let line = lines[0];
                let cause = match disturbance {
                    Disturbance::Fail(Errno::ENOSPC) => "No space left",
                    Disturbance::Fail(_) => "Input/output error",
                    _ => panic!("{what}: half a read or write is nothing wrong"),
                };
                assert_eq!(line.matches(cause).count(), 1, "{what}");
                if is_reader {
                    let names = files(self.watched).into_keys();
                    assert!(names.into_iter().any(|name| line.contains(&name)), "{what}: no file is named");
                }
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
const PART: [&str; 12] = [
    "render",
    "c.rset",
    "--size",
    "40x40",
    "--threads",
    "1",
    "--io",
    "pool",
    "--part",
    "1/2",
    "-o",
    "out.part",
];
const MERGE: [&str; 5] = ["merge", "1.part", "2.part", "-o", "out.png"];

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
fn a_part_of_a_picture_is_written_or_not_whatever_file_operation_fails() {
    use Operation::{Create, Open, Read, Rename, Write};
    let least = [(Create, 1), (Open, 2), (Read, 3), (Write, 1), (Rename, 1)];
    every_operation_fails_once(&PART, "out.part", &least);
}

#[test]
fn parts_are_merged_or_not_whatever_file_operation_fails() {
    use Operation::{Create, Open, Read, Rename, Write};
    let least = [(Create, 1), (Open, 2), (Read, 6), (Write, 1), (Rename, 1)];
    every_operation_fails_once(&MERGE, "out.png", &least);
    let exr = [&MERGE[..4], &["out.exr"]].concat();
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
    let runs = [(&BUILD[..], "out.rset"), (&PICTURE, "out.png"), (&PART, "out.part"), (&MERGE, "out.png")];
    for (arguments, output) in runs {
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

/// Files of every kind that is read besides PLY and plain voxels. Of a snapshot in several files,
/// all are there; volumes that are packed are unpacked first.
const INPUTS: [&str; 35] = [
    "two_scans.e57",
    "ascii_uint32.pcd",
    "binary_float32.pcd",
    "binary_compressed_float32.pcd",
    "binary_uint32.pcd.zst",
    "scans.ptx",
    "scans.ptx.zst",
    "format_2.las",
    "format_8.laz",
    "npy/plain_f8.npy",
    "npy/deflated.npz",
    "snapshots/swift.hdf5",
    "snapshots/arepo.0.hdf5+snapshots/arepo.1.hdf5",
    "gadget/format1",
    "gadget/parts.0+gadget/parts.1",
    "vtk/poly_text_42.vtk",
    "vtk/poly_binary_51.vtk",
    "vtk/binary_zlib.vtp",
    "vtk/base64_zlib.vtu",
    "meshes/ball.obj",
    "meshes/ball.ply",
    "meshes/ball.stl",
    "splats/inria.ply",
    "splats/packed.compressed.ply",
    "splats/v3.spz",
    "splats/v4.spz",
    "splats/khronos.glb",
    "splats/bundle.sog",
    "splats/records.splat",
    "splats/level1.ksplat",
    "volumes/plain.dx",
    "volumes/runs.slc",
    "volumes/deflated.npz",
    "volumes/binary_f4.vtk",
    "vdb/blosc.vdb.gz",
];
/// Operations on one input that are disturbed, at most.
const OPERATIONS: usize = 6;

/// A folder with inputs in a folder of their own. Returns the name of the first.
fn with_inputs(names: &str) -> (tempfile::TempDir, String) {
    let folder = folder();
    std::fs::create_dir(folder.path().join("in")).expect("a folder");
    let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("../rayset/tests/fixtures");
    let mut first = String::new();
    for name in names.split('+') {
        let mut bytes = std::fs::read(fixtures.join(name)).expect("a fixture");
        let mut name = Path::new(name).file_name().expect("a name").to_string_lossy().into_owned();
        if let Some(unpacked) = name.strip_suffix(".vdb.gz") {
            let packed = std::mem::take(&mut bytes);
            flate2::read::GzDecoder::new(&packed[..]).read_to_end(&mut bytes).expect("gzip");
            name = format!("{unpacked}.vdb");
        }
        std::fs::write(folder.path().join("in").join(&name), bytes).expect("a write");
        if first.is_empty() {
            first = format!("in/{name}");
        }
    }
    (folder, first)
}

/// Which of so many operations are disturbed: the first, the last, and some between.
fn chosen(count: usize) -> impl Iterator<Item = usize> {
    let most = OPERATIONS.min(count);
    (0..most).map(move |i| i * (count - 1) / (most - 1).max(1))
}

fn every_input_fails_cleanly(inputs: &[&str]) {
    for names in inputs {
        let (folder, input) = with_inputs(names);
        let watched = folder.path().join("in");
        if !tracer::can_trace(folder.path()) {
            return;
        }
        let mesh = input.contains("ball").then_some(["--mesh-points", "50"]);
        let mut arguments = vec!["build", &input, "-o", "out.rset", "--threads", "1", "--json"];
        arguments.extend(mesh.iter().flatten());
        let (trial, operations) = Trial::watching(folder.path(), &watched, &arguments, "out.rset");
        assert!(operations.contains(&Operation::Read), "{names}: {operations:?}");
        for (turn, number) in chosen(operations.len()).enumerate() {
            trial.fails_cleanly(number, Disturbance::Fail(Errno::EIO));
            // Of the others, each takes its turn.
            let others = &operations[number].disturbances()[1..];
            others.get(turn % others.len().max(1)).iter().for_each(|d| trial.fails_cleanly(number, **d));
        }
    }
}

#[test]
fn points_of_every_kind_are_read_or_not_whatever_file_operation_fails() {
    every_input_fails_cleanly(&INPUTS[..15]);
}

#[test]
fn points_of_vtk_meshes_and_splats_are_read_or_not_whatever_file_operation_fails() {
    every_input_fails_cleanly(&INPUTS[15..28]);
}

#[test]
fn volumes_of_every_kind_are_read_or_not_whatever_file_operation_fails() {
    every_input_fails_cleanly(&INPUTS[28..]);
}
