//! An output is there whole or not at all, is never an input, and what is no file is not replaced
//! by one.

#![cfg(unix)]

use std::fs::{self, File, TryLockError};
use std::io::{Read, Write};
use std::os::unix::fs::{FileTypeExt, MetadataExt, symlink};
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::sync::Barrier;
use std::time::{Duration, Instant};

use rayset::octree::Cloud;
use rayset::octree::build::{self, BuildControl, BuildError, BuildOptions};
use rayset::octree::verify::Depth;
use rayset::output::{Destination, OutputError, OutputFile};
use rayset::points::{self, PointBatch, PointSource, ReadError, ReadOptions, Schema, Workload};

use crate::common::{Random, folder, let_children_be_interrupted, names, send};

fn program(folder: &Path, arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_rayset"));
    command.current_dir(folder).args(arguments).stdin(Stdio::null());
    command
}

fn run(folder: &Path, arguments: &[&str]) -> Output {
    program(folder, arguments).output().expect("the program runs")
}

fn succeeds(folder: &Path, arguments: &[&str]) -> String {
    let output = run(folder, arguments);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{arguments:?}: {said}");
    String::from_utf8_lossy(&output.stdout).into_owned()
}

fn fails(folder: &Path, arguments: &[&str]) -> String {
    let output = run(folder, arguments);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{arguments:?}: {said}");
    said
}

/// A folder with `points.ply` and a cloud of it, `cloud.rset`.
fn with_cloud() -> tempfile::TempDir {
    let folder = folder();
    succeeds(folder.path(), &["generate", "sphere-2k", "-o", "points.ply"]);
    succeeds(folder.path(), &["build", "points.ply", "-o", "cloud.rset", "--radius", "0.2"]);
    folder
}

/// Points that come slowly, so that builds overlap.
struct Slow(Box<dyn PointSource>);

impl PointSource for Slow {
    fn schema(&self) -> &Schema {
        self.0.schema()
    }

    fn count_hint(&self) -> Option<u64> {
        self.0.count_hint()
    }

    fn select(&mut self, columns: &[usize]) {
        self.0.select(columns);
    }

    fn fill(&mut self, batch: &mut PointBatch, limit: usize) -> Result<(), ReadError> {
        std::thread::sleep(Duration::from_millis(2));
        self.0.fill(batch, limit.min(500))
    }
}

#[test]
fn of_builds_at_once_to_one_output_the_last_to_finish_wins_whole() {
    let folder = folder();
    let path = folder.path().join("c.rset");
    let counts = [3_000_u64, 4_000, 5_000, 6_000];
    for round in 0..3 {
        let barrier = Barrier::new(counts.len());
        std::thread::scope(|scope| {
            for count in counts {
                let (path, barrier) = (&path, &barrier);
                scope.spawn(move || {
                    let workload: Workload = format!("sphere-{count}").parse().expect("a workload");
                    let options = BuildOptions { threads: 1, memory_bytes: 16 << 20, ..Default::default() };
                    barrier.wait();
                    build::run(
                        vec![Box::new(Slow(workload.source()))],
                        path,
                        &options,
                        &BuildControl::default(),
                    )
                    .expect("every one of them builds");
                });
            }
        });
        let cloud = Cloud::open(&path).expect("the cloud opens");
        cloud.verify(Depth::Deep).expect("the cloud is whole");
        assert!(counts.contains(&cloud.header().points), "round {round}");
        assert_eq!(names(folder.path()), ["c.rset"], "round {round}");
    }
}

#[test]
fn of_processes_at_once_with_one_output_every_one_that_succeeds_leaves_a_whole_file() {
    let folder = folder();
    let f = folder.path();
    for (count, name) in [("20k", "a.ply"), ("30k", "b.ply")] {
        succeeds(f, &["generate", &format!("sphere-{count}"), "-o", name]);
    }
    for round in 0..6 {
        let start = |input| {
            let arguments = ["build", input, "-o", "c.rset", "--radius", "0.1", "--threads", "1"];
            let mut command = program(f, &arguments);
            command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().expect("the program runs")
        };
        for child in [start("a.ply"), start("b.ply")] {
            let output = child.wait_with_output().expect("it ends");
            assert!(output.status.success(), "{round}: {}", String::from_utf8_lossy(&output.stderr));
        }
        succeeds(f, &["verify", "c.rset", "--deep"]);
        assert_eq!(names(f), ["a.ply", "b.ply", "c.rset"]);
    }
}

