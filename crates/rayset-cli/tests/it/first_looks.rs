//! What is seen at first: which way up a thing stands, from which side it is seen, what it is
//! coloured by, and how bright.

use std::fs;
use std::path::Path;

use serde_json::Value;

use crate::common::{Random, folder, program};

fn rayset(folder: &Path, arguments: &[&str]) -> (String, String) {
    let mut command = program();
    command.current_dir(folder).env("XDG_CACHE_HOME", folder.join("home")).args(arguments);
    let output = command.output().expect("the program runs");
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{arguments:?}: {said}");
    (String::from_utf8_lossy(&output.stdout).into_owned(), said)
}

/// What `info` says of a file.
fn info(folder: &Path, file: &str) -> Value {
    let (said, _) = rayset(folder, &["info", "--json", "--no-cache", file]);
    serde_json::from_str(&said).expect("JSON")
}

/// The pixels of a picture of a file.
fn pixels(folder: &Path, file: &str, more: &[&str]) -> (usize, Vec<[u8; 4]>) {
    let plain = ["render", file, "-o", "p.png", "--size", "64x64", "--no-cache"];
    rayset(folder, &[&plain[..], more].concat());
    let reader = std::io::BufReader::new(fs::File::open(folder.join("p.png")).expect("the picture"));
    let mut reader = png::Decoder::new(reader).read_info().expect("a PNG");
    let mut bytes = vec![0; reader.output_buffer_size().expect("a size")];
    let info = reader.next_frame(&mut bytes).expect("a picture");
    (info.width as usize, bytes.as_chunks().0.to_vec())
}

/// A PLY file of vertices without anything else.
fn ply(path: &Path, points: &[[f64; 3]]) {
    let mut text = format!("ply\nformat ascii 1.0\nelement vertex {}\n", points.len());
    text += "property double x\nproperty double y\nproperty double z\nend_header\n";
    points.iter().for_each(|[x, y, z]| text += &format!("{x} {y} {z}\n"));
    fs::write(path, text).expect("a write");
}

/// Points on an ellipsoid.
fn ellipsoid(random: &mut Random, count: usize, middle: [f64; 3], half: [f64; 3]) -> Vec<[f64; 3]> {
    let mut point = || loop {
        let p: [f64; 3] = std::array::from_fn(|_| 2.0 * random.unit() - 1.0);
        let length = p.iter().map(|v| v * v).sum::<f64>().sqrt();
        if (0.1..1.0).contains(&length) {
            return std::array::from_fn(|i| middle[i] + half[i] * p[i] / length);
        }
    };
    (0..count).map(|_| point()).collect()
}

/// An animal on four legs, as long as y, with z up, a tenth of a unit large.
fn animal() -> Vec<[f64; 3]> {
    let mut random = Random(7);
    let mut points = ellipsoid(&mut random, 6000, [0.0, 0.0, 0.11], [0.03, 0.075, 0.032]);
    for (x, y) in [(-0.02, -0.05), (0.02, -0.05), (-0.02, 0.05), (0.02, 0.05)] {
        for i in 0..900 {
            let (turn, z) = (f64::from(i) * 2.399_963, f64::from(i) / 900.0 * 0.1);
            points.push([x + 0.008 * turn.cos(), y + 0.008 * turn.sin(), z]);
        }
    }
    // Neck and head.
    points.extend(ellipsoid(&mut random, 1500, [0.0, 0.085, 0.14], [0.015, 0.02, 0.035]));
    points
}

#[test]
fn an_animal_stands_on_its_feet_and_things_whose_feet_say_nothing_have_y_up() {
    let folder = folder();
    let f = folder.path();
    ply(&f.join("animal.ply"), &animal());
    let found = info(f, "animal.ply");
    assert!(found["up"] == "z", "{} {}", found["up"], found["up_reason"]);
    // The same with y up stays so, and a ball has no feet.
    let turned: Vec<[f64; 3]> = animal().into_iter().map(|[x, y, z]| [x, z, -y]).collect();
    ply(&f.join("turned.ply"), &turned);
    assert_eq!(info(f, "turned.ply")["up"], "y");
    ply(&f.join("ball.ply"), &ellipsoid(&mut Random(3), 5000, [0.0; 3], [0.1; 3]));
    assert_eq!(info(f, "ball.ply")["up"], "y");
}

#[test]
fn the_front_of_a_thing_is_the_side_with_its_details() {
    let folder = folder();
    let f = folder.path();
    // A slab that stands along z, smooth on one side, with folds on the other.
    let slab = |front: f64| -> Vec<[f64; 3]> {
        let grid = (0..160).flat_map(|i| (0..80).map(move |j| (f64::from(i) / 160.0, f64::from(j) / 160.0)));
        grid.flat_map(|(z, x)| {
            let fold = 0.03 * ((40.0 * x).sin() * (33.0 * z).sin());
            [[x, front * (0.08 + fold), 2.0 * z], [x, -front * 0.08, 2.0 * z]]
        })
        .collect()
    };
    for (front, sign) in [(1.0, -1.0), (-1.0, 1.0)] {
        ply(&f.join("slab.ply"), &slab(front));
        let arguments =
            ["render", "slab.ply", "-o", "a.png", "--size", "8x8", "--view", "front", "--no-cache"];
        rayset(f, &[&arguments[..], &["--write-scene", "s.json"]].concat());
        let scene: Value =
            serde_json::from_slice(&fs::read(f.join("s.json")).expect("a scene")).expect("JSON");
        let y = scene["camera"]["direction"][1].as_f64().expect("a direction");
        assert!(y * sign > 0.9, "front at {front}: {}", scene["camera"]);
    }
}

