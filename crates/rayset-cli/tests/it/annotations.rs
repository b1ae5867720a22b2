//! `--annotate`: what is drawn over a picture, and what stays as it was.

use std::fs;
use std::path::Path;

use crate::common::{folder, program};

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

/// A picture's width and pixels.
fn picture(path: &Path) -> (usize, Vec<[u8; 4]>) {
    let file = std::io::BufReader::new(fs::File::open(path).expect("the picture"));
    let mut reader = png::Decoder::new(file).read_info().expect("a PNG");
    let mut bytes = vec![0; reader.output_buffer_size().expect("a size")];
    let info = reader.next_frame(&mut bytes).expect("a picture");
    (info.width as usize, bytes.chunks_exact(4).map(|p| [p[0], p[1], p[2], p[3]]).collect())
}

/// Points on a wave, with heights.
fn wave(folder: &Path) {
    let text: String = (0..4900)
        .map(|i| (f64::from(i % 70) * 0.1, f64::from(i / 70) * 0.1))
        .map(|(x, y)| format!("{x} {y} {}\n", (x + y).sin()))
        .collect();
    fs::write(folder.join("wave.xyz"), text).expect("a write");
    succeeds(folder, &["build", "wave.xyz", "-o", "w.rset"]);
}

const HEIGHT: [&str; 10] =
    ["render", "w.rset", "--look", "height", "--size", "320x260", "--samples", "1", "--background", "none"];

#[test]
fn annotations_over_a_picture_leave_the_rest_of_it_as_it_is() {
    let folder = folder();
    let f = folder.path();
    wave(f);
    succeeds(f, &[&HEIGHT[..], &["-o", "plain.png"]].concat());
    succeeds(f, &[&HEIGHT[..], &["-o", "drawn.png", "--annotate-over"]].concat());
    let ((width, plain), (_, drawn)) = (picture(&f.join("plain.png")), picture(&f.join("drawn.png")));
    let differs = |x: usize, y: usize| plain[y * width + x] != drawn[y * width + x];
    let any = |xs: std::ops::Range<usize>, ys: std::ops::Range<usize>| {
        ys.clone().any(|y| xs.clone().any(|x| differs(x, y)))
    };
    assert!(any(0..160, 0..40), "a caption");
    assert!(any(250..320, 60..200), "a colour bar");
    assert!(any(0..60, 190..260), "axes");
    assert!(any(220..320, 230..260), "a scale");
    assert!(!any(100..220, 60..260) && !any(0..240, 50..180), "nothing in the middle");
    // The bar has the colours of both ends of the map one above the other.
    let rows = |color: [u8; 3]| -> Vec<usize> {
        let near = |p: &[u8; 4]| (0..3).all(|c| p[c].abs_diff(color[c]) <= 4) && p[3] == 255;
        (60 * width..200 * width)
            .filter(|at| at % width > 240 && near(&drawn[*at]))
            .map(|at| at / width)
            .collect()
    };
    let (top, bottom) = (rows([0xfd, 0xe7, 0x25]), rows([0x44, 0x01, 0x54]));
    let (top, bottom) = (top.first().expect("the upper end"), bottom.last().expect("the lower end"));
    assert!(*bottom > top + 100, "{top} {bottom}");
}

