//! Arrays of NumPy: every layout that numpy writes, archives, what is no points, and damage.

use rayset::points::{self, ColorDepth, ColumnType, ReadOptions};

use crate::common::{folder, real_data};
use crate::fixture::{attempt, check_all, damage, fixtures, read_all};

#[test]
fn arrays_and_archives_are_read_as_numpy_wrote_them() {
    check_all("npy");
}

#[test]
fn colours_have_the_range_of_their_type_and_classes_are_classes() {
    let schema = |name: &str| {
        let source = points::open(fixtures("npy").join(name), &ReadOptions::default()).expect("points");
        source.schema().clone()
    };
    // Programs keep colours of 0 to 255 in wider integers, too: their values decide.
    assert_eq!(schema("stored.npz").color_depth, ColorDepth::Guess);
    let structured = schema("structured.npy");
    assert_eq!(structured.color_depth, ColorDepth::Byte);
    assert!(structured.columns[structured.find("class").expect("there")].is_class);
    assert!(structured.find("name").is_none(), "no column holds texts");
    assert!(structured.find("half").is_some(), "half precision becomes single");
    assert!(schema("stored.npz").description.contains("ignored (4 × 4 × 4)"));
}

#[test]
fn numbers_of_half_precision_are_positions_and_columns_of_single_precision() {
    let schema = |name: &str| {
        let source = points::open(fixtures("npy").join(name), &ReadOptions::default()).expect("points");
        source.schema().clone()
    };
    for (name, column) in [
        ("structured.npy", "half"),
        ("halves.npy", "intensity"),
        ("halves.npz", "t"),
        ("halves_structured.npy", "green"),
    ] {
        let schema = schema(name);
        let column = schema.find(column).unwrap_or_else(|| panic!("{name}: no {column}"));
        assert_eq!(schema.columns[column].kind, ColumnType::F32, "{name}");
    }
}

#[test]
fn names_of_columns_can_be_given_for_plain_arrays() {
    let open = |names: &str| {
        let names = names.split(',').map(str::to_owned).collect();
        points::open(
            fixtures("npy").join("fortran.npy"),
            &ReadOptions::default().with_text_columns(Some(names)),
        )
    };
    let source = open("z,y,-,x,mass").expect("names");
    assert_eq!(source.schema().names().collect::<Vec<_>>(), ["mass"]);
    let said = open("x,y,z").err().expect("too few").to_string();
    assert!(said.contains("3 names of columns are given for rows of 5 numbers"), "{said}");
    let said = open("a,b,c,d,e").err().expect("no axes").to_string();
    assert!(said.contains("no x, y and z"), "{said}");
}

#[test]
fn arrays_that_are_no_points_are_refused_with_what_they_are() {
    for (name, part) in [
        ("volume.npy", "it has 4 × 5 × 6 elements: a volume"),
        ("line.npy", "it has 9 numbers; expected N × 3"),
        ("objects.npy", "objects of Python"),
        ("texts.npy", "elements are of the type <U1"),
        ("nothing.npz", "it has a (5 × 2), b (7)"),
    ] {
        let said = attempt(&fixtures("npy").join(name)).expect_err(name);
        assert!(said.contains(part), "{said}");
    }
}

/// A file of version 1 with an array of some type and shape.
fn array(descr: &str, shape: &str, data: &[u8]) -> Vec<u8> {
    let mut header = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}");
    while (header.len() + 11) % 64 != 0 {
        header.push(' ');
    }
    header.push('\n');
    [b"\x93NUMPY\x01\x00".as_slice(), &(header.len() as u16).to_le_bytes(), header.as_bytes(), data].concat()
}

fn of_array(
    descr: &str,
    shape: &str,
    data: &[u8],
) -> Result<(Vec<String>, rayset::points::PointBatch), String> {
    let folder = folder();
    let path = folder.path().join("a.npy");
    std::fs::write(&path, array(descr, shape, data)).expect("a write");
    let mut source = points::open(&path, &ReadOptions::default()).map_err(|error| error.to_string())?;
    let names = source.schema().names().map(str::to_owned).collect();
    Ok((names, read_all(&mut *source, 4096).map_err(|error| error.to_string())?))
}

