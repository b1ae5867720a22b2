//! Points of VTK: every encoding that its own writers have, what is no points, and damage.

use rayset::points::{self, ColorDepth, ReadOptions};

use crate::common::{folder, real_data};
use crate::fixture::{attempt, check_all, damage, fixtures, read_all};

#[test]
fn every_encoding_of_vtk_gives_the_same_points() {
    check_all("vtk");
}

#[test]
fn bytes_of_colours_are_colours_and_texts_are_left_out() {
    for name in ["poly_text_42.vtk", "grid_binary_42.vtk", "binary_zlib.vtp"] {
        let source = points::open(fixtures("vtk").join(name), &ReadOptions::default()).expect("points");
        let schema = source.schema();
        assert_eq!(schema.color_depth, ColorDepth::Byte, "{name}");
        let mut names: Vec<&str> = schema.names().collect();
        names.sort_unstable();
        let expected =
            ["blue", "green", "id", "q_0", "q_1", "q_2", "q_3", "red", "temp erature", "v_x", "v_y", "v_z"];
        assert_eq!(names, expected, "{name}");
    }
}

#[test]
fn grids_and_files_of_files_are_refused_with_the_way_to_a_volume() {
    let said = attempt(&fixtures("vtk").join("image.vtk")).expect_err("a grid");
    assert!(said.contains("STRUCTURED_POINTS, a grid and no points") && said.contains(".vti"), "{said}");
    let said = attempt(&fixtures("vtk").join("rectilinear.vtr")).expect_err("a grid");
    assert!(said.contains("`RectilinearGrid`: it is a grid") && said.contains(".vti"), "{said}");
    let folder = folder();
    let path = folder.path().join("a.pvtp");
    std::fs::write(&path, "<VTKFile type=\"PPolyData\"><PPolyData/></VTKFile>").expect("a write");
    let said = attempt(&path).expect_err("a file of files");
    assert!(said.contains("of a file that names others"), "{said}");
}

#[test]
fn a_text_that_is_no_number_is_an_error_with_its_place() {
    let folder = folder();
    let text = std::fs::read_to_string(fixtures("vtk").join("grid_text_51.vtk").as_path());
    let text = String::from_utf8_lossy(&text.map(String::into_bytes).expect("text")).into_owned();
    let path = folder.path().join("a.vtk");
    let at = text.find("POINTS").expect("points");
    let changed = format!("{}{}", &text[..at], text[at..].replacen('.', "x", 1));
    std::fs::write(&path, changed).expect("a write");
    let said = attempt(&path).expect_err("no number");
    assert!(said.contains("is no f32"), "{said}");
}

#[test]
fn damaged_files_of_vtk_are_errors_and_never_panics() {
    for (name, step, least) in [
        ("poly_text_42.vtk", 47, 10),
        ("poly_binary_51.vtk", 37, 10),
        ("grid_binary_42.vtk", 41, 10),
        ("binary_zlib.vtp", 71, 60),
        ("raw_big.vtu", 73, 60),
        ("base64_zlib.vtu", 79, 50),
    ] {
        let refused = damage(&fixtures("vtk").join(name), step);
        assert!(refused > least, "{name}: {refused} of the shortened files were refused");
    }
}

#[test]
fn real_files_of_vtk_have_the_sums_that_pyvista_finds() {
    for (name, columns, expected) in REAL {
        let Some(path) = real_data(&format!("particles/{name}")) else { return };
        let mut source = points::open(&path, &ReadOptions::default()).expect("points");
        let all = read_all(&mut *source, 3000).expect("points");
        let axes = (0..3).map(|axis| all.position.iter().map(|p| p[axis]).sum::<f64>());
        let column = |name: &&str| &all.columns[source.schema().find(name).expect("a column")];
        let sums = columns.iter().map(|name| (0..all.len()).map(|i| column(name).get(i)).sum::<f64>());
        for (found, expected) in axes.chain(sums).zip(expected) {
            assert!((found / expected - 1.0).abs() < 1e-9, "{name}: {found}, expected {expected}");
        }
    }
}

/// Names, columns, and the sums of the three coordinates and of the columns.
const REAL: [(&str, &[&str], &[f64]); 3] = [
    (
        "bunny_frame_14_7705_particles.vtk",
        &["id", "velocity_y"],
        &[
            1_203.143_139_020_030_5,
            10_506.900_533_020_496,
            -1_183.077_046_958_555,
            29_687_365.0,
            -17_347.522_460_887_674,
        ],
    ),
    (
        "double_dam_break_frame_26_4732_particles.vtk",
        &["id", "velocity_x"],
        &[
            -0.121_507_073_519_751_43,
            170.652_693_745_025_32,
            1.794_107_503_083_068_9,
            11_193_546.0,
            -1.805_514_989_944_640_5,
        ],
    ),
    (
        "stars.vtp",
        &["lum", "ci", "red", "blue"],
        &[
            -52_198.889_489_931_404,
            186_515.202_801_093_46,
            -767_768.015_471_03,
            7_161_273.420_812_206,
            75_611.142_982_878_72,
            26_291_344.0,
            23_703_113.0,
        ],
    ),
];

