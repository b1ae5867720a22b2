//! What is said of failures: once, of the right thing, and nothing that a terminal would obey.

use std::ffi::OsStr;
use std::fs;
use std::path::Path;
use std::process::{Command, Output, Stdio};

use crate::common::folder;

fn run(folder: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_rayset"));
    command.current_dir(folder).args(arguments).stdin(Stdio::null()).output().expect("the program runs")
}

fn succeeds(folder: &Path, arguments: &[&str]) -> String {
    let output = run(folder, arguments);
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// The one line that is said of a failure.
fn fails(folder: &Path, arguments: &[&str]) -> String {
    let output = run(folder, arguments);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{arguments:?}: {said}");
    // What was chosen before may be said, too.
    let lines: Vec<&str> = said.lines().skip_while(|line| line.starts_with("look: ")).collect();
    assert!(lines.len() == 1 && lines[0].starts_with("error: "), "{arguments:?}: {said}");
    format!("{}\n", lines[0])
}

/// A folder with `p.ply`, `c.rset` and `g.rset`.
fn prepared() -> tempfile::TempDir {
    let folder = folder();
    let f = folder.path();
    succeeds(f, &["generate", "sphere-2k", "-o", "p.ply"]);
    succeeds(f, &["build", "p.ply", "-o", "c.rset", "--radius", "0.2"]);
    fs::write(f.join("v.raw"), [5; 20 * 20 * 20]).expect("a write");
    succeeds(f, &["build", "v.raw", "--raw", "20x20x20,u8", "-o", "g.rset"]);
    folder
}

#[test]
fn no_cause_is_said_twice() {
    let folder = prepared();
    let f = folder.path();
    fs::create_dir(f.join("folder.rset")).expect("a folder");
    fs::write(f.join("s.json"), r#"{"rayset": 1, "root": {"type": "cloud", "file": "absent.rset"}}"#)
        .expect("a write");
    let mut damaged = fs::read(f.join("c.rset")).expect("it reads");
    damaged[4096 + 200] ^= 1;
    fs::write(f.join("damaged.rset"), &damaged).expect("a write");
    damaged[100] ^= 1;
    fs::write(f.join("header.rset"), &damaged).expect("a write");
    fs::write(f.join("short.rset"), &damaged[..9000]).expect("a write");
    for name in ["bad.las", "bad.ply", "bad.csv", "bad.nrrd", "bad.nii", "bad.vti", "bad.mha", "bad.json"] {
        fs::write(f.join(name), b"\x01\x02 nothing of the kind\n").expect("a write");
    }
    for arguments in [
        &["build", "absent.ply", "-o", "x.rset"][..],
        &["build", "absent.las", "-o", "x.rset"],
        &["build", "absent.csv", "-o", "x.rset"],
        &["build", "absent.nii", "-o", "x.rset"],
        &["build", "bad.las", "-o", "x.rset"],
        &["build", "bad.ply", "-o", "x.rset"],
        &["build", "bad.csv", "-o", "x.rset"],
        &["build", "bad.nrrd", "-o", "x.rset"],
        &["build", "bad.nii", "-o", "x.rset"],
        &["build", "bad.vti", "-o", "x.rset"],
        &["build", "bad.mha", "-o", "x.rset"],
        &["build", "p.ply", "-o", "x.rset", "--temp-dir", "absent"],
        &["build", "v.raw", "--raw", "20x20x90,u8", "-o", "x.rset"],
        &["build", "p.ply", "-o", "absent/x.rset"],
        &["generate", "sphere-9", "-o", "/dev/full"],
        &["generate", "--from-mesh", "absent.ply", "--points", "5"],
        &["render", "absent.rset", "-o", "x.png"],
        &["render", "folder.rset", "-o", "x.png"],
        &["render", "absent.json", "-o", "x.png"],
        &["render", "bad.json", "-o", "x.png"],
        &["render", "s.json", "-o", "x.png"],
        &["render", "damaged.rset", "-o", "x.png"],
        &["render", "header.rset", "-o", "x.png"],
        &["render", "c.rset", "-o", "/dev/full"],
        &["info", "absent.rset"],
        &["info", "short.rset"],
        &["verify", "header.rset"],
        &["verify", "damaged.rset"],
        &["check", "absent.json"],
        &["check", "s.json"],
    ] {
        let said = fails(f, arguments);
        let parts: Vec<&str> =
            said.trim_end().trim_start_matches("error: ").split(": ").filter(|p| p.len() > 12).collect();
        for (i, part) in parts.iter().enumerate() {
            assert_eq!(said.matches(part).count(), 1, "{arguments:?}: part {i} stands twice: {said}");
        }
        for hollow in ["failed to fill whole buffer", "os error 2) (os", "stream did not contain"] {
            assert!(!said.contains(hollow), "{arguments:?}: {said}");
        }
    }
}

#[test]
fn an_error_of_the_library_says_all_and_has_no_second_sentence_behind_it() {
    // A cause that is part of what is displayed and also the `source` is printed twice by whoever
    // walks causes. `r#source` is displayed and is no source.
    let mut files = Vec::new();
    let crates = ["rayset-base", "rayset-store", "rayset-files", "rayset-formats", "rayset-render"];
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut folders = crates.map(|name| here.with_file_name(name).join("src")).to_vec();
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).expect("the library is there") {
            let path = entry.expect("an entry").path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension() == Some(OsStr::new("rs")) {
                files.push(path);
            }
        }
    }
    assert!(files.len() > 300);
    let mut errors = 0;
    for path in files {
        let text = fs::read_to_string(&path).expect("it reads");
        let mut transparent = false;
        for (number, line) in text.lines().enumerate() {
            let line = line.trim();
            errors += usize::from(line.starts_with("#[error("));
            let place = format!("{}:{}: {line}", path.display(), number + 1);
            if line.starts_with("#[error(") {
                transparent = line.contains("transparent");
            }
            assert!(!line.contains("#[source]"), "{place}");
            assert!(!line.contains("#[from]") || transparent, "{place}");
            let is_field = line.starts_with("source: ") && line.ends_with(',');
            let is_error = ["Error,", "Error>,"].iter().any(|end| line.ends_with(end));
            assert!(!(is_field && is_error), "{place}: call it `r#source`");
        }
    }
    assert!(errors > 50, "{errors}");
}