#[test]
fn bands_crops_and_budgets_do_not_change_what_is_drawn() {
    let folder = folder();
    let f = folder.path();
    wave(f);
    let drawn =
        [&HEIGHT[..], &["--annotate", "--threads", "1", "--caption", "One line\\nand – another"]].concat();
    succeeds(f, &[&drawn[..], &["-o", "whole.png"]].concat());
    // With the least memory, bands have eight rows.
    let said =
        rayset(f, &[&drawn[..], &["-o", "least.png", "--memory", "1MiB"]].concat()).expect_err("too little");
    let (_, rest) = said.split_once("the smallest that would do is ").expect("it says how much");
    let least = rest.split(' ').next().expect("a number");
    succeeds(f, &[&drawn[..], &["-o", "least.png", "--memory", least, "--stats", "s.json"]].concat());
    assert!(fs::read(f.join("whole.png")).ok() == fs::read(f.join("least.png")).ok(), "the pictures differ");
    // Drawing takes memory, which the budget counts: the process grows by no more than the smallest
    // budget does.
    let plain = [&HEIGHT[..], &["-o", "x.png", "--threads", "1"]].concat();
    let said = rayset(f, &[&plain[..], &["--memory", "1MiB"]].concat()).expect_err("too little");
    let (_, rest) = said.split_once("the smallest that would do is ").expect("it says how much");
    let least_plain = rest.split(' ').next().expect("a number");
    succeeds(f, &[&plain[..], &["--memory", least_plain, "--stats", "p.json"]].concat());
    let number = |text: &str| text.parse::<f64>().expect("a number");
    let more = number(least) - number(least_plain);
    assert!(more > 320.0 * 260.0 / 4.0, "{more}");
    let peak = |file: &str| {
        let text = fs::read(f.join(file)).expect("statistics");
        serde_json::from_slice::<serde_json::Value>(&text).expect("JSON")["peak_rss_bytes"].as_f64()
    };
    if let (Some(drawing), Some(without)) = (peak("s.json"), peak("p.json")) {
        // The code that draws is not counted, and large if it is not optimised.
        let code = if cfg!(debug_assertions) { 512.0 * 1024.0 } else { 0.0 };
        assert!(drawing <= without + more + code, "{drawing} instead of {without}, for {more} more");
    }

    succeeds(f, &[&drawn[..], &["-o", "part.png", "--crop", "200,9,110,201"]].concat());
    let ((width, whole), (part_width, part)) = (picture(&f.join("whole.png")), picture(&f.join("part.png")));
    assert_eq!(part_width, 110);
    for (i, pixel) in part.iter().enumerate() {
        let (x, y) = (200 + i % 110, 9 + i / 110);
        assert_eq!(*pixel, whole[y * width + x], "at {x}, {y}");
    }
}

#[test]
fn what_cannot_be_annotated_is_refused_before_anything_is_written() {
    let folder = folder();
    let f = folder.path();
    wave(f);
    let said = rayset(f, &["render", "w.rset", "-o", "a.exr", "--annotate"]).expect_err("refused");
    assert!(said.contains("--annotate") && said.contains(".png"), "{said}");
    assert!(!f.join("a.exr").exists());
    let margin = ["--annotate", "--crop", "0,0,64,4"];
    let said = rayset(f, &[&HEIGHT[..], &margin, &["-o", "a.png"]].concat()).expect_err("refused");
    assert!(said.contains("--crop") && said.contains("margin") && !f.join("a.png").exists(), "{said}");
    let said = rayset(f, &["render", "w.rset", "-o", "a.png", "--caption", "x"]).expect_err("refused");
    assert!(said.contains("--annotate"), "{said}");
}

#[test]
fn pictures_of_every_size_and_of_scenes_can_be_annotated() {
    let folder = folder();
    let f = folder.path();
    let scene = r##"{"rayset": 1, "image": {"size": [40, 30]}, "background": "#ffffff",
        "root": {"type": "union", "children": [{"type": "sphere", "radius": 1, "color": {"type": "gradient",
        "from": [0, -1, 0], "to": [0, 1, 0], "color": "RdBu"}},
        {"type": "box", "size": [3, 0.2, 3], "transfers": [{"input": "red", "color": "ice", "valueRange": [0, 1]}]}]}}"##;
    fs::write(f.join("s.json"), scene).expect("a write");
    for size in ["1x1", "3x200", "200x3", "64x48", "300x200"] {
        succeeds(f, &["render", "s.json", "-o", "a.png", "--annotate", "--size", size, "--samples", "1"]);
        let caption = "a caption that is far too long for such a small picture, and goes on";
        succeeds(f, &["render", "s.json", "-o", "a.png", "--annotate", "--caption", caption, "--size", size]);
    }
    succeeds(f, &["render", "s.json", "-o", "t.png", "--annotate", "--turntable", "2", "--size", "64x48"]);
    let (first, second) = (picture(&f.join("t.0000.png")), picture(&f.join("t.0001.png")));
    assert!(first.1[64 * 30..] != second.1[64 * 30..], "the axes turn");
}

