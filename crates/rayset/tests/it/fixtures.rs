//! Files that other programs' writers made, in `tests/fixtures`, with what is expected of them; and
//! what becomes of them where they are damaged.

use std::path::{Path, PathBuf};

use rayset::points::{self, PointBatch, ReadError, ReadOptions};

use crate::common::folder;
use crate::tables::{Table, table};

pub(crate) fn path(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures").join(name)
}

pub(crate) fn bytes(name: &str) -> Vec<u8> {
    std::fs::read(path(name)).expect("a fixture")
}

/// The same number, to the last bit but for `rounding` of its size; what is missing is NaN.
fn is_same(found: f64, expected: &serde_json::Value, rounding: f64) -> bool {
    match expected.as_f64() {
        Some(v) if rounding == 0.0 => found == v,
        Some(v) => (found - v).abs() <= rounding * v.abs().max(1.0),
        None => expected.is_null() && found.is_nan(),
    }
}

/// Checks a file against the JSON of what is expected: positions, and columns with their types,
/// units and numbers.
pub(crate) fn check(file: &Path, json: &str) {
    let json = std::fs::read_to_string(path(json)).expect("what is expected");
    let expected: serde_json::Value = serde_json::from_str(&json).expect("JSON");
    let source = points::open(file, &ReadOptions::default()).unwrap_or_else(|e| panic!("{e}"));
    let schema = source.schema().clone();
    let columns = expected["columns"].as_array().expect("columns");
    let names: Vec<&str> = columns.iter().map(|c| c["name"].as_str().expect("a name")).collect();
    assert_eq!(schema.names().collect::<Vec<_>>(), names);
    if let Some(crs) = expected["crs"].as_str() {
        assert_eq!(schema.crs, crs);
    }
    for words in expected["described"].as_array().into_iter().flatten() {
        let words = words.as_str().expect("words");
        assert!(schema.description.contains(words), "{}", schema.description);
    }
    let (position, found) = table(file, None).expect("it reads");
    let places = expected["position"].as_array().expect("positions");
    assert_eq!(position.len(), places.len());
    for (i, (found, expected)) in position.iter().zip(places).enumerate() {
        let same = (0..3).all(|axis| is_same(found[axis], &expected[axis], 1e-13));
        assert!(same, "point {i}: {found:?}, not {expected}");
    }
    for ((info, (name, values)), column) in schema.columns.iter().zip(&found).zip(columns) {
        let said = (info.kind.name(), info.unit.as_str(), info.is_class);
        let expected = (&column["kind"], &column["unit"], &column["class"]);
        let expected = (expected.0.as_str(), expected.1.as_str(), expected.2.as_bool());
        assert_eq!((Some(said.0), Some(said.1), Some(said.2)), expected, "{name}");
        let rounding = if info.kind.name() == "f32" { 3e-7 } else { 0.0 };
        let numbers = column["values"].as_array().expect("numbers");
        assert_eq!(values.len(), numbers.len());
        for (i, (found, expected)) in values.iter().zip(numbers).enumerate() {
            assert!(is_same(*found, expected, rounding), "{name} of point {i}: {found}, not {expected}");
        }
    }
}

/// What comes of a damaged file: its points, or a sentence about it.
pub(crate) fn outcome(path: &Path) -> Result<Table, String> {
    match table(path, None) {
        Ok(found) => Ok(found),
        Err(error) => {
            let said = error.to_string();
            for never in ["panicked", "failed to fill whole buffer", "\n", "\u{1b}"] {
                assert!(!said.contains(never), "{said:?}");
            }
            assert!(said.contains(": ") && said.len() < 1000, "{said}");
            Err(said)
        }
    }
}

/// What comes of a file of these bytes.
pub(crate) fn outcome_of(name: &str, bytes: &[u8]) -> Result<Table, String> {
    let folder = folder();
    let path = folder.path().join(name);
    std::fs::write(&path, bytes).expect("a write");
    outcome(&path)
}

/// Most places of a file in which it is damaged: all of a small one.
const MOST_PLACES: usize = 1500;

/// Cuts a file off at every byte, or at many if it is long, and says where that went unnoticed.
pub(crate) fn truncations(name: &str, bytes: &[u8]) -> Vec<usize> {
    let folder = folder();
    let path = folder.path().join(name);
    let unnoticed = |length: &usize| {
        std::fs::write(&path, &bytes[..*length]).expect("a write");
        outcome(&path).is_ok()
    };
    (0..bytes.len()).step_by(bytes.len().div_ceil(MOST_PLACES)).filter(unnoticed).collect()
}

/// Flips bits of every byte of a file, or of many if it is long, one after another, with `mend`
/// making checksums right again. Whatever comes of it is points or a sentence. Returns of how many
/// bytes that was a sentence, and how many were flipped.
pub(crate) fn flips(name: &str, bytes: &[u8], mend: impl Fn(&mut [u8])) -> (usize, usize) {
    let folder = folder();
    let path = folder.path().join(name);
    let (mut refused, mut flipped) = (0, 0);
    for at in (0..bytes.len()).step_by(bytes.len().div_ceil(MOST_PLACES)) {
        let mut broken = bytes.to_vec();
        broken[at] ^= [1, 0x80, 0xff, 0x10][flipped % 4];
        mend(&mut broken);
        std::fs::write(&path, &broken).expect("a write");
        refused += usize::from(outcome(&path).is_err());
        flipped += 1;
    }
    (refused, flipped)
}

/// Reads a file in batches of a number of points, with nothing selected but column `column`.
pub(crate) fn in_batches(path: &Path, batch_points: usize, column: usize) -> Result<Table, ReadError> {
    let mut source = points::open(path, &ReadOptions::default())?;
    source.select(&[column]);
    let (mut position, mut values, mut batch) = (Vec::new(), Vec::new(), PointBatch::default());
    loop {
        source.fill(&mut batch, batch_points)?;
        if batch.is_empty() {
            let name = source.schema().columns[column].name.clone();
            return Ok((position, vec![(name, values)]));
        }
        assert!(batch.len() <= batch_points);
        position.extend_from_slice(&batch.position);
        values.extend((0..batch.len()).map(|i| batch.columns[0].get(i)));
    }
}

/// Whether two tables are of the same bits.
pub(crate) fn are_same(a: &[[f64; 3]], b: &[[f64; 3]]) -> bool {
    let bits = |points: &[[f64; 3]]| points.iter().map(|p| p.map(f64::to_bits)).collect::<Vec<_>>();
    bits(a) == bits(b)
}
