//! Whatever is rendered without a scene: it is built into the cache, framed, and looks as the data suggest.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use crate::common::folder;

fn run(folder: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_rayset"));
    command.current_dir(folder).env("XDG_CACHE_HOME", folder.join("home"));
    command.args(arguments).output().expect("the program runs")
}

/// What is said on standard error.
fn succeeds(folder: &Path, arguments: &[&str]) -> String {
    let output = run(folder, arguments);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{arguments:?}: {said}");
    said
}

/// A picture's width, height and pixels.
fn picture(path: &Path) -> (usize, usize, Vec<[u8; 4]>) {
    let file = std::io::BufReader::new(fs::File::open(path).expect("the picture"));
    let mut reader = png::Decoder::new(file).read_info().expect("a PNG");
    let mut bytes = vec![0; reader.output_buffer_size().expect("a size")];
    let info = reader.next_frame(&mut bytes).expect("a picture");
    let pixels = bytes.chunks_exact(4).map(|p| [p[0], p[1], p[2], p[3]]).collect();
    (info.width as usize, info.height as usize, pixels)
}

/// A table of points on two steps of a stair, with classes 2 and 6.
fn stair(folder: &Path) {
    let mut text = "x y z classification\n".to_owned();
    for i in 0..60 {
        for j in 0..60 {
            let (x, y) = (f64::from(i) * 0.1 + 500.0, f64::from(j) * 0.1 + 900.0);
            let (z, class) = if i < 30 { (10.0, 2) } else { (10.6, 6) };
            text += &format!("{x} {y} {z} {class}\n");
        }
    }
    fs::write(folder.join("stair.txt"), text).expect("a write");
}

#[test]
fn points_that_were_not_built_are_built_once_into_the_cache_and_said_to_be() {
    let folder = folder();
    let f = folder.path();
    stair(f);
    let arguments = ["render", "stair.txt", "-o", "a.png", "--size", "48x48", "--threads", "1"];
    let first = succeeds(f, &arguments);
    assert!(first.contains("built ") && first.contains("used again until the input changes"), "{first}");
    let kept = || fs::read_dir(f.join("home/rayset")).expect("the cache").count();
    assert_eq!(kept(), 1);
    let before = fs::read(f.join("a.png")).expect("a picture");
    let second = succeeds(f, &arguments);
    assert!(second.contains("built before"), "{second}");
    assert_eq!(fs::read(f.join("a.png")).expect("a picture"), before);
    // Nothing is kept where nothing shall be, and the picture is the same.
    let third = succeeds(f, &[&arguments[..], &["--no-cache"]].concat());
    assert!(third.contains("nothing is kept") && kept() == 1, "{third}");
    assert_eq!(fs::read(f.join("a.png")).expect("a picture"), before);
    // Another input of the same name is built anew.
    let text = fs::read_to_string(f.join("stair.txt")).expect("it reads");
    fs::write(f.join("stair.txt"), text.replace(" 6\n", " 5\n")).expect("a write");
    assert!(succeeds(f, &arguments).contains("used again until"));
    assert_eq!(kept(), 2);
    let described = run(f, &["info", "stair.txt"]);
    assert!(String::from_utf8_lossy(&described.stdout).contains("3 600"));
}

#[test]
fn a_full_cache_gives_up_what_was_not_used_for_longest() {
    let folder = folder();
    let f = folder.path();
    stair(f);
    let render = |extra: &[&str]| {
        let plain = ["render", "stair.txt", "-o", "a.png", "--size", "8x8", "--cache", "kept"];
        succeeds(f, &[&plain[..], extra].concat())
    };
    fs::create_dir(f.join("kept")).expect("a folder");
    fs::write(f.join("kept/someone-else.rset"), [0; 1000]).expect("a write");
    render(&[]);
    let text = fs::read_to_string(f.join("stair.txt")).expect("it reads");
    fs::write(f.join("stair.txt"), format!("{text}500 900 12 2\n")).expect("a write");
    let said = render(&["--cache-limit", "1KiB"]);
    assert!(said.contains("removed 1 older"), "{said}");
    let left = fs::read_dir(f.join("kept")).expect("the cache").count();
    assert_eq!(left, 2, "the newest stays, and what is not the cache's own");
}

