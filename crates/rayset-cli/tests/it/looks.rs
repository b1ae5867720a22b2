//! Whatever is rendered without a scene: it is built into the cache, framed, and looks as the data
//! suggest.

use std::fs;
use std::io::Read;
use std::path::Path;

use crate::common::{folder, run, succeeds};

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

#[test]
fn a_level_set_is_a_solid_thing_in_the_middle_of_the_frame() {
    let folder = folder();
    let f = folder.path();
    let fixture = Path::new(env!("CARGO_MANIFEST_DIR")).join("../rayset/tests/fixtures/vdb/sphere.vdb.gz");
    let mut bytes = Vec::new();
    let file = fs::File::open(fixture).expect("a fixture");
    flate2::read::GzDecoder::new(file).read_to_end(&mut bytes).expect("it is whole");
    fs::write(f.join("sphere.vdb"), bytes).expect("a write");
    let arguments =
        ["render", "sphere.vdb", "-o", "s.png", "--size", "64x64", "--background", "none", "--no-cache"];
    let said = succeeds(f, &arguments);
    assert!(said.contains("look: volume (a level set, the surface where values are 0)"), "{said}");
    let (width, height, pixels) = picture(&f.join("s.png"));
    let alpha = |x: usize, y: usize| pixels[y * width + x][3];
    assert!(alpha(32, 32) > 240, "inside it is solid, {}", alpha(32, 32));
    // A ball: 9 of 10 of the shorter side, round, and nothing around it.
    let covered = |x: usize, y: usize| alpha(x, y) > 128;
    let row = (0..width).filter(|&x| covered(x, 32)).count();
    let column = (0..height).filter(|&y| covered(32, y)).count();
    assert!((52..=61).contains(&row) && row.abs_diff(column) <= 2, "{row} x {column}");
    let border =
        (0..width).flat_map(|i| [alpha(i, 0), alpha(i, height - 1), alpha(0, i), alpha(width - 1, i)]);
    assert_eq!(border.max(), Some(0));
    let area = (0..width * height).filter(|i| covered(i % width, i / width)).count() as f64;
    let round = std::f64::consts::FRAC_PI_4 * (row * column) as f64;
    assert!((area / round - 1.0).abs() < 0.06, "{area} pixels, where a disc has {round}");
}

/// An array of NumPy of 24 × 24 × 24 voxels: a ball of values from 0 to 1, and `mark` in the first
/// slices.
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

#[test]
fn a_folder_is_the_files_in_it_that_can_be_read_and_a_series_of_slices_is_one_thing() {
    let folder = folder();
    let f = folder.path();
    fs::create_dir_all(f.join("tiles")).expect("a folder");
    stair(f);
    fs::rename(f.join("stair.txt"), f.join("tiles/stair.txt")).expect("a move");
    for (name, text) in
        [("README.md", "# Words"), ("index.json", "{}"), ("license.txt", "No numbers.\n"), ("a.jpg", "\u{0}")]
    {
        fs::write(f.join("tiles").join(name), text).expect("a write");
    }
    let said = succeeds(f, &["render", "tiles", "-o", "a.png", "--size", "16x16", "--no-cache"]);
    assert!(said.contains("left out 4 of 5 files in tiles, the first being README.md"), "{said}");
    fs::create_dir_all(f.join("case/series")).expect("a folder");
    for name in ["1", "2"] {
        fs::write(f.join("case/series").join(name), [&[0; 128][..], b"DICM"].concat()).expect("a write");
    }
    fs::create_dir_all(f.join("a.zarr")).expect("a folder");
    fs::write(f.join("a.zarr/zarr.json"), "{\"zarr_format\": 3}").expect("a write");
    for (input, what) in [("case", "this is DICOM"), ("a.zarr", "this is Zarr")] {
        let output = run(f, &["render", input, "-o", "a.png"]);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!output.status.success() && said.contains(what), "{said}");
    }
}

