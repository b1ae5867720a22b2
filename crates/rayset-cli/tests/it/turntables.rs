//! Turntables: what all of their cameras see.

use std::fs;
use std::path::Path;

use crate::common::{folder, program};

const FRAMES: usize = 6;

fn rayset(folder: &Path, arguments: &[&str]) {
    let mut command = program();
    command.current_dir(folder).env("XDG_CACHE_HOME", folder.join("home")).args(arguments);
    let output = command.output().expect("the program runs");
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
}

/// The first and last column and row of each frame in which anything is seen, and the size of a
/// frame.
fn frames(folder: &Path) -> Vec<([usize; 4], [usize; 2])> {
    let frame = |k: usize| {
        let file = fs::File::open(folder.join(format!("t.{k:04}.png"))).expect("the picture");
        let mut reader = png::Decoder::new(std::io::BufReader::new(file)).read_info().expect("a PNG");
        let mut bytes = vec![0; reader.output_buffer_size().expect("a size")];
        let info = reader.next_frame(&mut bytes).expect("a picture");
        let (width, height) = (info.width as usize, info.height as usize);
        let seen = |x: usize, y: usize| bytes[4 * (y * width + x) + 3] > 40;
        let columns: Vec<usize> = (0..width).filter(|&x| (0..height).any(|y| seen(x, y))).collect();
        let rows: Vec<usize> = (0..height).filter(|&y| (0..width).any(|x| seen(x, y))).collect();
        let ends = |found: &[usize]| (found[0], found[found.len() - 1]);
        let ((left, right), (top, bottom)) = (ends(&columns), ends(&rows));
        ([left, right, top, bottom], [width, height])
    };
    (0..FRAMES).map(frame).collect()
}

/// Nothing is cut off, and as much is seen as fits.
fn check(folder: &Path, what: &str) {
    let frames = frames(folder);
    for (k, ([left, right, top, bottom], [width, height])) in frames.iter().enumerate() {
        let is_whole = *left > 0 && *top > 0 && right + 1 < *width && bottom + 1 < *height;
        assert!(is_whole, "{what}: frame {k} shows {left} to {right}, {top} to {bottom}");
    }
    let share = |([left, right, top, bottom], [width, height]): &([usize; 4], [usize; 2])| {
        let part = |from: usize, to: usize, of: usize| (to - from + 1) as f64 / of as f64;
        part(*left, *right, *width).max(part(*top, *bottom, *height))
    };
    let largest = frames.iter().map(share).fold(0.0, f64::max);
    assert!(largest > 0.6, "{what}: {largest} of the frame is used at most");
}

#[test]
fn every_frame_of_a_turntable_shows_all_of_a_thing_however_long_it_is() {
    let folder = folder();
    let f = folder.path();
    // A beam along x, whose end comes toward the eye.
    let beam: String = (0..8000)
        .map(|i| (f64::from(i % 400) * 0.02, f64::from(i / 400)))
        .map(|(x, turn)| format!("{x} {} {}\n", 0.4 * (turn * 0.314).cos(), 0.4 * (turn * 0.314).sin()))
        .collect();
    fs::write(f.join("beam.xyz"), beam).expect("a write");
    rayset(f, &["build", "beam.xyz", "-o", "b.rset"]);
    let plain = ["render", "b.rset", "-o", "t.png", "--turntable", "6", "--samples", "1"];
    let plain = [&plain[..], &["--background", "none", "--size", "72x48"]].concat();
    for more in [&[][..], &["--view", "right"], &["--orthographic"], &["--fovy", "70"], &["--view", "top"]] {
        rayset(f, &[&plain[..], more].concat());
        check(f, &format!("{more:?}"));
    }
    // Of a scene whose camera is not said, too.
    let scene = r#"{"rayset": 1, "image": {"size": [72, 48]}, "root": {"type": "box", "size": [1, 1, 8]}}"#;
    fs::write(f.join("s.json"), scene).expect("a write");
    rayset(f, &["render", "s.json", "-o", "t.png", "--turntable", "6"]);
    check(f, "a scene");
}

#[test]
fn a_turntable_turns_about_what_is_up() {
    let folder = folder();
    let f = folder.path();
    // A cone: the same from all around, and from no side else.
    let cone: String = (0..9000)
        .map(|i| (f64::from(i) * 2.399_963, f64::from(i) / 9000.0))
        .map(|(turn, z)| format!("{} {} {}\n", (1.0 - z) * turn.cos(), (1.0 - z) * turn.sin(), 2.5 * z))
        .collect();
    fs::write(f.join("cone.xyz"), cone).expect("a write");
    rayset(f, &["build", "cone.xyz", "-o", "c.rset"]);
    let arguments = ["render", "c.rset", "-o", "t.png", "--turntable", "6", "--size", "64x64", "--up", "z"];
    rayset(f, &[&arguments[..], &["--background", "none", "--samples", "1"]].concat());
    let upright = frames(f);
    rayset(f, &[&arguments[..8], &["--background", "none", "--samples", "1"]].concat());
    for (k, (bounds, _)) in upright.iter().chain(&frames(f)).enumerate() {
        let same = bounds.iter().zip(&upright[0].0).all(|(a, b)| a.abs_diff(*b) <= 2);
        assert!(same, "frame {k} shows {bounds:?}, the first {:?}", upright[0].0);
    }
}
