//! Scenes that ask for too much: what `check` passes is rendered in bounded time and memory, the
//! rest is an error that says what there may be.

use std::fmt::Write as _;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use rayset::octree::build::BuildOptions;
use rayset::scene_file::SceneFile;

use crate::common::{build_at, folder, mixed_points};

/// How long a run may wait for anything: only for what never comes.
const NEVER: Duration = Duration::from_secs(600);

/// The processor time that a process has taken; `None` where that cannot be known.
fn processor_time(process: u32) -> Option<Duration> {
    let stat = std::fs::read_to_string(format!("/proc/{process}/stat")).ok()?;
    // Behind the name, which may hold anything, in hundredths of a second.
    let numbers: Vec<&str> = stat.rsplit_once(')')?.1.split_whitespace().collect();
    let ticks = numbers.get(11)?.parse::<u64>().ok()? + numbers.get(12)?.parse::<u64>().ok()?;
    Some(Duration::from_millis(ticks * 10))
}

/// Runs the program; `None` if it takes more than some seconds of processor time, however busy the
/// machine is, or never ends.
fn rayset_within(folder: &Path, seconds: u64, arguments: &[&str]) -> Option<Output> {
    let mut child = Command::new(env!("CARGO_BIN_EXE_rayset"))
        .current_dir(folder)
        .args(arguments)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program runs");
    let start = Instant::now();
    while child.try_wait().expect("a status").is_none() {
        let taken = processor_time(child.id()).unwrap_or_default();
        if taken > Duration::from_secs(seconds) || start.elapsed() > NEVER {
            child.kill().expect("it ends");
            child.wait().expect("it has ended");
            return None;
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    Some(child.wait_with_output().expect("its output"))
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// A scene of these children, with more of its own.
fn scene(more: &str, children: &str) -> String {
    format!(
        r#"{{"rayset": 1, "image": {{"size": [8, 8]}}, {more} "root": {{"type": "union", "children": [{children}]}}}}"#
    )
}

#[test]
fn numbers_beyond_their_ranges_are_errors_with_the_range() {
    let ball = r#"{"type": "sphere", "radius": 1}"#;
    let moved = |transform: &str| format!(r#"{{"type": "sphere", "radius": 1, "transform": {transform}}}"#);
    let lit = |light: &str| scene(&format!(r#""lights": [{light}],"#), ball);
    for (text, key) in [
        (lit(r#"{"type": "directional", "direction": [1e160, 0, 0]}"#), "direction[0]"),
        (lit(r#"{"type": "directional", "direction": [1e-160, 0, 0]}"#), "direction"),
        (lit(r#"{"type": "point", "position": [0, 1e300, 0]}"#), "position[1]"),
        (lit(r#"{"type": "ambient", "color": [1e13, 0, 0]}"#), "color[0]"),
        (lit(r#"{"type": "ambient", "color": [1e7, 0, 0], "intensity": 1e7}"#), "lights[0]"),
        (scene("", r#"{"type": "box", "size": [1e-308, 1, 1]}"#), "size"),
        (scene("", r#"{"type": "sphere", "radius": 1e-19}"#), "radius"),
        (scene("", r#"{"type": "sphere", "radius": 1e19}"#), "radius"),
        (scene("", &moved(r#"{"translate": [0, 0, 2e18]}"#)), "translate"),
        (scene("", &moved(r#"{"matrix": [[1e19, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]}"#)), "matrix"),
        (scene("", &moved(r#"[{"scale": 1e10}, {"scale": 1e10}]"#)), "transform"),
        (scene("", &moved(r#"{"scale": 1e-19}"#)), "transform"),
        (scene(r#""camera": {"position": [0, 0, 1e200]},"#, ball), "position[2]"),
        (scene(r#""camera": {"position": [0, 0, 3], "lookAt": [0, 0, 3]},"#, ball), "lookAt"),
        (scene(r#""rendering": {"unitDistance": 1e-300},"#, ball), "unitDistance"),
        (scene(r#""rendering": {"step": 1e-8},"#, ball), "rendering.step"),
        (scene(r#""background": [0, 0, 1e13],"#, ball), "background"),
    ] {
        let error = SceneFile::parse(Path::new("scene.json"), &text).expect_err(key);
        assert!(error.key.contains(key), "{key}: {error}");
        assert!(
            error.what.contains("expected")
                || error.what.contains("will do")
                || error.what.contains("1e12")
                || error.what.contains("stands where"),
            "{error}"
        );
    }
}

#[test]
fn every_limit_of_a_scene_is_an_error_that_says_it() {
    let many = |count: usize, one: &str| vec![one; count].join(",");
    let ball = r#"{"type": "sphere", "radius": 1}"#;
    let of_ball = |more: String| scene("", &format!(r#"{{"type": "sphere", "radius": 1, {more}}}"#));
    let lights = |count| scene(&format!(r#""lights": [{}],"#, many(count, r#"{"type": "headlight"}"#)), ball);
    let moves = |count| of_ball(format!(r#""transform": [{}]"#, many(count, r#"{"scale": 1}"#)));
    let transfers = |count| of_ball(format!(r#""transfers": [{}]"#, many(count, r#"{"opacity": [[0, 1]]}"#)));
    let curve = |count| of_ball(format!(r#""transfers": [{{"opacity": [{}]}}]"#, many(count, "[0, 1]")));
    let stops =
        |count| of_ball(format!(r#""transfers": [{{"color": [{}]}}]"#, many(count, "[0, [0, 0, 0]]")));
    let keys = |count: usize| {
        let mut keys = String::new();
        for frame in 0..count {
            let comma = if frame > 0 { "," } else { "" };
            write!(keys, r#"{comma}{{"frame": {frame}, "camera": {{"position": [0, 0, 5]}}}}"#)
                .expect("text");
        }
        scene(&format!(r#""animation": {{"keys": [{keys}]}},"#), ball)
    };
    let values =
        |count: usize| scene("", &format!(r#"{{"type": "sphere", "radius": [{}]}}"#, many(count, "1")));
    let deep = |depth: usize| scene("", &format!("{}{}", "[".repeat(depth), "]".repeat(depth)));
    let read = |text: &str| SceneFile::parse(Path::new("scene.json"), text).map(drop);
    for (name, most, make) in [
        ("1024", 1024, &lights as &dyn Fn(usize) -> String),
        ("256", 256, &moves),
        ("16", 16, &transfers),
        ("4096", 4096, &curve),
        ("4096", 4096, &stops),
        ("16384", 16384, &keys),
    ] {
        read(&make(most)).expect(name);
        let error = read(&make(most + 1)).expect_err(name).to_string();
        assert!(error.contains(&format!("at most {name}")), "{error}");
    }
    let error = read(&values(600_000)).expect_err("too many values").to_string();
    assert!(error.contains("more than 524288 values"), "{error}");
    let error = read(&deep(200)).expect_err("too deep").to_string();
    assert!(error.contains("nested more than 127 deep"), "{error}");
    let name = format!(r#"{{"type": "sphere", "radius": 1, "id": "{}"}}"#, "n".repeat(300));
    assert!(read(&scene("", &name)).expect_err("a long name").to_string().contains("longer than 256 bytes"));

    let folder = folder();
    let path = folder.path().join("long.json");
    std::fs::write(&path, " ".repeat((4 << 20) + 1)).expect("a file");
    assert!(SceneFile::load(&path).expect_err("too long").to_string().contains("longer than 4 MiB"));
    let preset = r#"{"type": "sphere", "radius": 1, "transfers": [{"preset": {"file": "long.json"}}]}"#;
    let beside = folder.path().join("scene.json");
    let error = SceneFile::parse(&beside, &scene("", preset)).expect_err("too long").to_string();
    assert!(error.contains("long.json: cannot read it: longer than 4 MiB"), "{error}");
}

#[test]
fn what_check_passes_is_rendered_in_bounded_time() {
    let folder = folder();
    let ball = r#"{"type": "sphere", "radius": 1}"#;
    let plate = r#"{"type": "box", "size": [3, 3, 1e-18], "transform": {"rotate": {"axis": [1, 2, 0], "degrees": 40}}}"#;
    let moved =
        |transform: &str| format!(r#"{{"type": "sphere", "radius": 1, "transform": {transform}}}, {ball}"#);
    let scenes = [
        ("a thin plate", scene("", &format!("{plate}, {ball}"))),
        (
            "steps of a thousandth of something fine",
            scene(
                r#""rendering": {"stepFraction": 0.001, "stopTransmittance": 0},"#,
                r##"{"type": "sphere", "radius": 1, "opacity": 0.01, "color": {"type": "checker", "colors": ["#000000", "#ffffff"], "size": 1e-18}}"##,
            ),
        ),
        (
            "a stretched ball",
            scene("", &moved(r#"{"matrix": [[1e12, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]}"#)),
        ),
        ("a flattened ball", scene("", &moved(r#"{"scale": [1, 1e-17, 1]}"#))),
        ("a ball far away", scene("", &moved(r#"{"translate": [1e18, 0, 0]}"#))),
        (
            "a small ball in a large one",
            scene(
                "",
                r#"{"type": "sphere", "radius": 1e18, "opacity": 0.001}, {"type": "sphere", "radius": 1e-18}"#,
            ),
        ),
        ("fine noise", scene("", r#"{"type": "noise", "radii": [1, 1, 1], "scale": 1e-18, "octaves": 8}"#)),
        (
            "a fine checker",
            scene(
                "",
                r##"{"type": "sphere", "radius": 1, "edge": 1e-18, "color": {"type": "checker", "colors": ["#000000", "#ffffff"], "size": 1e-18}}"##,
            ),
        ),
        (
            "a light far away",
            scene(
                r#""lights": [{"type": "point", "position": [1e18, 1e18, 0]}, {"type": "directional", "direction": [1e-18, 0, 0]}], "rendering": {"shadowResolution": 16},"#,
                ball,
            ),
        ),
        (
            "an eye far away",
            scene(
                r#""camera": {"position": [0, 0, 1e18], "fovy": 0.001}, "rendering": {"step": 0.01},"#,
                ball,
            ),
        ),
        (
            "a long unit distance",
            scene(
                r#""rendering": {"unitDistance": 1e18},"#,
                &format!(r#"{{"type": "difference", "children": [{ball}, {plate}]}}"#),
            ),
        ),
    ];
    for (name, text) in scenes {
        std::fs::write(folder.path().join("scene.json"), text).expect("a scene");
        let checked = rayset_within(folder.path(), 30, &["check", "scene.json"]).expect(name);
        assert!(checked.status.success(), "{name}: {}", said(&checked));
        let started = Instant::now();
        let rendered =
            rayset_within(folder.path(), 30, &["render", "scene.json", "-o", "p.png", "--threads", "1"]);
        let rendered = rendered.unwrap_or_else(|| panic!("{name} takes more than 30 seconds of a processor"));
        assert!(rendered.status.success(), "{name}: {}", said(&rendered));
        eprintln!("{name}: {:?}", started.elapsed());
    }
}

#[cfg(unix)]
#[test]
fn a_pipe_or_a_device_is_an_error_wherever_a_file_is_expected() {
    let folder = folder();
    drop(build_at(
        &folder.path().join("c.rset"),
        Box::new(mixed_points(50, 1.0, 3)),
        &BuildOptions::default(),
    ));
    for pipe in ["pipe.rset", "pipe.json"] {
        assert!(Command::new("mkfifo").arg(folder.path().join(pipe)).status().expect("mkfifo").success());
    }
    for device in ["zero.rset", "zero.json"] {
        std::os::unix::fs::symlink("/dev/zero", folder.path().join(device)).expect("a link");
    }
    let mut inputs = vec!["pipe.rset".to_owned(), "pipe.json".into(), "zero.rset".into(), "zero.json".into()];
    for (i, (kind, file)) in
        [("cloud", "pipe.rset"), ("grid", "pipe.rset"), ("cloud", "zero.rset")].iter().enumerate()
    {
        let text = scene("", &format!(r#"{{"type": "{kind}", "file": "{file}"}}"#));
        std::fs::write(folder.path().join(format!("data{i}.json")), text).expect("a scene");
        inputs.push(format!("data{i}.json"));
    }
    for file in ["pipe.json", "zero.json"] {
        let cloud = r#""type": "cloud", "file": "c.rset""#;
        let text =
            scene("", &format!(r#"{{{cloud}, "transferFunction": {{"preset": {{"file": "{file}"}}}}}}"#));
        std::fs::write(folder.path().join(format!("preset-{file}")), text).expect("a scene");
        inputs.push(format!("preset-{file}"));
    }
    for input in inputs {
        let output = rayset_within(folder.path(), 10, &["render", &input, "-o", "p.png"]);
        let output = output.unwrap_or_else(|| panic!("{input} is waited for"));
        assert!(!output.status.success(), "{input}");
        assert!(said(&output).contains("a regular file"), "{input}: {}", said(&output));
    }
}

#[cfg(target_os = "linux")]
#[test]
fn the_memory_of_large_scenes_is_known_beforehand_and_kept_to() {
    let folder = folder();
    let shadows = r#""lights": [{"type": "directional", "direction": [0, -1, -1]}], "rendering": {"shadowResolution": 16},"#;
    let mut balls = String::new();
    for i in 0..20_000 {
        let (x, y) = (f64::from(i % 200) / 100.0 - 1.0, f64::from(i / 200) / 50.0 - 1.0);
        let ball = r#""type": "sphere", "radius": 0.01"#;
        write!(
            balls,
            r#"{}{{{ball}, "transform": {{"translate": [{x}, {y}, 0]}}}}"#,
            if i > 0 { "," } else { "" }
        )
        .expect("text");
    }
    let lights = vec![r#"{"type": "directional", "direction": [0, -1, -1]}"#; 1024].join(",");
    let lights = format!(r#""lights": [{lights}], "rendering": {{"shadowResolution": 16}},"#);
    let ball = r#"{"type": "sphere", "radius": 1}"#;
    let moves = vec![r#"{"scale":1}"#; 256].join(",");
    let moved = vec![format!(r#"{{"type":"sphere","radius":1,"transform":[{moves}]}}"#); 1000].join(",");
    // A different place each, so that none stands for another.
    let stops = (0..4096)
        .map(|i| format!("[{},[{},0,0.5]]", f64::from(i) / 4095.0, i % 2))
        .collect::<Vec<_>>()
        .join(",");
    let mapped: Vec<String> =
        (0..8).map(|i| format!(r#"{{"ref": "map", "transform": {{"translate": [0, 0, {i}]}}}}"#)).collect();
    let define = format!(
        r#""define": {{"map": {{"type": "sphere", "radius": 1, "transfers": [{{"color": [{stops}]}}]}}}},"#
    );
    let needles = vec![ball; 60].join(",");
    let common = format!(r#"{{"type": "intersection", "children": [{needles}]}}"#);
    for (name, text) in [
        ("balls", scene(shadows, &balls)),
        ("lights", scene(&lights, ball)),
        ("moves", scene("", &moved)),
        ("maps", scene(&define, &mapped.join(","))),
        ("an intersection", scene(shadows, &common)),
    ] {
        std::fs::write(folder.path().join("scene.json"), text).expect("a scene");
        let render = |memory: &str| {
            let options = ["--memory", memory, "--threads", "2", "--stats", "s.json"];
            let arguments = [&["render", "scene.json", "-o", "p.png"], &options[..]].concat();
            rayset_within(folder.path(), 120, &arguments)
                .unwrap_or_else(|| panic!("{name} takes more than two minutes of a processor"))
        };
        let refused = said(&render("8MiB"));
        let least = refused.split_once("is ").and_then(|(_, rest)| rest.split_once(" bytes"));
        let least: u64 = least
            .and_then(|(n, _)| n.rsplit(' ').next()?.parse().ok())
            .unwrap_or_else(|| panic!("{name}: {refused}"));
        let output = render(&least.to_string());
        assert!(output.status.success(), "{name}: {}", said(&output));
        let text = std::fs::read_to_string(folder.path().join("s.json")).expect("statistics");
        let stats: serde_json::Value = serde_json::from_str(&text).expect("JSON");
        let peak = stats["peak_rss_bytes"].as_u64().expect("a peak");
        eprintln!("{name}: {peak} of {least}");
        assert!(peak <= least, "{name}: {peak} bytes resident of {least}");
    }
}