#[test]
fn the_relief_of_a_head_is_no_terrain_and_faces_the_reader() {
    let folder = folder();
    let f = folder.path();
    // Half an ellipsoid with a nose, in millimetres, in a table, whose custom is z up.
    let head = |flip: f64| -> String {
        let mut text = "x y z\n".to_owned();
        for i in 0..180 {
            for j in 0..210 {
                let (x, y) = (f64::from(i) - 90.0, f64::from(j) - 105.0);
                let square = (x / 90.0).powi(2) + (y / 105.0).powi(2);
                if square < 1.0 {
                    let nose = 15.0 * (-(x * x + y * y) / 200.0).exp();
                    text += &format!("{x} {y} {}\n", flip * (60.0 * (1.0 - square).sqrt() + nose));
                }
            }
        }
        text
    };
    for flip in [1.0, -1.0] {
        fs::write(f.join("head.txt"), head(flip)).expect("a write");
        let found = info(f, "head.txt");
        assert!(found["look"] == "surface" && found["up"] == "y", "{} {}", found["look"], found["up"]);
    }
    // A hill on a tile is ground.
    let hill: String = (0..150 * 150)
        .map(|i| (f64::from(i % 150), f64::from(i / 150)))
        .map(|(x, y)| {
            format!("{x} {y} {}\n", 40.0 * (-((x - 75.0).powi(2) + (y - 75.0).powi(2)) / 1500.0).exp())
        })
        .collect();
    fs::write(f.join("hill.txt"), format!("x y z\n{hill}")).expect("a write");
    let found = info(f, "hill.txt");
    assert!(found["look"] == "height" && found["up"] == "z", "{} {}", found["look"], found["up"]);
}

/// Points of a scan as PCD: a wavy floor, with what `of` makes of a point's number as its other
/// column.
fn scan(path: &Path, column: &str, of: &dyn Fn(u32) -> f64) {
    let mut text = format!("VERSION .7\nFIELDS x y z {column}\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 1\n");
    text += "WIDTH 6400\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 6400\nDATA ascii\n";
    for i in 0..6400_u32 {
        let (x, y) = (f64::from(i % 80) - 40.0, f64::from(i / 80) - 40.0);
        text += &format!("{x} {y} {} {}\n", 25.0 * (0.09 * x).sin() * (0.09 * y).cos(), of(i));
    }
    fs::write(path, text).expect("a write");
}

#[test]
fn classes_are_shown_only_if_two_of_them_are_more_than_specks() {
    let folder = folder();
    let f = folder.path();
    let look = |of: &dyn Fn(u32) -> f64| {
        scan(&f.join("s.pcd"), "label", of);
        info(f, "s.pcd")["look"].as_str().expect("a look").to_owned()
    };
    assert_ne!(look(&|_| 1.0), "classes");
    assert_ne!(look(&|i| if i % 100 == 0 { f64::from(2 + i / 100 % 2) } else { 1.0 }), "classes");
    assert_eq!(look(&|i| if i % 5 == 0 { 2.0 } else { 6.0 }), "classes");
}

#[test]
fn a_few_different_intensities_are_no_picture() {
    let folder = folder();
    let f = folder.path();
    let look = |levels: u32| {
        scan(&f.join("s.pcd"), "intensity", &|i| f64::from(i.wrapping_mul(2_654_435_761) % levels));
        info(f, "s.pcd")["look"].as_str().expect("a look").to_owned()
    };
    assert_ne!(look(15), "intensity");
    assert_eq!(look(200), "intensity");
}

/// The middle of the brightnesses of the pixels that are not of the background.
fn middle(pixels: &[[u8; 4]]) -> u8 {
    let mut seen: Vec<u8> = pixels.iter().filter(|p| p[3] > 250).map(|p| p[0].max(p[1]).max(p[2])).collect();
    seen.sort_unstable();
    assert!(seen.len() > 200, "{} pixels are seen", seen.len());
    seen[seen.len() / 2]
}