/// A legacy file of three points in text, with what goes behind them.
fn legacy(folder: &std::path::Path, behind: &str) -> std::path::PathBuf {
    let path = folder.join("a.vtk");
    let text = format!(
        "# vtk DataFile Version 5.1\nt\nASCII\nDATASET POLYDATA\nPOINTS 3 float\n0 0 0 1 0 0 0 1 0\n{behind}"
    );
    std::fs::write(&path, text).expect("a write");
    path
}

#[test]
fn what_is_told_of_the_arrays_of_a_field_is_no_array() {
    let folder = folder();
    let told = "METADATA\nINFORMATION 1\nNAME L2_NORM_RANGE LOCATION vtkDataArray\nDATA 2 0 1\n\n";
    let path = legacy(
        folder.path(),
        &format!(
            "POINT_DATA 3\nFIELD f 3\na 1 3 int\n1 2 3\n{told}b 1 3 int\n4 5 6\n{told}c 1 3 int\n7 8 9\n{told}"
        ),
    );
    let mut source = points::open(&path, &ReadOptions::default()).expect("points");
    assert_eq!(source.schema().names().collect::<Vec<_>>(), ["a", "b", "c"]);
    let all = read_all(&mut *source, 100).expect("points");
    assert_eq!(all.columns.iter().map(|c| c.get(2)).collect::<Vec<_>>(), [3.0, 6.0, 9.0]);
}

#[test]
fn lists_of_cells_are_passed_wherever_they_lie_in_the_file() {
    let folder = folder();
    // A buffer of 65536 bytes may end within the word that says how cells are written.
    for padding in 65380..65450 {
        let title = format!("{:<padding$}", "t");
        let path = folder.path().join("a.vtk");
        let text = format!(
            "# vtk DataFile Version 5.1\n{title}\nASCII\nDATASET POLYDATA\nPOINTS 1 float\n1 2 3\nVERTICES 2 1\n\
             OFFSETS vtktypeint64\n0 1\nCONNECTIVITY vtktypeint64\n0\n"
        );
        std::fs::write(&path, text).expect("a write");
        assert_eq!(attempt(&path).map(|all| all.len()), Ok(1), "{padding}");
    }
}

#[test]
fn a_number_of_too_many_letters_is_an_error_and_not_two_numbers() {
    let folder = folder();
    let long = format!("0.{}", "5".repeat(90));
    let path = legacy(folder.path(), &format!("POINT_DATA 3\nFIELD f 1\na 1 3 float\n{long} 2 3\n"));
    let said = attempt(&path).expect_err("too long");
    assert!(said.contains("more than 64 letters") && said.contains("`a`"), "{said}");
    let path = folder.path().join("a.vtp");
    let text = format!(
        "<VTKFile type=\"PolyData\"><PolyData><Piece NumberOfPoints=\"1\"><Points><DataArray type=\"Float32\" \
         NumberOfComponents=\"3\" format=\"ascii\">{long} 1 </DataArray></Points></Piece></PolyData></VTKFile>"
    );
    std::fs::write(&path, text).expect("a write");
    let said = attempt(&path).expect_err("two numbers");
    assert!(said.contains("more than 64 letters"), "{said}");
}

#[test]
fn counts_that_no_file_holds_are_refused_with_their_place() {
    let folder = folder();
    let path = folder.path().join("a.vtp");
    for count in [u64::MAX / 6, u64::MAX / 2 + 1, u64::MAX] {
        let text = format!(
            "<VTKFile type=\"PolyData\"><PolyData><Piece NumberOfPoints=\"{count}\"><Points><DataArray \
             type=\"Float32\" NumberOfComponents=\"3\" format=\"ascii\">1 2 3</DataArray></Points></Piece></PolyData>\
             </VTKFile>"
        );
        std::fs::write(&path, text).expect("a write");
        let said = attempt(&path).expect_err("no file");
        assert!(said.contains("the file ends before all numbers are there"), "{said}");
    }
}

#[test]
fn arrays_without_end_are_refused_soon() {
    let folder = folder();
    let mut text = String::from("POINT_DATA 3\nFIELD f 1000000\n");
    (0..300_000).for_each(|_| text.push_str("a 1 0 int\n"));
    let path = legacy(folder.path(), &text.replace("ASCII", "BINARY"));
    let started = std::time::Instant::now();
    let said = attempt(&path).expect_err("too many");
    assert!(said.contains("more than 65536 arrays"), "{said}");
    assert!(started.elapsed().as_secs() < 5, "{:?}", started.elapsed());
}