#[test]
fn leftovers_of_killed_runs_are_removed_and_what_is_being_written_is_not() {
    let folder = with_cloud();
    let f = folder.path();
    let files: Vec<File> = [
        ".out.rset.rayset-partial-1-0",
        ".out.rset.rayset-partial-1-1",
        ".out.rset.rayset-tmp-1-0",
        ".out.rset.rayset-partial-1-x",
        ".other.rset.rayset-partial-1-0",
    ]
    .into_iter()
    .map(|name| File::create(f.join(name)).expect("a file"))
    .collect();
    // The second one belongs to a process that lives.
    files[1].try_lock().expect("a lock");
    succeeds(f, &["build", "points.ply", "-o", "out.rset"]);
    assert_eq!(
        names(f),
        [
            ".other.rset.rayset-partial-1-0",
            ".out.rset.rayset-partial-1-1",
            ".out.rset.rayset-partial-1-x",
            "cloud.rset",
            "out.rset",
            "points.ply"
        ]
    );
    assert_eq!(files[1].metadata().expect("it is open").nlink(), 1);
    drop(files);
    for output in ["out.rset", "other.rset"] {
        succeeds(f, &["build", "points.ply", "-o", output]);
    }
    let left = names(f);
    assert_eq!(left.iter().filter(|n| n.starts_with('.')).count(), 1, "{left:?}");
}

#[test]
fn an_output_that_is_being_written_is_locked_and_has_its_old_content_under_its_name() {
    let folder = folder();
    let path = folder.path().join("o.bin");
    fs::write(&path, b"old").expect("a write");
    let to = Destination::new(&path).expect("a destination");
    let file = OutputFile::create(&to).expect("it is created");
    file.writer().write_all(b"new").expect("a write");
    let partial = names(folder.path()).into_iter().find(|n| n != "o.bin").expect("a partial file");
    let other = File::open(folder.path().join(partial)).expect("it opens");
    assert!(matches!(other.try_lock(), Err(TryLockError::WouldBlock)));
    assert_eq!(fs::read(&path).expect("it reads"), b"old");
    // A second one does not disturb the first.
    drop(OutputFile::create(&to).expect("it is created"));
    file.publish().expect("it gets its name");
    assert_eq!(fs::read(&path).expect("it reads"), b"new");
    assert_eq!(names(folder.path()), ["o.bin"]);
}

#[test]
fn a_file_of_which_a_write_failed_never_gets_its_name() {
    let folder = folder();
    let path = folder.path().join("o.bin");
    let file = OutputFile::create(&Destination::new(&path).expect("a destination")).expect("it is created");
    let mut writer = file.writer();
    std::io::Seek::seek(&mut writer, std::io::SeekFrom::Start(i64::MAX as u64 - 1)).expect("a seek");
    // As the buffer of an encoder that is dropped does.
    let _ = writer.write_all(&[0; 16]);
    assert!(matches!(file.publish(), Err(OutputError::Io { .. })));
    assert!(names(folder.path()).is_empty());
}

#[test]
fn names_of_any_length_can_be_written() {
    let folder = with_cloud();
    let f = folder.path();
    for name in ["x".repeat(250) + ".png", "ü".repeat(125) + ".png"] {
        succeeds(f, &["render", "cloud.rset", "-o", &name, "--size", "8x8"]);
    }
    assert_eq!(names(f).len(), 4);
}

/// Every file of a folder, with its bytes.
fn contents(folder: &Path) -> Vec<(String, Vec<u8>)> {
    names(folder)
        .into_iter()
        .filter(|name| folder.join(name).is_file())
        .map(|name| (name.clone(), fs::read(folder.join(name)).expect("it reads")))
        .collect()
}

