//! Files of points that other programs wrote, with what is in them.
//!
//! The scripts in `tests/fixtures` write the files, and from the same arrays a table: for each file
//! the positions, some columns and their units. A key may go on with the types of particles that
//! are asked for.

use std::path::{Path, PathBuf};

use rayset::points::{self, PointBatch, PointSource, ReadOptions, Values};
use serde_json::Value;

pub(crate) fn fixtures(folder: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures").join(folder)
}

pub(crate) fn options(particles: Option<&str>) -> ReadOptions {
    let particles = particles.map(|names| names.split(',').map(str::to_owned).collect());
    ReadOptions::default().with_particles(particles)
}

/// All points of a source with all of its columns, in batches of `limit`.
pub(crate) fn read_all(source: &mut dyn PointSource, limit: usize) -> Result<PointBatch, points::ReadError> {
    let columns: Vec<usize> = (0..source.schema().columns.len()).collect();
    source.select(&columns);
    let (mut all, mut batch) = (PointBatch::default(), PointBatch::default());
    all.reset(source.schema(), &columns);
    loop {
        source.fill(&mut batch, limit)?;
        if batch.is_empty() {
            return Ok(all);
        }
        assert!(batch.len() <= limit);
        all.position.extend_from_slice(&batch.position);
        for (to, from) in all.columns.iter_mut().zip(&batch.columns) {
            assert_eq!(from.len(), batch.len());
            to.extend_from(from, 0..from.len());
        }
    }
}

/// What an attempt to read all of a file says.
pub(crate) fn attempt(path: &Path) -> Result<PointBatch, String> {
    let read =
        points::open(path, &ReadOptions::default()).and_then(|mut source| read_all(&mut *source, 1000));
    read.map_err(|error| error.to_string())
}

/// The same number: exactly, or for a derived one to nine digits. Integers of 64 bits are compared
/// as such.
fn same(found: &Values, index: usize, expected: &Value, derived: bool) -> bool {
    if let (Values::U64(found), Some(expected)) = (found, expected.as_u64()) {
        return found[index] == expected;
    }
    if let (Values::I64(found), Some(expected)) = (found, expected.as_i64()) {
        return found[index] == expected;
    }
    let (found, expected) = (found.get(index), expected.as_f64().unwrap_or(f64::NAN));
    let tolerance = if derived { 1e-9 } else { ROUNDING };
    found == expected || (found.is_nan() && expected.is_nan()) || (found / expected - 1.0).abs() < tolerance
}

/// The parser of JSON does not always give the nearest of all doubles.
const ROUNDING: f64 = 1e-15;

/// Compares every file of a folder's table with what is read, in batches of several sizes.
pub(crate) fn check_all(folder: &str) {
    let text = std::fs::read_to_string(fixtures(folder).join("expected.json")).expect("the table");
    let table: Value = serde_json::from_str(&text).expect("JSON");
    for (key, expected) in table.as_object().expect("an object") {
        let (file, particles) = key.split_once(' ').map_or((key.as_str(), None), |(file, p)| (file, Some(p)));
        for limit in [1, 7, 1 << 20] {
            let path = fixtures(folder).join(file);
            let mut source = points::open(&path, &options(particles)).unwrap_or_else(|e| panic!("{e}"));
            let found = read_all(&mut *source, limit).unwrap_or_else(|e| panic!("{e}"));
            let positions = expected["position"].as_array().expect("positions");
            assert_eq!(found.len(), positions.len(), "{key}");
            assert!(source.count_hint().is_none_or(|count| count == found.len() as u64), "{key}");
            for (found, expected) in found.position.iter().zip(positions) {
                for axis in 0..3 {
                    let expected = expected[axis].as_f64().unwrap_or(f64::NAN);
                    let near = (found[axis] - expected).abs() <= ROUNDING * expected.abs();
                    assert!(near || expected.is_nan() && found[axis].is_nan(), "{key}: {found:?}");
                }
            }
            for (name, numbers) in expected["columns"].as_object().expect("columns") {
                let names: Vec<&str> = source.schema().names().collect();
                let column =
                    source.schema().find(name).unwrap_or_else(|| panic!("{key}: no {name} in {names:?}"));
                let derived = ["radius", "weight"].contains(&name.as_str());
                let numbers = numbers.as_array().expect("numbers");
                assert_eq!(numbers.len(), found.len(), "{key}, {name}");
                for (i, number) in numbers.iter().enumerate() {
                    let value = found.columns[column].get(i);
                    assert!(
                        same(&found.columns[column], i, number, derived),
                        "{key}, {name}[{i}]: {value}, {number}"
                    );
                }
            }
            for (name, unit) in expected["units"].as_object().into_iter().flatten() {
                let column = source.schema().find(name).expect("a column");
                assert_eq!(
                    Some(source.schema().columns[column].unit.as_str()),
                    unit.as_str(),
                    "{key}, {name}"
                );
            }
        }
    }
}

/// Reads a file cut off at every `step`th byte, and with each of these bytes changed: nothing
/// panics, and errors are sentences. Returns how many of the cut files were errors.
pub(crate) fn damage(path: &Path, step: usize) -> usize {
    let bytes = std::fs::read(path).expect("a fixture");
    let folder = crate::common::folder();
    let copy = folder.path().join(path.file_name().expect("a name"));
    let mut refused = 0;
    let judge = |bytes: &[u8]| {
        std::fs::write(&copy, bytes).expect("a write");
        let read = attempt(&copy);
        if let Err(said) = &read {
            assert!(said.len() > 20 && said.contains(' ') && !said.contains("panicked"), "{said}");
            assert!(!said.contains("failed to fill whole buffer"), "{said}");
        }
        read.is_err()
    };
    for at in (0..bytes.len()).step_by(step) {
        refused += usize::from(judge(&bytes[..at]));
        for flip in [0xff, 0x10] {
            let mut changed = bytes.clone();
            changed[at] ^= flip;
            judge(&changed);
        }
    }
    refused
}
