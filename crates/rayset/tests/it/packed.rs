//! gzip and zstd around text, PLY, PCD and PTX: recognized, read as what is within, and refused
//! where they are damaged.

use std::io::Write;
use std::path::Path;

use rayset::points::{self, MeshSource, PointBatch, PointSource, ReadOptions};

use crate::common::folder;
use crate::fixtures::{are_same, bytes, flips, outcome, outcome_of, path, truncations};
use crate::tables::table;

fn gzipped(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
    encoder.write_all(bytes).expect("a write");
    encoder.finish().expect("it ends")
}

/// As `zstd` without options leaves it: made by the program, of the fixture of the same name.
fn zstd_fixture(name: &str) -> Vec<u8> {
    bytes(&format!("{name}.zst"))
}

fn ply(points: usize, faces: usize) -> Vec<u8> {
    let mut text = format!(
        "ply\nformat ascii 1.0\nelement vertex {points}\nproperty float x\nproperty float y\nproperty float z\nelement \
         face {faces}\nproperty list uchar int vertex_indices\nend_header\n"
    );
    (0..points).for_each(|i| text.push_str(&format!("{} {} {}\n", i % 7, i, (i * i) % 13)));
    (0..faces).for_each(|i| text.push_str(&format!("3 {} {} {}\n", i, i + 1, i + 2)));
    text.into_bytes()
}

#[test]
fn compressed_files_are_read_as_what_they_hold_whatever_they_are_called() {
    let folder = folder();
    let check = |name: &str, packed: &[u8], plain: &Path| {
        let path = folder.path().join(name);
        std::fs::write(&path, packed).expect("a write");
        let (found, expected) = (table(&path, None), table(plain, None).expect("it reads"));
        let found = found.unwrap_or_else(|e| panic!("{e}"));
        assert!(are_same(&found.0, &expected.0), "{name}");
        assert_eq!(format!("{:?}", found.1), format!("{:?}", expected.1), "{name}");
    };
    for name in ["ascii_uint32.pcd", "binary_uint32.pcd", "scans.ptx"] {
        for packed in [gzipped(&bytes(name)), zstd_fixture(name)] {
            for called in [name, &format!("{name}.gz"), &format!("{name}.zst"), "nameless"] {
                check(called, &packed, &path(name));
            }
        }
    }
    let plain = folder.path().join("plain.ply");
    std::fs::write(&plain, ply(500, 3)).expect("a write");
    for called in ["p.ply.gz", "p.ply", "P.PLY.GZ", "nameless"] {
        check(called, &gzipped(&ply(500, 3)), &plain);
    }
    let text = b"x,y,z,red,green,blue\n1,2,3,4,5,6\n7,8,9,10,11,12\n";
    let plain = folder.path().join("plain.csv");
    std::fs::write(&plain, text).expect("a write");
    for called in ["p.csv.gz", "p.csv", "p.xyz.gz", "p.txt.gz"] {
        check(called, &gzipped(text), &plain);
    }
    // Members, one after another, are one file.
    check("p.csv.gz", &[gzipped(&text[..30]), gzipped(&text[30..])].concat(), &plain);
    let mesh = folder.path().join("mesh.ply.gz");
    std::fs::write(&mesh, gzipped(&ply(5, 3))).expect("a write");
    assert_eq!(MeshSource::open(&mesh, 10).expect("a mesh").count_hint(), Some(10));
    let packed = gzipped(&ply(5, 3));
    std::fs::write(&mesh, &packed[..packed.len() - 3]).expect("a write");
    let said = MeshSource::open(&mesh, 10).err().expect("refused").to_string();
    assert!(said.contains("is cut off"), "{said}");
}

#[test]
fn a_table_in_gzip_opens_whatever_its_name() {
    let folder = folder();
    let path = folder.path().join("cloud");
    std::fs::write(&path, gzipped(b"1 2 3\n4 5 6\n")).expect("a write");
    let source = rayset::points::open(&path, &rayset::points::ReadOptions::default()).expect("it opens");
    assert_eq!(source.schema().columns.len(), 0);
}

#[test]
fn frames_of_zstd_one_after_another_and_frames_to_be_skipped_are_one_file() {
    let frame = zstd_fixture("scans.ptx");
    let skipped = [&0x184d_2a53_u32.to_le_bytes()[..], &3_u32.to_le_bytes(), b"abc"].concat();
    let one = outcome_of("p.ptx", &frame).expect("it reads").0;
    // A frame to be skipped first is not told from other files.
    let all = outcome_of("p.ptx", &[&frame[..], &skipped, &frame, &skipped].concat()).expect("it reads").0;
    assert!(are_same(&all, &[one.clone(), one].concat()));
}

