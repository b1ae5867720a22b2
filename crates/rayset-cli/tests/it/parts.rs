//! Pictures in parts: joined, they are the file of one render, byte for byte, and what is missing,
//! double, foreign or damaged is refused.

use std::fs;
use std::path::Path;

use crate::common::{folder, mebibytes, program};

fn rayset(folder: &Path, arguments: &[&str]) -> Result<String, String> {
    let mut command = program();
    let output =
        command.current_dir(folder).env("XDG_CACHE_HOME", folder.join("home")).args(arguments).output();
    let output = output.expect("the program runs");
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    if output.status.success() { Ok(said) } else { Err(said) }
}

fn succeeds(folder: &Path, arguments: &[&str]) -> String {
    rayset(folder, arguments).unwrap_or_else(|said| panic!("{arguments:?}: {said}"))
}

fn fails(folder: &Path, arguments: &[&str]) -> String {
    let said = rayset(folder, arguments).expect_err("it succeeds");
    assert_eq!(said.matches("error: ").count(), 1, "{arguments:?}: {said}");
    assert!(said.lines().last().is_some_and(|line| line.starts_with("error: ")), "{arguments:?}: {said}");
    said
}

/// A folder with a small cloud, `cloud.rset`, and a scene with a mirror, a shadow and a moving
/// camera, `scene.json`.
fn with_cloud() -> tempfile::TempDir {
    let folder = folder();
    let f = folder.path();
    let text: String = (0..2500)
        .map(|i| (f64::from(i % 50) * 0.1, f64::from(i / 50) * 0.1))
        .map(|(x, y)| format!("{x} {y} {}\n", (2.0 * x).sin() * y.cos()))
        .collect();
    fs::write(f.join("wave.xyz"), text).expect("a write");
    succeeds(f, &["build", "wave.xyz", "-o", "cloud.rset"]);
    fs::write(
        f.join("scene.json"),
        r#"{"rayset": 1, "image": {"size": [90, 70], "toneMapping": "filmic", "exposure": 0.5, "samples": 2},
        "camera": {"position": [2.5, -6, 4], "lookAt": [2.5, 2.5, 0], "up": [0, 0, 1]},
        "animation": {"keys": [
            {"frame": 0, "camera": {"position": [2.5, -6, 4], "lookAt": [2.5, 2.5, 0], "up": [0, 0, 1]}},
            {"frame": 3, "camera": {"position": [7, -4, 4], "lookAt": [2.5, 2.5, 0], "up": [0, 0, 1]}}]},
        "lights": [{"type": "directional", "direction": [1, 1, -2]}, {"type": "ambient", "intensity": 0.2}],
        "rendering": {"shadows": "cached"},
        "root": {"type": "union", "children": [
            {"type": "cloud", "file": "cloud.rset"},
            {"type": "sphere", "radius": 1, "transform": {"translate": [2.5, 2.5, 1.5]}, "material": {"reflectance": 0.7}}]}}"#,
    )
    .expect("a write");
    folder
}

/// Renders a picture whole and in so many parts, each with options of its own that change nothing,
/// and compares the bytes.
fn parts_make_the_whole(folder: &Path, options: &[&str], whole: &str, counts: &[u32]) {
    let render = [&["render"], options].concat();
    succeeds(folder, &[&render[..], &["-o", whole]].concat());
    let expected = fs::read(folder.join(whole)).expect("the picture");
    let layers: &[&str] = if whole.ends_with(".exr") { &["--layers"] } else { &[] };
    let (little, _) = mebibytes(20.0);
    for &of in counts {
        let mut names: Vec<String> = Vec::new();
        for number in 1..=of {
            let (part, name) = (format!("{number}/{of}"), format!("picture.{number}.part"));
            let work: &[&str] = match number % 3 {
                0 => &["--threads", "1", "--predictor", "none"],
                1 => &["--threads", "3", "--memory", "64MiB"],
                _ => &["--io", "pool", "--memory", &little, "--threads", "1"],
            };
            succeeds(folder, &[&render[..], layers, work, &["--part", &part, "-o", &name]].concat());
            names.push(name);
        }
        // In whatever order.
        names.reverse();
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        let joined = format!("joined-{whole}");
        succeeds(folder, &[&["merge"], &names[..], &["-o", &joined, "--memory", "32MiB"]].concat());
        let found = fs::read(folder.join(&joined)).expect("the joined picture");
        assert!(found == expected, "{options:?} in {of} parts");
    }
}

