//! PLY files: headers of any length, damaged ones, and what is said of them; meshes too.

use std::path::{Path, PathBuf};

use rayset::points::{self, MeshSource, PointBatch, PointSource, ReadOptions};

use crate::common::{folder, real_data};
use crate::tables::table;

const XYZ: &str = "property float x\nproperty float y\nproperty float z\n";

fn write(folder: &Path, bytes: &[u8]) -> PathBuf {
    let path = folder.join("p.ply");
    std::fs::write(&path, bytes).expect("a write");
    path
}

/// What is said of a file that is refused, without its name.
fn refusal(bytes: impl AsRef<[u8]>) -> String {
    let folder = folder();
    let error = table(&write(folder.path(), bytes.as_ref()), None).expect_err("refused").to_string();
    error.split_once(", ").expect("a place").1.to_owned()
}

fn mesh_refusal(bytes: impl AsRef<[u8]>) -> String {
    let folder = folder();
    let path = write(folder.path(), bytes.as_ref());
    let error = MeshSource::open(&path, 10).err().expect("refused").to_string();
    error.split_once(", ").expect("a place").1.to_owned()
}

/// A header, and values in little-endian order behind it.
fn binary(header: &str, values: &[&[u8]]) -> Vec<u8> {
    let start = format!("ply\nformat binary_little_endian 1.0\n{header}end_header\n");
    [start.as_bytes(), &values.concat()].concat()
}

