//! Inputs as people have them: what is up in them, what their columns are, and what has nothing in
//! it.

use std::fs;
use std::path::Path;
use std::process::Command;

use crate::common::folder;

/// Whether it went well, and what was said on standard error.
fn run(folder: &Path, arguments: &[&str]) -> (bool, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_rayset"));
    command.current_dir(folder).env("XDG_CACHE_HOME", folder.join("home"));
    let output = command.args(arguments).output().expect("the program runs");
    (output.status.success(), String::from_utf8_lossy(&output.stderr).into_owned())
}

fn render(folder: &Path, more: &[&str]) -> String {
    let (well, said) =
        run(folder, &[&["render", "-o", "a.png", "--size", "16x16", "--no-cache"], more].concat());
    assert!(well, "{more:?}: {said}");
    said
}

/// Points on the sides of a box around the origin in the first two axes, and on it in the third.
fn sides(size: [f64; 3]) -> Vec<[f64; 3]> {
    let place = |i: u32| {
        let (side, u, v) = (i % 6, f64::from(i / 6 % 20) / 19.0, f64::from(i / 120) / 19.0);
        let end = f64::from(side % 2);
        let [x, y, z] = match side / 2 {
            0 => [u, v, end],
            1 => [u, end, v],
            _ => [end, u, v],
        };
        [size[0] * (x - 0.5), size[1] * (y - 0.5), size[2] * z]
    };
    (0..6 * 400).map(place).collect()
}

/// Which direction is said to be up.
fn up_in(said: &str) -> String {
    said.split(" up (").next().and_then(|start| start.rsplit(' ').next()).unwrap_or("none").to_owned()
}

fn write_pcd(path: &Path, points: &[[f64; 3]], column: Option<&str>) {
    let (name, size, kind, one) =
        column.map_or((String::new(), "", "", ""), |name| (format!(" {name}"), " 4", " F", " 1"));
    let mut text =
        format!("VERSION .7\nFIELDS x y z{name}\nSIZE 4 4 4{size}\nTYPE F F F{kind}\nCOUNT 1 1 1{one}\n");
    text += &format!("WIDTH {0}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {0}\nDATA ascii\n", points.len());
    for (i, [x, y, z]) in points.iter().enumerate() {
        let more = if column.is_some() { format!(" {}", i % 50) } else { String::new() };
        text += &format!("{x} {y} {z}{more}\n");
    }
    fs::write(path, text).expect("a write");
}

#[test]
fn what_is_up_in_a_pcd_follows_from_columns_of_lidar_and_the_size_of_a_site_or_a_person() {
    let folder = folder();
    let f = folder.path();
    let up = |size: [f64; 3], column: Option<&str>| {
        write_pcd(&f.join("a.pcd"), &sides(size), column);
        up_in(&render(f, &["a.pcd"]))
    };
    // A house, one that a LiDAR saw, a person in either frame, a statuette.
    assert_eq!(up([8.8, 6.8, 7.9], None), "z");
    assert_eq!(up([90.0, 80.0, 70.0], Some("ring")), "z");
    assert_eq!(up([1.2, 0.4, 1.8], None), "z");
    assert_eq!(up([1.2, 1.8, 0.4], None), "y");
    assert_eq!(up([0.2, 0.25, 0.2], None), "y");
}

#[test]
fn what_is_up_in_a_ply_of_a_building_or_a_room_is_z() {
    let folder = folder();
    let f = folder.path();
    let up = |size: [f64; 3], column: &str| {
        let property = if column.is_empty() { String::new() } else { format!("property float {column}\n") };
        let value = if column.is_empty() { "" } else { " 3" };
        let points: String = sides(size).iter().map(|[x, y, z]| format!("{x} {y} {z}{value}\n")).collect();
        let text = format!(
            "ply\nformat ascii 1.0\nelement vertex 2400\nproperty float x\nproperty float y\nproperty float z\n{property}\
             end_header\n{points}"
        );
        fs::write(f.join("a.ply"), text).expect("a write");
        up_in(&render(f, &["a.ply"]))
    };
    assert_eq!(up([8.8, 6.8, 7.9], "scalar_Intensity"), "z");
    assert_eq!(up([8.0, 6.0, 2.8], ""), "z");
    assert_eq!(up([8.0, 2.8, 6.0], "scalar_Intensity"), "y");
    assert_eq!(up([1.2, 1.8, 0.4], ""), "y");
}

#[test]
fn what_is_printed_stands_on_the_bed_of_a_printer() {
    let folder = folder();
    let f = folder.path();
    let up = |[a, b, c]: [f64; 3]| {
        let corner = |i: usize| {
            [
                if i & 1 > 0 { a } else { 0.0 },
                if i & 2 > 0 { b } else { 0.0 },
                if i & 4 > 0 { c } else { 0.0 },
            ]
        };
        let mut text = "solid box\n".to_owned();
        for face in [[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]] {
            for triangle in [[face[0], face[1], face[2]], [face[0], face[2], face[3]]] {
                text += "facet normal 0 0 0\nouter loop\n";
                for i in triangle {
                    let [x, y, z] = corner(i);
                    text += &format!("vertex {x} {y} {z}\n");
                }
                text += "endloop\nendfacet\n";
            }
        }
        fs::write(f.join("a.stl"), text + "endsolid box\n").expect("a write");
        up_in(&render(f, &["a.stl"]))
    };
    assert_eq!(up([8.0, 6.0, 6.8]), "z");
    assert_eq!(up([0.5, 0.4, 0.45]), "z");
    assert_eq!(up([5.0, 9.0, 5.0]), "y");
}

