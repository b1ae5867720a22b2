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
        let source = points::open(&fixtures("vtk").join(name), &ReadOptions::default()).expect("points");
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