#[test]
fn no_output_replaces_an_input_of_the_same_run() {
    let folder = with_cloud();
    let f = folder.path();
    for (name, text) in [
        ("t.csv", "x,y,z\n1,2,3\n4,5,6\n"),
        ("t.xyz", "1 2 3\n4 5 6\n"),
        (
            "mesh.ply",
            "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n",
        ),
        (
            "v.mhd",
            "ObjectType = Image\nNDims = 3\nDimSize = 4 4 4\nElementType = MET_UCHAR\nElementDataFile = v.raw\n",
        ),
        ("preset.json", r#"[{"Name": "p", "RGBPoints": [0, 0, 0, 0, 1, 1, 1, 1]}]"#),
        (
            "scene.json",
            r#"{"rayset": 1, "root": {"type": "union", "children": [
            {"type": "cloud", "file": "cloud.rset", "transferFunction": {"preset": {"file": "preset.json"}}},
            {"type": "grid", "file": "grid.rset"}]}}"#,
        ),
    ] {
        fs::write(f.join(name), text).expect("a write");
    }
    fs::write(f.join("v.raw"), [7; 64]).expect("a write");
    succeeds(f, &["build", "v.mhd", "-o", "grid.rset"]);
    fs::hard_link(f.join("points.ply"), f.join("hard.ply")).expect("a link");
    symlink("points.ply", f.join("soft.ply")).expect("a link");
    symlink("scene.json", f.join("scene.png")).expect("a link");
    symlink("cloud.rset", f.join("cloud.png")).expect("a link");
    let before = contents(f);
    let whole = f.join("points.ply");
    for arguments in [
        &["build", "points.ply", "-o", "points.ply"][..],
        &["build", "points.ply", "-o", "./points.ply"],
        &["build", "points.ply", "-o", whole.to_str().expect("a path")],
        &["build", "points.ply", "-o", "hard.ply"],
        &["build", "points.ply", "-o", "soft.ply"],
        &["build", "soft.ply", "-o", "points.ply"],
        &["build", "t.xyz", "points.ply", "-o", "points.ply"],
        &["build", "t.csv", "-o", "t.csv"],
        &["build", "v.mhd", "-o", "v.mhd"],
        &["build", "v.mhd", "-o", "v.raw"],
        &["build", "v.raw", "--raw", "4x4x4,u8", "-o", "v.raw"],
        &["generate", "--from-mesh", "mesh.ply", "--points", "9", "-o", "mesh.ply"],
        &["render", "cloud.rset", "-o", "cloud.png"],
        &["render", "cloud.rset", "-o", "p.png", "--stats", "cloud.rset"],
        &["render", "scene.json", "-o", "scene.png"],
        &["render", "scene.json", "-o", "p.png", "--stats", "scene.json"],
        &["render", "scene.json", "-o", "p.png", "--stats", "cloud.rset"],
        &["render", "scene.json", "-o", "p.png", "--stats", "grid.rset"],
        &["render", "scene.json", "-o", "p.png", "--stats", "preset.json"],
    ] {
        let said = fails(f, arguments);
        assert!(said.contains("is an input of this run"), "{arguments:?}: {said}");
        assert!(contents(f) == before, "{arguments:?} changed files: {:?}", names(f));
    }
    let said = fails(f, &["render", "cloud.rset", "-o", "p.png", "--stats", "./p.png"]);
    assert!(said.contains("twice"), "{said}");
    assert!(contents(f) == before);
}

#[test]
fn the_library_refuses_to_build_over_what_it_reads() {
    let folder = with_cloud();
    let path = folder.path().join("points.ply");
    let before = fs::read(&path).expect("it reads");
    let source = points::open(&path, &ReadOptions::default()).expect("it opens");
    let outcome = build::run(vec![source], &path, &BuildOptions::default(), &BuildControl::default());
    assert!(matches!(outcome, Err(BuildError::Output(OutputError::IsInput { .. }))));
    assert!(fs::read(&path).expect("it reads") == before);
}

