//! Tables as programs write them whose columns have other names, other line ends, other decimal
//! marks, or none of these; and how columns were read is said.

use rayset::points::{self, PointBatch, ReadOptions, Schema};

use crate::common::folder;
use crate::fixture::{fixtures, read_all};

/// The schema and all points of a file of this name, read with these names of columns.
fn read_as(name: &str, bytes: &[u8], columns: Option<&str>) -> Result<(Schema, PointBatch), String> {
    let folder = folder();
    let path = folder.path().join(name);
    std::fs::write(&path, bytes).expect("a write");
    let names = columns.map(|names| names.split(',').map(str::to_owned).collect());
    let opened = points::open(&path, &ReadOptions::default().with_text_columns(names));
    let mut source = opened.map_err(|error| error.to_string())?;
    let points = read_all(&mut *source, 1000).map_err(|error| error.to_string())?;
    Ok((source.schema().clone(), points))
}

fn read(name: &str, bytes: impl AsRef<[u8]>) -> (Schema, PointBatch) {
    read_as(name, bytes.as_ref(), None).unwrap_or_else(|said| panic!("{said}"))
}

/// A file of NumPy, of version 1.
fn array(descr: &str, shape: &str, data: &[u8]) -> Vec<u8> {
    let mut header = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}");
    while (header.len() + 11) % 64 != 0 {
        header.push(' ');
    }
    header.push('\n');
    [b"\x93NUMPY\x01\x00".as_slice(), &(header.len() as u16).to_le_bytes(), header.as_bytes(), data].concat()
}

fn floats(count: u32, value: impl Fn(u32) -> f32) -> Vec<u8> {
    (0..count).flat_map(|i| value(i).to_le_bytes()).collect()
}

/// An archive of arrays, as `numpy.savez` stores them.
pub(crate) fn archive(arrays: &[(&str, Vec<u8>)]) -> Vec<u8> {
    let (mut bytes, mut directory) = (Vec::new(), Vec::new());
    for (name, data) in arrays {
        let mut sum = flate2::Crc::new();
        sum.update(data);
        let (name, size) = (format!("{name}.npy"), data.len() as u32);
        let mut shared = [20_u16, 0, 0, 0, 0].iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
        [sum.sum(), size, size].iter().for_each(|v| shared.extend(v.to_le_bytes()));
        shared.extend([name.len() as u16, 0].iter().flat_map(|v| v.to_le_bytes()));
        directory.extend(b"PK\x01\x02\x14\x00");
        directory.extend(&shared);
        directory.extend([0; 10]);
        directory.extend((bytes.len() as u32).to_le_bytes());
        directory.extend(name.bytes());
        bytes.extend(b"PK\x03\x04");
        bytes.extend(shared);
        bytes.extend(name.bytes());
        bytes.extend(data);
    }
    let (start, size, count) = (bytes.len() as u32, directory.len() as u32, arrays.len() as u16);
    bytes.extend(directory);
    bytes.extend(b"PK\x05\x06\0\0\0\0");
    [count, count].iter().for_each(|v| bytes.extend(v.to_le_bytes()));
    [size, start].iter().for_each(|v| bytes.extend(v.to_le_bytes()));
    bytes.extend([0; 2]);
    bytes
}

/// What gsplat's own asset has: centres, colours, and cameras.
fn gaussians(name: &str) -> Vec<u8> {
    archive(&[
        ("viewmats", array("<f4", "(3, 4, 4)", &floats(48, |_| 0.0))),
        ("Ks", array("<f4", "(3, 3, 3)", &floats(27, |_| 1.0))),
        ("scales", array("<f4", "(50, 3)", &floats(150, |_| 0.1))),
        (name, array("<f4", "(50, 3)", &floats(150, |i| i as f32))),
        ("colors", array("|u1", "(50, 3)", &[200; 150])),
        ("poses", array("<f4", "(3, 4)", &floats(12, |_| 0.0))),
        ("height", array("<i8", "()", &5_i64.to_le_bytes())),
    ])
}

#[test]
fn the_array_of_three_numbers_that_others_agree_with_is_the_points() {
    for name in ["means3d", "anything"] {
        let (schema, points) = read("a.npz", gaussians(name));
        assert_eq!((points.len(), points.position[49]), (50, [147.0, 148.0, 149.0]), "{name}");
        assert!(schema.find("red").is_some() && schema.reading.contains(name), "{}", schema.reading);
    }
    // The matrices of its cameras are no volume.
    let folder = folder();
    let path = folder.path().join("a.npz");
    std::fs::write(&path, gaussians("means3d")).expect("a write");
    assert!(!rayset::volumes::is_volume(&path).expect("it reads"));
}

