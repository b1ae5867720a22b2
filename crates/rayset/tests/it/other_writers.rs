//! Files as many programs write them, which no fixture has: tables without names, scans without
//! headers, degrees.

use std::path::{Path, PathBuf};

use rayset::geometry::DVec3;
use rayset::points::{self, ColorDepth, PointBatch, ReadError, ReadOptions, Schema};

use crate::common::folder;

fn write(folder: &Path, name: &str, bytes: impl AsRef<[u8]>) -> PathBuf {
    let path = folder.join(name);
    std::fs::write(&path, bytes).expect("a write");
    path
}

/// The schema and all points with all columns.
fn read(path: &Path) -> Result<(Schema, PointBatch), ReadError> {
    let mut source = points::open(path, &ReadOptions::default())?;
    source.select(&(0..source.schema().columns.len()).collect::<Vec<_>>());
    let mut batch = PointBatch::default();
    source.fill(&mut batch, 100_000)?;
    Ok((source.schema().clone(), batch))
}

fn opened(name: &str, bytes: impl AsRef<[u8]>) -> (Schema, PointBatch) {
    let folder = folder();
    read(&write(folder.path(), name, bytes)).unwrap_or_else(|error| panic!("{error}"))
}

fn refusal(name: &str, bytes: impl AsRef<[u8]>) -> String {
    let folder = folder();
    read(&write(folder.path(), name, bytes)).expect_err("refused").to_string()
}

fn names(schema: &Schema) -> String {
    schema.names().collect::<Vec<_>>().join(" ")
}

/// Lines of x, y, z and what belongs to each number.
fn table(rows: u32, more: impl Fn(u32) -> String) -> String {
    (0..rows)
        .map(|i| format!("{} {} {} {}\n", f64::from(i).sin(), 0.1 * f64::from(i % 9), 0.5, more(i)))
        .collect()
}

#[test]
fn columns_of_text_without_names_are_known_by_their_values() {
    let (schema, points) = opened("a.txt", table(40, |i| format!("0.6 0 0.8 {}", i % 3)));
    assert_eq!(names(&schema), "nx ny nz label");
    assert!(schema.columns[3].is_class);
    assert_eq!((points.len(), points.columns[3].get(4)), (40, 1.0));
    let (schema, _) = opened("a.xyz", table(40, |i| format!("200 90 {i} 0.5 -0.3 0.2")));
    assert_eq!(names(&schema), "red green blue column7 column8 column9");
    // Longer than what is looked at.
    let (schema, points) = opened("a.xyz", table(5000, |_| "-1200 10 20 30".into()));
    assert_eq!((names(&schema).as_str(), points.len()), ("intensity red green blue", 5000));
    assert_eq!(points.position[4999][1], 0.1 * f64::from(4999 % 9));
}

#[test]
fn a_number_or_a_time_before_the_positions_and_words_behind_them_are_passed_over() {
    let text: String = (0..40).map(|i| format!("{},{},{},{},GND\n", 1000 + i, i * i, i % 7, 0.5)).collect();
    let (schema, points) = opened("a.csv", text);
    assert_eq!(names(&schema), "");
    assert_eq!(points.position[3], [9.0, 3.0, 0.5]);
    let text = "time,latitude (deg),alt [m],longitude,speed\n2023-05-01T12:00Z,48.1,500,11.5,3\n";
    let (schema, points) = opened("a.csv", text);
    assert_eq!(names(&schema), "speed");
    assert_eq!((schema.crs.as_str(), points.position[0][2]), ("EPSG:32632", 500.0));
    let said = refusal("a.csv", "name,x,y,z,class\na,1,2,3,4\nb,1,2,3,ground\n");
    assert!(said.contains("line 3: `ground` is not a number"), "{said}");
}

