//! Each option of a style: what it is on the command line, in the scene that is written, and in the
//! command that the viewer gives.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use rayset_inputs::style::OPTIONS;

use crate::common::{Random, folder, succeeds};

/// Each option with a value, beside those without which it means nothing.
const SAID: &[(&str, &[&str])] = &[
    ("samples", &["--samples=3"]),
    ("exposure", &["--exposure=-1.5"]),
    ("lod", &["--lod=2"]),
    ("look", &["--look=gas"]),
    ("kernel", &["--kernel=chen"]),
    ("splat-filter", &["--splat-filter=mip", "--kernel=splat", "--opacity=extinction:1"]),
    ("normalised", &["--normalised"]),
    ("radius-scale", &["--radius-scale=1.5"]),
    ("opacity", &["--opacity=0:0,1:0.5"]),
    ("unit-distance", &["--unit-distance=3"]),
    ("color", &["--color=#1060a0"]),
    ("colormap", &["--colormap=magma_r", "--color-by=x"]),
    ("color-by", &["--color-by=y"]),
    ("value-range", &["--value-range=10%:60%", "--color-by=x"]),
    ("log", &["--log", "--color-by=x", "--value-range=0.1:2"]),
    ("shading", &["--shading=none"]),
    ("compositing", &["--compositing=display", "--ambient-occlusion=0"]),
    ("ambient-occlusion", &["--ambient-occlusion=2"]),
    ("background", &["--background=#203040"]),
    ("step", &["--step=0.3"]),
    ("step-fraction", &["--step-fraction=2"]),
    ("phase", &["--phase=hashed"]),
    ("stop", &["--stop=0.5"]),
    ("view", &["--view=left"]),
    ("position", &["--position=5,4,-3"]),
    ("look-at", &["--look-at=0.2,0,0.5", "--position=5,4,-3"]),
    ("direction", &["--direction=0,0.5,-1"]),
    ("up", &["--up=-x"]),
    ("fovy", &["--fovy=60", "--position=5,4,-3"]),
    ("orthographic", &["--orthographic"]),
    ("height", &["--height=1.5", "--orthographic"]),
];

fn write_points(path: &Path) {
    let mut random = Random(7);
    let mut text = String::new();
    for _ in 0..400 {
        let [x, y, z] = [(); 3].map(|()| 2.0 * random.unit());
        writeln!(text, "{x} {y} {z}").expect("a line");
    }
    fs::write(path, text).expect("points are written");
}

#[test]
fn whatever_is_said_of_a_picture_its_written_scene_renders_the_same_bytes() {
    let folder = folder();
    let f = folder.path();
    write_points(&f.join("points.txt"));
    let read = |name: &str| fs::read(f.join(name)).expect("a picture");
    let render = |words: &[&str]| {
        let plain = ["render", "points.txt", "-o", "a.png", "--size", "24x24", "--write-scene", "s.json"];
        succeeds(f, &[&plain, words].concat());
        read("a.png")
    };
    assert!(
        OPTIONS.iter().map(|option| option.name).eq(SAID.iter().map(|(name, _)| *name)),
        "each option is said"
    );
    // Without aggregates, each point is seen: `lod` has the tests of what is with them.
    for (name, words) in SAID.iter().filter(|(name, _)| *name != "lod") {
        assert_ne!(render(words), render(&words[1..]), "--{name} changes nothing");
        let said = render(words);
        succeeds(f, &["render", "s.json", "-o", "b.png"]);
        assert_eq!(said, read("b.png"), "--{name}: the written scene");
    }
}

#[test]
fn every_number_of_rays_that_may_be_asked_for_may_stand_in_a_scene() {
    let folder = folder();
    let f = folder.path();
    write_points(&f.join("points.txt"));
    let mut pictures = Vec::new();
    for (samples, size) in
        [("--samples=auto", "160x120"), ("--samples=2", "160x120"), ("--samples=64", "12x9")]
    {
        let plain = ["render", "points.txt", "-o", "a.png", "--size", size, "--write-scene", "s.json"];
        succeeds(f, &[&plain[..], &[samples, "--look=gas", "--exposure=2"]].concat());
        succeeds(f, &["render", "s.json", "-o", "b.png"]);
        let said = fs::read(f.join("a.png")).expect("a picture");
        assert_eq!(said, fs::read(f.join("b.png")).expect("a picture"), "{samples}");
        pictures.push(said);
    }
    assert_ne!(pictures[0], pictures[1], "where the picture is smooth, a pixel has one ray");
}