#[test]
fn a_file_of_another_kind_is_told_what_it_is_and_what_to_do_with_it() {
    let folder = prepared();
    let f = folder.path();
    fs::write(f.join("empty.rset"), b"").expect("a write");
    fs::write(f.join("zeros.rset"), [0; 9000]).expect("a write");
    let grid = fs::read(f.join("g.rset")).expect("it reads");
    fs::write(f.join("g-short.rset"), &grid[..5000]).expect("a write");
    fs::write(f.join("g-cut.rset"), &grid[..grid.len() - 100]).expect("a write");
    let cloud = fs::read(f.join("c.rset")).expect("it reads");
    fs::write(f.join("c-short.rset"), &cloud[..20]).expect("a write");
    for (arguments, words) in [
        (&["verify", "p.ply"][..], &["neither a cloud", "rayset build p.ply -o p.rset"][..]),
        (&["render", "c.rset", "p.ply", "-o", "x.png"], &["c.rset", "has been built", "docs/scene.md"]),
        (
            &["render", "g.rset", "--look", "surface", "-o", "x.png"],
            &["is for points", "the input has voxels, whose looks are volume and labels"],
        ),
        (&["render", "c.rset", "--look", "classes", "-o", "x.png"], &["stores no classes"]),
        (&["render", "absent*.laz", "-o", "x.png"], &["no file matches absent*.laz"]),
        (&["verify", "v.raw"], &["neither a cloud", "rayset build"]),
        (&["info", "empty.rset"], &["empty.rset", "empty"]),
        (&["info", "zeros.rset"], &["zeros.rset", "not finished"]),
        (&["info", "g-short.rset"], &["ends at byte 5000", "grid file"]),
        (&["verify", "g-short.rset"], &["ends at byte 5000", "grid file"]),
        (&["verify", "g-cut.rset"], &["g-cut.rset"]),
        (&["info", "c-short.rset"], &["ends at byte 20", "cloud file"]),
        (&["verify", "."], &["is a folder"]),
        (&["verify", "/dev/null"], &["pipe or a device"]),
    ] {
        let said = fails(f, arguments);
        words.iter().for_each(|word| assert!(said.contains(word), "{arguments:?}: {said}"));
        assert!(!said.contains("not a file of this kind"), "{arguments:?}: {said}");
    }
}

