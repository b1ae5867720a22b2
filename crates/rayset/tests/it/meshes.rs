//! Meshes sampled by area: PLY, OBJ and STL.
//!
//! The fixtures are made by `tests/fixtures/make_meshes.py`.

use std::path::{Path, PathBuf};

use rayset::octree::build::{self, BuildControl, BuildError, BuildOptions};
use rayset::points::{self, MeshSource, PointBatch, PointSource, ReadError, ReadOptions};

use crate::common::folder;
use crate::tables::table;

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/meshes").join(name)
}

fn write(folder: &Path, name: &str, bytes: impl AsRef<[u8]>) -> PathBuf {
    let path = folder.join(name);
    std::fs::write(&path, bytes).expect("a write");
    path
}

fn with_points(points: u64) -> ReadOptions {
    ReadOptions::default().with_mesh_points(Some(points))
}

/// Opens a mesh and samples some points with all columns.
fn sample(path: &Path, count: u64) -> Result<PointBatch, ReadError> {
    let mut source = points::open(path, &with_points(count))?;
    source.select(&(0..source.schema().columns.len()).collect::<Vec<_>>());
    let mut batch = PointBatch::default();
    source.fill(&mut batch, usize::MAX)?;
    Ok(batch)
}

/// What is said of a file that is refused, without its name.
fn refusal(name: &str, bytes: impl AsRef<[u8]>) -> String {
    let folder = folder();
    let error = sample(&write(folder.path(), name, bytes), 10).expect_err("refused").to_string();
    error.split_once(", ").expect("a place").1.to_owned()
}

#[test]
fn a_mesh_gives_the_same_points_in_whatever_format_trimesh_writes_it() {
    let mut expected = MeshSource::open(fixture("ball.ply"), 300).expect("a mesh");
    let mut batch = PointBatch::default();
    expected.fill(&mut batch, 1000).expect("points");
    assert_eq!(batch.len(), 300);
    for name in ["ball.ply", "ball.obj", "ball.stl", "ball-ascii.stl"] {
        let found = sample(&fixture(name), 300).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(found.position, batch.position, "{name}");
        let mut opened = MeshSource::open(fixture(name), 300).unwrap_or_else(|e| panic!("{e}"));
        opened.fill(&mut batch, 1000).expect("points");
        assert_eq!(found.position, batch.position, "{name}");
        // An icosphere of radius 2 with its faces divided once: no point lies deeper than their
        // centres.
        for [x, y, z] in found.position {
            let distance = ((x - 3.0).powi(2) + (y + 1.0).powi(2) + (z - 0.5).powi(2)).sqrt();
            assert!((1.85..2.02).contains(&distance), "{name}: {distance}");
        }
    }
}

#[test]
fn points_of_a_mesh_lie_evenly_so_that_its_surface_has_no_pores() {
    const POINTS: u64 = 10_000;
    let found = sample(&fixture("square.obj"), POINTS).expect("points").position;
    // Among as many random points the largest hole that is found has a radius of 1.57 spacings.
    let spacing = 1.0 / (POINTS as f64).sqrt();
    let nearest = |x: f64, y: f64| {
        let squares = found.iter().map(|p| (p[0] - x).powi(2) + (p[1] - y).powi(2));
        squares.fold(f64::INFINITY, f64::min).sqrt()
    };
    let places = (0..40_u32).flat_map(|i| (0..40).map(move |j| [i, j].map(|k| (f64::from(k) + 0.5) / 40.0)));
    let hole = places.map(|[x, y]| nearest(x, y)).fold(0.0, f64::max);
    assert!(hole < 1.1 * spacing, "{} spacings", hole / spacing);
    // Both halves have as many, in batches of any size.
    let above = found.iter().filter(|p| p[1] > p[0]).count() as u64;
    assert!(above.abs_diff(POINTS / 2) <= 1, "{above}");
    let (mut batch, mut parts) = (PointBatch::default(), Vec::new());
    let mut source = points::open(fixture("square.obj"), &with_points(POINTS)).expect("a mesh");
    while parts.len() < found.len() {
        source.fill(&mut batch, 777).expect("points");
        parts.extend_from_slice(&batch.position);
    }
    assert_eq!(parts, found);
}