#[test]
fn a_compressed_file_that_is_cut_off_anywhere_is_a_sentence() {
    for (name, packed) in [
        ("p.ptx", gzipped(&bytes("scans.ptx"))),
        ("p.pcd", gzipped(&bytes("binary_uint32.pcd"))),
        ("p.pcd", gzipped(&bytes("ascii_uint32.pcd"))),
        ("p.ply", gzipped(&ply(50, 20))),
        ("p.ptx", zstd_fixture("scans.ptx")),
        ("p.pcd", zstd_fixture("binary_uint32.pcd")),
        ("p.pcd", zstd_fixture("ascii_uint32.pcd")),
    ] {
        let unnoticed: Vec<usize> = truncations(name, &packed);
        assert_eq!(unnoticed, [0_usize; 0], "{name} of {}", packed.len());
        let said = outcome_of(name, &packed[..packed.len() - 2]).expect_err("cut off");
        assert!(said.contains("is cut off"), "{said}");
    }
}

#[test]
fn a_damaged_compressed_file_is_a_sentence() {
    for (name, packed, harmless) in [
        // Name, time and system of gzip's header are in no checksum.
        ("p.ptx", gzipped(&bytes("scans.ptx")), 9),
        ("p.ply", gzipped(&ply(50, 20)), 9),
        ("p.ptx", zstd_fixture("scans.ptx"), 2),
        ("p.pcd", zstd_fixture("binary_uint32.pcd"), 2),
    ] {
        let (refused, flipped) = flips(name, &packed, |_| ());
        assert!(refused + harmless >= flipped, "{name}: {refused} of {flipped}");
        let mut wrong = packed.clone();
        let last = wrong.len() - if name == "p.ply" { 6 } else { 1 };
        wrong[last] ^= 1;
        let said = outcome_of(name, &wrong).expect_err("a wrong checksum");
        assert!(said.contains("damaged") || said.contains("wrong"), "{said}");
    }
}

/// A window is memory that a few bytes ask for.
#[test]
fn a_window_of_zstd_is_limited_before_it_is_given() {
    let frame = |window: u8| [&0xfd2f_b528_u32.to_le_bytes()[..], &[0, window, 1, 0, 0]].concat();
    let said = outcome_of("p.csv", &frame(31 << 3)).expect_err("refused");
    assert!(
        said.contains("its zstd data need a window of 2097152 MiB, and up to 128 MiB are given"),
        "{said}"
    );
    let single = [&0xfd2f_b528_u32.to_le_bytes()[..], &[0xe0], &[0xff; 8], &[1, 0, 0]].concat();
    let said = outcome_of("p.csv", &single).expect_err("refused");
    assert!(said.contains("its zstd data need a window of"), "{said}");
    // A later frame may not have a larger one.
    let frames = [zstd_fixture("scans.ptx"), frame(17 << 3)].concat();
    let said = outcome_of("p.ptx", &frames).expect_err("refused");
    assert!(said.contains("zstd"), "{said}");
    let memory = |name: &str| {
        let folder = folder();
        let path = folder.path().join(name);
        std::fs::write(&path, zstd_fixture(name)).expect("a write");
        points::open(&path, &ReadOptions::default()).expect("it opens").memory_needed()
    };
    assert!((4 << 20..8 << 20).contains(&memory("scans.ptx")));
}

#[test]
fn formats_that_are_read_in_many_places_are_refused_within_gzip() {
    for name in ["one_scan.e57", "binary_compressed_uint32.pcd"] {
        let said = outcome_of(&format!("{name}.gz"), &gzipped(&bytes(name))).expect_err("refused");
        assert!(said.contains("decompress it first") && said.contains("gzip"), "{said}");
    }
    let said = outcome_of("unknown.gz", &gzipped(&[200; 100])).expect_err("refused");
    assert!(said.contains("compressed with gzip") && said.contains("gunzip unknown.gz"), "{said}");
    // What is wrong within is said with its line.
    let folder = folder();
    let path = folder.path().join("p.xyz.gz");
    std::fs::write(&path, gzipped(b"1 2 3\n4 five 6\n")).expect("a write");
    assert!(outcome(&path).expect_err("refused").ends_with("line 2: `five` is not a number"));
}

#[test]
fn a_file_that_is_damaged_behind_its_last_point_is_an_error_once() {
    let folder = folder();
    let head =
        "ply\nformat ascii 1.0\nelement vertex 2000\nproperty float x\nproperty float y\nproperty float z\n";
    let mut bytes = gzipped((head.to_owned() + "end_header\n" + &"0.5 0.25 0.125\n".repeat(2000)).as_bytes());
    // Of the checksum that gzip ends with.
    let last = bytes.len() - 6;
    bytes[last] ^= 1;
    let path = folder.path().join("points.ply.gz");
    std::fs::write(&path, bytes).expect("a write");
    let mut source = points::open(&path, &ReadOptions::default()).expect("its header is right");
    let mut batch = PointBatch::default();
    let said = source.fill(&mut batch, usize::MAX).expect_err("the checksum is another").to_string();
    assert!(said.contains("gzip"), "{said}");
    source.fill(&mut batch, usize::MAX).expect("it was said");
    assert!(batch.is_empty());
}