#[test]
fn titles_before_a_header_are_passed_over_and_unknown_names_are_not() {
    let (schema, points) =
        opened("a.txt", "Project: Bridge 12\nDate: 2021-04-01\nX Y Z Code\n1 2 3 7\n4 5 6 8\n");
    assert_eq!((names(&schema).as_str(), points.len()), ("Code", 2));
    let said = refusal("a.csv", "source_id,ra,dec\n1,2,3\n4,5,6\n");
    assert!(said.contains("line 1: expected numbers or a header") && said.contains("source_id"), "{said}");
    let said = refusal("a.csv", "one\ntwo\n");
    assert!(said.contains("line 1: ") && said.contains("found `one`"), "{said}");
    let (schema, points) = opened("a.csv", "#name,x,y,alt\nIMG.jpg,1,2,3\n");
    assert_eq!((names(&schema).as_str(), points.position[0]), ("", [1.0, 2.0, 3.0]));
    // Höhe in Latin-1.
    assert_eq!(opened("a.csv", b"X;Y;H\xf6he\n1,5;2;3\n").1.position[0], [1.5, 2.0, 3.0]);
}

#[test]
fn sparse_points_of_colmap_are_read_with_y_down_and_without_their_tracks() {
    let text = "# 3D point list with one line of data per point:\n\
                #   POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n\
                7 1 2 3 250 120 30 0.5 1 17 2 40\n8 4 5 6 25 12 3 0.5 1 17\n";
    let (schema, points) = opened("points3D.txt", text);
    assert_eq!(names(&schema), "POINT3D_ID R G B ERROR");
    assert_eq!(points.position, [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]);
    assert_eq!((schema.find("red"), schema.up), (Some(1), Some(DVec3::NEG_Y)));
}

#[test]
fn any_text_may_be_a_table_under_any_name() {
    assert_eq!(opened("points", "1 2 3\n4 5 6\n").1.len(), 2);
    assert_eq!(opened("points.dat", "x,y,z\n4,5,6\n").1.len(), 1);
    for (text, what) in [("No numbers.\n", "this is text, but no table"), ("", "this file is empty")] {
        let said = refusal("notes", text);
        assert!(said.contains(what), "{said}");
    }
}

/// Floats, little-endian.
fn floats(rows: &[Vec<f32>]) -> Vec<u8> {
    rows.iter().flatten().flat_map(|v| v.to_le_bytes()).collect()
}

#[test]
fn scans_of_four_or_five_floats_are_read_and_other_bytes_are_not_taken_for_them() {
    let row = |i: u16| vec![f32::from(i).sin() * 30.0, f32::from(i), -1.7, 0.25];
    let four: Vec<Vec<f32>> = (0..700).map(row).collect();
    let (schema, points) = opened("000000.bin", floats(&four));
    assert_eq!((names(&schema).as_str(), points.len()), ("intensity", 700));
    assert_eq!(schema.up, Some(DVec3::Z));
    assert_eq!(points.position[3][0], f64::from(four[3][0]));
    let five: Vec<Vec<f32>> = (0..8).map(|i| [row(i), vec![f32::from(i % 32)]].concat()).collect();
    let (schema, points) = opened("sweep.pcd.bin", floats(&five));
    assert_eq!(names(&schema), "intensity ring");
    assert_eq!((points.columns[1].get(5), points.position[5][2]), (5.0, f64::from(-1.7_f32)));
    let said = refusal("a.bin", vec![0x5a; 1600]);
    assert!(said.contains("expected a scan as KITTI") && said.contains("numpy.fromfile"), "{said}");
    assert!(refusal("a.bin", floats(&four[..3]).split_at(47).0).contains("47 bytes"));
    assert!(refusal("points3D.bin", floats(&four)).contains("colmap model_converter"));
}