#[test]
fn dimensions_of_length_one_do_not_count() {
    let row = |i: u32| if i % 6 < 3 { (i * i % 97) as f32 } else { (i % 200) as f32 };
    for shape in ["(1, 60, 6)", "(60, 1, 6)", "(1, 1, 60, 6)"] {
        let (schema, points) = read("a.npy", array("<f4", shape, &floats(360, row)));
        assert_eq!(points.len(), 60, "{shape}");
        assert_eq!(schema.names().collect::<Vec<_>>(), ["red", "green", "blue"], "{shape}");
    }
}

#[test]
fn how_columns_were_read_is_said_and_names_of_columns_say_otherwise() {
    let rows: String = (0..40)
        .map(|i| {
            let (light, other) = (i * 37 % 100, i * 61 % 251);
            format!(
                "{} {} 0.5 {} {} {} {other}\n",
                f64::from(i).sin(),
                i % 9,
                50 + light,
                80 + light,
                120 + light
            )
        })
        .collect();
    let (schema, _) = read("a.xyz", &rows);
    let said = &schema.reading;
    assert!(said.contains("by the values of the first rows: x,y,z,red,green,blue,intensity"), "{said}");
    assert!(
        said.contains("--columns") && schema.description.contains("x,y,z,red,green,blue,intensity"),
        "{said}"
    );
    let (schema, _) = read_as("a.xyz", rows.as_bytes(), Some("x,y,z,intensity,r,g,b")).expect("names");
    assert!(schema.reading.ends_with("by --columns: x,y,z,intensity,red,green,blue"), "{}", schema.reading);
    let (schema, _) = read("a.csv", "Rechtswert;Hochwert;Höhe;t;Rf;Gf;Bf\n1;2;3;4;0,5;0,25;1\n");
    assert!(schema.reading.contains("by the header on line 1: x,y,z,t,red,green,blue"), "{}", schema.reading);
    let (schema, _) = read("a.npy", array("<f4", "(20, 4)", &floats(80, |i| (i * i % 31) as f32 + 0.5)));
    assert!(
        schema.reading.contains("by the values of the first rows: x,y,z,intensity"),
        "{}",
        schema.reading
    );
    // An archive, a table of its arrays.
    let archive = gaussians("means3d");
    let (schema, _) = read("a.npz", &archive);
    let list = "x,y,z,scales_x,scales_y,scales_z,red,green,blue";
    assert!(schema.reading.contains(list), "{}", schema.reading);
    let (schema, points) = read_as("a.npz", &archive, Some("-,-,-,x,y,z,nx,ny,nz")).expect("names");
    assert_eq!(schema.names().collect::<Vec<_>>(), ["nx", "ny", "nz"]);
    assert!((points.position[7][0] - 0.1).abs() < 1e-7);
    let said = read_as("a.npz", &archive, Some("x,y,z")).expect_err("too few");
    assert!(
        said.contains("3 names of columns are given for rows of 9 numbers") && said.contains("scales_x"),
        "{said}"
    );
    // A format that names its columns has nothing to say.
    let ply = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n1 2 3\n";
    assert_eq!(read("a.ply", ply).0.reading, "");
}

#[cfg(feature = "hdf5")]
#[test]
fn columns_of_snapshots_are_said_and_can_have_other_names() {
    let path = fixtures("snapshots").join("gadget.hdf5");
    let open =
        |names: Option<Vec<String>>| points::open(&path, &ReadOptions::default().with_text_columns(names));
    let source = open(None).expect("it opens");
    let reading = &source.schema().reading;
    assert!(reading.starts_with("columns, by the names of datasets: x,y,z,radius,weight,mass"), "{reading}");
    let mut names: Vec<String> = ["z", "y", "x"].map(str::to_owned).to_vec();
    names.extend(
        source.schema().names().map(|name| if name == "mass" { "m".to_owned() } else { "-".to_owned() }),
    );
    let mut other = open(Some(names)).expect("names");
    assert_eq!(other.schema().names().collect::<Vec<_>>(), ["m"]);
    let (mut first, mut turned) = (PointBatch::default(), PointBatch::default());
    let mut source = source;
    source.fill(&mut first, 1).expect("a point");
    other.fill(&mut turned, 1).expect("a point");
    let [x, y, z] = first.position[0];
    assert_eq!(turned.position[0], [z, y, x]);
    let said = open(Some(vec!["x".into(), "y".into(), "z".into()])).err().expect("too few").to_string();
    assert!(said.contains("3 names of columns are given for"), "{said}");
}