#[test]
fn folders_patterns_and_lists_are_one_cloud() {
    let folder = folder();
    let f = folder.path();
    fs::create_dir(f.join("tiles")).expect("a folder");
    for i in 0..3 {
        let text: String =
            (0..40).map(|j| format!("{} {} 0\n", f64::from(i) + 0.01 * f64::from(j), j % 7)).collect();
        fs::write(f.join(format!("tiles/{i}.xyz")), text).expect("a write");
    }
    fs::write(f.join("tiles/.hidden"), "no points").expect("a write");
    let points = |inputs: &[&str]| {
        let output = run(f, &[&["info", "--json", "--no-cache"], inputs].concat());
        let report: serde_json::Value = serde_json::from_slice(&output.stdout).expect("a report");
        (report["points"].as_u64(), report["identity"].clone())
    };
    let listed = points(&["tiles/0.xyz", "tiles/1.xyz", "tiles/2.xyz"]);
    assert_eq!(listed.0, Some(120));
    assert_eq!(points(&["tiles"]), listed);
    assert_eq!(points(&["tiles/*.xyz"]), listed);
}

#[test]
fn a_look_is_a_scene_that_renders_to_the_same_picture_and_to_parts_of_it() {
    let folder = folder();
    let f = folder.path();
    stair(f);
    succeeds(f, &["build", "stair.txt", "-o", "c.rset"]);
    let said = succeeds(
        f,
        &[
            "render",
            "c.rset",
            "-o",
            "a.png",
            "--size",
            "64x48",
            "--write-scene",
            "s.json",
            "--background",
            "none",
        ],
    );
    assert!(said.starts_with("look: classes (classified points)") && said.contains("z up"), "{said}");
    succeeds(f, &["render", "s.json", "-o", "b.png"]);
    assert_eq!(fs::read(f.join("a.png")).expect("a picture"), fs::read(f.join("b.png")).expect("a picture"));
    succeeds(
        f,
        &[
            "render",
            "c.rset",
            "-o",
            "c.png",
            "--size",
            "64x48",
            "--crop",
            "20,10,30,25",
            "--background",
            "none",
        ],
    );
    let (whole, part) = (picture(&f.join("a.png")), picture(&f.join("c.png")));
    assert_eq!((part.0, part.1), (30, 25));
    for y in 0..25 {
        for x in 0..30 {
            assert_eq!(part.2[y * 30 + x], whole.2[(y + 10) * 64 + x + 20], "at {x}, {y}");
        }
    }
}

#[test]
fn what_is_seen_fills_most_of_the_frame_from_every_side() {
    let folder = folder();
    let f = folder.path();
    stair(f);
    succeeds(f, &["build", "stair.txt", "-o", "c.rset"]);
    for view in ["front", "back", "left", "right", "top", "bottom", "iso"] {
        for more in [&[][..], &["--orthographic"], &["--up", "-y"]] {
            let plain = [
                "render",
                "c.rset",
                "-o",
                "v.png",
                "--size",
                "96x64",
                "--background",
                "none",
                "--view",
                view,
            ];
            succeeds(f, &[&plain[..], more].concat());
            let (width, height, pixels) = picture(&f.join("v.png"));
            let covered = |at: usize| pixels[at][3] > 64;
            let columns: Vec<usize> =
                (0..width).filter(|&x| (0..height).any(|y| covered(y * width + x))).collect();
            let rows: Vec<usize> =
                (0..height).filter(|&y| (0..width).any(|x| covered(y * width + x))).collect();
            let share =
                |found: &[usize], of: usize| (found[found.len() - 1] - found[0] + 1) as f64 / of as f64;
            let largest = share(&columns, width).max(share(&rows, height));
            assert!((0.8..=0.99).contains(&largest), "{view} {more:?}: {largest}");
            // As much is left free on one side as on the other.
            let middle = 0.5 * (rows[0] + rows[rows.len() - 1] + 1) as f64 / height as f64;
            assert!((0.42..0.58).contains(&middle), "{view} {more:?}: {middle}");
        }
    }
}

#[test]
fn colours_that_are_all_black_are_none_and_dark_ones_are_made_brighter() {
    let folder = folder();
    let f = folder.path();
    let table = |name: &str, color: u32| {
        let mut text = "x,y,z,red,green,blue\n".to_owned();
        for i in 0..2000_u32 {
            let (x, y) = (f64::from(i % 50), f64::from(i / 50));
            text += &format!("{x},{y},{},{color},{color},{}\n", (x * 0.2).sin(), color / 2);
        }
        // Files of bytes; one bright point keeps them from being taken for numbers from 0 to 1.
        fs::write(f.join(name), text).expect("a write");
    };
    table("black.csv", 0);
    table("dark.csv", 30);
    table("light.csv", 220);
    let look = |name: &str| {
        let said = succeeds(f, &["render", name, "-o", "x.png", "--size", "32x32", "--no-cache"]);
        let (_, _, pixels) = picture(&f.join("x.png"));
        let brightest = pixels.iter().map(|p| p[0].max(p[1]).max(p[2])).max().unwrap_or(0);
        (said, brightest)
    };
    let (black, dark, light) = (look("black.csv"), look("dark.csv"), look("light.csv"));
    assert!(!black.0.contains("points' colours") && black.1 > 90, "{} {}", black.0, black.1);
    assert!(dark.0.contains("made brighter") && dark.1 > 90, "{} {}", dark.0, dark.1);
    assert!(light.0.contains("points' colours") && !light.0.contains("brighter"), "{}", light.0);
}