fn floats(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

#[test]
fn headers_beyond_a_mebibyte_open() {
    let folder = folder();
    let many = "comment a line of a comment\nobj_info and of another kind\n".repeat(40_000);
    let long = format!("comment {}\n", "long ".repeat(1 << 20));
    let huge = format!("obj_info {}\n", "x".repeat(20 << 20));
    for comments in [many, long, huge] {
        assert!(comments.len() > 2 << 20);
        let text = format!("ply\nformat ascii 1.0\n{comments}element vertex 1\n{XYZ}end_header\n1 2 3\n");
        let found = table(&write(folder.path(), text.as_bytes()), None).expect("it reads");
        assert_eq!(found.0, [[1.0, 2.0, 3.0]]);
        let header = format!("{comments}element vertex 1\n{XYZ}");
        let found = table(&write(folder.path(), &binary(&header, &[&floats(&[1.0, 2.0, 3.0])])), None);
        assert_eq!(found.expect("it reads").0, [[1.0, 2.0, 3.0]]);
        // Lines are counted on, whatever their length.
        let lines = comments.lines().count() + 7;
        let wrong = refusal(text.replace("1 2 3", "1 2"));
        assert!(wrong.starts_with(&format!("line {}: too few values", lines + 1)), "{wrong}");
    }
}

#[test]
fn headers_that_are_none_are_refused_with_line_and_reason() {
    let with = |lines: &str| format!("ply\nformat ascii 1.0\n{lines}end_header\n1 2 3\n");
    for (text, expected) in [
        ("solid ply\n".to_owned(), "line 1: not a PLY file"),
        ("p".repeat(5000), "line 1: not a PLY file"),
        ("ply\nformat ascii 1.0\n".to_owned(), "line 3: the file ends before `end_header`"),
        (with(&format!("elements vertex 1\n{XYZ}")), "line 3: `elements` where format, comment"),
        (
            with(&format!("element vertex -1\n{XYZ}")),
            "line 3: `-1` is not a number of records; expected a whole",
        ),
        (with(&format!("element vertex 1.5\n{XYZ}")), "line 3: `1.5` is not a number of records"),
        (
            with(&format!("element vertex 99999999999999999999\n{XYZ}")),
            "line 3: `99999999999999999999` is not a number",
        ),
        (with("element vertex 1\nproperty real x\n"), "line 4: unknown type `real`; expected char, uchar"),
        (with("element vertex 1\nproperty list uchar x\n"), "line 4: expected `property TYPE NAME`"),
        (with("property float x\n"), "line 3: `property` before any `element`"),
        (
            with("element vertex 1\nproperty float x\nproperty float y\n"),
            "line 6: the `vertex` element lacks x, y or z; it has x, y",
        ),
        (
            with(&format!("element vertex 1\n{XYZ}property float x\n")),
            "line 8: the `vertex` element has two properties called `x`",
        ),
        (
            with("element vertex 1\nproperty list uchar float x\nproperty float y\nproperty float z\n"),
            "line 7: the `vertex` element lacks x",
        ),
        (
            with(&format!("element vertex 1\n{XYZ}element vertex 1\n")),
            "line 7: a second element called `vertex`",
        ),
        (with("element point 1\n"), "line 4: no `vertex` element"),
        (
            with(&format!("element vertex 1\n{XYZ}property float {}\n", "n".repeat(2000))),
            "line 7: a line of more than 1024 bytes",
        ),
        (
            with(&format!("element vertex 1\n{}", "property float a\n".repeat(5000))),
            "line 4099: more than 4096 elements and properties",
        ),
        (
            format!("ply\nformat xml 1.0\nelement vertex 1\n{XYZ}end_header\n"),
            "line 2: unknown format `xml`; expected ascii",
        ),
        (format!("ply\nelement vertex 1\n{XYZ}end_header\n1 2 3\n"), "line 6: no `format` line"),
    ] {
        let what = refusal(&text);
        assert!(what.starts_with(expected), "{what}\n{expected}");
    }
    let endless = format!("ply\nformat ascii 1.0\ncomment {}", "x".repeat(65 << 20));
    assert!(refusal(endless).contains("a header of more than 67108864 bytes"));
}

#[test]
fn a_file_that_ends_early_says_where_and_how_many_of_how_many_were_read() {
    let vertices = floats(&[0.0; 3 * 5]);
    let header = format!("element vertex 100\n{XYZ}");
    let whole = binary(&header, &[&vertices, &[1, 2, 3]]);
    let what = refusal(&whole);
    assert_eq!(what, format!("byte {}: the file ends early: 5 of 100 vertices read", whole.len()));
    // The same where records vary in length, and in elements before.
    let header = format!("element vertex 100\n{XYZ}property list uchar uchar l\n");
    let record = [floats(&[0.0; 3]), vec![2, 7, 7]].concat();
    for cut in 0..record.len() {
        let whole = binary(&header, &[&record, &record, &record[..cut]]);
        assert_eq!(
            refusal(&whole),
            format!("byte {}: the file ends early: 2 of 100 vertices read", whole.len())
        );
    }
    let header = format!("element chunk 9\nproperty short a\nelement vertex 1\n{XYZ}");
    let whole = binary(&header, &[&[0; 7]]);
    assert_eq!(
        refusal(&whole),
        format!("byte {}: the file ends early: 3 of 9 records of element `chunk` read", whole.len())
    );
    let text = format!("ply\nformat ascii 1.0\nelement vertex 100\n{XYZ}end_header\n1 2 3\n4 5 6\n");
    assert_eq!(refusal(text), "line 9: the file ends early: 2 of 100 vertices read");
}

#[test]
fn lists_of_damaged_counts_are_errors_with_their_place() {
    let header = format!("element vertex 2\nproperty list char float l\n{XYZ}");
    let good = [vec![1], floats(&[0.5, 1.0, 2.0, 3.0])].concat();
    let whole = binary(&header, &[&good, &good]);
    let folder = folder();
    assert_eq!(table(&write(folder.path(), &whole), None).expect("it reads").0, [[1.0, 2.0, 3.0]; 2]);
    let broken = binary(&header, &[&good, &[0xff], &good]);
    let at = broken.len() - good.len() - 1;
    assert_eq!(
        refusal(&broken),
        format!("byte {at}: a list of -1 items; expected a whole number from 0 to 4294967295")
    );
    for (count, shown) in [("-1", "-1"), ("nan", "NaN"), ("0.5", "0.5"), ("5e9", "5000000000")] {
        let text = format!(
            "ply\nformat ascii 1.0\nelement vertex 1\nproperty list float float l\n{XYZ}end_header\n{count} 1 2 3\n"
        );
        assert_eq!(
            refusal(text),
            format!("line 9: a list of {shown} items; expected a whole number from 0 to 4294967295")
        );
    }
    // Four billion items are believed as far as the file goes, and take no memory.
    let header = format!("element vertex 1\nproperty list uint double l\n{XYZ}");
    let whole = binary(&header, &[&u32::MAX.to_le_bytes(), &[0; 80]]);
    assert!(refusal(&whole).ends_with("the file ends early: 0 of 1 vertices read"));
}

#[test]
fn ascii_values_that_their_header_does_not_allow_are_errors() {
    let text = |row: &str| {
        format!(
            "ply\nformat ascii 1.0\nelement vertex 2\n{XYZ}property uchar a\nend_header\n1 2 3 4\n{row}\n"
        )
    };
    for (row, expected) in [
        ("1 2 3 4 5", "line 10: 1 values more than the 4 properties"),
        ("1 2 3", "line 10: too few values for 4 properties"),
        ("1 2 3 256", "line 10: `256` is no value of type u8"),
        ("1 2 3 0.5", "line 10: `0.5` is no value of type u8"),
        ("1 2 3 nan", "line 10: `nan` is no value of type u8"),
        ("1 2 3 1,5", "line 10: `1,5` is no value of type u8"),
        ("1 2 3 1,5,2", "line 10: `1,5,2` is not a number"),
    ] {
        let what = refusal(text(row));
        assert!(what.starts_with(expected), "{what}");
    }
    let folder = folder();
    let found = table(&write(folder.path(), text("nan inf 3 255.0").as_bytes()), None).expect("it reads");
    assert_eq!(found.1[0].1, [4.0, 255.0]);
    assert!(found.0[1][0].is_nan() && found.0[1][1].is_infinite());
}

#[test]
fn elements_without_properties_take_nothing_whatever_their_count() {
    let folder = folder();
    let header = format!("element note 18446744073709551615\nelement vertex 1\n{XYZ}");
    let found = table(&write(folder.path(), &binary(&header, &[&floats(&[1.0, 2.0, 3.0])])), None);
    assert_eq!(found.expect("it reads").0, [[1.0, 2.0, 3.0]]);
    let text = format!("ply\nformat ascii 1.0\n{header}end_header\n1 2 3\n");
    assert_eq!(table(&write(folder.path(), text.as_bytes()), None).expect("it reads").0, [[1.0, 2.0, 3.0]]);
}

#[test]
fn properties_keep_their_names_and_colours_go_by_any_of_theirs() {
    let folder = folder();
    let header = format!(
        "comment CloudCompare\ncomment from /home/somebody/scans\nobj_info made\tby \x1b[31mhand\nelement vertex 1\n{XYZ}\
         property float nx\nproperty uchar diffuse_red\nproperty uchar diffuse_green\nproperty uchar diffuse_blue\n\
         property float scalar_Intensity\nproperty uchar scalar_Classification\nproperty float r\n"
    );
    let path = write(
        folder.path(),
        &binary(&header, &[&floats(&[0.0; 4]), &[1, 2, 3], &floats(&[0.5]), &[6], &floats(&[7.0])]),
    );
    let source = points::open(&path, &ReadOptions::default()).expect("it opens");
    let schema = source.schema();
    let names = [
        "nx",
        "diffuse_red",
        "diffuse_green",
        "diffuse_blue",
        "scalar_Intensity",
        "scalar_Classification",
        "r",
    ];
    assert_eq!(schema.names().collect::<Vec<_>>(), names);
    assert_eq!(
        ["red", "green", "blue", "r"].map(|name| schema.find(name)),
        [Some(1), Some(2), Some(3), Some(6)]
    );
    assert_eq!(schema.color_depth, points::ColorDepth::Byte);
    assert!(schema.columns[5].is_class && !schema.columns[4].is_class);
    assert_eq!(schema.description, "PLY 1.0 binary_little_endian; CloudCompare; made by  [31mhand");
    let comments = "comment \u{e4}\u{e4}\u{e4}\u{e4}\u{e4}\n".repeat(500);
    let text = format!("ply\nformat ascii 1.0\n{comments}element vertex 0\n{XYZ}end_header\n");
    let source =
        points::open(write(folder.path(), text.as_bytes()), &ReadOptions::default()).expect("it opens");
    let length = source.schema().description.len();
    assert!((500..=512).contains(&length), "{length}");
}

const SQUARE: [f32; 12] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 0.0];