#[test]
fn a_link_stays_and_the_file_that_it_leads_to_is_replaced() {
    let folder = with_cloud();
    let f = folder.path();
    fs::create_dir(f.join("far")).expect("a folder");
    fs::write(f.join("far/old.png"), b"old").expect("a write");
    symlink("far/old.png", f.join("a.png")).expect("a link");
    symlink("a.png", f.join("chain.png")).expect("a link");
    symlink("far/new.png", f.join("dangling.png")).expect("a link");
    symlink("loop.png", f.join("loop.png")).expect("a link");
    for (link, target) in [("a.png", "old.png"), ("chain.png", "old.png"), ("dangling.png", "new.png")] {
        let target = f.join("far").join(target);
        let _ = fs::write(f.join("far/old.png"), b"old");
        succeeds(f, &["render", "cloud.rset", "-o", link, "--size", "8x8"]);
        assert!(fs::symlink_metadata(f.join(link)).expect("it is there").is_symlink(), "{link}");
        assert!(fs::read(&target).expect("it reads").starts_with(b"\x89PNG"), "{link}");
    }
    assert!(fails(f, &["render", "cloud.rset", "-o", "loop.png"]).contains("loop.png"));
    assert_eq!(names(&f.join("far")), ["new.png", "old.png"]);
}

#[test]
fn folders_are_refused_and_pipes_are_written_to_or_refused_but_never_replaced() {
    let folder = with_cloud();
    let f = folder.path();
    fs::create_dir(f.join("folder.png")).expect("a folder");
    assert!(Command::new("mkfifo").arg(f.join("pipe.png")).status().expect("mkfifo").success());
    assert!(Command::new("mkfifo").arg(f.join("pipe.exr")).status().expect("mkfifo").success());
    let before = names(f);
    let said = fails(f, &["render", "cloud.rset", "-o", "folder.png"]);
    assert!(said.contains("is a folder; name a file in it"), "{said}");
    assert!(fails(f, &["render", "cloud.rset", "-o", "absent/x.png"]).contains("there is no folder absent"));
    for arguments in [
        &["build", "points.ply", "-o", "pipe.png"][..],
        &["build", "points.ply", "-o", "/dev/null"],
        &["render", "cloud.rset", "-o", "pipe.exr"],
    ] {
        let said = fails(f, arguments);
        assert!(said.contains("needs a regular file"), "{arguments:?}: {said}");
    }
    // Somebody reads the pipe.
    let pipe = f.join("pipe.png");
    let reader = std::thread::spawn(move || fs::read(pipe).expect("the pipe reads"));
    succeeds(f, &["render", "cloud.rset", "-o", "pipe.png", "--size", "16x16"]);
    let streamed = reader.join().expect("the reader ends");
    succeeds(f, &["render", "cloud.rset", "-o", "file.png", "--size", "16x16"]);
    assert!(streamed == fs::read(f.join("file.png")).expect("it reads"));
    fs::remove_file(f.join("file.png")).expect("it goes");
    let output = run(f, &["generate", "sphere-2k", "-o", "/dev/stdout"]);
    assert!(output.status.success());
    assert!(output.stdout == fs::read(f.join("points.ply")).expect("it reads"));
    assert!(String::from_utf8_lossy(&output.stderr).contains("2 000 points"));
    for arguments in [
        &["generate", "sphere-2k", "-o", "/dev/null"][..],
        &["render", "cloud.rset", "-o", "/dev/null", "--size", "8x8", "--stats", "/dev/null"],
    ] {
        succeeds(f, arguments);
    }
    for arguments in [
        &["generate", "sphere-2k", "-o", "/dev/full"][..],
        &["render", "cloud.rset", "-o", "/dev/full", "--size", "8x8"],
    ] {
        let said = fails(f, arguments);
        assert_eq!(said.matches("No space left").count(), 1, "{said}");
    }
    for device in ["/dev/null", "/dev/full"] {
        assert!(fs::metadata(device).expect("it is there").file_type().is_char_device());
    }
    assert_eq!(names(f), before);
    assert!(fs::metadata(f.join("pipe.png")).expect("it is there").file_type().is_fifo());
}

