//! Colours of several inputs: each has a depth of its own, and points without colours are grey
//! among others.

use std::path::{Path, PathBuf};

use rayset::build::{BuildControl, BuildOptions, BuildReport};
use rayset::points::{self, ReadOptions};

use crate::common::folder;
use crate::fixtures::outcome_of;

fn write(folder: &Path, name: &str, text: impl AsRef<[u8]>) -> PathBuf {
    let path = folder.join(name);
    std::fs::write(&path, text).expect("a write");
    path
}

/// The colours of one cloud of all `files`, each with the x of its point, in the order of x; and
/// the report.
fn colors(files: &[PathBuf]) -> (Vec<(f64, [f64; 3])>, BuildReport) {
    let open = |file: &PathBuf| points::open(file, &ReadOptions::default()).expect("it opens");
    let sources = files.iter().map(open).collect();
    let options = BuildOptions::default().with_threads(1);
    let (cloud, report) = rayset::octree::build::run_in_memory(sources, &options, &BuildControl::default())
        .expect("it is built");
    let schema = cloud.sample_schema();
    let sample = cloud.sample(usize::MAX).expect("it reads");
    let columns = ["red", "green", "blue"].map(|name| schema.find(name).expect("it has colours"));
    let color = |i: usize| columns.map(|column| sample.columns[column].get(i));
    let mut all: Vec<_> = (0..sample.len()).map(|i| (sample.position[i][0].round(), color(i))).collect();
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    (all, report)
}

/// A table of `rows` points from x on, the first with the largest of the colours.
fn table(x: u32, rows: u32, names: &str, row: impl Fn(u32) -> String) -> String {
    let lines = (0..rows).map(|i| format!("{},{},0,{}\n", x + i, i % 7, row(i)));
    std::iter::once(format!("x,y,z,{names}\n")).chain(lines).collect()
}

#[test]
fn each_input_has_a_depth_of_colour_of_its_own_and_it_is_said() {
    let folder = folder();
    let eight = table(0, 50, "r,g,b", |_| "200,100,50".into());
    let sixteen = table(50, 50, "r,g,b", |_| "51400,25700,12850".into());
    let files = [("a.csv", &eight), ("b.csv", &sixteen)].map(|(name, text)| write(folder.path(), name, text));
    let (found, report) = colors(&files);
    assert_eq!(found.len(), 100);
    assert!(found.iter().all(|(_, color)| *color == [200.0, 100.0, 50.0]), "{found:?}");
    let said = report.remarks.join("\n");
    assert!(said.contains("0 to 255 in 1 input") && said.contains("0 to 65535 in 1 input"), "{said}");
    assert!(colors(&files[..1]).1.remarks.is_empty());
}

#[test]
fn whole_numbers_up_to_1_are_dark_beside_inputs_of_bytes_and_bright_by_themselves() {
    let folder = folder();
    let dark = write(folder.path(), "dark.csv", table(0, 50, "r,g,b", |i| format!("{0},{0},1", i % 2)));
    let light = write(folder.path(), "light.csv", table(50, 50, "r,g,b", |_| "200,100,50".into()));
    let (found, _) = colors(&[dark.clone(), light]);
    assert_eq!((found[1].1, found[99].1), ([1.0; 3], [200.0, 100.0, 50.0]));
    assert_eq!(colors(&[dark]).0[1].1, [255.0; 3]);
}