#[test]
fn a_file_that_has_become_shorter_is_said_to_end_early_and_where() {
    use rayset::working_set::read::{FileStorage, Storage};
    let folder = folder();
    let path = folder.path().join("short");
    fs::write(&path, [1; 100]).expect("a write");
    let storage = FileStorage::open(&path, false).expect("it opens");
    let error = storage.read_exact_at(&mut [0; 64], 64).expect_err("it ends early");
    assert_eq!(error.kind(), std::io::ErrorKind::UnexpectedEof);
    assert!(error.to_string().contains("ends at byte 100, before byte 128"), "{error}");
}

#[test]
fn a_grid_is_described_in_json_where_json_is_asked_for() {
    let folder = prepared();
    let said = succeeds(folder.path(), &["info", "g.rset", "--json"]);
    let info: serde_json::Value = serde_json::from_str(&said).expect("JSON");
    assert_eq!(info["size"], serde_json::json!([20, 20, 20]));
    assert_eq!((&info["value_min"], &info["value_max"]), (&5.0.into(), &5.0.into()));
    assert_eq!(info["bounds_max"], serde_json::json!([19.0, 19.0, 19.0]));
    assert!(info["file_bytes"].as_u64().is_some_and(|bytes| bytes > 8192));
}

#[cfg(target_os = "linux")]
#[test]
fn results_that_do_not_arrive_are_an_error_and_a_closed_pipe_is_not() {
    let folder = prepared();
    let f = folder.path();
    for arguments in [
        &["info", "c.rset"][..],
        &["info", "g.rset", "--json"],
        &["verify", "c.rset"],
        &["build", "p.ply", "-o", "x.rset"],
        &["--help"],
        &["--version"],
    ] {
        let mut command = Command::new(env!("CARGO_BIN_EXE_rayset"));
        let full = fs::File::options().write(true).open("/dev/full").expect("a device");
        let output = command.current_dir(f).args(arguments).stdout(full).output().expect("it runs");
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{arguments:?}: {said}");
        assert!(said.contains("error: results are lost") && said.contains("No space left"), "{said}");

        let (reader, writer) = std::io::pipe().expect("a pipe");
        drop(reader);
        let mut command = Command::new(env!("CARGO_BIN_EXE_rayset"));
        let output = command.current_dir(f).args(arguments).stdout(writer).output().expect("it runs");
        assert_eq!(output.status.code(), Some(0), "{arguments:?}");
        assert!(output.stderr.is_empty(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    }
}

#[cfg(unix)]
#[test]
fn names_and_texts_of_files_cannot_move_the_terminal() {
    let folder = prepared();
    let f = folder.path();
    let evil = "e\u{1b}[31m\u{7}\r\u{9b}2J\u{202e}\n.rset";
    fs::copy(f.join("c.rset"), f.join(evil)).expect("a copy");
    fs::write(f.join("evil.csv"), "x,y,z,a\u{1b}]0;b\u{7}\n1,2,3,4\n5,6,7,8\n").expect("a write");
    fs::write(
        f.join("evil.json"),
        "{\"rayset\": 1, \"\\u001b[2J\": 1, \"root\": {\"type\": \"cloud\", \"file\": \"c.rset\"}}",
    )
    .expect("a write");
    for arguments in [
        &["info", evil][..],
        &["info", &format!("absent{evil}")],
        &["verify", evil],
        &["render", evil, "-o", &format!("{evil}.png"), "--size", "8x8"],
        &["render", evil, "-o", &format!("{evil}.jpg")],
        &["build", evil, "-o", "x.rset"],
        &["build", "evil.csv", "-o", &format!("x{evil}"), "--attributes", "absent"],
        &["build", "p.ply", "-o", &format!("x{evil}")],
        &["build", evil, "--unknown", evil],
        &["check", "evil.json"],
        &["info", evil, evil],
    ] {
        let output = run(f, arguments);
        for said in [output.stdout, output.stderr] {
            let said = String::from_utf8(said).expect("text");
            let obeyed = |c: char| (c.is_control() && c != '\n') || c == '\u{202e}';
            assert!(!said.contains(obeyed), "{arguments:?}: {said:?}");
        }
    }
    let said = fails(f, &["info", &format!("absent{evil}")]);
    assert!(said.contains("absente\\u{1b}[31m"), "{said}");
}