#[test]
fn what_falls_falls_down() {
    let folder = folder();
    let f = folder.path();
    let up = |velocity: &dyn Fn(f64) -> [f64; 3]| {
        let some = |i: u32, step: f64| (f64::from(i) * step).fract();
        let line = |[x, y, z]: [f64; 3]| format!("{x} {y} {z}\n");
        let places: String = (0..500)
            .map(|i| [0.8191, 0.6711, 0.5498].map(|step| some(i, step)))
            .map(|[x, y, z]| line([x, y, 1.5 * z]))
            .collect();
        let velocities: String = (0..500).map(|i| line(velocity(some(i, 0.618) - 0.5))).collect();
        let head = "# vtk DataFile Version 3.0\nwords\nASCII\nDATASET POLYDATA\nPOINTS 500 float\n";
        let vectors = "POINT_DATA 500\nVECTORS velocity float\n";
        fs::write(f.join("a.vtk"), [head, &places, vectors, &velocities].concat()).expect("a write");
        let said = succeeds(f, &["render", "a.vtk", "-o", "a.png", "--size", "8x8", "--no-cache"]);
        said.lines().find(|line| line.starts_with("look: ")).unwrap_or_default().to_owned()
    };
    assert!(up(&|t| [t, t - 3.0, t]).contains("y up (particles that fall)"));
    assert!(up(&|t| [t, t, 2.0 * t - 5.0]).contains("z up (particles that fall)"));
    // A wind, a fountain, and a whirl.
    assert!(!up(&|t| [t + 3.0, t, t]).contains("fall"));
    assert!(!up(&|t| [t, 3.0 + t, t]).contains("fall"));
    assert!(!up(&|t| [t, -0.2, t]).contains("fall"));
}

#[test]
fn gas_shows_in_units_of_any_size() {
    let folder = folder();
    let f = folder.path();
    let some = |i: u32, step: f64| (f64::from(i) * step).fract();
    for unit in [1.0, 4e9, 2e-9] {
        let points: String = (0..2000)
            .map(|i| [0.8191, 0.6711, 0.5498].map(|step| unit * some(i, step)))
            .map(|[x, y, z]| format!("{x:e} {y:e} {z:e}\n"))
            .collect();
        fs::write(f.join("box.xyz"), points).expect("a write");
        let said = succeeds(
            f,
            &["render", "box.xyz", "-o", "a.png", "--size", "32x32", "--look", "gas", "--no-cache"],
        );
        assert!(!said.contains("empty") && !said.contains("black"), "{unit}: {said}");
        let (_, _, pixels) = picture(&f.join("a.png"));
        let lit = pixels.iter().filter(|pixel| pixel[0] > 40).count();
        assert!(lit > 200, "{unit}: {lit} pixels are lit");
    }
}

/// A file of points in a box of 100, thin everywhere, with dense clumps of a size about some
/// places, and others.
fn clumps(f: &Path, places: &[[f64; 3]], size: f64, others: &[[f64; 3]]) {
    clumps_of(f, places, size, 4000, others);
}

/// The same of so many thin points.
fn clumps_of(f: &Path, places: &[[f64; 3]], size: f64, count: u32, others: &[[f64; 3]]) {
    let some = |i: u32, step: f64| (f64::from(i) * step).fract();
    let thin = (0..count).map(|i| [0.819_172_5, 0.671_043_6, 0.549_700_5].map(|step| 100.0 * some(i, step)));
    let dense = places.iter().flat_map(|place| {
        (0..3 * count / 8).map(move |i| {
            let (turn, height) = (some(i, 0.618) * std::f64::consts::TAU, 2.0 * some(i, 0.7549) - 1.0);
            let (level, reach) = ((1.0 - height * height).sqrt(), size * some(i, 0.5698).powf(1.5));
            let toward = [level * turn.cos(), level * turn.sin(), height];
            [0, 1, 2].map(|axis| place[axis] + reach * toward[axis])
        })
    });
    let all = thin.chain(dense).chain(others.iter().copied());
    let lines: String = all.map(|[x, y, z]| format!("{x} {y} {z}\n")).collect();
    fs::write(f.join("gas.xyz"), lines).expect("a write");
}