#[test]
fn points_without_colours_among_others_are_grey_by_their_intensity_and_it_is_said() {
    let folder = folder();
    let colored = write(folder.path(), "a.csv", table(0, 50, "r,g,b", |_| "200,100,50".into()));
    let grey = write(folder.path(), "b.csv", table(100, 100, "intensity", |i| format!("{}", 1000 + 20 * i)));
    let plain = write(folder.path(), "c.csv", table(200, 10, "t", |i| i.to_string()));
    let black = write(folder.path(), "d.csv", table(300, 10, "r,g,b", |_| "0,0,0".into()));
    let (found, report) = colors(&[colored, grey, plain.clone(), black]);
    assert!(found[..50].iter().all(|(_, color)| *color == [200.0, 100.0, 50.0]));
    let greys: Vec<f64> = found[50..150].iter().map(|(_, color)| color[0]).collect();
    assert!(found[50..150].iter().all(|(_, [r, g, b])| r == g && g == b));
    assert!(
        greys.is_sorted() && greys[5] < 50.0 && (90.0..165.0).contains(&greys[50]) && greys[95] > 205.0,
        "{greys:?}"
    );
    assert!(found[150..].iter().all(|(_, color)| *color == [153.0; 3]), "{:?}", &found[150..]);
    let said = report.remarks.join("\n");
    for part in [
        "100 points without colours are shown in grey by their intensity",
        "10 points without colours and",
        "all black",
    ] {
        assert!(said.contains(part), "{part}: {said}");
    }
    // Without any colours there is none.
    let sources = vec![points::open(&plain, &ReadOptions::default()).expect("it opens")];
    let (cloud, report) =
        rayset::octree::build::run_in_memory(sources, &BuildOptions::default(), &BuildControl::default())
            .expect("built");
    assert!(!cloud.header().has_color && report.remarks.is_empty());
}

#[test]
fn a_scan_without_colours_in_a_ptx_file_is_grey_by_its_intensity() {
    let scan = |x: u32, color: &str| {
        let points: String = (0..50)
            .map(|i| format!("{} {} 1 {:.4}{color}\n", x + i, i % 7, 0.2 + 0.01 * f64::from(i)))
            .collect();
        format!("10\n5\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n{points}")
    };
    let folder = folder();
    let [colored, grey] = [scan(1, " 200 100 50"), scan(100, "")];
    for text in [format!("{colored}{grey}"), format!("{grey}{colored}")] {
        a_scan_is_grey(&write(folder.path(), "a.ptx", text));
    }
}

/// The first 50 points are of a colour, and the next 50 grey by their intensity, which is said.
fn a_scan_is_grey(file: &Path) {
    let (found, report) = colors(&[file.to_owned()]);
    assert!(found[..50].iter().all(|(_, color)| *color == [200.0, 100.0, 50.0]));
    let greys: Vec<f64> = found[50..].iter().map(|(_, color)| color[0]).collect();
    assert!(greys.is_sorted() && greys[3] < 60.0 && greys[46] > 195.0, "{greys:?}");
    assert!(report.remarks.join("\n").contains("50 points without colours"), "{:?}", report.remarks);
}

#[test]
fn colours_are_whole_numbers_or_bits_in_the_float_of_a_pcd_file() {
    let head = "# .PCD v.7\nVERSION .7\nFIELDS x y z rgb\nSIZE 4 4 4 KIND\nTYPE F F F F\nCOUNT 1 1 1 1\nWIDTH 3\nHEIGHT 1\nPOINTS 3\n";
    let whole = 0x00c8_6432_u32;
    let expected =
        [("red", [200.0, 0.0, 200.0]), ("green", [100.0, 0.0, 100.0]), ("blue", [50.0, 0.0, 50.0])];
    let expected = expected.map(|(name, values)| (name.to_owned(), values.to_vec()));
    let bits = f32::from_bits(whole);
    for (kind, first) in [("4", format!("{bits:e}")), ("4", whole.to_string()), ("8", format!("{whole}.0"))] {
        let text =
            format!("{}DATA ascii\n1 2 3 {first}\n4 5 6 0\n7 8 9 {first}\n", head.replace("KIND", kind));
        let (_, columns) = outcome_of("p.pcd", text.as_bytes()).expect("it reads");
        assert_eq!(columns, expected, "{first}");
    }
    let mut binary = format!("{}DATA binary\n", head.replace("KIND", "4")).into_bytes();
    for color in [whole as f32, 0.0, bits] {
        [1.0, 2.0, 3.0, color].iter().for_each(|v| binary.extend_from_slice(&v.to_le_bytes()));
    }
    assert_eq!(outcome_of("p.pcd", &binary).expect("it reads").1, expected);
}