#[test]
fn a_volume_is_rendered_by_itself_without_its_background() {
    let folder = folder();
    let f = folder.path();
    let voxels: Vec<u8> = (0..32 * 32 * 32_i32)
        .map(|i| {
            let [x, y, z] = [i % 32 - 16, i / 32 % 32 - 16, i / 1024 - 16];
            let distance = x * x + y * y + z * z;
            if distance < 100 { (220 - distance) as u8 } else { 12 }
        })
        .collect();
    fs::write(f.join("v.raw"), voxels).expect("a write");
    succeeds(f, &["build", "v.raw", "--raw", "32x32x32,u8", "-o", "g.rset"]);
    let said = succeeds(f, &["render", "g.rset", "-o", "g.png", "--size", "48x48", "--background", "none"]);
    assert!(said.starts_with("look: volume"), "{said}");
    let (width, _, pixels) = picture(&f.join("g.png"));
    assert!(pixels[24 * width + 24][3] > 100, "the ball shows");
    assert_eq!(pixels[0][3], 0, "the background does not");
}

/// An array of NumPy of 24 × 24 × 24 voxels: a ball of values from 0 to 1, and `mark` in the first slices.
fn marked_volume(path: &Path, mark: f32) {
    let mut bytes = b"\x93NUMPY\x01\x00\x76\x00".to_vec();
    let header = "{'descr': '<f4', 'fortran_order': False, 'shape': (24, 24, 24), }";
    bytes.extend(format!("{header:117}\n").bytes());
    for i in 0..24 * 24 * 24 {
        let [z, y, x] = [i / 576, i / 24 % 24, i % 24].map(|v| v as f32 - 11.5);
        let value = (1.0 - (x * x + y * y + z * z).sqrt() / 10.0).max(0.0);
        bytes.extend(if i / 576 < 4 { mark } else { value }.to_le_bytes());
    }
    fs::write(path, bytes).expect("a write");
}

#[test]
fn numbers_that_mark_places_without_a_value_do_not_choose_the_look_of_a_volume_and_are_not_seen() {
    let folder = folder();
    let f = folder.path();
    let render = |mark: f32| {
        marked_volume(&f.join("v.npy"), mark);
        let said = succeeds(f, &["render", "v.npy", "-o", "v.png", "--size", "48x48", "--no-cache"]);
        let look = said.lines().find(|line| line.starts_with("look: ")).unwrap_or_default().to_owned();
        (look, picture(&f.join("v.png")).2)
    };
    let (plain_look, plain) = render(0.0);
    for mark in [9.969_21e36, 1e20, -1e20] {
        let (look, pixels) = render(mark);
        let word = |look: &str| look.split(';').next().unwrap_or_default().to_owned();
        assert!(word(&look).starts_with("look: volume (values above 0."), "{look}, {plain_look}");
        // The corners are as dark as without marks, and the ball is there.
        let sum = |pixels: &[[u8; 4]]| pixels.iter().map(|p| u64::from(p[0])).sum::<u64>();
        let background = pixels.iter().filter(|p| **p == plain[0]).count();
        assert!(background * 4 > pixels.len(), "{background} pixels of background with {mark}");
        assert!(sum(&pixels) > pixels.len() as u64 * u64::from(plain[0][0]) * 3 / 2, "no ball with {mark}");
    }
}

#[test]
fn points_as_a_depth_camera_sees_them_have_y_down() {
    let folder = folder();
    let f = folder.path();
    let pcd = |offset: f64| {
        let mut text = "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n".to_owned();
        text += "WIDTH 900\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 900\nDATA ascii\n";
        for i in 0..900 {
            let (x, y) = (f64::from(i % 30) / 15.0 - 1.0, f64::from(i / 30) / 15.0 - 1.0);
            text += &format!("{x} {y} {}\n", offset + x * x + y);
        }
        fs::write(f.join("p.pcd"), text).expect("a write");
        succeeds(f, &["render", "p.pcd", "-o", "p.png", "--size", "16x16", "--no-cache"])
    };
    let said = pcd(3.0);
    assert!(said.contains("-y up (a camera's own axes)"), "{said}");
    // Around the origin no camera has seen them.
    let said = pcd(0.0);
    assert!(!said.contains("-y up") && !said.contains("a camera's"), "{said}");
}
