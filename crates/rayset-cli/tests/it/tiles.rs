//! Folders of tiles: memory and open files do not grow with their number, and a damaged one is left
//! out, counted and named.

#![cfg(unix)]

use std::fmt::Write as _;
use std::fs;
use std::path::Path;
use std::process::Command;

use crate::common::{Random, folder, run, succeeds};

/// The points of tile `number`: fifty on a rough plane of ten by ten.
fn points(number: usize) -> Vec<[f64; 3]> {
    let mut random = Random(number as u64 + 1);
    let (x, y) = (600_000.0 + 10.0 * (number % 40) as f64, 5_000_000.0 + 10.0 * (number / 40) as f64);
    (0..50)
        .map(|_| [x + 10.0 * random.unit(), y + 10.0 * random.unit(), 100.0 + 0.5 * random.unit()])
        .collect()
}

fn write_las(path: &Path, points: &[[f64; 3]], extension: &str) {
    let mut builder = las::Builder::from((1, 2));
    builder.point_format = las::point::Format::new(0).expect("a format");
    builder.point_format.is_compressed = extension == "laz";
    let transform = |offset| las::Transform { scale: 0.001, offset };
    builder.transforms =
        las::Vector { x: transform(600_000.0), y: transform(5_000_000.0), z: transform(0.0) };
    let header = builder.into_header().expect("a header");
    let mut writer = las::Writer::from_path(path, header).expect("a writer");
    for [x, y, z] in points {
        let point = las::Point { x: *x, y: *y, z: *z, ..las::Point::default() };
        writer.write_point(point).expect("a point");
    }
    writer.close().expect("it closes");
}

/// Writes `count` tiles of a kind into a folder.
fn write_tiles(folder: &Path, kind: &str, count: usize) {
    fs::create_dir(folder).expect("a folder");
    for number in 0..count {
        let (path, points) = (folder.join(format!("{number:04}.{kind}")), points(number));
        if ["las", "laz"].contains(&kind) {
            write_las(&path, &points, kind);
            continue;
        }
        let mut text = String::new();
        if kind == "ply" {
            text += "ply\nformat ascii 1.0\nelement vertex 50\nproperty double x\nproperty double y\nproperty double z\n\
                     end_header\n";
        }
        for [x, y, z] in points {
            let _ = writeln!(text, "{x:.3} {y:.3} {z:.3}");
        }
        fs::write(path, text).expect("a write");
    }
}

#[test]
fn a_folder_of_many_tiles_of_any_kind_opens_in_the_memory_and_the_files_of_a_few() {
    let folder = folder();
    let f = folder.path();
    for kind in ["laz", "las", "xyz", "ply"] {
        write_tiles(&f.join(kind), kind, 400);
        let program = env!("CARGO_BIN_EXE_rayset");
        let build = format!(
            "ulimit -n 64; exec {program} build {kind} -o {kind}.rset --memory 32MiB --threads 2 --json"
        );
        let output = Command::new("sh").current_dir(f).args(["-c", &build]).output().expect("a shell");
        assert!(output.status.success(), "{kind}: {}", String::from_utf8_lossy(&output.stderr));
        let report: serde_json::Value = serde_json::from_slice(&output.stdout).expect("a report");
        assert_eq!(report["points"], 400 * 50, "{kind}");
        let peak = report["peak_rss_bytes"].as_f64().unwrap_or(0.0);
        assert!(peak <= f64::from(32 << 20), "{kind}: {peak} bytes of 32 MiB");
    }
}

#[test]
fn a_damaged_tile_is_left_out_whole_counted_and_named_and_strict_stops_at_it() {
    let folder = folder();
    let f = folder.path();
    write_tiles(&f.join("sound"), "laz", 7);
    write_tiles(&f.join("tiles"), "laz", 7);
    // One whose header is damaged, and one that breaks off after a chunk that can be read.
    fs::write(f.join("tiles/broken.laz"), [&b"LASF"[..], &[0; 50]].concat()).expect("a write");
    let many: Vec<[f64; 3]> = (1000..3000).flat_map(points).collect();
    write_las(&f.join("tiles/torn.laz"), &many, "laz");
    let torn = fs::read(f.join("tiles/torn.laz")).expect("it reads");
    fs::write(f.join("tiles/torn.laz"), &torn[..torn.len() * 9 / 10]).expect("a write");

    succeeds(f, &["build", "sound", "-o", "sound.rset"]);
    let said = succeeds(f, &["build", "tiles", "-o", "tiles.rset"]);
    assert!(said.contains("left out 2 of 9 files as damaged"), "{said}");
    assert!(said.contains("broken.laz") && said.contains("torn.laz"), "{said}");
    let read = |name: &str| fs::read(f.join(name)).expect("a cloud");
    assert!(read("sound.rset") == read("tiles.rset"), "points of a damaged tile are kept");

    // What is kept in the cache says the same when it is used again.
    for round in 0..2 {
        let said = succeeds(f, &["render", "tiles", "-o", "a.png", "--size", "8x8"]);
        assert!(said.contains("left out 2 of 9 files"), "{round}: {said}");
    }
    for arguments in [
        &["build", "tiles", "-o", "x.rset", "--strict"][..],
        &["render", "tiles", "-o", "a.png", "--size", "8x8", "--strict"],
        // A person who names a file wants that file.
        &["build", "sound", "tiles/torn.laz", "-o", "x.rset"],
    ] {
        let output = run(f, arguments);
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{arguments:?}: {said}");
        assert!(said.contains("broken.laz") || said.contains("torn.laz"), "{said}");
    }
    assert!(!f.join("x.rset").exists());
}

#[test]
fn of_a_folder_of_which_nothing_can_be_read_the_reason_is_said() {
    let folder = folder();
    let f = folder.path();
    fs::create_dir(f.join("tiles")).expect("a folder");
    for name in ["a.laz", "b.laz"] {
        fs::write(f.join("tiles").join(name), [&b"LASF"[..], &[0; 50]].concat()).expect("a write");
    }
    let output = run(f, &["build", "tiles", "-o", "x.rset"]);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(1) && said.contains("a.laz"), "{said}");
}
