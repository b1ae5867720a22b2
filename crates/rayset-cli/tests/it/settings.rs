//! Options of a render that make no sense: each an error that names it, before there is any output.

use std::process::Command;

use rayset::octree::build::BuildOptions;

use crate::common::{build_at, folder, mixed_points};

#[test]
fn settings_that_make_no_sense_are_errors_that_name_them_and_nothing_is_written() {
    let folder = folder();
    drop(build_at(
        &folder.path().join("c.rset"),
        Box::new(mixed_points(200, 1.0, 3)),
        &BuildOptions::default(),
    ));
    let scene = r#"{"rayset": 1, "image": {"size": [16, 16]}, "root": {"type": "sphere", "radius": 1},
        "animation": {"keys": [{"frame": 3, "camera": {"position": [0, 0, 5]}}, {"frame": 5, "camera": {"position": [0, 1, 5]}}]}}"#;
    std::fs::write(folder.path().join("s.json"), scene).expect("a scene");
    let of_cloud = [
        "--exposure nan",
        "--exposure inf",
        "--exposure 33",
        "--turntable 0",
        "--direction 0,0,0",
        "--direction nan,0,1",
        "--direction inf,0,0",
        "--up 0,0,0",
        "--position 0,0,3 --direction 0,0,-1 --up 0,0,2",
        "--direction 0,0,-1 --up 0,0,2",
        "--position 1,1,1 --look-at 1,1,1",
        "--position inf,0,0",
        "--fovy 0",
        "--fovy 180",
        "--fovy nan",
        "--orthographic --height 0",
        "--orthographic --height nan",
        "--size 0x16",
        "--size 1000000000x1000000000",
        "--crop 0,0,0,4",
        "--crop 500,0,100,4",
        "--crop 4294967295,0,4294967295,4",
        "--crop 1,2,3",
        "--samples 0",
        "--samples 1000000000",
        "--step 0",
        "--step nan",
        "--step -1",
        "--step 1e-17",
        "--step-fraction 0",
        "--step-fraction nan",
        "--stop 1",
        "--stop nan",
        "--unit-distance 0",
        "--unit-distance inf",
        "--opacity extinction:nan",
        "--opacity extinction:-1",
        "--opacity 0:0,nan:1",
        "--opacity 1:0,0:1",
        "--colormap viridis --value-range 1:1",
        "--colormap viridis --value-range 0:inf",
        "--frames 1",
        "--tile 0",
        "--slab 33",
    ];
    let of_scene = ["--frames 5..3", "--frames 0..4", "--frames 4000000000", "--frames x", "--frames -1"];
    let cases = (of_cloud.iter().map(|options| ("c.rset", options)))
        .chain(of_scene.iter().map(|options| ("s.json", options)));
    for (input, options) in cases {
        let output = Command::new(env!("CARGO_BIN_EXE_rayset"))
            .current_dir(folder.path())
            .args(["render", input, "-o", "out.png", "--threads", "1"])
            .args(options.split(' '))
            .output()
            .expect("the program runs");
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success(), "{options} succeeds");
        assert!(said.contains("error: ") && !said.contains("panicked"), "{options}: {said}");
    }
    let mut names: Vec<_> =
        std::fs::read_dir(folder.path()).expect("it lists").map(|e| e.expect("it").file_name()).collect();
    names.sort();
    assert_eq!(names, ["c.rset", "s.json"], "nothing is written");
}