#[test]
fn colours_of_vertices_are_interpolated() {
    for (name, largest) in [("square.ply", 255.0), ("square.obj", 1.0)] {
        let schema = points::open(fixture(name), &with_points(1)).expect("a mesh").schema().clone();
        assert!(schema.names().eq(["red", "green", "blue", "nx", "ny", "nz"]), "{name}");
        let found = sample(&fixture(name), 200).expect("points");
        for (i, [x, y, _]) in found.position.iter().enumerate() {
            let color = [0, 1, 2].map(|channel| found.columns[channel].get(i) / largest);
            let error = (color[0] - x).abs().max((color[1] - y).abs()).max(color[2]);
            assert!(error < 1e-6, "{name}: {color:?} at {x}, {y}");
        }
    }
    // One vertex without a colour: there are none.
    let folder = folder();
    let text = "v 0 0 0 1 0 0\nv 1 0 0 1 0 0\nv 0 1 0\nf 1 2 3\n";
    let source = points::open(write(folder.path(), "m.obj", text), &with_points(1)).expect("a mesh");
    assert_eq!(source.schema().names().collect::<Vec<_>>(), ["nx", "ny", "nz"]);
}

/// A PLY of a lattice of vertices, two triangles between four; `more` are a property of vertices
/// and its value.
fn lattice(side: u32, more: Option<(&str, &str)>) -> String {
    let (name, value) =
        more.map_or((String::new(), ""), |(name, value)| (format!("property {name}\n"), value));
    let mut text = format!(
        "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n{name}element face \
         {}\nproperty list uchar int vertex_indices\nend_header\n",
        side * side,
        (side - 1) * (side - 1)
    );
    for i in 0..side * side {
        text += &format!("{} {} 0 {value}\n", i % side, i / side);
    }
    for i in (0..side - 1).flat_map(|y| (0..side - 1).map(move |x| y * side + x)) {
        text += &format!("4 {i} {} {} {}\n", i + 1, i + side + 1, i + side);
    }
    text
}

#[test]
fn a_ply_of_a_shape_is_its_faces_and_one_of_a_scan_or_of_measurements_its_vertices() {
    let folder = folder();
    let open = |text: String| {
        let source =
            points::open(write(folder.path(), "m.ply", text), &ReadOptions::default()).expect("it opens");
        (source.count_hint(), source.schema().warnings.join(" "))
    };
    let (count, said) = open(lattice(3, None));
    assert_eq!(count, Some(1_000_000));
    assert!(said.contains("sampled on the 8 triangles"), "{said}");
    assert_eq!(open(lattice(3, Some(("float nx", "0")))).0, Some(1_000_000));
    for text in [lattice(150, None), lattice(3, Some(("float temperature", "7")))] {
        let (count, said) = open(text);
        assert!(count < Some(30_000) && said.contains("vertices are read, not the"), "{count:?} {said}");
        assert!(said.contains("--mesh-points"), "{said}");
    }
    // Faces without an area leave the vertices.
    let flat = lattice(3, None).replace("4 ", "0 ").replace("\n0 1 2 5 4", "\n3 1 1 1");
    assert!(points::open(write(folder.path(), "f.ply", flat), &ReadOptions::default()).is_ok());
}

#[test]
fn colours_of_vertices_in_off_are_read() {
    let folder = folder();
    for (word, normal) in [("COFF", ""), ("CNOFF", "0 0 1 ")] {
        let vertex = |x: u32, y: u32| format!("{x} {y} 0 {normal}200 80 40 255\n");
        let text = format!("{word}\n3 1 0\n{}{}{}3 0 1 2\n", vertex(0, 0), vertex(1, 0), vertex(0, 1));
        let batch = sample(&write(folder.path(), "m.off", text), 5).expect("a mesh");
        assert_eq!(batch.columns.len(), 6, "{word}");
        assert!(
            (batch.columns[0].get(2) - 200.0).abs() < 1e-3 && (batch.columns[2].get(2) - 40.0).abs() < 1e-3
        );
    }
}

#[test]
fn without_a_number_there_are_ten_points_a_triangle_within_bounds() {
    let none = ReadOptions::default();
    for name in ["ball.ply", "ball.obj", "ball.stl", "ball-ascii.stl"] {
        let source = points::open(fixture(name), &none).expect("it opens");
        assert_eq!(source.count_hint(), Some(1_000_000), "{name}");
        let warnings = &source.schema().warnings;
        assert_eq!(warnings, &["1000000 points are sampled on the 80 triangles of a mesh"], "{name}");
        let asked = points::open(fixture(name), &with_points(77)).expect("it opens");
        assert_eq!((asked.count_hint(), asked.schema().warnings.len()), (Some(77), 0));
    }
    let folder = folder();
    let fan: String = (0..150_000).map(|_| "f 1 2 3\n").collect();
    let text = format!("v 0 0 0\nv 1 0 0\nv 0 1 0\n{fan}");
    let source = points::open(write(folder.path(), "m.obj", text), &none).expect("it opens");
    assert_eq!(source.count_hint(), Some(1_500_000));
    // A binary STL of zeros, which take no room on disk.
    let path = write(folder.path(), "m.stl", [&[0; 80][..], &2_000_001_u32.to_le_bytes()].concat());
    let file = std::fs::File::options().write(true).open(&path).expect("a file");
    file.set_len(84 + 50 * 2_000_001).expect("a length");
    let source = points::open(&path, &none).expect("it opens");
    assert_eq!(source.count_hint(), Some(20_000_000));
}