const PLAIN: [&str; 3] = ["cloud.rset", "--size", "100x75"];

#[test]
fn a_picture_of_one_two_and_seven_parts_is_that_of_one_render() {
    let folder = with_cloud();
    parts_make_the_whole(folder.path(), &PLAIN, "p.png", &[1, 2, 7]);
    // Of more parts than blocks, some are empty.
    parts_make_the_whole(folder.path(), &["cloud.rset", "--size", "40x30", "--samples", "1"], "q.png", &[5]);
}

#[test]
fn openexr_of_parts_is_that_of_one_render_with_all_layers() {
    let folder = with_cloud();
    parts_make_the_whole(folder.path(), &PLAIN, "p.exr", &[1, 2, 7]);
    parts_make_the_whole(folder.path(), &["scene.json"], "s.exr", &[3]);
}

#[test]
fn ambient_occlusion_crops_and_annotations_are_those_of_one_render() {
    let folder = with_cloud();
    let f = folder.path();
    let occluded = ["cloud.rset", "--size", "110x90", "--ambient-occlusion", "1.5"];
    parts_make_the_whole(f, &occluded, "p.png", &[2, 7]);
    let cropped = [&occluded[..], &["--crop", "13,37,61,31"]].concat();
    parts_make_the_whole(f, &cropped, "c.png", &[3]);
    parts_make_the_whole(f, &cropped, "c.exr", &[3]);
    let drawn = [&occluded[..], &["--look", "height", "--annotate", "--exposure", "0.7"]].concat();
    parts_make_the_whole(f, &drawn, "a.png", &[1, 3]);
    let drawn = [&drawn[..], &["--crop", "5,0,90,50", "--background", "none"]].concat();
    parts_make_the_whole(f, &drawn, "b.png", &[3]);
}

#[test]
fn mirrors_shadows_and_tone_mapping_are_those_of_one_render() {
    let folder = with_cloud();
    parts_make_the_whole(folder.path(), &["scene.json"], "s.png", &[2, 5]);
    parts_make_the_whole(folder.path(), &["scene.json", "--samples", "3"], "t.png", &[2]);
}

#[test]
fn parts_with_layers_make_the_png_of_a_render_without() {
    let folder = with_cloud();
    let f = folder.path();
    succeeds(f, &["render", "scene.json", "-o", "whole.png"]);
    for part in ["1/2", "2/2"] {
        let name = format!("{}.part", &part[..1]);
        succeeds(f, &["render", "scene.json", "--layers", "--part", part, "-o", &name]);
    }
    succeeds(f, &["merge", "1.part", "2.part", "-o", "joined.png"]);
    assert!(
        fs::read(f.join("joined.png")).expect("it reads") == fs::read(f.join("whole.png")).expect("it reads")
    );
}