#[test]
fn nothing_is_left_of_what_did_not_fit_or_was_refused() {
    let folder = with_cloud();
    let f = folder.path();
    fs::write(f.join("v.raw"), vec![1; 64 * 64 * 64]).expect("a write");
    fs::write(f.join("bad.ply"), "ply\nformat ascii 1.0\nelement vertex 9\nproperty float x\nproperty float y\nproperty float z\nend_header\n1 2 3\n").expect("a write");
    let before = contents(f);
    // A limit of 16 KiB on the size of files, as a disk that is full.
    for arguments in [
        &["generate", "sphere-20k", "-o", "out.ply"][..],
        &["build", "points.ply", "-o", "out.rset"],
        &["build", "v.raw", "--raw", "64x64x64,u8", "-o", "out.rset"],
        &["render", "cloud.rset", "-o", "out.png", "--size", "256x256"],
        &["render", "cloud.rset", "-o", "out.exr", "--size", "256x256"],
    ] {
        let mut shell = Command::new("/bin/sh");
        shell.current_dir(f).args(["-c", "ulimit -f 16; exec \"$0\" \"$@\"", env!("CARGO_BIN_EXE_rayset")]);
        let output = shell.args(arguments).output().expect("a shell");
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{arguments:?}: {said}");
        assert_eq!(said.matches("File too large").count(), 1, "{arguments:?}: {said}");
        assert!(contents(f) == before, "{arguments:?} left {:?}", names(f));
    }
    for arguments in [
        &["build", "bad.ply", "-o", "out.rset"][..],
        &["build", "points.ply", "-o", "out.rset", "--radius", "size"],
        &["build", "points.ply", "-o", "out.rset", "--precision", "2"],
        &["build", "points.ply", "-o", "out.rset", "--memory", "1MiB"],
        &["render", "cloud.rset", "-o", "out.png", "--memory", "1MiB"],
        &["render", "cloud.rset", "-o", "out.png", "--color-by=nothing"],
        &["render", "cloud.rset", "-o", "out.png", "--crop", "600,600,9,9"],
        &["render", "cloud.rset", "-o", "out.jpeg"],
    ] {
        fails(f, arguments);
        assert!(contents(f) == before, "{arguments:?} left {:?}", names(f));
    }
}

/// Waits until a run has begun to write in the folder.
/// Whether a run was seen to write; it may have ended before.
fn wait_for_partial(folder: &Path, child: &mut Child) -> bool {
    let started = Instant::now();
    while !names(folder).iter().any(|name| name.contains("rayset-partial")) {
        if child.try_wait().expect("it can be asked").is_some() {
            return false;
        }
        assert!(started.elapsed() < Duration::from_secs(60), "it never writes");
        std::thread::sleep(Duration::from_millis(1));
    }
    true
}

#[test]
fn a_signal_ends_a_run_with_its_number_and_a_line_and_leaves_nothing() {
    let_children_be_interrupted();
    let folder = with_cloud();
    let f = folder.path();
    succeeds(f, &["generate", "sphere-400k", "-o", "many.ply"]);
    fs::write(f.join("v.raw"), vec![1; 512 * 512 * 60]).expect("a write");
    let before = names(f);
    let slow = ["render", "cloud.rset", "-o", "out.png", "--size", "4000x4000", "--samples", "8"];
    for (number, (arguments, signal, code, name)) in [
        (&["build", "many.ply", "-o", "out.rset"][..], "INT", 130, "SIGINT"),
        (&["build", "v.raw", "--raw", "512x512x60,u8", "-o", "out.rset"], "TERM", 143, "SIGTERM"),
        (&["generate", "sphere-40m", "-o", "out.ply"], "INT", 130, "SIGINT"),
        (&slow, "TERM", 143, "SIGTERM"),
        (&slow, "HUP", 129, "SIGHUP"),
        (&[&slow[..3], &["out.exr"], &slow[4..]].concat(), "INT", 130, "SIGINT"),
    ]
    .into_iter()
    .enumerate()
    {
        // On a busy machine a signal may come when the run has ended by itself, rightly: once more,
        // then.
        let signalled = || {
            let mut command = program(f, arguments);
            command.stdout(Stdio::null()).stderr(Stdio::piped());
            let mut child = command.spawn().expect("the program runs");
            if wait_for_partial(f, &mut child) {
                send(signal, &child);
            }
            let output = child.wait_with_output().expect("it ends");
            let by_itself = output.status.success();
            if by_itself {
                names(f).iter().filter(|name| !before.contains(name)).for_each(|name| {
                    fs::remove_file(f.join(name)).expect("its output");
                });
            }
            (!by_itself).then_some(output)
        };
        let output = (0..20).find_map(|_| signalled()).expect("it is still running when the signal comes");
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{number}: {arguments:?}: {said}");
        assert!(said.lines().any(|line| line.starts_with(&format!("ended by {name}"))), "{number}: {said}");
        assert!(!said.contains("error"), "{number}: {said}");
        assert_eq!(names(f), before, "{number}");
    }
}

