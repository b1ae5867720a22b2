//! `rayset lod`: a file with what stands for its points from afar is the same cloud, and making it
//! keeps to its memory.

use std::fs;
use std::path::Path;

use crate::common::{folder, names, run, succeeds};

#[test]
fn a_file_gains_aggregates_in_place_within_the_memory_that_is_named_and_renders_as_before() {
    let folder = folder();
    let f = folder.path();
    succeeds(f, &["generate", "sphere-100k", "-o", "p.ply"]);
    succeeds(f, &["build", "p.ply", "-o", "c.rset", "--radius", "0.04"]);
    let render = |picture: &str| {
        succeeds(f, &["render", "c.rset", "--size", "64x64", "-o", picture]);
        fs::read(f.join(picture)).expect("a picture")
    };
    let before = render("before.png");
    let refused = run(f, &["lod", "c.rset", "--memory", "1MiB", "--threads", "2"]);
    let said = String::from_utf8_lossy(&refused.stderr).into_owned();
    let least = said.split("the smallest that would do is ").nth(1).and_then(|rest| rest.split(' ').next());
    let least = least.unwrap_or_else(|| panic!("no number: {said}"));
    let made = run(f, &["lod", "c.rset", "--memory", least, "--threads", "2", "--json"]);
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    let made: serde_json::Value = serde_json::from_slice(&made.stdout).expect("JSON");
    let number = |key: &str| made[key].as_f64();
    assert!(number("aggregates").is_some_and(|count| (1000.0..20_000.0).contains(&count)), "{made}");
    if let Some(peak) = number("peak_rss_bytes") {
        assert!(peak <= least.parse::<f64>().expect("a number"), "{made} in {least}");
    }
    let checked = run(f, &["verify", "c.rset", "--deep"]);
    assert!(String::from_utf8_lossy(&checked.stdout).contains("aggregates"), "{checked:?}");
    assert!(before == render("after.png"), "the picture is another");
    let left: Vec<String> = names(f).into_iter().filter(|name| name.contains(".rset")).collect();
    assert_eq!(left, ["c.rset"], "something is left behind");
}

#[test]
fn gas_is_built_with_aggregates_whole_or_in_parts_and_other_clouds_if_that_is_asked() {
    let folder = folder();
    let f = folder.path();
    let bytes = |file: &str| fs::read(f.join(file)).expect("a file");
    succeeds(f, &["generate", "cube-200k", "-o", "gas.ply"]);
    succeeds(f, &["build", "gas.ply", "-o", "without.rset", "--no-lod"]);
    let built = run(f, &["build", "gas.ply", "-o", "c.rset", "--json"]);
    let built: serde_json::Value = serde_json::from_slice(&built.stdout).expect("JSON");
    assert_eq!(built["file_bytes"], bytes("c.rset").len());
    let more = bytes("c.rset").len() - bytes("without.rset").len();
    assert!(built["aggregates"].as_u64() > Some(1000), "{built}");
    assert!(built["aggregate_bytes"].as_u64().is_some_and(|n| n <= more as u64 && 2 * n > more as u64));
    succeeds(f, &["lod", "without.rset", "-o", "with.rset"]);
    assert!(bytes("with.rset") == bytes("c.rset"), "not as `rayset lod` makes them");
    for part in ["1/2", "2/2"].iter().cycle().take(16) {
        succeeds(f, &["build", "gas.ply", "-o", "p.rset", "--part", part]);
    }
    succeeds(f, &["merge", "p.rset.parts", "-o", "p.rset", "--keep"]);
    assert!(bytes("p.rset") == bytes("c.rset"), "not as those of a build by one process");
    succeeds(f, &["merge", "p.rset.parts", "-o", "p.rset", "--no-lod"]);
    assert!(bytes("p.rset") == bytes("without.rset"), "merged without");
    let said = fails(f, &["build", "gas.ply", "-o", "p.rset", "--part", "1/2", "--lod"]);
    assert!(said.contains("--lod is for `rayset merge`"), "{said}");
    // A surface has none unless it is asked for.
    succeeds(f, &["generate", "sphere-20k", "-o", "s.ply"]);
    succeeds(f, &["build", "s.ply", "-o", "plain.rset"]);
    succeeds(f, &["build", "s.ply", "-o", "s.rset", "--lod"]);
    assert!(bytes("plain.rset").len() < bytes("s.rset").len());
    succeeds(f, &["lod", "plain.rset"]);
    assert!(bytes("plain.rset") == bytes("s.rset"));
    // Where memory is too little for them, a file does not silently lack them.
    let said = fails(f, &["build", "gas.ply", "-o", "little.rset", "--memory", "24MiB", "--threads", "1"]);
    assert!(said.contains("is built, but has no aggregates") && said.contains("smallest"), "{said}");
    assert!(bytes("little.rset") == bytes("without.rset"));
    let left = names(f).into_iter().find(|name| name.starts_with('.'));
    assert_eq!(left, None, "something is left behind");
}

#[test]
fn what_is_no_cloud_is_refused_by_name() {
    let folder = folder();
    let f = folder.path();
    fs::write(f.join("x.rset"), b"no cloud").expect("a write");
    for file in ["x.rset", "absent.rset"] {
        let refused = run(f, &["lod", file]);
        let said = String::from_utf8_lossy(&refused.stderr).into_owned();
        assert!(!refused.status.success() && said.contains(file), "{said}");
    }
}

