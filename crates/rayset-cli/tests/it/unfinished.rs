//! What is finished of a picture outlives what interrupts its render, and is gone on with to the
//! same bytes.

#![cfg(target_os = "linux")]

use std::fs;
use std::path::Path;
use std::process::{Output, Stdio};
use std::time::{Duration, Instant};

use crate::common::{folder, let_children_be_interrupted, names, program, run, send, succeeds};

/// A scene that takes a while, in every square of its picture.
const SCENE: &str = r#"{"rayset": 1, "image": {"size": [640, 480], "samples": 1},
    "camera": {"position": [0, 0, 4], "lookAt": [0, 0, 0], "fovy": 40},
    "rendering": {"ambientOcclusion": 0.5, "step": 0.03},
    "lights": [{"type": "ambient", "intensity": 0.4}, {"type": "directional", "direction": [1, -1, -1]}],
    "root": {"type": "union", "children": [
        {"type": "noise", "radii": [1.2, 1.2, 1.2], "scale": 1, "octaves": 2, "opacity": 0.1},
        {"type": "sphere", "radius": 0.8}]}}"#;

/// What a run that fails says.
fn fails(folder: &Path, arguments: &[&str]) -> String {
    let output = run(folder, arguments);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{arguments:?}: {said}");
    said
}

/// Bytes of the file that is being written in the folder.
fn partial_bytes(folder: &Path) -> u64 {
    let partial = names(folder).into_iter().find(|name| name.contains("rayset-partial"));
    partial.and_then(|name| fs::metadata(folder.join(name)).ok()).map_or(0, |of| of.len())
}

/// Runs a render and interrupts it once it has kept something more than `before` bytes. `None` if
/// it has ended before the signal came, as it may on a busy machine.
fn interrupted(f: &Path, arguments: &[&str], signal: &str, before: u64) -> Option<Output> {
    let mut command = program();
    command.current_dir(f).env("XDG_CACHE_HOME", f.join("home")).args(arguments);
    let mut child = command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().expect("the program runs");
    let started = Instant::now();
    while partial_bytes(f) <= before {
        if child.try_wait().expect("it can be asked").is_some() {
            return None;
        }
        assert!(started.elapsed() < Duration::from_secs(120), "it never keeps anything");
        std::thread::sleep(Duration::from_millis(1));
    }
    send(signal, &child);
    let output = child.wait_with_output().expect("it ends");
    (!output.status.success()).then_some(output)
}

/// The text chunks of a PNG file.
fn texts(path: &Path) -> Vec<String> {
    let file = std::io::BufReader::new(fs::File::open(path).expect("a picture"));
    let reader = png::Decoder::new(file).read_info().expect("a PNG");
    let texts = &reader.info().uncompressed_latin1_text;
    texts.iter().map(|text| format!("{}: {}", text.keyword, text.text)).collect()
}

/// The pixels of a PNG file, eight bits a channel.
fn pixels(path: &Path) -> Vec<[u8; 4]> {
    let file = std::io::BufReader::new(fs::File::open(path).expect("a picture"));
    let mut reader = png::Decoder::new(file).read_info().expect("a PNG");
    let mut bytes = vec![0; reader.output_buffer_size().expect("its size")];
    reader.next_frame(&mut bytes).expect("pixels");
    bytes.as_chunks::<4>().0.to_vec()
}

