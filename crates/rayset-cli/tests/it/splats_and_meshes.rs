//! Clouds of Gaussian splats and of meshes: what is kept, and said, when they are built.

use std::path::Path;
use std::process::{Command, Output, Stdio};

use crate::common::folder;

/// Builds a fixture of the library; returns what is said on standard output and standard error.
fn build(folder: &Path, fixture: &str, arguments: &[&str]) -> (String, String) {
    let input = Path::new(env!("CARGO_MANIFEST_DIR")).join("../rayset/tests/fixtures").join(fixture);
    let mut command = Command::new(env!("CARGO_BIN_EXE_rayset"));
    command.current_dir(folder).arg("build").arg(input).args(["-o", "c.rset"]).args(arguments);
    let Output { status, stdout, stderr } = command.stdin(Stdio::null()).output().expect("the program runs");
    let [stdout, stderr] = [stdout, stderr].map(|text| String::from_utf8_lossy(&text).into_owned());
    assert!(status.success(), "{fixture}: {stderr}");
    (stdout, stderr)
}

#[test]
fn a_build_of_splats_keeps_their_opacity_and_deviations_and_the_colours_of_all_directions() {
    let folder = folder();
    let (said, remarks) =
        build(folder.path(), "splats/v4.spz", &["--attributes", "opacity,scale_0,scale_1,scale_2"]);
    assert!(said.contains("c.rset: 40 points"), "{said}");
    assert!(!remarks.contains("left out"), "{remarks}");
    let mut info = Command::new(env!("CARGO_BIN_EXE_rayset"));
    let info = info.current_dir(folder.path()).args(["info", "c.rset"]).output().expect("the program runs");
    let info = String::from_utf8_lossy(&info.stdout).into_owned();
    assert!(info.contains("by direction: harmonics of degree 1") && info.contains("scale_2"), "{info}");
}

#[test]
fn copies_of_splats_stay_and_copies_of_other_points_become_one() {
    let folder = folder();
    let records = Path::new(env!("CARGO_MANIFEST_DIR")).join("../rayset/tests/fixtures/splats/records.splat");
    let records = std::fs::read(records).expect("a fixture");
    let splats = records.len() / 32;
    std::fs::write(folder.path().join("twice.splat"), [&records[..], &records[..]].concat())
        .expect("a write");
    let row = |i: usize| format!("{},{},0,0.5\n", i % 5, i % 7);
    std::fs::write(
        folder.path().join("twice.csv"),
        format!("x,y,z,radius\n{}", (0..70).map(row).collect::<String>()),
    )
    .expect("a write");
    let points = |input: &str, more: &[&str]| {
        let input = folder.path().join(input);
        build(folder.path(), input.to_str().expect("a name"), more).0
    };
    for more in [&[][..], &["--radius", "auto"]] {
        let said = points("twice.splat", more);
        assert!(said.contains(&format!("c.rset: {} points", 2 * splats)), "{said}");
    }
    let said = points("twice.csv", &[]);
    assert!(said.contains("c.rset: 35 points"), "{said}");
}

#[test]
fn a_build_samples_as_many_points_on_a_mesh_as_are_asked_for() {
    let folder = folder();
    for name in ["ball.ply", "ball.obj", "ball.stl"] {
        let (said, remarks) =
            build(folder.path(), &format!("meshes/{name}"), &["--mesh-points", "700", "--radius", "0.3"]);
        assert!(
            said.contains("c.rset: 700 points") && !remarks.contains("sampled"),
            "{name}: {said}{remarks}"
        );
    }
    for name in ["meshes/ball.stl", "meshes/ball.ply"] {
        let (said, remarks) = build(folder.path(), name, &["--radius", "0.01"]);
        assert!(said.contains("c.rset: 1 000 000 points"), "{said}");
        assert!(remarks.contains("1000000 points are sampled on the 80 triangles of a mesh"), "{remarks}");
    }
}

#[test]
fn a_build_says_that_normals_turn_points_and_keeps_them_only_if_it_is_asked_to() {
    let folder = folder();
    let row = |i: i32| format!("{},{},0,0,0,1,{i}\n", i % 10, i / 10);
    let rows: String = (0..100).map(row).collect();
    std::fs::write(folder.path().join("p.csv"), format!("x,y,z,normal_x,normal_y,normal_z,T\n{rows}"))
        .expect("a write");
    let said_of = |more: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_rayset"));
        command.current_dir(folder.path()).args(["build", "p.csv", "-o", "c.rset"]).args(more);
        let built = command.output().expect("the program runs");
        let mut info = Command::new(env!("CARGO_BIN_EXE_rayset"));
        let info = info.current_dir(folder.path()).args(["info", "c.rset"]).output().expect("it runs");
        [built.stderr, info.stdout].map(|text| String::from_utf8_lossy(&text).into_owned())
    };
    let [said, info] = said_of(&[]);
    assert!(said.contains("points are discs across their normals (normal_x, normal_y, normal_z)"), "{said}");
    assert!(info.contains("attribute   T") && !info.contains("attribute   normal_x"), "{info}");
    let [said, _] = said_of(&["--radius", "0.5"]);
    assert!(!said.contains("across their normals"), "{said}");
    let [_, info] = said_of(&["--attributes", "all"]);
    assert!(info.contains("attribute   normal_x"), "{info}");
}