#[test]
fn meshes_in_off_are_read_whatever_their_first_line_looks_like() {
    let body = "# a remark\n0 0 0\n1 0 0 255 0 0\n\n1 1 0\n0 1 0\n4 0 1 2 3 0.5 0.5 0.5\n";
    let options = ReadOptions::default().with_mesh_points(Some(100));
    let folder = folder();
    for head in ["OFF\n4 1 0\n", "OFF4 1 0\n", "COFF 4 1 0\n", "OFF # made by\n4 1\t0\n"] {
        let path = write(folder.path(), "m.off", format!("{head}{body}"));
        let mut source = points::open(&path, &options).unwrap_or_else(|error| panic!("{head}: {error}"));
        let mut batch = PointBatch::default();
        source.fill(&mut batch, 1000).expect("points");
        let lies = |p: &&[f64; 3]| p[0] >= 0.0 && p[0] <= 1.0 && p[1] >= 0.0 && p[1] <= 1.0 && p[2] == 0.0;
        assert_eq!(batch.position.iter().filter(lies).count(), 100, "{head}");
    }
    for (text, what) in [
        ("OFF\n4 1 0\n0 0 0\n", "line 3: the file ends after 1 of 4 vertices"),
        ("OFF\n1 1 0\n0 0 0\n3 0 0 1\n", "line 4: `1` is no corner of a face: there are 1 vertices"),
        ("OFF\n1 1 0\n0 0 0\n3 0 0\n", "line 4: a face of 3 corners, of which 2 are given"),
        ("OFF\n1 1 0\n0 zero 0\n", "line 3: expected x, y and z of a vertex, found `0 zero 0`"),
        ("OFF\n", "line 1: the file ends before the numbers"),
        ("OFF\n9999999999 1 0\n", "line 2: 9999999999 vertices; at most"),
    ] {
        let said = refusal("m.off", text);
        assert!(said.contains(what), "{said}");
    }
}

#[test]
fn degrees_become_metres_and_points_all_over_the_globe_are_refused() {
    let (schema, points) = opened("a.csv", "lon,lat,height\n11.5,48.1,520\n11.50001,48.1,521\nnan,48.1,1\n");
    assert_eq!(schema.crs, "EPSG:32632");
    assert!(schema.warnings.iter().any(|warning| warning.contains("UTM zone 32N")), "{:?}", schema.warnings);
    let [east, north, up] = points.position[0];
    assert!((east - 686_121.756).abs() < 0.01 && (north - 5_330_438.130).abs() < 0.01 && up == 520.0);
    assert!((points.position[1][0] - east - 0.745).abs() < 0.01);
    assert!(points.position[2][0].is_nan());
    let said = refusal("a.csv", "lon,lat,height\n11.5,48.1,520\n-70,48.1,521\n");
    assert!(said.contains("longitude -70") && said.contains("--columns"), "{said}");
    // Eastings under such a name stay.
    let (schema, points) = opened("a.csv", "lon,lat,height\n500000,5400000,520\n");
    assert_eq!((points.position[0][0], schema.color_depth), (500_000.0, ColorDepth::Guess));
}

#[test]
fn ply_of_nerfstudio_says_what_is_up_and_ply_of_colmap_is_known_by_its_layout() {
    let head = |comment: &str, names: &str| {
        let axes = names.split(' ').map(|name| format!("property float {name}\n")).collect::<String>();
        format!(
            "ply\nformat ascii 1.0\n{comment}element vertex 1\n{axes}property uchar red\nproperty uchar green\n\
             property uchar blue\nend_header\n{}1 2 3\n",
            "0 ".repeat(names.split(' ').count())
        )
    };
    let (schema, _) = opened("a.ply", head("comment Vertical Axis: z\n", "x y z"));
    assert_eq!(schema.up, Some(DVec3::Z));
    let (schema, _) = opened("a.ply", head("", "x y z nx ny nz"));
    assert!(schema.description.contains("COLMAP") && schema.up.is_none(), "{}", schema.description);
    for other in [head("", "x y z"), head("comment by MeshLab\n", "x y z nx ny nz")] {
        assert!(!opened("a.ply", other).0.description.contains("COLMAP"));
    }
}