#[test]
fn what_is_finished_of_a_picture_outlives_signals_and_is_gone_on_with_to_the_same_bytes() {
    let_children_be_interrupted();
    let folder = folder();
    let f = folder.path();
    fs::write(f.join("s.json"), SCENE).expect("a scene");
    let part = ["--part", "2/2"];
    for (name, options, signal, code) in
        [("o.png", &[][..], "INT", 130), ("o.exr", &[], "TERM", 143), ("o.part", &part, "HUP", 129)]
    {
        let render = |output: &str, more: &[&str]| {
            [&["render", "s.json", "-o", output, "--threads", "1"], options, more]
                .concat()
                .iter()
                .map(|&word| word.to_owned())
                .collect::<Vec<_>>()
        };
        let finish = |output: &str, more: &[&str]| {
            let words = render(output, more);
            succeeds(f, &words.iter().map(String::as_str).collect::<Vec<_>>())
        };
        let interrupt = |more: &[&str], before: u64| {
            let words = render(name, more);
            let words: Vec<&str> = words.iter().map(String::as_str).collect();
            (0..20).find_map(|_| interrupted(f, &words, signal, before)).expect("it is still running")
        };
        let whole = format!("whole.{name}");
        finish(&whole, &[]);
        let (unfinished, is_picture) = (f.join(format!("{name}.unfinished")), options.is_empty());
        // The head of a part is shorter than this.
        let first = interrupt(&["--keep-partial"], 3000);
        let said = String::from_utf8_lossy(&first.stderr).into_owned();
        assert_eq!(first.status.code(), Some(code), "{said}");
        let last = said.lines().last().unwrap_or_default();
        assert!(last.starts_with(&format!("ended by SIG{signal}; ")), "{said}");
        assert!(last.contains("% of o.") && last.contains("--resume"), "{said}");
        assert!(!said.contains("error"), "{said}");
        assert_eq!(f.join(name).exists(), is_picture, "a share is no picture");
        if name == "o.png" {
            let text = texts(&f.join(name)).join("; ");
            assert!(text.starts_with("Comment: unfinished: ") && text.contains("%"), "{text}");
            let (some, all) = (pixels(&f.join(name)), pixels(&f.join(&whole)));
            let there = some.iter().filter(|pixel| **pixel != [0; 4]).count();
            assert!(there > 0 && there < all.len(), "{there} pixels");
        }
        let reached = fs::metadata(&unfinished).expect("what is finished").len();
        let second = interrupt(&["--resume"], reached);
        let said = String::from_utf8_lossy(&second.stderr).into_owned();
        assert!(said.starts_with(&format!("going on with {name}.unfinished: ")), "{said}");
        assert!(fs::metadata(&unfinished).expect("what is finished").len() > reached);
        finish(name, &["--resume"]);
        assert!(fs::read(f.join(name)).expect("it") == fs::read(f.join(&whole)).expect("it"), "{name}");
        assert!(!unfinished.exists());
    }
    assert!(texts(&f.join("o.png")).is_empty(), "a finished picture says nothing");
}

#[test]
fn what_is_finished_of_another_render_is_refused_and_stays() {
    let_children_be_interrupted();
    let folder = folder();
    let f = folder.path();
    fs::write(f.join("s.json"), SCENE).expect("a scene");
    let render = ["render", "s.json", "-o", "o.png", "--threads", "1"];
    let keep = [&render[..], &["--keep-partial"]].concat();
    (0..20).find_map(|_| interrupted(f, &keep, "INT", 3000)).expect("it is still running");
    let kept = fs::read(f.join("o.png.unfinished")).expect("what is finished");
    for (more, named) in [(&["--size", "320x240"][..], "width"), (&["--samples", "3"], "samples")] {
        let said = fails(f, &[&render[..], &["--resume"], more].concat());
        assert!(said.contains("o.png.unfinished is of another render") && said.contains(named), "{said}");
    }
    fs::write(f.join("o.png.unfinished"), &kept[..kept.len() / 2]).expect("a write");
    let said = fails(f, &[&render[..], &["--resume"]].concat());
    assert!(said.contains("damaged or incomplete"), "{said}");
    assert_eq!(names(f).iter().filter(|name| name.contains("partial")).count(), 0, "{:?}", names(f));
    // Anew, which says what it does not use, and removes it in the end.
    let small = ["--size", "64x48"];
    let said = succeeds(f, &[&keep[..], &small].concat());
    assert!(said.contains("is not gone on with"), "{said}");
    assert!(!f.join("o.png.unfinished").exists());
    // With nothing to go on with, from the beginning.
    succeeds(f, &[&render[..], &small, &["--resume"]].concat());
}

