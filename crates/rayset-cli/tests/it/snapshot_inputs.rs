//! Snapshots of simulations as inputs of every command: what is read of them, what is kept, and in
//! which units it is shown.

use std::path::Path;

use serde_json::Value;

use crate::common::{folder, program};

/// A snapshot among the fixtures of the library's tests.
fn snapshot(name: &str) -> String {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../rayset/tests/fixtures/snapshots");
    folder.join(name).display().to_string()
}

fn run(folder: &Path, arguments: &[&str]) -> (bool, String, String) {
    let mut command = program();
    command.current_dir(folder).env("XDG_CACHE_HOME", folder.join("home")).args(arguments);
    let output = command.output().expect("the program runs");
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (output.status.success(), text(&output.stdout), text(&output.stderr))
}

fn info(folder: &Path, arguments: &[&str]) -> Value {
    let (is_done, said, remarks) = run(folder, &[&["info", "--json"], arguments].concat());
    assert!(is_done, "{arguments:?}: {remarks}");
    serde_json::from_str(&said).expect("JSON")
}

fn names(report: &Value) -> Vec<&str> {
    let attributes = report["attributes"].as_array().expect("a list");
    attributes.iter().map(|attribute| attribute["name"].as_str().expect("a name")).collect()
}

#[test]
fn options_of_a_build_work_wherever_an_input_is_opened_and_are_kept_apart_in_the_cache() {
    let folder = folder();
    let f = folder.path();
    let file = snapshot("gadget.hdf5");
    let points = |more: &[&str]| info(f, &[&[file.as_str()], more].concat())["points"].as_u64();
    assert_eq!(points(&[]), Some(30));
    assert_eq!(points(&["--particles", "dark"]), Some(20));
    assert_eq!(points(&["--particles", "dark,stars"]), Some(30));
    assert_eq!(points(&[]), Some(30));
    let kept = std::fs::read_dir(f.join("home/rayset")).expect("the cache").count();
    assert_eq!(kept, 3, "one for each choice");
    let render = |more: &[&str]| {
        let plain = ["render", file.as_str(), "-o", "a.png", "--size", "8x8"];
        let (is_done, _, said) = run(f, &[&plain[..], more].concat());
        assert!(is_done, "{more:?}: {said}");
        said
    };
    assert!(render(&["--particles", "dark"]).contains("built before"));
    render(&["--radius", "2.5", "--weight", "mass", "--attributes", "Density", "--length-scale", "0.5"]);
    let report = info(f, &[&file, "--radius", "2.5", "--attributes", "none"]);
    assert!(report["radius_min"] == 2.5 && names(&report).is_empty(), "{report}");
    // What has been built has its options already.
    let (is_done, _, said) = run(f, &["build", &file, "-o", "a.rset"]);
    assert!(is_done, "{said}");
    let (is_done, _, said) = run(f, &["render", "a.rset", "-o", "a.png", "--particles", "dark"]);
    assert!(!is_done && said.contains("--particles") && said.contains("build it with"), "{said}");
    // Voxels without a header, too.
    std::fs::write(f.join("v.raw"), (0..4096).map(|i| (i % 251) as u8).collect::<Vec<_>>()).expect("a write");
    let (is_done, _, said) =
        run(f, &["render", "v.raw", "--raw", "16x16x16,u8", "-o", "v.png", "--size", "8x8"]);
    assert!(is_done, "{said}");
}

