//! Points, volumes and scenes on a web server become the very clouds, grids and scenes that local files become.

use std::path::{Path, PathBuf};

use rayset::build::{self, BuildControl, BuildOptions, GridBuildOptions};
use rayset::points::{self, ReadOptions};
use rayset::scene_file::SceneFile;
use rayset::volumes::VolumeSource;

use crate::addresses::server;

fn fixtures() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../rayset/tests/fixtures")
}

/// The cloud of one input.
fn built(input: &Path) -> Result<Vec<u8>, String> {
    let folder = tempfile::tempdir().expect("a folder");
    let output = folder.path().join("out.rset");
    let source = points::open(input, &ReadOptions::default()).map_err(|error| error.to_string())?;
    let options = BuildOptions::default().with_radius(Some(build::Rule::Number(0.01)));
    build::to_file(vec![source], &output, &options, &BuildControl::default())
        .map_err(|error| error.to_string())?;
    Ok(std::fs::read(output).expect("the cloud"))
}

#[test]
fn points_of_every_kind_are_read_over_the_web_as_from_a_disk() {
    let server = server();
    let ply = tempfile::tempdir().expect("a folder");
    let ply = ply.path().join("points.ply");
    let rows: String = (0..500).map(|i| format!("{} {} {}\n", i % 7, i % 11, i)).collect();
    let header = "ply\nformat ascii 1.0\nelement vertex 500\nproperty float x\nproperty float y\nproperty float z\nend_header\n";
    std::fs::create_dir_all(ply.parent().expect("a folder")).expect("a folder");
    std::fs::write(&ply, format!("{header}{rows}")).expect("a write");
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
    files.push(ply);
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
    let grid = |input: &Path| {
        let folder = tempfile::tempdir().expect("a folder");
        let output = folder.path().join("out.rset");
        let source = VolumeSource::open(input).map_err(|error| error.to_string())?;
        build::grid_to_file(source, &output, &GridBuildOptions::default(), &BuildControl::default())
            .map_err(|error| error.to_string())?;
        Ok::<_, String>(std::fs::read(output).expect("the grid"))
    };
    let mut compared = 0;
    for entry in std::fs::read_dir(fixtures().join("volumes")).expect("fixtures") {
        let path = entry.expect("a file").path();
        let Ok(expected) = grid(&path) else { continue };
        let name = path.file_name().expect("a name").to_string_lossy().into_owned();
        // Headers name the files of their voxels, which lie beside them.
        for beside in std::fs::read_dir(fixtures().join("volumes")).expect("fixtures") {
            let beside = beside.expect("a file").path();
            if beside.is_file() {
                let name = beside.file_name().expect("a name").to_string_lossy().into_owned();
                server.put(&name, std::fs::read(&beside).expect("a file"));
            }
        }
        let found =
            grid(&PathBuf::from(server.address_of(&name))).unwrap_or_else(|error| panic!("{name}: {error}"));
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