fn mesh_header(faces: u32, lists: &str) -> String {
    format!("element vertex 4\n{XYZ}element face {faces}\n{lists}")
}

#[test]
fn points_lie_on_the_faces_of_a_mesh_and_other_lists_are_no_faces() {
    let folder = folder();
    let header =
        mesh_header(1, "property list uchar float texcoord\nproperty list uchar int vertex_indices\n");
    let corners: Vec<u8> = [0_i32, 1, 2, 3].iter().flat_map(|i| i.to_le_bytes()).collect();
    let bytes = binary(&header, &[&floats(&SQUARE), &[3], &floats(&[9.0, -1.0, f32::NAN]), &[4], &corners]);
    let mut source = MeshSource::open(write(folder.path(), &bytes), 500).expect("a mesh");
    let mut batch = PointBatch::default();
    source.fill(&mut batch, 1000).expect("points");
    assert_eq!(batch.len(), 500);
    assert!(
        batch
            .position
            .iter()
            .all(|&[x, y, z]| (0.0..=1.0).contains(&x) && (0.0..=1.0).contains(&y) && z == 0.0)
    );
    // Both triangles of the fan.
    assert!(batch.position.iter().any(|[x, y, _]| x > y) && batch.position.iter().any(|[x, y, _]| x < y));
}