#[test]
fn numbers_of_half_precision_are_read_in_either_byte_order() {
    // 1, -2, 0.5 and 3, 0, 65504.
    let halves = [0x3c00_u16, 0xc000, 0x3800, 0x4200, 0, 0x7bff];
    let little: Vec<u8> = halves.iter().flat_map(|h| h.to_le_bytes()).collect();
    let big: Vec<u8> = halves.iter().flat_map(|h| h.to_be_bytes()).collect();
    for (descr, data) in [("<f2", little), (">f2", big)] {
        let (_, points) = of_array(descr, "(2, 3)", &data).expect(descr);
        assert_eq!(points.position, [[1.0, -2.0, 0.5], [3.0, 0.0, 65504.0]], "{descr}");
    }
}

#[test]
fn columns_of_a_plain_array_are_known_by_its_values_in_either_order_of_memory() {
    let rows: Vec<[f32; 7]> =
        (0..70).map(|i| [i as f32, (i * i % 7) as f32, 0.5, 200.0, 90.0, i as f32, (i % 3) as f32]).collect();
    let data: Vec<u8> = rows.iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
    assert_eq!(of_array("<f4", "(70, 7)", &data).expect("points").0, ["red", "green", "blue", "label"]);
    let normals: Vec<u8> = (0..70)
        .flat_map(|i| [i as f32, (i * i % 7) as f32, 0.5, 0.6, 0.0, -0.8])
        .flat_map(f32::to_le_bytes)
        .collect();
    assert_eq!(of_array("<f4", "(70, 6)", &normals).expect("points").0, ["nx", "ny", "nz"]);
}

#[test]
fn pictures_depth_maps_and_batches_of_clouds_are_refused_with_what_to_do() {
    let of = |descr, shape, bytes| of_array(descr, shape, &vec![0; bytes]).expect_err(shape);
    assert!(of("|u1", "(20, 30, 3)", 1800).contains("a picture"));
    assert!(
        of("<f4", "(5, 64, 3)", 3840).contains("several clouds, of which `numpy.save(\"points.npy\", a[0])`")
    );
    assert!(of("<f4", "(48, 80)", 15360).contains("a depth map"));
}

#[test]
fn an_archive_whose_bytes_are_not_those_of_its_checksum_is_an_error() {
    let folder = folder();
    let path = folder.path().join("p.npz");
    let mut bytes = std::fs::read(fixtures("npy").join("stored.npz")).expect("a fixture");
    // A byte in the middle of the positions, which are stored as they are.
    let name = bytes.windows(13).position(|w| w == b"positions.npy").expect("the member");
    bytes[name + 400] ^= 1;
    std::fs::write(&path, &bytes).expect("a write");
    let said = attempt(&path).expect_err("a wrong byte");
    assert!(said.contains("positions does not have its checksum"), "{said}");
}

#[test]
fn damaged_arrays_are_errors_and_never_panics() {
    // A shortened array is always an error, for its header says how long it is.
    let bytes = std::fs::metadata(fixtures("npy").join("structured.npy")).expect("a fixture").len() as usize;
    assert_eq!(damage(&fixtures("npy").join("structured.npy"), 13), bytes.div_ceil(13));
    assert!(damage(&fixtures("npy").join("deflated.npz"), 11) > 50);
    assert!(damage(&fixtures("npy").join("fortran.npy"), 19) > 30);
}

#[test]
fn real_arrays_have_the_sums_that_numpy_finds() {
    let sums = |name: &str, columns: &[&str]| {
        let path = real_data(name)?;
        let mut source = points::open(&path, &ReadOptions::default()).expect("points");
        let all = read_all(&mut *source, 4096).expect("rows");
        let axes = (0..3).map(|axis| all.position.iter().map(|p| p[axis]).sum::<f64>());
        let column = |name: &&str| &all.columns[source.schema().find(name).expect("a column")];
        let of = columns.iter().map(|name| (0..all.len()).map(|i| column(name).get(i)).sum::<f64>());
        Some(axes.chain(of).collect::<Vec<_>>())
    };
    let near = |found: Option<Vec<f64>>, expected: &[f64]| {
        for (found, expected) in found.iter().flatten().zip(expected) {
            assert!((found / expected - 1.0).abs() < 1e-9, "{found}, expected {expected}");
        }
    };
    near(sums("npy/halo_low_res.npy", &[]), &HALO);
    near(sums("npy/1.2-with-color.npy", &["gps_time", "red", "scan_angle_rank"]), &LIDAR);
}

const HALO: [f64; 3] = [2_478_069.063_125_610_4, 614_085.921_104_431_2, 2_951_612.693_397_522];
const LIDAR: [f64; 6] =
    [67_872_102_297.0, 90_658_075_849.0, 46_231_420.0, 263_704_809.390_784_8, 129_567.0, -807.0];