#[test]
fn faces_of_obj_have_any_number_of_corners_counted_from_either_end() {
    let folder = folder();
    let square = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n";
    let points = |text: String| {
        sample(&write(folder.path(), "m.obj", text), 100).unwrap_or_else(|e| panic!("{e}")).position
    };
    let expected = points(format!("{square}f 1 2 3\nf 1 3 4\n"));
    for text in [
        format!("{square}f 1 2 3 4\n"),
        format!("{square}f -4 -3 -2 -1\n"),
        format!(
            "mtllib a b.mtl\no gr\u{f6}\u{df}e\n{square}vt 0 0\nvn 0 0 1\ng one two\ns off\nusemtl x\nf 1/1/1 2/1/1 3//1 4/1\nl 1 2\n"
        ),
        // Faces may come first, with a weight behind coordinates, and lines go on behind a
        // backslash.
        format!("f 1 2 \\\n3 4\r\n{}", square.replace(" 0\n", " 0 1.0\n")),
    ] {
        assert_eq!(points(text.clone()), expected, "{text}");
    }
    assert_eq!(points(format!("{square}v 0 0 9\nf -5 -4 -3 -2\n")), expected);
}

#[test]
fn an_obj_without_faces_gives_its_vertices() {
    let folder = folder();
    let path = write(folder.path(), "m.obj", "# by hand\nv 1 2 3 0.5 0 1\nvn 0 0 1\nv 4 5 6 0 0.25 1\n");
    for options in [ReadOptions::default(), with_points(9)] {
        assert_eq!(points::open(&path, &options).expect("it opens").count_hint(), Some(2));
    }
    let found = table(&path, None).expect("it reads");
    assert_eq!(found.0, [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]);
    let columns: Vec<_> = found.1.iter().map(|(name, values)| (name.as_str(), values.as_slice())).collect();
    assert_eq!(columns, [("red", &[0.5, 0.0][..]), ("green", &[0.0, 0.25]), ("blue", &[1.0, 1.0])]);
}

#[test]
fn what_is_wrong_in_an_obj_file_is_said_with_its_line() {
    for (text, expected) in [
        ("v 0 0\n", "line 1: a vertex of 2 numbers; expected x, y and z"),
        ("\nv 0 0 zero\n", "line 2: `zero` is not a number"),
        ("# nothing\n", "line 1: no vertices: no line begins with `v`"),
        (
            "v 0 0 0\nf 1 0 1\n",
            "line 2: `0` is no corner of a face; expected the number of a vertex from 1 on, or from -1 back to -1",
        ),
        ("v 0 0 0\nf 1 -2 1\n", "line 2: `-2` is no corner"),
        ("v 0 0 0\nf 1 a/1 1\n", "line 2: `a/1` is no corner"),
        (
            "v 0 0 0\nf 1 7 2\nf 3 1 1\nv 0 0 1\n",
            "line 2: a corner is vertex 7, which is not there: there are 2, counted from 1",
        ),
        ("v 0 0 0\nv 1 0 0\nf 1 2 1\n", "line 1: the mesh has no faces with an area"),
        ("v 0 0 0\nv 1 nan 0\nv 1 1 1\nf 1 2 3\n", "line 1: a face has a corner that is not finite"),
    ] {
        let said = refusal("m.obj", text);
        assert!(said.starts_with(expected), "{said}\n{expected}");
    }
    assert!(
        refusal("m.obj", format!("v {}", "1 ".repeat(40_000)))
            .starts_with("line 1: a line of more than 65536 bytes")
    );
}

#[test]
fn a_binary_stl_is_one_by_its_size_whatever_it_begins_with() {
    let binary = std::fs::read(fixture("ball.stl")).expect("a fixture");
    let folder = folder();
    let expected = sample(&fixture("ball.stl"), 50).expect("points").position;
    let mut solid = binary.clone();
    solid[..12].copy_from_slice(b"solid object");
    assert_eq!(sample(&write(folder.path(), "m.stl", &solid), 50).expect("points").position, expected);
    // Bytes behind the triangles are no harm, unless it may be text.
    let longer = [&binary[..], b"more"].concat();
    assert_eq!(sample(&write(folder.path(), "m.stl", longer), 50).expect("points").position, expected);
    let cut = &binary[..binary.len() - 1];
    let said = refusal("m.stl", cut);
    assert_eq!(said, "byte 4083: the file ends early: 80 triangles take 4084 bytes, of which it has 4083");
    assert!(refusal("m.stl", &binary[..83]).contains("not an STL file"));
    // Text is known by its content.
    let text = std::fs::read(fixture("ball-ascii.stl")).expect("a fixture");
    assert_eq!(sample(&write(folder.path(), "no-name", text), 50).expect("points").position, expected);
}