#[test]
fn vectors_are_kept_whole_with_their_speed_or_not_at_all() {
    let folder = folder();
    let f = folder.path();
    let report = info(f, &[&snapshot("gadget.hdf5"), "--no-cache"]);
    let velocities = names(&report).iter().filter(|name| name.starts_with("Velocities")).count();
    assert!(velocities == 0 || velocities == 3, "{:?}", names(&report));
    // By its name, and by the look of a file that has little else.
    let report = info(f, &[&snapshot("gadget.hdf5"), "--no-cache", "--attributes", "Velocities,speed"]);
    assert_eq!(names(&report), ["Velocities_x", "Velocities_y", "Velocities_z", "speed"]);
    let table = "x y z velocity_x velocity_y velocity_z\n0 0 0 1 2 -2\n1 0 0 3 4 0\n0 1 0 0 0 0\n";
    std::fs::write(f.join("t.txt"), table).expect("a write");
    for arguments in [&["t.txt", "--no-cache"][..], &["t.rset"]] {
        let (is_done, _, said) = run(f, &["build", "t.txt", "-o", "t.rset", "--attributes", "all"]);
        assert!(is_done, "{said}");
        let report = info(f, arguments);
        if arguments[0] == "t.rset" {
            assert_eq!(names(&report), ["velocity_x", "velocity_y", "velocity_z", "speed"]);
            let speed = &report["attributes"][3];
            assert!(speed["min"] == 0.0 && speed["max"] == 5.0, "{speed}");
        }
    }
}

#[test]
fn units_of_snapshots_are_those_of_astronomers_and_their_signs_are_explained_once() {
    let folder = folder();
    let f = folder.path();
    let told = |name: &str| {
        let (is_done, said, remarks) = run(f, &["info", &snapshot(name), "--no-cache"]);
        assert!(is_done, "{remarks}");
        said
    };
    let arepo = told("arepo.1.hdf5");
    let lines = |of: &str| arepo.lines().filter(|line| line.starts_with(of)).collect::<Vec<_>>().join("\n");
    assert!(lines("lengths").contains("ckpc/h"), "{arepo}");
    assert!(lines("attribute").contains("1e10 M☉/h") && !lines("attribute").contains("cgs"), "{arepo}");
    assert!(lines("units").contains("comoving") && lines("units").contains("Hubble"), "{arepo}");
    assert_eq!(arepo.matches("comoving").count(), 1, "{arepo}");
    let swift = told("swift.hdf5");
    assert!(swift.contains("lengths     in cMpc") && swift.contains(" 1e10 M☉ ("), "{swift}");
    let eagle = told("eagle.hdf5");
    assert!(eagle.contains(" K (f32"), "{eagle}");
}

#[test]
fn weights_that_are_densities_already_are_not_divided_by_volumes_again() {
    let folder = folder();
    let f = folder.path();
    let file = snapshot("gadget.hdf5");
    let render = |picture: &str, more: &[&str]| {
        let plain = ["render", file.as_str(), "-o", picture, "--size", "32x32", "--look", "gas"];
        let (is_done, _, said) = run(f, &[&plain[..], &["--kernel", "cubic-spline"], more].concat());
        assert!(is_done, "{said}");
        (said, std::fs::read(f.join(picture)).expect("a picture"))
    };
    let (_, once) = render("a.png", &[]);
    let (said, twice) = render("b.png", &["--normalised"]);
    assert!(said.contains("--normalised is left out") && said.contains("densities already"), "{said}");
    assert!(once == twice, "the pictures differ");
    // Weights of other files are what they are.
    std::fs::write(f.join("t.txt"), "x y z weight\n0 0 0 1\n1 0 0 2\n0 1 0 3\n0 0 1 4\n").expect("a write");
    let (is_done, _, said) = run(f, &["render", "t.txt", "-o", "c.png", "--size", "8x8", "--normalised"]);
    assert!(is_done && !said.contains("left out"), "{said}");
}

#[test]
fn options_that_help_does_not_show_are_not_suggested() {
    let folder = folder();
    for wrong in ["--slabs", "--tiles", "--slap"] {
        let (is_done, _, said) = run(folder.path(), &["render", "a.ply", "-o", "a.png", wrong, "3"]);
        assert!(!is_done && said.contains(wrong), "{said}");
        assert!(!said.contains("--slab'") && !said.contains("--tile'"), "{said}");
    }
    let (_, _, said) = run(folder.path(), &["render", "a.ply", "-o", "a.png", "--backgroud", "none"]);
    assert!(said.contains("--background"), "{said}");
}