#[test]
fn a_signal_removes_the_folder_of_a_demonstration_and_an_ignored_one_stays_ignored() {
    let (folder, temporary) = (folder(), folder());
    let mut command = program(folder.path(), &["demo", "--workload", "knot-1m"]);
    command.env("TMPDIR", temporary.path()).stdout(Stdio::null()).stderr(Stdio::null());
    let mut child = command.spawn().expect("the program runs");
    let started = Instant::now();
    while names(temporary.path()).is_empty() {
        assert!(started.elapsed() < Duration::from_secs(60), "it never starts");
        std::thread::sleep(Duration::from_millis(1));
    }
    std::thread::sleep(Duration::from_millis(20));
    send("TERM", &child);
    assert_eq!(child.wait().expect("it ends").code(), Some(143));
    assert!(names(temporary.path()).is_empty() && names(folder.path()).is_empty());

    // As under `nohup`.
    let mut shell = Command::new("/bin/sh");
    shell.current_dir(folder.path()).args(["-c", "trap '' HUP; exec \"$0\" \"$@\""]);
    shell.args([env!("CARGO_BIN_EXE_rayset"), "generate", "sphere-2m", "-o", "p.ply"]);
    let mut child = shell.stdout(Stdio::null()).spawn().expect("a shell");
    assert!(wait_for_partial(folder.path(), &mut child), "it ended before it wrote");
    send("HUP", &child);
    assert_eq!(child.wait().expect("it ends").code(), Some(0));
    assert_eq!(names(folder.path()), ["p.ply"]);
}

#[test]
fn a_second_signal_ends_at_once_what_the_first_could_not() {
    let_children_be_interrupted();
    let folder = folder();
    let f = folder.path();
    // Nobody reads what is said, and there is no room for more: the line that the first signal asks
    // for waits.
    let (_reader, mut writer) = std::io::pipe().expect("a pipe");
    writer.write_all(&[b'.'; 1 << 16]).expect("as much as a pipe holds");
    let mut command = program(f, &["generate", "sphere-40m", "-o", "out.ply"]);
    let mut child = command.stdout(Stdio::null()).stderr(writer).spawn().expect("the program runs");
    assert!(wait_for_partial(f, &mut child), "it ended before it wrote");
    send("INT", &child);
    let started = Instant::now();
    while !names(f).is_empty() {
        assert!(started.elapsed() < Duration::from_secs(60), "the file stays");
        std::thread::sleep(Duration::from_millis(1));
    }
    std::thread::sleep(Duration::from_millis(50));
    assert!(child.try_wait().expect("it can be asked").is_none(), "the line does not wait");
    send("INT", &child);
    assert_eq!(child.wait().expect("it ends").code(), Some(130));
    assert!(names(f).is_empty());
}

#[test]
fn a_panic_leaves_no_half_output() {
    struct Panics(Box<dyn PointSource>);
    impl PointSource for Panics {
        fn schema(&self) -> &Schema {
            self.0.schema()
        }

        fn count_hint(&self) -> Option<u64> {
            None
        }

        fn select(&mut self, columns: &[usize]) {
            self.0.select(columns);
        }

        fn fill(&mut self, _: &mut PointBatch, _: usize) -> Result<(), ReadError> {
            panic!("a reader gives up");
        }
    }
    let folder = folder();
    let path = folder.path().join("c.rset");
    let source = "sphere-100".parse::<Workload>().expect("a workload").source();
    let build = || {
        build::run(vec![Box::new(Panics(source))], &path, &BuildOptions::default(), &BuildControl::default())
    };
    assert!(std::panic::catch_unwind(std::panic::AssertUnwindSafe(build)).is_err());
    assert!(names(folder.path()).is_empty());
}