#[test]
fn frames_of_turntables_and_paths_are_the_files_of_the_whole_sequence() {
    let folder = with_cloud();
    let f = folder.path();
    for (options, names) in [
        (&["cloud.rset", "--size", "40x40", "--turntable", "4"][..], [1, 2]),
        (&["scene.json", "--size", "40x40"][..], [2, 3]),
    ] {
        let whole: &[&str] = if options.contains(&"--turntable") { &[] } else { &["--frames", "all"] };
        succeeds(f, &[&["render"], options, whole, &["-o", "all.png"]].concat());
        let frames = format!("{}..{}", names[0], names[1]);
        succeeds(f, &[&["render"], options, &["--frames", &frames, "-o", "some.png"]].concat());
        let read = |name: String| fs::read(f.join(name)).expect("a frame");
        for frame in 0..4 {
            let name = format!("some.{frame:04}.png");
            assert_eq!(f.join(&name).exists(), names.contains(&frame), "{name}");
            if names.contains(&frame) {
                assert!(read(name) == read(format!("all.{frame:04}.png")), "{options:?}, {frame}");
                fs::remove_file(f.join(format!("some.{frame:04}.png"))).expect("it goes");
            }
        }
        // A frame in parts.
        let frame = names[1].to_string();
        for number in ["1", "2"] {
            let (part, output) = (format!("{number}/2"), format!("f{number}.part"));
            let last = ["--frames", &frame, "--part", &part, "-o", &output];
            succeeds(f, &[&["render"], options, &last].concat());
        }
        let part = |number: u32| format!("f{number}.{:04}.part", names[1]);
        succeeds(f, &["merge", &part(1), &part(2), "-o", "joined.png"]);
        assert!(read("joined.png".into()) == read(format!("all.{:04}.png", names[1])), "{options:?}");
    }
    let said = fails(f, &["render", "cloud.rset", "--turntable", "4", "--frames", "2..4", "-o", "x.png"]);
    assert!(said.contains("the turntable runs from frame 0 to frame 3"), "{said}");
}

/// Machines may have the files in other folders, and call them otherwise.
#[test]
fn where_files_lie_and_how_a_scene_is_written_make_no_difference() {
    let folder = with_cloud();
    let f = folder.path();
    fs::create_dir(f.join("there")).expect("a folder");
    fs::copy(f.join("cloud.rset"), f.join("there/other.rset")).expect("a copy");
    let scene = fs::read_to_string(f.join("scene.json")).expect("the scene");
    let scene = scene.replace("cloud.rset", "other.rset").replace('\n', " ").replace("0.20", "0.2");
    fs::write(f.join("there/scene.json"), scene).expect("a write");
    succeeds(f, &["render", "scene.json", "--part", "1/2", "-o", "1.part"]);
    succeeds(f, &["render", "there/scene.json", "--part", "2/2", "-o", "2.part"]);
    succeeds(f, &["merge", "1.part", "2.part", "-o", "joined.png"]);
    succeeds(f, &["render", "scene.json", "-o", "whole.png"]);
    assert!(
        fs::read(f.join("joined.png")).expect("it reads") == fs::read(f.join("whole.png")).expect("it reads")
    );
}

/// Renders part `share` into `name`.
fn part(folder: &Path, share: &str, name: &str, options: &[&str]) {
    let all = [&["render", "cloud.rset", "--size", "100x75", "--samples", "1"], options];
    succeeds(folder, &[&all.concat()[..], &["--part", share, "-o", name]].concat());
}

#[test]
fn missing_and_double_parts_are_named() {
    let folder = with_cloud();
    let f = folder.path();
    for number in 1..=4 {
        part(f, &format!("{number}/4"), &format!("{number}.part"), &[]);
    }
    let said = fails(f, &["merge", "4.part", "1.part", "-o", "p.png"]);
    assert!(said.contains("of 4 parts 2 are missing: 2/4 to 3/4; render them again"), "{said}");
    let said = fails(f, &["merge", "1.part", "2.part", "4.part", "-o", "p.png"]);
    assert!(said.contains("of 4 parts 1 is missing: 3/4; render it again"), "{said}");
    part(f, "2/4", "again.part", &["--threads", "1"]);
    // A part that was rendered again is the same file.
    assert!(
        fs::read(f.join("again.part")).expect("it reads") == fs::read(f.join("2.part")).expect("it reads")
    );
    let said = fails(f, &["merge", "1.part", "2.part", "again.part", "3.part", "4.part", "-o", "p.png"]);
    assert!(said.contains("2.part and again.part are both part 2/4"), "{said}");
    assert!(!f.join("p.png").exists());
    succeeds(f, &["merge", "1.part", "again.part", "3.part", "4.part", "-o", "p.png"]);
}

