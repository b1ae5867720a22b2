//! LAS and LAZ against laspy: fixtures of every point format that it wrote, and what it finds in
//! real files.

use rayset::points::{self, ReadOptions};

use crate::common::{folder, real_data};
use crate::fixtures::{bytes, check, flips, outcome_of, path, truncations};
use crate::tables::table;

const FIXTURES: [&str; 11] = [
    "format_0.las",
    "format_1.las",
    "format_2.las",
    "format_3.laz",
    "format_4.las",
    "format_5.laz",
    "format_6.las",
    "format_7.laz",
    "format_8.laz",
    "format_9.las",
    "format_10.las",
];

#[test]
fn every_point_format_and_type_of_extra_bytes_is_read_as_laspy_wrote_it() {
    for name in FIXTURES {
        check(&path(name), &format!("{name}.json"));
    }
}

/// LAS 1.5 adds bytes to the header, which move what follows.
#[test]
fn a_header_of_las_1_5_is_read_with_the_bytes_that_it_adds() {
    let mut newer = bytes("format_6.las");
    let number = |bytes: &[u8], at: usize| u32::from_le_bytes(std::array::from_fn(|i| bytes[at + i]));
    let points_start = number(&newer, 96);
    newer[25] = 5;
    newer[94..96].copy_from_slice(&393_u16.to_le_bytes());
    newer[96..100].copy_from_slice(&(points_start + 18).to_le_bytes());
    newer.splice(375..375, [7; 18]);
    let folder = folder();
    let named = folder.path().join("p.las");
    std::fs::write(&named, &newer).expect("a write");
    check(&named, "format_6.las.json");
    let source = points::open(&named, &ReadOptions::default()).expect("it opens");
    assert!(source.schema().description.starts_with("LAS 1.5, point format 6"));
    newer[94..96].copy_from_slice(&374_u16.to_le_bytes());
    let said = outcome_of("p.las", &newer).expect_err("too short a header");
    assert!(said.contains("byte 94: a header of 374 bytes, where LAS 1.5 has 375 or more"), "{said}");
}

#[test]
fn las_fixtures_that_are_damaged_are_points_or_a_sentence() {
    for name in ["format_0.las", "format_10.las", "format_3.laz", "format_8.laz"] {
        let whole = bytes(name);
        let ending = if name.ends_with('z') { "p.laz" } else { "p.las" };
        let (refused, flipped) = flips(ending, &whole, |_| ());
        assert!(refused > 10 && refused < flipped, "{name}: {refused} of {flipped}");
        let unnoticed = truncations(ending, &whole);
        // Of compressed points, a table of chunks at the end is not needed if there is a single
        // chunk.
        assert!(unnoticed.iter().all(|length| whole.len() - length < 32), "{name}: {unnoticed:?}");
    }
}

#[test]
fn real_las_laz_and_copc_files_have_the_columns_types_and_numbers_that_laspy_finds() {
    let Some(folder) = real_data("lidar") else { return };
    let json = String::from_utf8(bytes("real_las.json")).expect("text");
    let expected: serde_json::Value = serde_json::from_str(&json).expect("JSON");
    let mut compared = 0;
    for (name, expected) in expected.as_object().expect("files") {
        let points = expected["points"].as_u64().expect("a number");
        // All of the others take long.
        if points > 40_000 {
            continue;
        }
        let path = folder.join(name);
        let source = points::open(&path, &ReadOptions::default()).unwrap_or_else(|e| panic!("{e}"));
        let kinds: Vec<&str> = source.schema().columns.iter().map(|c| c.kind.name()).collect();
        let (position, mut columns) = table(&path, None).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(position.len() as u64, points, "{name}");
        let mut kinds: Vec<String> = kinds.into_iter().map(str::to_owned).collect();
        for (axis, of) in ["x", "y", "z"].into_iter().enumerate() {
            columns.insert(axis, (of.to_owned(), position.iter().map(|p| p[axis]).collect()));
            kinds.insert(axis, "f64".to_owned());
        }
        let found: Vec<&str> = columns.iter().map(|c| c.0.as_str()).collect();
        let wanted = expected["columns"].as_object().expect("columns");
        // laspy makes columns of bytes, too, of which files do not say what they are.
        let is_known = |name: &&String| !name.starts_with("Reserved") && !name.starts_with("ExtraBytes");
        let known: Vec<&String> = wanted.keys().filter(is_known).collect();
        assert_eq!(found.len(), known.len(), "{name}: {found:?}, not {known:?}");
        for ((column, values), kind) in columns.iter().zip(&kinds) {
            let wanted = &wanted[column.as_str()];
            assert_eq!(Some(kind.as_str()), wanted[0].as_str(), "{column} of {name}");
            let sum: f64 = values.iter().sum();
            for (found, wanted) in [values[0], values[values.len() - 1], sum].into_iter().zip(1..) {
                let Some(wanted) = expected["columns"][column.as_str()][wanted].as_f64() else { continue };
                let near = (found - wanted).abs() <= 1e-9 * wanted.abs() + 1e-6;
                assert!(near, "{column} of {name}: {found}, not {wanted}");
            }
        }
        compared += 1;
    }
    assert!(compared > 25, "{compared}");
}
