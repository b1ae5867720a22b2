//! Sources that pass over points deliver the same points after them, whether they seek or read.

use std::path::{Path, PathBuf};

use rayset::points::{self, PointBatch, PointSource, ReadOptions, Workload};

use crate::common::folder;
use crate::fixture::{fixtures, read_all};
use crate::las_writer::{Chunks, LasFile};

/// All numbers of some points, bit by bit.
fn bits(points: &PointBatch, first: usize) -> Vec<Vec<u64>> {
    let numbers = |i: usize| {
        let position = points.position[i].iter().map(|v| v.to_bits());
        position.chain(points.columns.iter().map(|column| column.get(i).to_bits())).collect()
    };
    (first..points.len()).map(numbers).collect()
}

/// Checks a source at several places; returns whether it seeks. `None` if it cannot be read.
fn check(name: &str, open: &dyn Fn() -> Option<Box<dyn PointSource>>) -> Option<bool> {
    let all = read_all(&mut *open()?, 1000).ok()?;
    for skipped in [0, 1, all.len() / 2, all.len().saturating_sub(1), all.len(), all.len() + 5] {
        let mut source = open()?;
        let columns: Vec<usize> = (0..source.schema().columns.len()).collect();
        source.select(&columns);
        source.skip(skipped as u64).expect("it can be passed over");
        let rest = read_all(&mut *source, 1000).expect("the rest reads");
        let same = bits(&rest, 0) == bits(&all, skipped.min(all.len()));
        assert!(same, "{name}: other points after {skipped} of {}", all.len());
    }
    open().map(|source| source.can_skip())
}

fn check_file(path: &Path) -> Option<bool> {
    let open = || points::open(path, &ReadOptions::default()).ok();
    check(&path.display().to_string(), &open)
}

fn files(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("an entry").path();
        if path.is_dir() { files(&path, found) } else { found.push(path) }
    }
}

#[test]
fn files_of_every_reader_go_on_where_points_were_passed_over() {
    let mut paths = Vec::new();
    files(&fixtures(""), &mut paths);
    let seeks: Vec<bool> = paths.iter().filter_map(|path| check_file(path)).collect();
    let seeking = seeks.iter().filter(|&&seeks| seeks).count();
    assert!(seeking > 15 && seeks.len() > seeking + 15, "{seeking} of {}", seeks.len());
}

#[test]
fn chunks_of_laz_are_passed_over_as_a_whole_where_a_table_says_how_long_they_are() {
    let folder = folder();
    for format in [1, 3, 6, 7] {
        let las = LasFile::random(format, 1000, 0, 5);
        for (chunks, seeks) in [
            (Chunks::Fixed(50), true),
            (Chunks::Variable(&[7, 90, 1]), true),
            (Chunks::Streamed(50), true),
            (Chunks::NoTable(50), false),
            (Chunks::One, false),
        ] {
            if format >= 6 && chunks == Chunks::One {
                continue;
            }
            let path = folder.path().join("a.laz");
            std::fs::write(&path, las.laz(chunks)).expect("a write");
            assert_eq!(check_file(&path), Some(seeks), "format {format}");
        }
        let path = folder.path().join("a.las");
        std::fs::write(&path, las.las()).expect("a write");
        assert_eq!(check_file(&path), Some(true), "format {format}");
    }
}

#[test]
fn ply_is_entered_in_the_middle_if_it_is_binary_and_not_compressed() {
    let folder = folder();
    let header = |format: &str| {
        format!(
            "ply\nformat {format} 1.0\nelement vertex 3000\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
        )
    };
    let path = folder.path().join("a.ply");
    let numbers = (0..9000).flat_map(|i| (i as f32).to_le_bytes());
    let binary: Vec<u8> = header("binary_little_endian").into_bytes().into_iter().chain(numbers).collect();
    std::fs::write(&path, binary).expect("a write");
    assert_eq!(check_file(&path), Some(true));
    let text: String = (0..3000).map(|i| format!("{i} {} {}\n", i + 1, i + 2)).collect();
    std::fs::write(&path, header("ascii") + &text).expect("a write");
    assert_eq!(check_file(&path), Some(false));
    let sphere: Workload = "sphere-3000".parse().expect("a workload");
    assert_eq!(check("a workload", &|| Some(sphere.source())), Some(true));
}