#[test]
fn haloes_far_smaller_than_their_box_glow_in_it_whatever_the_radii_in_their_middles() {
    let folder = folder();
    let f = folder.path();
    let places = [[20.0, 30.0, 80.0], [70.0, 60.0, 20.0], [40.0, 80.0, 50.0]];
    let stray = [[3e4, 0.0, 0.0]];
    for (size, others) in [(0.2, &[][..]), (2.0, &[]), (2.0, &stray)] {
        clumps(f, &places, size, others);
        succeeds(
            f,
            &["render", "gas.xyz", "-o", "a.png", "--size", "360x240", "--look", "gas", "--no-cache"],
        );
        let (_, _, pixels) = picture(&f.join("a.png"));
        let mut reds: Vec<u8> = pixels.iter().map(|pixel| pixel[0]).collect();
        reds.sort_unstable();
        let (middle, brightest) = (reds[reds.len() / 2], reds[reds.len() - 4]);
        assert!(middle < 40 && brightest > 70, "{size} {others:?}: {middle}, {brightest}");
    }
}

/// The scene of a file as gas.
fn scene_of_gas(f: &Path, file: &str) -> serde_json::Value {
    let render = ["render", file, "-o", "a.png", "--size", "48x32", "--no-cache"];
    succeeds(f, &[&render[..], &["--look", "gas", "--write-scene", "s.json"]].concat());
    let scene = fs::read_to_string(f.join("s.json")).expect("a scene");
    serde_json::from_str(&scene).expect("JSON")
}

/// A cloud is sampled by its pages, and columns of a gas are counted along its axes.
#[test]
fn how_opaque_gas_is_depends_neither_on_pages_nor_on_axes() {
    let folder = folder();
    let f = folder.path();
    let build = |points: &str, file: &str, page: &str| {
        let build = ["build", points, "--precision", "exact", "--no-lod", "-o", file, "--page-size", page];
        succeeds(f, &build);
    };
    let places =
        [0, 1, 2, 3, 4, 5, 6, 7].map(|i| [50.0, 10.0 + 11.0 * f64::from(i), 90.0 - 9.0 * f64::from(i)]);
    clumps_of(f, &places, 3.0, 100_000, &[]);
    let unit = |file: &str| scene_of_gas(f, file)["rendering"]["unitDistance"].as_f64().expect("a number");
    build("gas.xyz", "small.rset", "16384");
    build("gas.xyz", "large.rset", "262144");
    let (small, large) = (unit("small.rset"), unit("large.rset"));
    // Of many pages a sample has a few, in which fewer of the places lie.
    assert!((0.85..1.3).contains(&(small / large)), "{small} with many pages, {large} with few");
    // A sheet, which covers much along one axis and little along the others.
    let some = |i: u32, step: f64| (f64::from(i) * step).fract();
    let sheet: Vec<[f64; 3]> = (0..200_000)
        .map(|i| {
            [48.0 + 4.0 * some(i, 0.819_172_5), 100.0 * some(i, 0.671_043_6), 100.0 * some(i, 0.549_700_5)]
        })
        .collect();
    clumps_of(f, &[], 0.0, 100_000, &sheet);
    let points = fs::read_to_string(f.join("gas.xyz")).expect("points");
    let faint = [[0, 1, 2], [1, 2, 0]].map(|order| {
        let turned: String = points
            .lines()
            .map(|line| line.split(' ').collect::<Vec<_>>())
            .map(|of| format!("{} {} {}\n", of[order[0]], of[order[1]], of[order[2]]))
            .collect();
        fs::write(f.join("turned.xyz"), turned).expect("a write");
        build("turned.xyz", "turned.rset", "262144");
        let scene = scene_of_gas(f, "turned.rset");
        scene["root"]["transferFunction"]["opacity"][16][1].as_f64().expect("a number")
    });
    assert!((faint[0] / faint[1] - 1.0).abs() < 0.05, "{faint:?} along two axes");
}

#[test]
fn thin_gas_about_a_dense_middle_is_left_out_of_the_frame_but_not_a_box_in_which_clumps_are_everywhere() {
    let folder = folder();
    let f = folder.path();
    let corners = [[5.0, 5.0, 5.0], [95.0, 95.0, 95.0], [5.0, 95.0, 50.0], [95.0, 5.0, 50.0]];
    let far_from_middle = |places: &[[f64; 3]]| {
        clumps(f, places, 3.0, &[]);
        let scene = scene_of_gas(f, "gas.xyz");
        let of = |axis: usize| scene["camera"]["position"][axis].as_f64().expect("a number") - 50.0;
        of(0).hypot(of(1)).hypot(of(2))
    };
    let (close, far) = (far_from_middle(&[[50.0; 3]]), far_from_middle(&corners));
    // The box of 100 has to fit into a view of 35 degrees.
    assert!(far > 200.0 && close < 0.5 * far, "{close}, {far}");
}