/// What a command says that fails.
fn fails(folder: &Path, arguments: &[&str]) -> String {
    let done = run(folder, arguments);
    assert!(!done.status.success(), "{arguments:?}");
    String::from_utf8_lossy(&done.stderr).into_owned()
}

/// A file of points that fill a volume.
fn with_gas(f: &Path, points: &str) {
    succeeds(f, &["generate", points, "-o", "p.ply"]);
    succeeds(f, &["build", "p.ply", "-o", "c.rset"]);
}

#[test]
fn gas_with_aggregates_is_seen_from_afar_by_one_ray_and_it_is_said() {
    let folder = folder();
    let f = folder.path();
    with_gas(f, "cube-20k");
    let render = |options: &[&str]| {
        let plain = [
            "render",
            "c.rset",
            "--look",
            "gas",
            "--size",
            "32x24",
            "-o",
            "p.png",
            "--write-scene",
            "s.json",
        ];
        let done = run(f, &[&plain, options].concat());
        assert!(done.status.success(), "{done:?}");
        let scene = fs::read_to_string(f.join("s.json")).expect("a scene");
        let scene: serde_json::Value = serde_json::from_str(&scene).expect("JSON");
        let said = String::from_utf8_lossy(&done.stderr).into_owned();
        (fs::read(f.join("p.png")).expect("a picture"), scene, said)
    };
    let (whole, scene, said) = render(&[]);
    assert!(!said.contains("seen together") && scene["rendering"]["lod"].is_null(), "{said}");
    succeeds(f, &["lod", "c.rset"]);
    let (from_afar, scene, said) = render(&[]);
    assert!(said.contains("small points are seen together"), "{said}");
    assert_eq!((&scene["rendering"]["lod"], &scene["image"]["samples"]), (&"coarse".into(), &1.into()));
    assert_ne!(from_afar, whole);
    succeeds(f, &["render", "s.json", "-o", "again.png"]);
    assert_eq!(fs::read(f.join("again.png")).expect("a picture"), from_afar, "the written scene");
    let (off, scene, said) = render(&["--lod", "off"]);
    assert_eq!((off, &scene["rendering"]["lod"]), (whole, &"off".into()), "{said}");
    succeeds(f, &["render", "s.json", "--lod", "coarse", "--samples", "1", "-o", "again.png"]);
    assert_eq!(fs::read(f.join("again.png")).expect("a picture"), from_afar, "a scene, otherwise");
    let other = ["auto", "3"].map(|lod| {
        let (picture, scene, _) = render(&["--lod", lod]);
        assert_ne!(picture, from_afar, "{lod}");
        (picture, scene["rendering"]["lod"].clone())
    });
    assert!(other[0].1 == "auto" && other[1].1 == 3.0, "{other:?}");
    assert_ne!(other[0].0, other[1].0);
    // Aggregates of another kernel are of no use.
    let (_, scene, _) = render(&["--kernel", "chen"]);
    assert!(scene["rendering"]["lod"].is_null() && scene["image"]["samples"] == "auto");
}

#[test]
fn what_is_no_level_of_detail_is_refused_with_what_is() {
    let folder = folder();
    let f = folder.path();
    with_gas(f, "cube-1k");
    for value in ["on", "0", "65", "nan"] {
        let said = fails(f, &["render", "c.rset", "--lod", value, "-o", "p.png"]);
        assert!(said.contains("off, auto, coarse or a number from 0.0625 to 64"), "{said}");
    }
    let scene = r#"{"rayset": 1, "rendering": {"lod": "on"}, "root": {"type": "cloud", "file": "c.rset"}}"#;
    fs::write(f.join("s.json"), scene).expect("a write");
    let said = fails(f, &["check", "s.json"]);
    assert!(said.contains("rendering.lod") && said.contains("0.0625"), "{said}");
}

#[test]
fn parts_seen_from_afar_by_other_aggregates_are_refused() {
    let folder = folder();
    let f = folder.path();
    with_gas(f, "cube-2k");
    let part = |number: &str, name: &str| {
        let plain = ["render", "c.rset", "--size", "16x16", "--lod", "auto"];
        succeeds(f, &[&plain[..], &["--part", number, "-o", name]].concat());
    };
    succeeds(f, &["lod", "c.rset"]);
    part("1/2", "1.part");
    succeeds(f, &["lod", "c.rset", "--kernel", "chen"]);
    part("2/2", "2.part");
    let said = fails(f, &["merge", "1.part", "2.part", "-o", "p.png"]);
    assert!(said.contains("clouds and grids"), "{said}");
}

#[test]
fn what_is_built_of_gas_to_be_shown_has_aggregates() {
    let folder = folder();
    let f = folder.path();
    succeeds(f, &["generate", "cube-200k", "-o", "p.ply"]);
    let render =
        ["render", "p.ply", "--look", "gas", "--size", "8x8", "-o", "p.png", "--write-scene", "s.json"];
    succeeds(f, &[&render[..], &["--cache", "kept"]].concat());
    let scene = fs::read_to_string(f.join("s.json")).expect("a scene");
    assert!(scene.contains(r#""lod": "coarse""#), "{scene}");
}