#[test]
fn of_several_pictures_the_one_that_was_interrupted_and_those_after_it_are_gone_on_with() {
    let_children_be_interrupted();
    let folder = folder();
    let f = folder.path();
    fs::write(f.join("s.json"), SCENE).expect("a scene");
    let turn = ["render", "s.json", "--turntable", "3", "--size", "320x240", "--threads", "1", "-o"];
    succeeds(f, &[&turn[..], &["whole.png"]].concat());
    let keep = [&turn[..], &["o.png", "--keep-partial"]].concat();
    let stopped = (0..20).find_map(|_| interrupted(f, &keep, "TERM", 3000)).expect("it is still running");
    let said = String::from_utf8_lossy(&stopped.stderr).into_owned();
    let rest = said.split("--frames ").nth(1).and_then(|rest| rest.split(' ').next());
    let rest = rest.unwrap_or_else(|| panic!("frames in {said}"));
    assert!(rest.ends_with("..2"), "{said}");
    succeeds(f, &[&turn[..], &["o.png", "--resume", "--frames", rest]].concat());
    for frame in 0..3 {
        let read = |name: &str| fs::read(f.join(format!("{name}.000{frame}.png"))).expect("a picture");
        assert!(read("o") == read("whole"), "frame {frame}");
    }
    assert!(!names(f).iter().any(|name| name.contains("unfinished")), "{:?}", names(f));
}

#[test]
fn a_render_that_fails_keeps_what_is_finished() {
    let folder = folder();
    let f = folder.path();
    succeeds(f, &["generate", "knot-60k", "-o", "p.ply"]);
    succeeds(f, &["build", "p.ply", "-o", "c.rset", "--page-size", "16384"]);
    // By a scene with its own look and camera, pages are read by rays alone.
    let scene = r#"{"rayset": 1, "image": {"size": [600, 600]},
        "camera": {"position": [5.4, 3.4, 9.4], "direction": [-0.46, -0.29, -0.84], "fovy": 35},
        "root": {"type": "cloud", "file": "c.rset", "transferFunction": {"opacity": {"extinction": 9}}}}"#;
    fs::write(f.join("s.json"), scene).expect("a scene");
    let render = ["render", "s.json", "--threads", "1", "--memory", "32MiB", "-o"];
    succeeds(f, &[&render[..], &["whole.png"]].concat());
    let sound = fs::read(f.join("c.rset")).expect("a cloud");
    let mut found = false;
    // Pages from the end of the file are damaged until squares before them are finished.
    for at in (1..20).map(|part| sound.len() * part / 20) {
        let mut damaged = sound.clone();
        damaged[at] ^= 1;
        fs::write(f.join("c.rset"), &damaged).expect("a write");
        let mut command = program();
        command.current_dir(f).args([&render[..], &["o.png", "--keep-partial"]].concat());
        let output = command.output().expect("the program runs");
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        fs::write(f.join("c.rset"), &sound).expect("a write");
        if said.contains("of o.png is finished") {
            assert_eq!(output.status.code(), Some(1), "{said}");
            assert!(said.contains("--resume") && said.contains("c.rset"), "{said}");
            found = true;
            break;
        }
    }
    assert!(found, "no page whose damage is met late");
    succeeds(f, &[&render[..], &["o.png", "--resume"]].concat());
    assert!(fs::read(f.join("o.png")).expect("it") == fs::read(f.join("whole.png")).expect("it"));
}

#[test]
fn an_output_beside_which_nothing_can_be_kept_is_refused() {
    let folder = folder();
    let f = folder.path();
    fs::write(f.join("s.json"), SCENE).expect("a scene");
    let said = fails(f, &["render", "s.json", "-o", "/dev/null", "--keep-partial"]);
    assert!(said.contains("regular file"), "{said}");
}