#[test]
fn a_few_points_far_apart_are_seen() {
    let folder = folder();
    let f = folder.path();
    let place = |i: u32, step: f64| (f64::from(i) * step).fract() * 1000.0;
    let points: String = (0..40)
        .map(|i| format!("{} {} {} 0.01\n", place(i, 0.8191), place(i, 0.6711), place(i, 0.5498)))
        .collect();
    fs::write(f.join("few.xyz"), format!("x y z radius\n{points}")).expect("a write");
    for look in [&[][..], &["--look", "gas"]] {
        let arguments = ["render", "few.xyz", "-o", "a.png", "--size", "128x128", "--no-cache"];
        let said = succeeds(f, &[&arguments, look].concat());
        assert!(said.contains("--radius-scale"), "{said}");
        let (_, _, pixels) = picture(&f.join("a.png"));
        let background = pixels[0];
        let lit =
            pixels.iter().filter(|pixel| pixel[..3].iter().zip(background).any(|(a, b)| a.abs_diff(b) > 8));
        assert!(lit.count() > 100, "{look:?}");
        // As stored, if that is what is asked for.
        let stored = succeeds(f, &[&arguments, look, &["--radius-scale", "1"]].concat());
        assert!(!stored.contains("few points"), "{stored}");
    }
}

#[test]
fn inputs_of_different_reference_systems_are_remarked_upon() {
    let folder = folder();
    let f = folder.path();
    // Degrees on both sides of the border between the zones 32 and 33.
    for (name, east) in [("a.csv", 11.9), ("b.csv", 12.1), ("c.csv", 11.8)] {
        let rows: String =
            (0..40).map(|i| format!("{},{},{i}\n", east + 1e-5 * f64::from(i), 48.0)).collect();
        fs::write(f.join(name), format!("lon,lat,alt\n{rows}")).expect("a write");
    }
    let said = succeeds(f, &["build", "a.csv", "b.csv", "-o", "ab.rset"]);
    assert!(said.contains("2 reference systems, EPSG:32632 and EPSG:32633 among them"), "{said}");
    let said = succeeds(f, &["build", "a.csv", "c.csv", "-o", "ac.rset"]);
    assert!(!said.contains("reference systems"), "{said}");
}

#[test]
fn splats_of_which_one_is_astray_are_shown_with_few_samples() {
    let folder = folder();
    let f = folder.path();
    let names = ["f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2"];
    let more: String = names.iter().map(|name| format!("property float {name}\n")).collect();
    let splat = |place: [f64; 3]| format!("{} {} {} 0.5 0 0 2 -3 -3 -3", place[0], place[1], place[2]);
    for (far, most) in [(1.0, 1e6), (1e6, 1e6), (1e12, 1e6)] {
        let close = (0..40).map(|i| [f64::from(i % 4), f64::from(i / 4 % 3), f64::from(i / 12)]);
        ply(&f.join("s.ply"), &more, close.chain([[far, 0.0, 0.0]]).map(splat));
        let said = succeeds(f, &["render", "s.ply", "-o", "s.png", "--size", "32x32", "--stats", "s.json"]);
        assert!(said.contains("look: splats"), "{said}");
        let told = fs::read_to_string(f.join("s.json")).expect("statistics");
        let told: serde_json::Value = serde_json::from_str(&told).expect("JSON");
        let evaluations = told["kernel_evaluations"].as_f64().expect("a number");
        assert!(evaluations < most, "{far}: {evaluations}");
    }
}

