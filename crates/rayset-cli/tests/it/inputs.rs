//! How inputs are opened: from the standard input, of a series of volumes, and with a line about
//! their columns.

use std::io::Write;
use std::path::Path;
use std::process::Stdio;

use crate::common::{folder, program};

/// Runs the program in a folder, with these bytes as its standard input. Whether it ends well, and
/// all that it says.
fn run(folder: &Path, arguments: &[&str], input: &[u8]) -> (bool, String) {
    let mut child = program()
        .current_dir(folder)
        .args(arguments)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("it starts");
    let mut to = child.stdin.take().expect("a pipe");
    // What is refused is not read to its end.
    let _ = to.write_all(input);
    drop(to);
    let output = child.wait_with_output().expect("it ends");
    let text = [output.stdout, output.stderr].concat();
    (output.status.success(), String::from_utf8_lossy(&text).into_owned())
}

const TABLE: &str = "x,y,z,intensity\n1,2,3,4\n2,3,4,5\n3,4,5,6\n";

#[cfg(unix)]
#[test]
fn formats_that_are_read_from_start_to_end_come_through_the_standard_input() {
    let folder = folder();
    let ply = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nend_header\n\
               1 2 3\n4 5 6\n7 8 9\n";
    let pcd = "# .PCD v.7\nVERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 3\nHEIGHT 1\nPOINTS 3\n\
               DATA ascii\n1 2 3\n4 5 6\n7 8 9\n";
    let ptx = "1\n3\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n1 2 3 0.5\n4 5 6 0.5\n7 8 9 0.5\n";
    let mut packed = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    packed.write_all(TABLE.as_bytes()).expect("a write");
    let packed = packed.finish().expect("it ends");
    for bytes in [TABLE.as_bytes(), ply.as_bytes(), pcd.as_bytes(), ptx.as_bytes(), &packed] {
        for name in ["-", "/dev/stdin"] {
            let (well, said) = run(folder.path(), &["info", "--no-cache", name], bytes);
            assert!(well && said.contains("points      3 "), "{name}: {said}");
            let (well, said) = run(folder.path(), &["build", name, "-o", "c.rset"], bytes);
            assert!(well && said.contains("3 points"), "{name}: {said}");
        }
    }
    let (well, said) = run(folder.path(), &["info", "--no-cache", "-"], b"LASF\x01\x02\x03");
    assert!(!well && said.contains("write it to a file"), "{said}");
    let (well, said) = run(folder.path(), &["info", "--no-cache", "-"], b"");
    assert!(!well && said.contains("/dev/stdin"), "{said}");
}

#[test]
fn a_line_says_how_the_columns_of_a_table_were_read_also_of_one_that_was_built_before() {
    let folder = folder();
    let f = folder.path();
    std::fs::write(f.join("a.csv"), TABLE).expect("a write");
    std::fs::write(f.join("b.csv"), TABLE).expect("a write");
    let line = "columns, by the header on line 1: x,y,z,intensity";
    for _ in 0..2 {
        let (well, said) = run(f, &["info", "--cache", "cache", "a.csv"], b"");
        assert!(well && said.contains(line), "{said}");
    }
    let (well, said) = run(f, &["build", "a.csv", "b.csv", "-o", "c.rset"], b"");
    assert!(well && said.contains(&format!("a.csv and 1 more: {line}")), "{said}");
    assert!(said.contains("--columns"), "{said}");
    let (well, said) = run(f, &["build", "a.csv", "-o", "c.rset", "--columns", "x,y,z,t"], b"");
    assert!(well && said.contains("columns, by --columns: x,y,z,t"), "{said}");
}

#[test]
fn another_volume_of_a_series_is_read_by_its_index() {
    let folder = folder();
    let f = folder.path();
    let mut bytes = b"NRRD0004\ntype: uchar\ndimension: 4\nsizes: 2 2 2 3\nencoding: raw\n\n".to_vec();
    (0..3_u8).for_each(|volume| bytes.extend([volume, volume, volume, 10 + volume].repeat(2)));
    std::fs::write(f.join("a.nrrd"), bytes).expect("a write");
    for (arguments, line, values) in [
        (&[][..], "volume 0 of a series of 3", "0 to 10"),
        (&["--volume-index", "2"], "volume 2 of a series of 3", "2 to 12"),
    ] {
        let (well, said) = run(f, &[&["info", "--cache", "cache", "a.nrrd"], arguments].concat(), b"");
        assert!(well && said.contains(line) && said.contains(values), "{said}");
        let (well, said) = run(f, &[&["build", "a.nrrd", "-o", "g.rset"], arguments].concat(), b"");
        assert!(well && said.contains(line) && said.contains(values), "{said}");
    }
    let (well, said) = run(f, &["info", "--no-cache", "a.nrrd", "--volume-index", "3"], b"");
    assert!(!well && said.contains("the file has 3 volumes, of indices 0 to 2"), "{said}");
    std::fs::write(f.join("a.csv"), TABLE).expect("a write");
    let (well, said) = run(f, &["info", "--no-cache", "a.csv", "--volume-index", "1"], b"");
    assert!(!well && said.contains("--volume-index 1 is for volumes"), "{said}");
}