#[test]
fn what_killed_runs_of_every_kind_leave_the_next_ones_remove() {
    let folder = with_cloud();
    let f = folder.path();
    let before = names(f);
    let mut random = Random(12);
    let runs: [(&[&str], &str); 3] = [
        (&["build", "points.ply", "-o", "out.rset"], "out.rset"),
        (&["render", "cloud.rset", "-o", "out.png", "--size", "64x64"], "out.png"),
        (&["generate", "sphere-50k", "-o", "out.ply"], "out.ply"),
    ];
    for (arguments, output) in runs {
        for _ in 0..6 {
            let mut command = program(f, arguments);
            let mut child =
                command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("the program runs");
            std::thread::sleep(Duration::from_secs_f64(0.03 * random.unit()));
            child.kill().expect("it can be killed");
            child.wait().expect("it ends");
        }
        succeeds(f, arguments);
        let mut after = before.clone();
        after.push(output.into());
        after.sort();
        assert_eq!(names(f), after);
        fs::remove_file(f.join(output)).expect("it goes");
    }
    let mut bytes = Vec::new();
    File::open(f.join("cloud.rset")).and_then(|mut file| file.read_to_end(&mut bytes)).expect("it reads");
    assert!(!bytes.is_empty());
}

#[test]
fn no_output_replaces_a_file_that_an_input_pulls_in() {
    let folder = folder();
    let f = folder.path();
    let parts = Path::new(env!("CARGO_MANIFEST_DIR")).join("../rayset/tests/fixtures/gadget");
    let others: [(&str, &str, usize); 2] = [
        ("v.mhd", "NDims = 3\nDimSize = 8 8 8\nElementType = MET_UCHAR\nElementDataFile = v.raw\n", 512),
        (
            "v.nhdr",
            "NRRD0004\ntype: uint8\ndimension: 3\nsizes: 8 8 8\nencoding: raw\ndata file: v.raw\n",
            512,
        ),
    ];
    let refused = |arguments: &[&str], kept: &str| {
        let before = fs::read(f.join(kept)).expect("it reads");
        let said = fails(f, arguments);
        assert!(said.contains("is an input of this run"), "{arguments:?}: {said}");
        assert!(fs::read(f.join(kept)).expect("it is still there") == before, "{arguments:?}");
    };
    for (header, text, bytes) in others {
        fs::write(f.join(header), text).expect("a write");
        fs::write(f.join("v.raw"), (0..bytes).map(|i| i as u8).collect::<Vec<_>>()).expect("a write");
        refused(&["build", header, "-o", "v.raw"], "v.raw");
        // Built now, and taken from the cache.
        let render = ["render", header, "-o", "a.png", "--size", "8x8"];
        succeeds(f, &[&render[..], &["--cache", "kept"]].concat());
        fs::copy(f.join("v.raw"), f.join("w.png")).expect("a copy");
        for option in ["--stats", "--write-scene"] {
            refused(&[&render[..], &["--cache", "kept", option, "v.raw"]].concat(), "v.raw");
            refused(&[&render[..], &[option, "v.raw", "--no-cache"]].concat(), "v.raw");
        }
    }
    let png = "NDims = 3\nDimSize = 8 8 8\nElementType = MET_UCHAR\nElementDataFile = w.png\n";
    fs::write(f.join("w.mhd"), png).expect("a write");
    refused(&["render", "w.mhd", "-o", "w.png", "--size", "8x8", "--no-cache"], "w.png");
    // Voxels of OpenDX in a file of their own, and series of volumes, of which one is read.
    let numbers: Vec<u8> = (0..27).flat_map(|i| (i as f32).to_le_bytes()).collect();
    fs::write(f.join("numbers.png"), [&[0; 16], &numbers[..]].concat()).expect("a write");
    let dx = "object 1 class gridpositions counts 3 3 3\n origin 0 0 0\n delta 1 0 0\n delta 0 1 0\n delta 0 0 1\n\
        object 2 class gridconnections counts 3 3 3\nobject 3 class array type float rank 0 items 27 lsb ieee \
        data file numbers.png,16\nattribute \"dep\" string \"positions\"\nobject \"f\" class field\n\
        component \"positions\" value 1\ncomponent \"data\" value 3\nend\n";
    fs::write(f.join("v.dx"), dx).expect("a write");
    let render = ["render", "v.dx", "--size", "8x8", "--no-cache", "-o"];
    refused(&["build", "v.dx", "-o", "numbers.png"], "numbers.png");
    refused(&[&render[..], &["numbers.png"]].concat(), "numbers.png");
    refused(&[&render[..], &["a.png", "--write-scene", "numbers.png"]].concat(), "numbers.png");
    let header = "{'descr': '|u1', 'fortran_order': False, 'shape': (2, 5, 5, 5), }\n";
    let npy =
        [b"\x93NUMPY\x01\0", &(header.len() as u16).to_le_bytes()[..], header.as_bytes(), &[9; 250]].concat();
    fs::write(f.join("series.npy"), npy).expect("a write");
    let mut nifti = vec![0_u8; 352 + 250];
    nifti[0..4].copy_from_slice(&348_i32.to_le_bytes());
    for (i, n) in [4_i16, 5, 5, 5, 2].into_iter().enumerate() {
        nifti[40 + 2 * i..42 + 2 * i].copy_from_slice(&n.to_le_bytes());
    }
    nifti[70] = 2;
    nifti[108..112].copy_from_slice(&352_f32.to_le_bytes());
    nifti[344..348].copy_from_slice(b"n+1\0");
    fs::write(f.join("series.nii"), nifti).expect("a write");
    for series in ["series.npy", "series.nii"] {
        refused(&["build", series, "-o", series, "--volume-index", "1"], series);
        for option in ["--stats", "--write-scene"] {
            let words =
                ["render", series, "-o", "a.png", "--size", "8x8", "--volume-index", "1", option, series];
            refused(&[&words[..], &["--no-cache"]].concat(), series);
            refused(&[&words[..], &["--cache", "kept"]].concat(), series);
        }
    }
    for name in ["parts.0", "parts.1"] {
        fs::copy(parts.join(name), f.join(name)).expect("a snapshot");
    }
    refused(&["build", "parts.0", "-o", "parts.1"], "parts.1");
    refused(&["build", "parts.0", "-o", "parts.1", "--part", "1/2"], "parts.1");
    // A preset and a picture of a scene.
    let scene = r#"{"rayset": 1, "image": {"size": [8, 8]}, "root": {"type": "sphere", "radius": 1,
        "transfers": [{"preset": {"file": "p.json"}}]}}"#;
    fs::write(f.join("s.json"), scene).expect("a write");
    let preset = r#"[{"Name": "a", "RGBPoints": [0, 0, 0, 0, 1, 1, 1, 1]}]"#;
    fs::write(f.join("p.json"), preset).expect("a write");
    refused(&["render", "s.json", "-o", "a.png", "--stats", "p.json"], "p.json");
}