#[test]
fn parts_of_other_pictures_are_refused_and_it_is_said_what_differs() {
    let folder = with_cloud();
    let f = folder.path();
    part(f, "1/2", "1.part", &[]);
    let wave = fs::read_to_string(f.join("wave.xyz")).expect("the points").replace("0.1 0 ", "0.11 0 ");
    fs::write(f.join("other.xyz"), wave).expect("a write");
    succeeds(f, &["build", "other.xyz", "-o", "other.rset"]);
    let refused = |options: &[&str], expected: &[&str]| {
        succeeds(f, &[&["render"], options, &["--part", "2/2", "-o", "2.part"]].concat());
        let said = fails(f, &["merge", "1.part", "2.part", "-o", "p.png"]);
        assert!(said.contains("2.part is of another picture than 1.part: "), "{said}");
        assert!(expected.iter().all(|word| said.contains(word)), "{options:?}: {said}");
    };
    let plain = ["cloud.rset", "--size", "100x75", "--samples", "1"];
    let with = |more: &[&'static str]| [&plain[..], more].concat();
    refused(&with(&["--opacity", "extinction:3"]), &["its scene is", "the same input and options"]);
    refused(&["other.rset", "--size", "100x75", "--samples", "1"], &["clouds and grids", "the same files"]);
    refused(
        &["cloud.rset", "--size", "100x75", "--samples", "2"],
        &["samples: Fixed(2), and there samples: Fixed(1)"],
    );
    refused(&["cloud.rset", "--size", "100x76", "--samples", "1"], &["height: 76, and there height: 75"]);
    refused(&with(&["--crop", "0,0,100,60"]), &["rows 0..60", "rows 0..75 of 100x75 pixels"]);
    refused(&with(&["--view", "left"]), &["camera"]);
    refused(&with(&["--layers"]), &["layers: true, and there layers: false"]);
    // Its background is a colour of the display, so that the light of it differs.
    refused(&with(&["--exposure", "1"]), &["its scene is"]);
    refused(&with(&["--annotate-over"]), &["exposure or annotations"]);
    part(f, "2/3", "2.part", &[]);
    let said = fails(f, &["merge", "1.part", "2.part", "-o", "p.png"]);
    assert!(said.contains("in 3 parts, and that of columns 0..100"), "{said}");
    assert!(!f.join("p.png").exists());
}

#[test]
fn parts_with_and_without_fused_multiply_add_are_refused_together() {
    let folder = with_cloud();
    let f = folder.path();
    let levels = rayset::SimdLevel::available();
    let Some(best) = levels.iter().map(|level| level.name()).find(|name| ["avx512", "avx2"].contains(name))
    else {
        return eprintln!("skipped: this processor has no fused multiply-add");
    };
    part(f, "1/2", "1.part", &["--simd", best]);
    part(f, "2/2", "2.part", &["--simd", "sse2"]);
    let said = fails(f, &["merge", "1.part", "2.part", "-o", "p.png"]);
    assert!(said.contains("without fused multiply–add (sse2), and that with fused"), "{said}");
    assert!(said.contains("render all parts with one --simd"), "{said}");
    // Those of one class go together.
    if best == "avx512" {
        part(f, "2/2", "2.part", &["--simd", "avx2"]);
        succeeds(f, &["merge", "1.part", "2.part", "-o", "p.png"]);
    }
}

#[test]
fn damaged_parts_and_what_is_no_part_are_errors_that_say_where() {
    let folder = with_cloud();
    let f = folder.path();
    part(f, "1/2", "1.part", &[]);
    part(f, "2/2", "2.part", &[]);
    let whole = fs::read(f.join("2.part")).expect("it reads");
    let merged = |bytes: &[u8]| {
        fs::write(f.join("bad.part"), bytes).expect("a write");
        rayset(f, &["merge", "1.part", "bad.part", "-o", "p.png"])
    };
    assert!(merged(&whole).is_ok());
    fs::remove_file(f.join("p.png")).expect("it goes");
    for length in
        (0..whole.len()).step_by(whole.len() / 40 + 1).chain([7, 8, 11, 12, 35, 36, whole.len() - 1])
    {
        let said = merged(&whole[..length]).expect_err("it is cut off");
        assert!(said.starts_with("error: bad.part: byte "), "{length}: {said}");
    }
    for at in (0..whole.len()).step_by(whole.len() / 60 + 1) {
        let mut bytes = whole.clone();
        bytes[at] ^= 0x10;
        let said = merged(&bytes).expect_err("a bit is wrong");
        assert!(said.starts_with("error: bad.part: ") && said.lines().count() == 1, "{at}: {said}");
    }
    let mut later = whole.clone();
    later[8] = 9;
    let said = merged(&later).expect_err("another version");
    assert!(said.contains("version 9 of parts, and this program reads version 2"), "{said}");
    assert!(!f.join("p.png").exists(), "no half picture");
    for name in ["cloud.rset", "wave.xyz"] {
        let said = fails(f, &["merge", name, "-o", "p.png"]);
        assert!(said.contains("byte 0: not a part"), "{said}");
        let said = fails(f, &["merge", "1.part", name, "-o", "p.png"]);
        assert!(said.contains(&format!("{name}: byte 0: not a part")), "{said}");
    }
    assert!(fails(f, &["merge", "absent.part", "-o", "p.png"]).contains("cannot read absent.part"));
}

/// Ambient occlusion keeps rows, and an OpenEXR file is compressed by a thread of its own.
#[test]
fn merging_keeps_to_the_smallest_budget_that_it_names() {
    let folder = folder();
    let f = folder.path();
    fs::write(
        f.join("ball.json"),
        r#"{"rayset": 1, "image": {"size": [900, 2000]}, "camera": {"position": [0, 0, 3], "lookAt": [0, 0, 0]},
        "rendering": {"ambientOcclusion": 1, "step": 0.2}, "root": {"type": "sphere", "radius": 1}}"#,
    )
    .expect("a write");
    succeeds(f, &["render", "ball.json", "--layers", "--part", "1/2", "-o", "1.part"]);
    succeeds(f, &["render", "ball.json", "--layers", "--part", "2/2", "-o", "2.part"]);
    let said = fails(f, &["merge", "1.part", "2.part", "-o", "p.exr", "--memory", "1MiB"]);
    let least = said.split("the smallest that would do is ").nth(1).and_then(|rest| rest.split(' ').next());
    let least = least.expect("a number");
    let output = program()
        .current_dir(f)
        .args(["merge", "1.part", "2.part", "-o", "p.exr", "--memory", least])
        .output()
        .expect("the program runs");
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let peak = said.split("peak memory ").nth(1).and_then(|rest| rest.split(' ').next());
    let Some(peak) = peak else {
        return eprintln!("skipped: the system does not say how much memory is used");
    };
    let (peak, least): (f64, f64) = (peak.parse().expect("a number"), least.parse().expect("a number"));
    assert!(peak <= least / f64::from(1 << 20) + 0.06, "{peak} MiB of {least} bytes");
}

#[test]
fn what_cannot_be_done_with_parts_is_refused_before_anything_is_rendered() {
    let folder = with_cloud();
    let f = folder.path();
    let said = fails(f, &["render", "cloud.rset", "--part", "1/2", "-o", "p.png"]);
    assert!(said.contains("a part is no picture yet"), "{said}");
    for wrong in ["0/2", "3/2", "1", "x/y"] {
        let said =
            rayset(f, &["render", "cloud.rset", "--part", wrong, "-o", "p.part"]).expect_err("no part");
        assert!(said.contains("the third of eight"), "{said}");
    }
    part(f, "1/1", "1.part", &[]);
    let said = fails(f, &["merge", "1.part", "-o", "p.exr"]);
    assert!(said.contains("render them with --layers"), "{said}");
    assert!(fails(f, &["merge", "1.part", "-o", "1.part"]).contains("is an input of this run"));
    let said = fails(f, &["merge", "1.part", "-o", "p.png", "--memory", "1MiB"]);
    let least = said.split("the smallest that would do is ").nth(1).and_then(|rest| rest.split(' ').next());
    succeeds(f, &["merge", "1.part", "-o", "p.png", "--memory", least.expect("a number")]);
}