#[test]
fn dark_scans_are_seen_although_a_few_of_their_points_are_bright() {
    let folder = folder();
    let f = folder.path();
    // Nineteen in twenty are dark, the others white.
    let mut text = "x,y,z,red,green,blue\n".to_owned();
    for i in 0..4900_u32 {
        let (x, y) = (f64::from(i % 70), f64::from(i / 70));
        let color = if i % 20 == 7 { 250 } else { 14 + i % 9 };
        text += &format!("{x},{y},{},{color},{color},{color}\n", (0.2 * x).sin());
    }
    fs::write(f.join("dark.csv"), text).expect("a write");
    let of_colors = middle(&pixels(f, "dark.csv", &["--background", "none"]).1);
    assert!(of_colors > 60, "colours: {of_colors}");
    // Intensities of which a few are far larger than the others.
    let lit = |i: u32| if i.is_multiple_of(20) { 4000.0 } else { 20.0 + f64::from(i % 61) };
    scan(&f.join("dark.pcd"), "intensity", &lit);
    let of_intensities = middle(&pixels(f, "dark.pcd", &["--background", "none", "--look", "intensity"]).1);
    assert!(of_intensities > 60, "intensities: {of_intensities}");
}

/// Places in Earth-centred coordinates of a tilted town at 47° north, 8° east: of offsets to the
/// east, the north and upward.
fn on_earth(offsets: &[[f64; 3]]) -> Vec<[f64; 3]> {
    let (latitude, longitude) = (47_f64.to_radians(), 8_f64.to_radians());
    let ((a, b), (c, d)) = (latitude.sin_cos(), longitude.sin_cos());
    let (east, north, up) = ([-c, d, 0.0], [-a * d, -a * c, b], [b * d, b * c, a]);
    let place = |[e, n, u]: &[f64; 3]| -> [f64; 3] {
        std::array::from_fn(|i| e * east[i] + n * north[i] + (u + 6_367_000.0) * up[i])
    };
    offsets.iter().map(place).collect()
}

#[test]
fn earth_centred_coordinates_stand_upright_with_the_north_ahead_and_metres() {
    let folder = folder();
    let f = folder.path();
    // Ground, and a tower in its middle.
    let mut offsets: Vec<[f64; 3]> =
        (0..6400).map(|i| [f64::from(i % 80) - 40.0, f64::from(i / 80) - 40.0, 0.0]).collect();
    offsets.extend((0..600).map(|i| {
        let (x, y) = [(2.0, 0.0), (0.0, 2.0), (-2.0, 0.0), (0.0, -2.0)][i % 4];
        [x, y, 0.05 * (i as f64)]
    }));
    ply(&f.join("earth.ply"), &on_earth(&offsets));
    let found = info(f, "earth.ply");
    assert_eq!(found["up_reason"], "Earth-centred coordinates");
    assert_eq!(found["length_unit"], "m");
    // Seen from the front the ground is level: its rows at the left and at the right are the same.
    let (width, seen) = pixels(f, "earth.ply", &["--view", "front", "--background", "none"]);
    let lowest = |x: usize| (0..64).rev().find(|y| seen[y * width + x][3] > 128);
    let columns: Vec<usize> = (0..width).filter(|&x| lowest(x).is_some()).collect();
    let (left, right) = (columns[2], columns[columns.len() - 3]);
    let (left, right) = (lowest(left).expect("ground"), lowest(right).expect("ground"));
    assert!(left.abs_diff(right) <= 1, "{left} {right}");
    // And the tower stands in the middle, upright.
    let is_seen = |x: usize, y: usize| seen[y * width + x][3] > 40;
    let top = (0..64).find(|&y| (0..width).any(|x| is_seen(x, y))).expect("a tower");
    let above: Vec<usize> = (0..width).filter(|&x| is_seen(x, top) || is_seen(x, top + 1)).collect();
    let middle = (above[0] + above[above.len() - 1]) / 2;
    assert!(middle.abs_diff(32) <= 3, "{above:?}");
    // What is as far from the origin, but as large as the Earth, is none of its ground.
    let globe = ellipsoid(&mut Random(5), 3000, [0.0; 3], [6.37e6; 3]);
    ply(&f.join("globe.ply"), &globe);
    assert_ne!(info(f, "globe.ply")["up_reason"], "Earth-centred coordinates");
}

#[test]
fn degrees_near_a_pole_become_metres_and_that_is_said() {
    let folder = folder();
    let f = folder.path();
    for (name, sign) in [("north.csv", 1.0), ("south.csv", -1.0)] {
        let rows: String = (0..900)
            .map(|i| (f64::from(i % 30) * 6.0 - 87.0, 88.0 + f64::from(i / 30) * 0.06))
            .map(|(longitude, latitude)| format!("{longitude},{},10\n", sign * latitude))
            .collect();
        fs::write(f.join(name), format!("lon,lat,alt\n{rows}")).expect("a write");
        let (said, remarks) = rayset(f, &["info", "--json", "--no-cache", name]);
        assert!(remarks.contains("made metres") && remarks.contains("polar"), "{remarks}");
        let found: Value = serde_json::from_str(&said).expect("JSON");
        assert_eq!(found["length_unit"], "m");
        let low = found["bounds_min"][0].as_f64().expect("a number");
        let high = found["bounds_max"][0].as_f64().expect("a number");
        // Two degrees to either side of the pole.
        assert!((2.0 * 2.2e5..2.0 * 2.3e5).contains(&(high - low)), "{low} {high}");
    }
}