#[test]
fn lines_end_with_carriage_returns_alone_in_files_that_have_no_others() {
    for (name, text) in [
        ("a.xyz", "1 2 3\r4 5 6\r"),
        ("a.csv", "x,y,z\r1,2,3\r4,5,6"),
        (
            "a.ply",
            "ply\rformat ascii 1.0\relement vertex 2\rproperty float x\rproperty float y\rproperty float z\rend_header\r1 2 3\r4 5 6\r",
        ),
        ("a.obj", "v 1 2 3\rv 4 5 6\r"),
    ] {
        assert_eq!(read(name, text).1.position, [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]], "{name}");
    }
}

#[test]
fn bytes_of_0_behind_the_last_line_are_passed_over() {
    let rows = "1 2 3\n4 5 6";
    for (name, zeros) in [("a.xyz", 1), ("a.xyz", 512), ("a", 512), ("a.txt", 200_000)] {
        for end in ["", "\n"] {
            let text = [rows.as_bytes(), end.as_bytes(), &vec![0; zeros]].concat();
            assert_eq!(read(name, text).1.position, [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]], "{name}, {zeros}");
        }
    }
    let within = [rows.as_bytes(), &[0; 20], b"\n7 8 9\n"].concat();
    assert!(read_as("a.xyz", &within, None).is_err(), "a hole is damage");
}

#[test]
fn a_comma_is_the_decimal_mark_in_quotes_and_in_ply_where_it_separates_no_thousands() {
    let quoted = "x,y,z\n\"0,473\",\"-11,542\",\"0,047\"\n\"1,5\",2,\"3,25\"\n";
    assert_eq!(read("a.csv", quoted).1.position, [[0.473, -11.542, 0.047], [1.5, 2.0, 3.25]]);
    let bare = "\"0,5\",\"1,5\",\"2,5\"\n\"3,5\",\"4,5\",\"5,5\"\n";
    assert_eq!(read("a.csv", bare).1.position, [[0.5, 1.5, 2.5], [3.5, 4.5, 5.5]]);
    // These may be thousands.
    let said = read_as("a.csv", b"x,y,z\n\"652,000\",\"6,862,000\",\"100\"\n", None).expect_err("thousands");
    assert!(said.contains("652,000"), "{said}");
    let said = read_as("a.csv", b"x,y,z\n\"652,000\",\"862,000\",\"100,000\"\n", None).expect_err("either");
    assert!(said.contains("thousands"), "{said}");
    let ply = |row: &str| {
        format!(
            "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty double y\nproperty float z\nend_header\n{row}\n"
        )
    };
    assert_eq!(read("a.ply", ply("0,5 -11,542 3")).1.position, [[0.5, -11.542, 3.0]]);
    let said = read_as("a.ply", ply("0,5 1.5 3").as_bytes(), None).expect_err("two marks");
    assert!(said.contains("`1.5` has two decimal marks, or another"), "{said}");
}

#[test]
fn colours_have_the_names_of_cloudcompare_and_those_of_faces_are_used() {
    let (schema, points) =
        read("a.asc", "//X,Y,Z,Rf,Gf,Bf,Intensity\n1,2,3,0.5,0.25,1,7\n4,5,6,0.5,0.25,1,8\n");
    let column = |name: &str| points.columns[schema.find(name).unwrap_or_else(|| panic!("{name}"))].get(0);
    assert_eq!(["red", "green", "blue"].map(column), [0.5, 0.25, 1.0]);
    let head = |names: [&str; 3]| {
        let names = names.map(|name| format!("property float {name}\n")).concat();
        format!(
            "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n{names}end_header\n"
        )
    };
    let (schema, points) = read("a.ply", head(["scalar_R", "scalar_G", "scalar_B"]) + "1 2 3 200 100 50\n");
    let column = |name: &str| points.columns[schema.find(name).unwrap_or_else(|| panic!("{name}"))].get(0);
    assert_eq!(["red", "green", "blue"].map(column), [200.0, 100.0, 50.0]);
    // Two triangles, side by side.
    let faces = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nelement face 2\n\
                 property list uchar int vertex_indices\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n\
                 0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2 200 40 30\n3 0 2 3 40 70 200\n";
    let (schema, points) = read("a.ply", faces);
    assert_eq!(schema.names().collect::<Vec<_>>(), ["red", "green", "blue", "nx", "ny", "nz"]);
    assert!(points.len() > 1000);
    for i in 0..points.len() {
        let [x, y, _] = points.position[i];
        // On the edge that they share it is either.
        if (x - y).abs() < 1e-6 {
            continue;
        }
        let expected = if x > y { [200.0, 40.0, 30.0] } else { [40.0, 70.0, 200.0] };
        assert_eq!([0, 1, 2].map(|channel| points.columns[channel].get(i)), expected, "{x} {y}");
    }
}
