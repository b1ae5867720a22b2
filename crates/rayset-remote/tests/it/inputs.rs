//! Points, volumes and scenes on a web server become the very clouds, grids and scenes that local
//! files become.

use std::path::{Path, PathBuf};

use rayset::scene_file::SceneFile;

use crate::common::{built, built_grid, fixtures, server};
use crate::las_writer::{Chunks, LasFile, place_of_table, points_start};

/// Points whose cloud is more than 8 MiB, and is sent in two parts.
pub(crate) const OF_TWO_PARTS: usize = 1_800_000;

/// An array of so many positions.
pub(crate) fn npy(count: usize) -> Vec<u8> {
    let header = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({count}, 3), }}");
    let length = (10 + header.len() + 1).next_multiple_of(64);
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend(((length - 10) as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    bytes.resize(length - 1, b' ');
    bytes.push(b'\n');
    bytes.extend(positions(count).flatten().flat_map(f32::to_le_bytes));
    bytes
}

/// Points on a spiral.
fn positions(count: usize) -> impl Iterator<Item = [f32; 3]> {
    (0..count).map(move |at| {
        let share = at as f32 / count as f32;
        [(share * 400.0).cos() * share, (share * 400.0).sin() * share, (at % 1000) as f32 / 1000.0]
    })
}

/// A PLY file in binary, with colours.
fn binary_ply(count: usize) -> Vec<u8> {
    let axes = "property float x\nproperty float y\nproperty float z\n";
    let colours = "property uchar red\nproperty uchar green\nproperty uchar blue\n";
    let header =
        format!("ply\nformat binary_little_endian 1.0\nelement vertex {count}\n{axes}{colours}end_header\n");
    let mut bytes = header.into_bytes();
    for (at, position) in positions(count).enumerate() {
        bytes.extend(position.into_iter().flat_map(f32::to_le_bytes));
        bytes.extend([at as u8, (at >> 8) as u8, 77]);
    }
    bytes
}

/// A LAZ file of many chunks.
pub(crate) fn laz(count: usize) -> Vec<u8> {
    LasFile::random(7, count, 0, 5).laz(Chunks::Fixed(5_000))
}

/// A COPC file: chunks that are nodes of an octree, its description in the first record, and its
/// hierarchy in an extended one.
fn copc(chunks: &'static [usize]) -> Vec<u8> {
    let mut file = LasFile::random(7, chunks.iter().sum(), 0, 9);
    file.records.push(("copc", 1, vec![0; 160]));
    // Where each node's points lie: as in a file that ends with them.
    let place_of_chunk = |chunk: usize| {
        let mut part = file.clone();
        part.points.truncate(chunks[..chunk].iter().sum());
        place_of_table(&part.laz(Chunks::Variable(chunks))) as u64
    };
    let mut hierarchy = Vec::new();
    let mut start = points_start(&file.laz(Chunks::Variable(chunks))) as u64 + 8;
    for (chunk, &points) in chunks.iter().enumerate() {
        // The root, and children of it.
        let key = if chunk == 0 {
            [0; 4]
        } else {
            [1, chunk as i32 & 1, chunk as i32 >> 1 & 1, chunk as i32 >> 2 & 1]
        };
        let end = place_of_chunk(chunk + 1);
        hierarchy.extend(key.into_iter().flat_map(i32::to_le_bytes));
        hierarchy.extend(start.to_le_bytes());
        hierarchy.extend(((end - start) as i32).to_le_bytes());
        hierarchy.extend((points as i32).to_le_bytes());
        start = end;
    }
    let length = hierarchy.len() as u64;
    file.extended.push(("copc", 1000, hierarchy));
    let mut bytes = file.laz(Chunks::Variable(chunks));
    // Centre, half the side and spacing; then where the hierarchy is.
    let about: Vec<u8> = [5e5, 0.0, 1e6, 1e6, 1e4].into_iter().flat_map(f64::to_le_bytes).collect();
    let at = 375 + 54;
    bytes[at..at + 40].copy_from_slice(&about);
    let place = bytes.len() as u64 - length;
    bytes[at + 40..at + 48].copy_from_slice(&place.to_le_bytes());
    bytes[at + 48..at + 56].copy_from_slice(&length.to_le_bytes());
    bytes
}

/// A volume of a lumpy ball.
pub(crate) fn nrrd(side: usize) -> Vec<u8> {
    let mut bytes =
        format!("NRRD0004\ntype: uint8\ndimension: 3\nsizes: {side} {side} {side}\nencoding: raw\n\n")
            .into_bytes();
    let place = |at: usize| 2.0 * at as f64 / (side - 1) as f64 - 1.0;
    for at in 0..side * side * side {
        let [x, y, z] = [at % side, at / side % side, at / side / side].map(place);
        let lumps = (x * 9.0).sin() * (y * 8.0).cos() * (z * 7.0).sin();
        let value = 250.0 * (1.0 - (x * x + y * y + z * z).sqrt() + 0.15 * lumps);
        bytes.push(value.clamp(0.0, 250.0) as u8);
    }
    bytes
}

#[test]
fn points_of_every_kind_are_read_over_the_web_as_from_a_disk() {
    let server = server();
    let folder = tempfile::tempdir().expect("a folder");
    let rows: String = (0..500).map(|i| format!("{} {} {}\n", i % 7, i % 11, i)).collect();
    let header = "ply\nformat ascii 1.0\nelement vertex 500\nproperty float x\nproperty float y\nproperty float z\nend_header\n";
    let written = [
        ("ascii.ply", format!("{header}{rows}").into_bytes()),
        // Of more than one request.
        ("binary.ply", binary_ply(150_000)),
        ("octree.copc.laz", copc(&[3000, 1500, 2500, 700])),
    ]
    .map(|(name, bytes)| {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).expect("a write");
        path
    });
    for path in &written {
        built(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    }
    let mut files: Vec<PathBuf> = [
        "format_3.laz",
        "format_7.laz",
        "format_10.las",
        "two_scans.e57",
        "binary_compressed_float32.pcd",
        "ascii_uint32.pcd.zst",
        "scans.ptx",
    ]
    .map(|name| fixtures().join(name))
    .into();
    files.extend(written);
    for folder in ["npy", "splats", "snapshots", "vtk"] {
        let entries = std::fs::read_dir(fixtures().join(folder)).expect("fixtures");
        let mut some: Vec<PathBuf> = entries.map(|entry| entry.expect("a file").path()).collect();
        some.retain(|path| {
            path.is_file() && path.extension().is_some_and(|end| end != "json" && end != "py")
        });
        some.sort();
        files.extend(some);
    }
    let name_of = |path: &Path| path.file_name().expect("a name").to_string_lossy().into_owned();
    // All of them first: some are of one snapshot.
    for path in &files {
        server.put(&name_of(path), std::fs::read(path).expect("a file"));
    }
    let mut compared = 0;
    for path in files {
        let Ok(expected) = built(&path) else { continue };
        let name = name_of(&path);
        let address = PathBuf::from(server.address_of(&name));
        let found = built(&address).unwrap_or_else(|error| panic!("{name}: {error}"));
        assert!(found == expected, "{name}: another cloud");
        compared += 1;
    }
    assert!(compared > 20, "only {compared} inputs were compared");
}

#[test]
fn volumes_are_read_over_the_web_as_from_a_disk() {
    let server = server();
    let mut compared = 0;
    for entry in std::fs::read_dir(fixtures().join("volumes")).expect("fixtures") {
        let path = entry.expect("a file").path();
        let Ok(expected) = built_grid(&path) else { continue };
        let name = path.file_name().expect("a name").to_string_lossy().into_owned();
        // Headers name the files of their voxels, which lie beside them.
        for beside in std::fs::read_dir(fixtures().join("volumes")).expect("fixtures") {
            let beside = beside.expect("a file").path();
            if beside.is_file() {
                let name = beside.file_name().expect("a name").to_string_lossy().into_owned();
                server.put(&name, std::fs::read(&beside).expect("a file"));
            }
        }
        let address = PathBuf::from(server.address_of(&name));
        let found = built_grid(&address).unwrap_or_else(|error| panic!("{name}: {error}"));
        assert!(found == expected, "{name}: another grid");
        compared += 1;
    }
    assert!(compared >= 3, "only {compared} volumes were compared");
}

#[test]
fn a_scene_on_the_web_finds_its_clouds_beside_it() {
    let server = server();
    let cloud = built(&fixtures().join("format_3.laz")).expect("a cloud");
    server.put("scenes/points.rset", cloud);
    let scene = r#"{"rayset": 1, "root": {"type": "cloud", "file": "../scenes/points.rset"}}"#;
    server.put("scenes/a.json", scene.as_bytes().to_vec());
    let address = PathBuf::from(server.address_of("scenes/a.json"));
    let read = SceneFile::load(&address).expect("a scene");
    let paths: Vec<String> = read.files.iter().map(|path| path.display().to_string()).collect();
    assert!(paths.contains(&server.address_of("scenes/points.rset")), "{paths:?}");
}