#[test]
fn a_folder_of_levels_of_detail_is_read_once_at_its_finest() {
    let folder = folder();
    let f = folder.path();
    fs::create_dir(f.join("in")).expect("a folder");
    let bundle = Path::new(env!("CARGO_MANIFEST_DIR")).join("../rayset/tests/fixtures/splats/bundle.sog");
    for name in ["coarse.sog", "fine.sog"] {
        fs::copy(&bundle, f.join("in").join(name)).expect("a copy");
    }
    let levels = r#"{"lodLevels": 2, "filenames": ["coarse.sog", "fine.sog"], "tree": {"lods":
        {"0": {"file": 1, "offset": 0, "count": 30}, "1": {"file": 0, "offset": 0, "count": 10}}}}"#;
    fs::write(f.join("in/lod-meta.json"), levels).expect("a write");
    succeeds(f, &["build", "in", "-o", "levels.rset"]);
    let told = run(f, &["info", "levels.rset", "--json"]).stdout;
    let told: serde_json::Value = serde_json::from_slice(&told).expect("JSON");
    assert_eq!(told["points"], 30, "{told}");
}

#[test]
fn json_of_others_is_no_scene() {
    let folder = folder();
    for (name, what) in
        [("a.gltf", "a scene or a mesh for renderers"), ("tileset.json", "3D Tiles"), ("a.geojson", "a map")]
    {
        fs::write(folder.path().join(name), "{\"asset\": {}}").expect("a write");
        let output = run(folder.path(), &["render", name, "-o", "a.png"]);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!output.status.success() && said.contains(what), "{said}");
    }
}

/// A PLY in text of points with some more properties.
fn ply(path: &Path, more: &str, points: impl Iterator<Item = String>) {
    let points: Vec<String> = points.collect();
    let text = format!(
        "ply\nformat ascii 1.0\ncomment made up\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n\
         {more}end_header\n{}\n",
        points.len(),
        points.join("\n")
    );
    fs::write(path, text).expect("a write");
}

/// The comment in a file of OpenEXR.
fn comment_of(path: &Path) -> Option<String> {
    let meta = exr::meta::MetaData::read_from_file(path, false).expect("a picture");
    meta.headers[0].own_attributes.comments.as_ref().map(ToString::to_string)
}

#[test]
fn pictures_of_linear_light_say_if_they_were_composited_in_display_values() {
    let folder = folder();
    let f = folder.path();
    let bundle = Path::new(env!("CARGO_MANIFEST_DIR")).join("../rayset/tests/fixtures/splats/bundle.sog");
    let bundle = bundle.to_str().expect("a name");
    let render = |output: &str, more: &[&str]| {
        succeeds(f, &[&["render", bundle, "-o", output, "--size", "40x40"][..], more].concat())
    };
    render("whole.exr", &[]);
    render("linear.exr", &["--compositing", "linear"]);
    render("1.part", &["--part", "1/2", "--layers"]);
    render("2.part", &["--part", "2/2", "--layers"]);
    succeeds(f, &["merge", "1.part", "2.part", "-o", "merged.exr"]);
    assert_eq!(comment_of(&f.join("linear.exr")), None);
    let comment = comment_of(&f.join("whole.exr")).expect("a comment");
    assert!(comment.starts_with("composited in display values (sRGB)"), "{comment}");
    assert_eq!(comment_of(&f.join("merged.exr")).as_ref(), Some(&comment));
    assert_eq!(fs::read(f.join("merged.exr")).ok(), fs::read(f.join("whole.exr")).ok());
}

/// Points on the sides of a box.
fn sides([a, b, c]: [f64; 3]) -> impl Iterator<Item = [f64; 3]> {
    (0..6 * 400).map(move |i| {
        let (side, u, v) = (i % 6, f64::from(i / 6 % 20) / 19.0, f64::from(i / 120) / 19.0);
        let end = f64::from(side % 2);
        let [x, y, z] = match side / 2 {
            0 => [u, v, end],
            1 => [u, end, v],
            _ => [end, u, v],
        };
        [a * x, b * y, c * z]
    })
}