#[test]
fn what_is_wrong_in_an_ascii_stl_is_said_with_its_line() {
    let facet = |lines: &str| {
        format!("solid a\nfacet normal 0 0 1\nouter loop\n{lines}endloop\nendfacet\nendsolid\n")
    };
    let good = "vertex 0 0 0\nVERTEX 1 0 0\nvertex 0 1e0 0\n";
    let folder = folder();
    assert_eq!(sample(&write(folder.path(), "m.stl", facet(good)), 5).expect("points").len(), 5);
    for (text, expected) in [
        (facet("vertex 0 0 0\n"), "line 6: `endfacet` after 1 vertices of a facet, which has 3"),
        (facet(&good.repeat(2)), "line 7: `vertex` after 3 vertices of a facet"),
        (facet(&good.replace("1e0", "one")), "line 6: `one` is not a number"),
        (facet(&good.replace("1e0 0", "1")), "line 6: a vertex of 2 numbers; expected three"),
        (facet("triangle\n"), "line 4: `triangle` where facet, outer loop, vertex"),
        (
            facet(good).replace("endsolid\n", ""),
            "line 8: the file ends early: no `endsolid` after 1 triangles",
        ),
        ("solid nothing\nendsolid\n".into(), "line 1: the mesh has no faces with an area"),
    ] {
        let said = refusal("m.stl", &text);
        assert!(said.starts_with(expected), "{said}\n{expected}");
    }
}

#[test]
fn a_mesh_counts_in_the_memory_of_a_build_before_it_is_loaded() {
    // 300 000 vertices of 24 bytes, 100 000 triangles of 20.
    let folder = folder();
    let mut stl = vec![0_u8; 84];
    stl[80..].copy_from_slice(&100_000_u32.to_le_bytes());
    for i in 0..100_000_u32 {
        let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, i as f32]];
        stl.extend([0; 12]);
        corners.iter().flatten().for_each(|v: &f32| stl.extend(v.to_le_bytes()));
        stl.extend([0; 2]);
    }
    let path = write(folder.path(), "m.stl", stl);
    let source = points::open(&path, &with_points(1000)).expect("it opens");
    let needed = source.memory_needed();
    assert!((9_200_000..10_000_000).contains(&needed), "{needed}");
    let options = BuildOptions { memory_bytes: 15 << 20, threads: 1, ..BuildOptions::default() };
    let cloud = folder.path().join("m.rset");
    let refused =
        build::run(vec![source], &cloud, &options, &BuildControl::default()).expect_err("too little");
    let BuildError::Memory { needed, .. } = refused else { panic!("{refused}") };
    let source = points::open(&path, &with_points(1000)).expect("it opens");
    let built = build::run(
        vec![source],
        &cloud,
        &BuildOptions { memory_bytes: needed, ..options },
        &BuildControl::default(),
    );
    assert_eq!(built.expect("enough").points, 1000);
}

#[test]
fn damaged_and_shortened_meshes_are_errors_or_other_meshes_and_never_panic() {
    let folder = folder();
    for name in ["ball.ply", "ball.obj", "ball.stl", "ball-ascii.stl", "square.obj"] {
        let whole = std::fs::read(fixture(name)).expect("a fixture");
        let step = (whole.len() / 400).max(1);
        for at in (0..whole.len()).step_by(step) {
            let cut = sample(&write(folder.path(), name, &whole[..at]), 3);
            // A text may end after any face.
            assert!(cut.is_err() || name.ends_with("obj"), "{name} without its end from byte {at}");
            let mut flipped = whole.clone();
            flipped[at] ^= 0xff;
            if let Err(error) = sample(&write(folder.path(), name, &flipped), 3) {
                assert!(!error.to_string().contains("failed to fill"), "{error}");
            }
        }
    }
}

#[test]
fn remarks_behind_the_numbers_of_an_obj_file_are_passed_over() {
    let folder = folder();
    let text = "v 0 0 0 # first\nv 1 0 0 #second\nv 0 1 0\nf 1 2 3 # a face of 3 corners\n";
    let path = write(folder.path(), "a.obj", text);
    let points = sample(&path, 10).expect("a mesh");
    assert_eq!(points.len(), 10);
}