#[test]
fn parts_are_not_merged_into_their_own_folder() {
    let folder = folder();
    let f = folder.path();
    succeeds(f, &["generate", "sphere-2k", "-o", "p.ply"]);
    for _ in 0..9 {
        succeeds(f, &["build", "p.ply", "-o", "x", "--radius", "0.2", "--part", "1/1"]);
    }
    let before = names(&f.join("x.parts"));
    for output in ["x.parts/order-1-of-1.data", "x.parts/new.rset", "x.parts/../x.parts/new.rset"] {
        let said = fails(f, &["merge", "x.parts", "-o", output]);
        assert!(said.contains("the folder of the parts"), "{output}: {said}");
    }
    assert_eq!(names(&f.join("x.parts")), before);
    succeeds(f, &["merge", "x.parts", "-o", "x.rset"]);
}

#[test]
fn an_output_keeps_the_mode_of_the_file_that_it_replaces() {
    use std::os::unix::fs::PermissionsExt;
    let folder = with_cloud();
    let f = folder.path();
    let outputs: [&[&str]; 4] = [
        &["build", "points.ply", "-o"],
        &["render", "cloud.rset", "--size", "8x8", "-o"],
        &["render", "cloud.rset", "--size", "8x8", "-o", "other.png", "--stats"],
        &["generate", "sphere-100", "-o"],
    ];
    for (arguments, name) in outputs.into_iter().zip(["o.rset", "o.png", "o.json", "o.ply"]) {
        for mode in [0o600, 0o640, 0o664] {
            fs::write(f.join(name), "an older file").expect("a write");
            fs::set_permissions(f.join(name), fs::Permissions::from_mode(mode)).expect("a mode");
            succeeds(f, &[arguments, &[name]].concat());
            let now = fs::metadata(f.join(name)).expect("it is there");
            assert!(now.len() != 13 && now.mode() & 0o777 == mode, "{name}: {:o}", now.mode());
        }
    }
}