#[test]
fn what_is_up_in_a_ply_follows_from_its_extent_columns_and_place() {
    let folder = folder();
    let f = folder.path();
    let gray = "property uchar red\nproperty uchar green\nproperty uchar blue\n";
    let up = |more: &str, size: [f64; 3], from: [f64; 3]| {
        let shift = |[x, y, z]: [f64; 3]| {
            let color = if more.is_empty() { "" } else { " 120 130 140" };
            format!("{} {} {}{color}", x + from[0], y + from[1], z + from[2])
        };
        ply(&f.join("a.ply"), more, sides(size).map(shift));
        let said = succeeds(f, &["render", "a.ply", "-o", "a.png", "--size", "8x8", "--no-cache"]);
        said.split(" up (").next().and_then(|start| start.rsplit(' ').next()).unwrap_or("none").to_owned()
    };
    let near = [-1.0, -1.0, -1.0];
    // A room, a person, a street, a thing without colours, a block on a map.
    assert_eq!(up(gray, [6.0, 5.0, 2.7], near), "z");
    assert_eq!(up(gray, [0.8, 1.8, 0.33], near), "y");
    assert_eq!(up("", [80.0, 90.0, 9.0], near), "z");
    assert_eq!(up("", [6.0, 5.0, 4.7], near), "y");
    assert_eq!(up("", [60.0, 50.0, 40.0], [5e5, 5e6, 100.0]), "z");
}

#[test]
fn what_is_far_from_the_origin_is_in_no_cameras_frame_unless_it_is_around_its_axis() {
    let folder = folder();
    let f = folder.path();
    let up = |from: [f64; 3]| {
        let text: String = sides([4.0, 5.0, 4.5])
            .map(|[x, y, z]| format!("{} {} {}\n", x + from[0], y + from[1], z + from[2]))
            .collect();
        fs::write(f.join("a.xyz"), text).expect("a write");
        succeeds(f, &["render", "a.xyz", "-o", "a.png", "--size", "8x8", "--no-cache"])
    };
    let said = up([300.0, 300.0, 300.0]);
    assert!(said.contains("z up (the custom of such files)"), "{said}");
    let said = up([-2.0, -2.0, 3.0]);
    assert!(said.contains("-y up (a camera's own axes)"), "{said}");
}

#[test]
fn intensities_that_are_all_the_same_are_not_shown() {
    let folder = folder();
    let f = folder.path();
    for (intensity, look) in [("0", "surface ("), ("7", "surface ("), ("", "intensity (")] {
        let points: Vec<String> = sides([6.0, 5.0, 4.0])
            .enumerate()
            .map(|(i, [x, y, z])| {
                let own = (i % 50).to_string();
                format!("{x} {y} {z} {}", if intensity.is_empty() { &own } else { intensity })
            })
            .collect();
        fs::write(f.join("a.pts"), format!("{}\n{}\n", points.len(), points.join("\n"))).expect("a write");
        let said = succeeds(f, &["render", "a.pts", "-o", "a.png", "--size", "8x8", "--no-cache"]);
        assert!(said.contains(&format!("look: {look}")), "{intensity}: {said}");
    }
}

#[test]
fn crowds_in_a_box_that_has_points_everywhere_are_no_surface() {
    let folder = folder();
    let f = folder.path();
    // A part all over the box, and the rest on the surfaces of small balls, as crowded as halos.
    let some = |i: u32, step: f64| (f64::from(i) * step).fract();
    let spread = (0..6000).map(|i| [0.8191, 0.6711, 0.5498].map(|step| 100.0 * some(i, step)));
    let crowds = (0..12000).map(|i| {
        let center = [0.381, 0.733, 0.157].map(|step| 100.0 * some(i % 60, step));
        let (turn, z) = (std::f64::consts::TAU * some(i, 0.618), 2.0 * some(i, 0.7548) - 1.0);
        let flat = (1.0 - z * z).sqrt();
        [center[0] + 0.5 * flat * turn.cos(), center[1] + 0.5 * flat * turn.sin(), center[2] + 0.5 * z]
    });
    let text: String = spread.chain(crowds).map(|[x, y, z]| format!("{x} {y} {z}\n")).collect();
    fs::write(f.join("box.xyz"), text).expect("a write");
    let said = succeeds(f, &["render", "box.xyz", "-o", "a.png", "--size", "8x8", "--no-cache"]);
    assert!(said.contains("look: gas (points that fill a volume)"), "{said}");
}

