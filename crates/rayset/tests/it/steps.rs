//! The step of coordinates: no digit below it is known, however exactly a cloud stores positions.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use rayset::Cloud;
use rayset::octree::build::{self, BuildControl, BuildOptions, BuildParts, BuildStep};
use rayset::points::{self, ArraySource, PointSource, ReadOptions};

use crate::common::folder;
use crate::las_writer::LasFile;

const LAS_STEP: [f64; 3] = [0.01, 0.01, 0.001];

fn written(folder: &Path, name: &str, bytes: impl AsRef<[u8]>) -> PathBuf {
    let path = folder.join(name);
    std::fs::write(&path, bytes).expect("a write");
    path
}

fn las(folder: &Path) -> PathBuf {
    let file = LasFile { scale: LAS_STEP, offset: [4e5, 5.7e6, 0.123_456], ..LasFile::random(1, 400, 0, 26) };
    written(folder, "a.las", file.las())
}

/// Rows of places with these decimals, after a line of names if it is not empty.
fn text(names: &str, separator: &str, decimals: [usize; 3]) -> String {
    let mut text = names.to_owned();
    for i in 0..300 {
        let [x, y, z] = [7.125 + 0.011 * f64::from(i), 41.0 - 0.017 * f64::from(i), 3.3 + 0.5 * f64::from(i)];
        let [a, b, c] = decimals;
        writeln!(text, "{x:.a$}{separator}{y:.b$}{separator}{z:.c$}").expect("it writes");
    }
    text
}

fn opened(path: &Path) -> Box<dyn PointSource> {
    points::open(path, &ReadOptions::default()).expect("it opens")
}

fn step_of(path: &Path) -> Option<[f64; 3]> {
    opened(path).schema().step
}

fn built(folder: &Path, sources: Vec<Box<dyn PointSource>>, options: &BuildOptions) -> Option<[f64; 3]> {
    let path = folder.join("built.rset");
    build::run(sources, &path, options, &BuildControl::default()).expect("the cloud builds");
    Cloud::open(&path).expect("the cloud opens").header().step
}

#[test]
fn files_say_the_step_of_their_coordinates_and_text_says_it_by_its_decimals() {
    let folder = folder();
    let folder = folder.path();
    assert_eq!(step_of(&las(folder)), Some(LAS_STEP));
    let table = |name, text: String| step_of(&written(folder, name, text));
    assert_eq!(table("a.xyz", text("", " ", [2, 2, 3])), Some(LAS_STEP));
    assert_eq!(table("a.csv", text("x,y,z\n", ",", [2, 2, 3])), Some(LAS_STEP));
    assert_eq!(table("b.xyz", text("", ";", [2, 2, 3]).replace('.', ",")), Some(LAS_STEP));
    // What leaves trailing zeros out, whole numbers and single rows say nothing.
    let shortest =
        (0..300).fold(String::new(), |text, i| text + &format!("{} {} 1.5\n", i, 0.25 * f64::from(i)));
    assert_eq!(table("c.xyz", shortest), None);
    assert_eq!(table("d.xyz", text("", " ", [0, 2, 2])), None);
    assert_eq!(table("e.xyz", "1.25 2.25 3.25\n1.50 2.50 3.50\n".into()), None);
    // Of degrees, in metres.
    let [x, y, z] = table("g.csv", text("longitude,latitude,z\n", ",", [7, 7, 2])).expect("a step");
    assert!(
        (x - 0.0111).abs() < 1e-3 && x.to_bits() == y.to_bits() && (z - 0.01).abs() < 1e-12,
        "{x} {y} {z}"
    );
}

#[test]
fn a_cloud_has_the_largest_step_of_its_inputs_and_none_if_one_does_not_say() {
    let folder = folder();
    let (las, folder) = (las(folder.path()), folder.path());
    let coarse = written(folder, "a.xyz", text("", " ", [1, 3, 1]));
    let options = BuildOptions::default();
    assert_eq!(built(folder, vec![opened(&las)], &options), Some(LAS_STEP));
    assert_eq!(built(folder, vec![opened(&las), opened(&coarse)], &options), Some([0.1, 0.01, 0.1]));
    let unknown = Box::new(ArraySource::new(vec![[4e5, 5.7e6, 1.0]], vec![]));
    assert_eq!(built(folder, vec![opened(&las), unknown], &options), None);
    let doubled = BuildOptions { length_scale: 2.0, ..options };
    assert_eq!(built(folder, vec![opened(&las)], &doubled), Some(LAS_STEP.map(|v| 2.0 * v)));
}

#[test]
fn a_cloud_that_is_built_in_parts_has_the_step_of_a_local_one() {
    let folder = folder();
    let (las, folder) = (las(folder.path()), folder.path());
    let coarse = written(folder, "a.xyz", text("", " ", [1, 3, 1]));
    let sources = || vec![opened(&las), opened(&coarse)];
    let (options, control) = (BuildOptions::default(), BuildControl::default());
    let expected = built(folder, sources(), &options);
    assert!(expected.is_some());
    let parts = BuildParts::new(&folder.join("parts"), 3).expect("parts");
    for step in BuildStep::ALL {
        for part in 1..=3 {
            match step {
                BuildStep::Read => parts.read(part, sources(), &options, &control),
                _ => parts.run(step, part, &options, &control),
            }
            .expect("a part");
        }
    }
    let path = folder.join("merged.rset");
    parts.merge(&path, &options, &control).expect("it merges");
    assert_eq!(Cloud::open(&path).expect("the cloud opens").header().step, expected);
    let bytes = |path: &Path| std::fs::read(path).expect("the file reads");
    assert!(bytes(&path) == bytes(&folder.join("built.rset")), "another file");
}
