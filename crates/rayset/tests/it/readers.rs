//! Promise 6 and the formats: what is read, and what malformed input costs.

use std::path::{Path, PathBuf};

use proptest::prelude::*;
use rayset::points::{self, PointBatch, ReadError, ReadOptions};

use crate::common::{folder, real_data};

/// Everything that a file holds: positions and all columns, by name.
fn read(path: &Path, options: &ReadOptions) -> Result<(Vec<[f64; 3]>, Vec<(String, Vec<f32>)>), ReadError> {
    let mut source = points::open(path, options)?;
    let names = source.schema().names().map(str::to_owned).collect::<Vec<_>>();
    source.select(&(0..names.len()).collect::<Vec<_>>());
    let mut all: Vec<Vec<f32>> = vec![Vec::new(); names.len()];
    let (mut position, mut batch) = (Vec::new(), PointBatch::default());
    loop {
        source.fill(&mut batch, 1000)?;
        if batch.is_empty() {
            return Ok((position, names.into_iter().zip(all).collect()));
        }
        assert!(batch.len() <= 1000 && batch.columns.iter().all(|c| c.len() == batch.len()));
        position.extend_from_slice(&batch.position);
        all.iter_mut().zip(&batch.columns).for_each(|(a, c)| a.extend((0..c.len()).map(|i| c.get(i) as f32)));
    }
}

fn write(folder: &Path, name: &str, bytes: &[u8]) -> PathBuf {
    let path = folder.join(name);
    std::fs::write(&path, bytes).expect("a write");
    path
}

/// The same three points in every form of PLY, with a face list before, a list within, and odd
/// types.
fn ply(encoding: &str) -> Vec<u8> {
    let header = format!(
        "ply\nformat {encoding} 1.0\ncomment hello\nelement face 2\nproperty list uchar int vertex_indices\n\
         element vertex 3\nproperty uchar red\nproperty double z\nproperty list ushort float extra\nproperty short x\n\
         property uchar green\nproperty uchar blue\nproperty float y\nproperty uint id\nend_header\n"
    );
    let mut bytes = header.into_bytes();
    let points: [(u8, f64, &[f32], i16, f32, u32); 3] = [
        (255, 0.1, &[1.0, 2.0], -3, 2.5, 7),
        (0, 1e7 + 0.001, &[], 4, -0.5, 8),
        (51, -2.0, &[9.0], 0, 0.0, 4_000_000_000),
    ];
    if encoding == "ascii" {
        bytes.extend_from_slice(b"3 0 1 2\n4 0 1 2 0\n");
        for (r, z, extra, x, y, id) in points {
            let list: Vec<String> = extra.iter().map(f32::to_string).collect();
            let line = format!("{r} {z} {} {} {x} 10 20 {y} {id}\n", extra.len(), list.join(" "));
            bytes.extend_from_slice(line.as_bytes());
        }
        return bytes;
    }
    let big = encoding == "binary_big_endian";
    let mut put = |mut little: Vec<u8>| {
        if big {
            little.reverse();
        }
        bytes.extend_from_slice(&little);
    };
    for face in [&[0, 1, 2][..], &[0, 1, 2, 0]] {
        put(vec![face.len() as u8]);
        face.iter().for_each(|i: &i32| put(i.to_le_bytes().to_vec()));
    }
    for (r, z, extra, x, y, id) in points {
        put(vec![r]);
        put(z.to_le_bytes().to_vec());
        put((extra.len() as u16).to_le_bytes().to_vec());
        extra.iter().for_each(|v| put(v.to_le_bytes().to_vec()));
        put(x.to_le_bytes().to_vec());
        put(vec![10]);
        put(vec![20]);
        put(y.to_le_bytes().to_vec());
        put(id.to_le_bytes().to_vec());
    }
    bytes
}

#[test]
fn ply_reads_alike_in_ascii_and_both_binary_orders() {
    let folder = folder();
    for encoding in ["ascii", "binary_little_endian", "binary_big_endian"] {
        let path = write(folder.path(), "p.ply", &ply(encoding));
        let (position, columns) = read(&path, &ReadOptions::default()).expect(encoding);
        assert_eq!(position, [[-3.0, 2.5, 0.1], [4.0, -0.5, 1e7 + 0.001], [0.0, 0.0, -2.0]], "{encoding}");
        let names: Vec<&str> = columns.iter().map(|c| c.0.as_str()).collect();
        assert_eq!(names, ["red", "green", "blue", "id"]);
        assert_eq!(columns[0].1, [255.0, 0.0, 51.0]);
        assert_eq!(columns[3].1, [7.0, 8.0, 4e9]);
    }
}

#[test]
fn every_truncation_of_a_ply_file_is_an_error_with_a_place() {
    let folder = folder();
    for encoding in ["ascii", "binary_little_endian", "binary_big_endian"] {
        let bytes = ply(encoding);
        // Without its last line end an ASCII file is still whole.
        for length in 0..bytes.len() - 2 {
            let path = write(folder.path(), "p.ply", &bytes[..length]);
            match read(&path, &ReadOptions::default()) {
                Err(e) => {
                    let text = e.to_string();
                    assert!(
                        text.contains("p.ply") && (text.contains("line") || text.contains("byte")),
                        "{text}"
                    );
                }
                // A shortened last number is a number.
                Ok(_) => {
                    assert!(encoding == "ascii" && length > bytes.len() - 12, "{encoding} cut at {length}");
                }
            }
        }
    }
}