#[test]
fn a_few_returns_from_far_away_do_not_make_the_rest_of_a_scan_small() {
    let folder = folder();
    let f = folder.path();
    // A disc of points, and one in twenty along a line of twelve times its radius.
    let mut text = String::new();
    for i in 0..20_000_u32 {
        let turn = f64::from(i) * 2.399_963;
        let reach =
            if i % 20 == 0 { 12.0 * f64::from(i) / 20_000.0 } else { (f64::from(i) / 20_000.0).sqrt() };
        let turn = if i % 20 == 0 { 0.3 } else { turn };
        text += &format!("{} {} 0\n", 10.0 * reach * turn.cos(), 10.0 * reach * turn.sin());
    }
    fs::write(f.join("scan.xyz"), text).expect("a write");
    succeeds(f, &["render", "scan.xyz", "-o", "a.png", "--size", "64x64", "--view", "top", "--no-cache"]);
    let (width, _, pixels) = picture(&f.join("a.png"));
    let backdrop = pixels[0];
    let seen = pixels.iter().filter(|&&pixel| pixel != backdrop).count();
    assert!(seen > width * width / 8, "{seen} pixels");
}

/// A sheet of points in dark colours.
fn dark_sheet(path: &Path) {
    let mut text = "x y z r g b\n".to_owned();
    for i in 0..3600 {
        let shade = 8 + i % 40;
        text += &format!("{} {} {} {shade} {} {shade}\n", i % 60, i / 60, i % 3, shade + 4);
    }
    fs::write(path, text).expect("a write");
}

#[test]
fn a_written_scene_has_the_samples_and_the_exposure_of_its_picture() {
    let folder = folder();
    let f = folder.path();
    dark_sheet(&f.join("dark.txt"));
    stair(f);
    fs::write(f.join("v.raw"), (0..4096).map(|i| (i / 16) as u8).collect::<Vec<_>>()).expect("a write");
    let header =
        "NDims = 3\nDimSize = 16 16 16\nElementType = MET_UCHAR\nElementDataFile = v.raw\n".to_owned();
    fs::write(f.join("v.mhd"), header).expect("a write");
    for input in ["dark.txt", "stair.txt", "v.mhd"] {
        for options in
            [&[][..], &["--samples", "3"], &["--exposure", "1.5"], &["--exposure=-2", "--samples=1"]]
        {
            let render = ["render", input, "-o", "a.png", "--size", "24x24", "--write-scene", "s.json"];
            succeeds(f, &[&render[..], options].concat());
            succeeds(f, &["render", "s.json", "-o", "b.png"]);
            let read = |name: &str| fs::read(f.join(name)).expect("a picture");
            assert!(read("a.png") == read("b.png"), "{input} {options:?}");
        }
    }
}

#[test]
fn the_background_is_its_colour_under_any_exposure_and_dark_points_alone_are_made_brighter() {
    let folder = folder();
    let f = folder.path();
    dark_sheet(&f.join("dark.txt"));
    let render = |options: &[&str]| {
        let plain = ["render", "dark.txt", "-o", "a.png", "--size", "32x32", "--view", "top"];
        let said = succeeds(f, &[&plain[..], options].concat());
        let (width, height, pixels) = picture(&f.join("a.png"));
        (said, pixels[0], pixels[height / 2 * width + width / 2])
    };
    let (said, corner, middle) = render(&[]);
    assert!(said.contains("made brighter by") && middle[1] > 60, "{said}{middle:?}");
    let backdrop = [0x26, 0x2a, 0x31, 255];
    assert_eq!(corner, backdrop);
    let (said, corner, middle) = render(&["--exposure", "0"]);
    assert!(!said.contains("made brighter by") && middle[1] < 60, "{said}{middle:?}");
    assert_eq!(corner, backdrop);
    assert_eq!(render(&["--exposure", "2"]).1, backdrop);
    assert_eq!(render(&["--background", "#804020"]).1, [0x80, 0x40, 0x20, 255]);
    // Another colour is not brighter than it is.
    for option in ["--color=#606060", "--color-by=z"] {
        let (said, corner, middle) = render(&[option]);
        assert!(!said.contains("made brighter by") && middle[..3] != [255; 3], "{option}: {said}{middle:?}");
        assert_eq!(corner, backdrop, "{option}");
    }
}