#[test]
fn annotations_have_a_margin_of_their_own_beside_the_picture() {
    let folder = folder();
    let f = folder.path();
    wave(f);
    // From so near that points fill all of the picture.
    let near = ["--position", "3.5,3.5,2.2", "--direction", "0,0,-1", "--up", "y", "--fovy", "60"];
    let plain = [&HEIGHT[..], &near].concat();
    succeeds(f, &[&plain[..], &["-o", "drawn.png", "--annotate"]].concat());
    let (width, drawn) = picture(&f.join("drawn.png"));
    assert_eq!((width, drawn.len()), (320, 320 * 260), "the sheet has the size that was asked for");
    // The picture is the largest opaque rectangle: its edges are where whole rows and columns begin
    // and end.
    let is_full = |x: usize, y: usize| drawn[y * width + x][3] > 240;
    let middle = (110, 120);
    let left = (0..middle.0).rev().find(|&x| !is_full(x, middle.1)).expect("a margin") + 1;
    let right = (middle.0..width).find(|&x| !is_full(x, middle.1)).expect("a margin");
    let top = (0..middle.1).rev().find(|&y| !is_full(middle.0, y)).expect("a margin") + 1;
    let bottom = (middle.1..260).find(|&y| !is_full(middle.0, y)).expect("a margin");
    assert!(right - left > 150 && bottom - top > 120, "{left} {right} {top} {bottom}");
    // What is in it is what the camera sees in a picture of that size, and nothing is drawn over
    // it.
    let size = format!("{}x{}", right - left, bottom - top);
    let at = plain.iter().position(|word| *word == "320x260").expect("a size");
    let mut same = plain.clone();
    same[at] = &size;
    succeeds(f, &[&same[..], &["-o", "same.png"]].concat());
    let (inner, pixels) = picture(&f.join("same.png"));
    assert_eq!(inner, right - left);
    for (i, pixel) in pixels.iter().enumerate() {
        let (x, y) = (left + i % inner, top + i / inner);
        assert_eq!(*pixel, drawn[y * width + x], "at {x}, {y}");
    }
    // Around it there are a caption, a bar and axes.
    let any = |xs: std::ops::Range<usize>, ys: std::ops::Range<usize>| {
        ys.clone().any(|y| xs.clone().any(|x| drawn[y * width + x][3] > 0))
    };
    assert!(any(0..160, 0..top) && any(right + 8..320, top..160) && any(right + 8..320, 180..260));
    // Parts that are merged make the same sheet.
    for part in ["1/2", "2/2"] {
        let name = format!("{}.part", &part[..1]);
        succeeds(f, &[&plain[..], &["-o", &name, "--annotate", "--part", part]].concat());
    }
    succeeds(f, &["merge", "1.part", "2.part", "-o", "merged.png"]);
    assert!(fs::read(f.join("merged.png")).ok() == fs::read(f.join("drawn.png")).ok(), "the sheets differ");
    // The scene that is kept makes the same sheet again.
    succeeds(
        f,
        &[&plain[..], &["-o", "x.png", "--annotate", "--caption", "c", "--write-scene", "s.json"]].concat(),
    );
    succeeds(f, &["render", "s.json", "-o", "y.png", "--annotate", "--caption", "c", "--samples", "1"]);
    assert!(fs::read(f.join("x.png")).ok() == fs::read(f.join("y.png")).ok(), "the sheets differ");
}