#[test]
fn separators_headers_and_column_names_are_detected() {
    let folder = folder();
    let none = ReadOptions::default();
    let check = |name: &str, text: &str, options: &ReadOptions, columns: &[&str]| {
        let path = write(folder.path(), name, text.as_bytes());
        let (position, found) = read(&path, options).unwrap_or_else(|e| panic!("{text:?}: {e}"));
        assert_eq!(position, [[1.0, 2.0, 3.0], [-4.5, 5e3, 0.25]], "{text:?}");
        assert_eq!(found.iter().map(|c| c.0.as_str()).collect::<Vec<_>>(), columns, "{text:?}");
    };
    check("a.xyz", "1 2 3\n-4.5 5e3 .25\n", &none, &[]);
    check("a.txt", "# a comment\n\n  1\t2\t3\n-4.5\t5e3\t.25", &none, &[]);
    check("a.csv", "x,y,z,Intensity\n1,2,3,9\n-4.5,5e3,.25,\n", &none, &["Intensity"]);
    check("a.csv", "z;x;y\r\n3;1;2\r\n.25;-4.5;5e3\r\n", &none, &[]);
    check("a.txt", "//X Y Z R G B\n1 2 3 0 0 0\n-4.5 5e3 .25 1 2 3\n", &none, &["R", "G", "B"]);
    check(
        "a.pts",
        "2\n1 2 3 -9 1 2 3\n-4.5 5e3 .25 8 1 2 3\n",
        &none,
        &["intensity", "red", "green", "blue"],
    );
    let named = |names: &str| {
        ReadOptions::default().with_text_columns(Some(names.split(',').map(str::to_owned).collect()))
    };
    check("a.xyz", "7 1 2 3 8\n7 -4.5 5e3 .25 8\n", &named("-,x,y,z,height_above"), &["height_above"]);
}

#[test]
fn malformed_text_is_an_error_that_names_line_and_value() {
    let folder = folder();
    let message = |text: &str| {
        let path = write(folder.path(), "a.xyz", text.as_bytes());
        read(&path, &ReadOptions::default()).expect_err("malformed").to_string()
    };
    assert!(message("1 2 3\n4 five 6\n").contains("line 2: `five`"));
    assert!(message("1 2 3\n4 5\n").contains("line 2: 2 values where 3"));
    assert!(message("").contains("no line of numbers"));
    assert!(message("hello world\n").contains("expected numbers"));
    assert!(message(&"9".repeat(100_000)).contains("a line of more than"));
}

#[test]
fn real_las_and_laz_files_of_every_version_and_format_read() {
    let Some(folder) = real_data("lidar") else { return };
    let mut read_files = 0;
    let entries = std::fs::read_dir(folder).expect("the folder lists");
    let mut paths: Vec<PathBuf> = entries.map(|e| e.expect("an entry").path()).collect();
    paths.sort();
    for path in paths {
        let source = points::open(&path, &ReadOptions::default()).unwrap_or_else(|e| panic!("{e}"));
        let expected = source.count_hint().expect("LAS states its count");
        if expected > 200_000 {
            continue;
        }
        let (position, columns) = read(&path, &ReadOptions::default()).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(position.len() as u64, expected, "{}", path.display());
        assert!(position.iter().flatten().all(|v| v.is_finite()));
        assert!(columns.iter().any(|c| c.0 == "intensity"));
        read_files += 1;
    }
    assert!(read_files > 20, "only {read_files} files");
}

#[test]
fn truncated_and_scrambled_las_files_are_errors_not_panics() {
    let Some(folder_of_las) = real_data("lidar") else { return };
    let folder = folder();
    let mut random = crate::common::Random(77);
    for name in ["simple.las", "simple.laz", "pdrf6-1.4.laz", "1.2_3.las"] {
        let bytes = std::fs::read(folder_of_las.join(name)).expect("it reads");
        for _ in 0..60 {
            let mut broken = bytes.clone();
            if random.unit() < 0.5 {
                broken.truncate((random.unit() * bytes.len() as f64) as usize);
            }
            for _ in 0..3 {
                if !broken.is_empty() {
                    let at = (random.unit() * broken.len().min(600) as f64) as usize;
                    broken[at] = (random.unit() * 256.0) as u8;
                }
            }
            let path = write(folder.path(), name, &broken);
            // Whatever comes of it comes as a value.
            let _ = read(&path, &ReadOptions::default());
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, ..ProptestConfig::default() })]

    #[test]
    fn scrambled_ply_and_text_never_panic(at in 0_usize..700, byte: u8, cut in 0_usize..700, which in 0_usize..3) {
        let folder = folder();
        let mut bytes = ply(["ascii", "binary_little_endian", "binary_big_endian"][which]);
        let length = bytes.len();
        bytes[at % length] = byte;
        bytes.truncate(length - cut % length);
        let _ = read(&write(folder.path(), "p.ply", &bytes), &ReadOptions::default());
        let _ = read(&write(folder.path(), "p.csv", &bytes), &ReadOptions::default());
    }
}