#[test]
fn columns_can_be_named_wherever_points_are_opened() {
    let folder = folder();
    let f = folder.path();
    let text: String =
        (0..500).map(|i| format!("{} {} {} {}\n", i % 20, i / 20, 100 + i % 7, i % 50)).collect();
    fs::write(f.join("a.txt"), text).expect("a write");
    let said = render(f, &["a.txt", "--columns", "-,y,z,x"]);
    assert!(said.contains("look: "), "{said}");
    // What is kept of one is not taken for the other.
    let bounds = |columns: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_rayset"));
        command.current_dir(f).args(["info", "a.txt", "--json", "--cache", "kept"]).args(columns);
        let output = command.output().expect("the program runs");
        let report: serde_json::Value = serde_json::from_slice(&output.stdout).expect("a report");
        report["bounds_max"][0].as_f64().expect("a number").round()
    };
    assert_eq!(bounds(&[]), 19.0);
    assert_eq!(bounds(&["--columns", "-,y,z,x"]), 49.0);
    assert_eq!(bounds(&["--columns", "x,y,z,-"]), 19.0);
    let (well, said) = run(f, &["build", "a.txt", "-o", "a.rset", "--columns", "-,y,z,x"]);
    assert!(well, "{said}");
    let (well, said) = run(f, &["info", "a.rset", "--columns", "x,y,z"]);
    assert!(!well && said.contains("has been built"), "{said}");
}

#[test]
fn files_of_no_points_are_refused() {
    let folder = folder();
    let f = folder.path();
    let header = "ply\nformat ascii 1.0\nelement vertex 0\nproperty float x\nproperty float y\nproperty float z\nend_header\n";
    fs::write(f.join("a.ply"), header).expect("a write");
    let (well, said) = run(f, &["render", "a.ply", "-o", "a.png", "--no-cache"]);
    assert!(!well && said.contains("a.ply: no points"), "{said}");
}

#[test]
fn json_that_is_no_scene_is_refused_with_what_it_is() {
    let folder = folder();
    let f = folder.path();
    for (name, text, what) in [
        ("list.json", "[1, 2]", "JSON, and no scene"),
        ("points.json", "{\"points\": [[1, 2, 3]]}", "JSON, and no scene"),
        ("trees.json", "{\"type\": \"FeatureCollection\", \"features\": []}", "a map of vectors"),
        ("scene.json", "{\"camera\": {}}", "\"rayset\" is missing"),
    ] {
        fs::write(f.join(name), text).expect("a write");
        let (well, said) = run(f, &["render", name, "-o", "a.png"]);
        assert!(!well && said.contains(what), "{name}: {said}");
    }
}

#[test]
fn a_number_of_points_on_faces_is_not_ignored_in_silence() {
    let folder = folder();
    let f = folder.path();
    fs::write(f.join("a.xyz"), "1 2 3\n4 5 6\n7 8 10\n").expect("a write");
    let (well, said) = run(f, &["build", "a.xyz", "-o", "a.rset", "--mesh-points", "100"]);
    assert!(well && said.contains("--mesh-points is for the faces"), "{said}");
}

#[test]
fn of_points_in_places_far_apart_one_is_framed_and_it_is_said_and_rows_of_zeros_are_no_place() {
    let folder = folder();
    let f = folder.path();
    let points = sides([40.0, 30.0, 20.0]);
    let rows = |east: f64| -> String {
        points.iter().map(|[x, y, z]| format!("{} {} {z}\n", x + east, y + 5.2e6)).collect()
    };
    fs::write(f.join("a.xyz"), rows(4e5)).expect("a write");
    let alone = render(f, &["a.xyz"]);
    assert!(!alone.contains("places"), "{alone}");
    let picture = || fs::read(f.join("a.png")).expect("a picture").len();
    let full = picture();
    fs::write(
        f.join("a.xyz"),
        rows(4e5) + &rows(7e5).lines().take(600).map(|row| format!("{row}\n")).collect::<String>(),
    )
    .expect("a write");
    let said = render(f, &["a.xyz"]);
    assert!(said.contains("the points lie in places 3.000e5 apart"), "{said}");
    assert!(!said.contains("is under a pixel") && !said.contains("few points"), "{said}");
    assert!(picture() * 2 > full, "{} of {full} bytes", picture());
    fs::write(f.join("a.xyz"), rows(4e5) + &"0 0 0\n".repeat(8)).expect("a write");
    let said = render(f, &["a.xyz"]);
    assert!(!said.contains("places") && !said.contains("is under a pixel"), "{said}");
    assert!(picture() * 2 > full, "{} of {full} bytes", picture());
}