#[test]
fn damaged_meshes_are_errors_with_their_place_and_take_no_memory() {
    let list = "property list uint int vertex_indices\n";
    let start = binary(&mesh_header(1, list), &[&floats(&SQUARE)]).len();
    let face = |count: u32, corners: &[i32]| {
        let corners: Vec<u8> = corners.iter().flat_map(|i| i.to_le_bytes()).collect();
        binary(&mesh_header(1, list), &[&floats(&SQUARE), &count.to_le_bytes(), &corners])
    };
    let four_billion = mesh_refusal(face(4_000_000_000, &[0, 1, 2]));
    assert_eq!(
        four_billion,
        format!("byte {start}: face 0 has 4000000000 corners; at most 65536 are believed")
    );
    let negative = mesh_refusal(face(3, &[0, -1, 2]));
    assert!(
        negative
            .starts_with(&format!("byte {}: a corner of face 0 is vertex -1, which is not there", start + 8)),
        "{negative}"
    );
    let beyond = mesh_refusal(face(3, &[0, 1, 4]));
    assert!(beyond.contains("vertex 4, which is not there: there are 4, counted from 0"), "{beyond}");
    let short = face(3, &[0, 1]);
    assert_eq!(mesh_refusal(&short), format!("byte {}: the file ends early: 0 of 1 faces read", short.len()));
    let vertices = &short[..start - 13];
    assert_eq!(
        mesh_refusal(vertices),
        format!("byte {}: the file ends early: 2 of 4 vertices read", vertices.len())
    );
    let not_a_number = binary(
        &mesh_header(1, "property list uchar float vertex_indices\n"),
        &[&floats(&SQUARE), &[3], &floats(&[0.0, f32::NAN, 2.0])],
    );
    assert!(mesh_refusal(not_a_number).contains("a corner of face 0 is vertex NaN, which is not there"));
    let ascii = |rest: &str| {
        format!(
            "ply\nformat ascii 1.0\n{}end_header\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n{rest}",
            mesh_header(1, list)
        )
    };
    assert!(mesh_refusal(ascii("3 0 1 1e3\n")).starts_with("line 14: a corner of face 0 is vertex 1000"));
    assert!(mesh_refusal(ascii("3 0 1 -1\n")).starts_with("line 14: a corner of face 0 is vertex -1"));
    assert!(mesh_refusal(ascii("3 0 1 nan\n")).starts_with("line 14: `nan` is no value of type i32"));
    assert!(mesh_refusal(ascii("3 0 1 0.5\n")).starts_with("line 14: `0.5` is no value of type i32"));
    assert!(mesh_refusal(ascii("3 0 1\n")).starts_with("line 14: too few values"));
    assert!(mesh_refusal(ascii("")).starts_with("line 13: the file ends early: 0 of 1 faces read"));
    assert!(mesh_refusal(ascii("3 0 1 1\n")).contains("no faces with an area"));
    assert!(mesh_refusal(ascii("3 0 1 2\n").replace("0 0 0", "0 nan 0")).contains("is not finite"));
    assert!(
        mesh_refusal(format!("ply\nformat ascii 1.0\nelement vertex 1\n{XYZ}end_header\n1 2 3\n"))
            .contains("no `face` element")
    );
    // Vertices without coordinates would be free of charge.
    let none =
        binary("element vertex 4000000000000\nelement face 1\nproperty list uchar int vertex_indices\n", &[]);
    assert!(mesh_refusal(none).contains("the `vertex` element lacks x, y or z; it has nothing"));
}

#[test]
fn real_ply_files_are_read_to_their_last_vertex() {
    for (name, points, columns) in [
        ("scan/bun_zipper.ply", 35_947, 2),
        ("scan/bun_zipper_res2.ply", 8171, 2),
        ("scan/lucy.ply", 49_987, 0),
        ("3dgs/train-1000.ply", 1000, 65),
    ] {
        let Some(path) = real_data(name) else {
            eprintln!("skipped: no {name} here");
            continue;
        };
        let found = table(&path, None).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!((found.0.len(), found.1.len()), (points, columns), "{name}");
        if name.starts_with("scan") {
            MeshSource::open(&path, 10).unwrap_or_else(|e| panic!("{e}"));
        }
    }
}
