//! PTX: scans with poses, directions in which nothing was found, and damaged files. PTS, its
//! sibling without poses.

use rayset::points::{self, ReadOptions};

use crate::common::{folder, real_data};
use crate::fixtures::{are_same, bytes, check, flips, in_batches, outcome_of, path, truncations};
use crate::tables::table;

fn refusal(text: &str) -> String {
    outcome_of("p.ptx", text.as_bytes()).expect_err("refused").split_once(", ").expect("a place").1.to_owned()
}

/// A scan of one column.
fn scan(rows: usize, points: &str) -> String {
    format!("1\n{rows}\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n5 6 7 1\n{points}")
}

#[test]
fn scans_of_a_ptx_file_are_one_cloud_with_poses_and_what_was_not_found_left_out() {
    check(&path("scans.ptx"), "scans.ptx.json");
}

#[test]
fn ptx_is_known_by_its_content_and_read_alike_in_batches_of_any_size() {
    let folder = folder();
    for name in ["scan.txt", "scan.pts", "scan"] {
        let named = folder.path().join(name);
        std::fs::write(&named, bytes("scans.ptx")).expect("a write");
        let whole = table(&named, None).expect("it reads");
        for size in [1, 5, 1000] {
            let parts = in_batches(&named, size, 4).expect("it reads");
            assert!(are_same(&parts.0, &whole.0));
            assert_eq!(parts.1[0], whole.1[4]);
        }
    }
    let source = points::open(path("scans.ptx"), &ReadOptions::default()).expect("it opens");
    assert!(source.memory_needed() < 1 << 20);
}

#[test]
fn a_ptx_file_that_is_cut_off_is_a_sentence() {
    let whole = bytes("scans.ptx");
    let text = String::from_utf8(whole.clone()).expect("text");
    let ends_of_scans: Vec<usize> = (text.match_indices("\n0\n5\n").chain(text.match_indices("\n2\n3\n")))
        .chain(text.match_indices("\n2\n2\n"))
        .map(|(at, _)| at)
        .collect();
    for length in truncations("p.ptx", &whole) {
        // Whole scans are a whole file, and a shortened last number is a number; a last colour may
        // go unnoticed, too.
        let is_end = ends_of_scans.iter().any(|&end| length <= end + 1 && length + 30 > end);
        assert!(is_end || length + 30 > whole.len(), "cut off at {length} of {}", whole.len());
    }
}

#[test]
fn a_damaged_ptx_file_is_points_or_a_sentence() {
    let (refused, flipped) = flips("p.ptx", &bytes("scans.ptx"), |_| ());
    assert!(refused > 250 && refused < flipped, "{refused} of {flipped}");
}

#[test]
fn malformed_ptx_is_an_error_that_names_line_and_value() {
    for (text, expected) in [
        (String::new(), "byte 0: this file is empty: it was not written, or not copied"),
        ("many\n".into(), "line 1: `many` where a number of columns was expected"),
        ("4\n4\n1 2 3\n".into(), "line 3: the file ends within the header of a scan, on line 1"),
        (scan(2, "1 2 3 0.5\n"), "line 1: the scan has 2 points, and 1 follow"),
        (scan(1, "1 2 3 0.5 1\n"), "line 11: 5 numbers where 3, 4, 6 or 7 were expected"),
        (scan(1, "1 2 3 0.5 1 2 3 4\n"), "line 11: 8 numbers where 3, 4, 6 or 7 were expected"),
        (scan(1, "1 2 3 0.5 1 2 300\n"), "line 11: a colour of [1.0, 2.0, 300.0]"),
        (scan(1, "1 2 x 0.5\n"), "line 11: `x` is not a number"),
        (scan(1, "1 2 3 0.5\n1 2 3 0.5\n"), "line 12: `1 2 3 0.5` where a number of columns was expected"),
        (scan(1, "1 2 3 0.5\n").replace("5 6 7 1\n", "5 6 7 2\n"), "line 10: row 4 of the matrix"),
        (scan(1, "1 2 3 0.5\n").replace("0 0 1\n", "0 0 1 9\n"), "line 6: 4 numbers where 3 were expected"),
    ] {
        assert!(refusal(&text).starts_with(expected), "{}, not {expected}", refusal(&text));
    }
    let (position, _) = outcome_of("p.ptx", scan(1, "1 2 3 0.5").as_bytes()).expect("it reads");
    assert_eq!(position, [[6.0, 8.0, 10.0]]);
}

#[test]
fn scans_of_a_ptx_file_have_intensities_and_colours_in_any_order_or_lack_them() {
    let rows = ["1 2 3", "1 2 3 0.5", "1 2 3 10 20 30", "1 2 3 0.5 10 20 30"];
    for (first, second) in (0..16).map(|i| (rows[i / 4], rows[i % 4])) {
        let width = |row: &str| row.split(' ').count();
        let has_intensity = [first, second].iter().any(|row| [4, 7].contains(&width(row)));
        let has_color = [first, second].iter().any(|row| width(row) > 4);
        let text = scan(1, &format!("{first}\n")) + &scan(1, &format!("{second}\n"));
        let (position, columns) = outcome_of("p.ptx", text.as_bytes()).expect("it reads");
        assert_eq!(position, [[6.0, 8.0, 10.0]; 2]);
        let of = |row: &str, name: &str| {
            let color = [("red", 10.0), ("green", 20.0), ("blue", 30.0)].iter().find(|color| color.0 == name);
            match color {
                Some((_, value)) if width(row) > 4 => *value,
                None if name == "intensity" && [4, 7].contains(&width(row)) => 0.5,
                _ => f64::NAN,
            }
        };
        let names = ["intensity", "red", "green", "blue", "scan"];
        let there = names.into_iter().filter(|&name| match name {
            "intensity" => has_intensity,
            "scan" => true,
            _ => has_color,
        });
        assert!(there.clone().eq(columns.iter().map(|column| column.0.as_str())), "{columns:?}");
        for (name, values) in &columns {
            let expected =
                if name == "scan" { vec![0.0, 1.0] } else { vec![of(first, name), of(second, name)] };
            assert_eq!(format!("{values:?}"), format!("{expected:?}"), "{name} of `{first}`, `{second}`");
        }
    }
}

/// As PDAL reads them.
#[test]
fn real_ptx_files_are_read_with_their_poses() {
    let Some(folder) = real_data("ptsptx") else { return };
    let (position, columns) = table(&folder.join("multiple-and-transform.ptx"), None).expect("it reads");
    assert_eq!(position.len(), 8);
    let close = |p: [f64; 3], q: [f64; 3]| p.iter().zip(q).all(|(a, b)| (a - b).abs() < 1e-6);
    // The first scan is moved and stretched to where the second one is.
    for i in 0..4 {
        assert!(close(position[i], position[i + 4]), "{:?}, not {:?}", position[i], position[i + 4]);
    }
    assert!(close(position[0], [637_012.24, 849_028.31, 431.66]));
    assert_eq!(columns[1], ("scan".to_owned(), vec![0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0]));
    let (position, columns) = table(&folder.join("1.2-with-color.ptx"), None).expect("it reads");
    assert_eq!((position.len(), columns.len()), (1065, 5));
    assert_eq!(columns[1..4].iter().map(|c| c.1[0]).collect::<Vec<_>>(), [68.0, 77.0, 88.0]);
}

#[test]
fn real_pts_files_have_intensities_below_zero_and_colours_or_neither() {
    let Some(folder) = real_data("ptsptx") else { return };
    for (name, points, columns, intensity) in [
        ("autzen.pts", 10, 4, Some((-1998.0, 602.0))),
        ("bunnyData.pts", 30571, 0, None),
        ("test.pts", 19, 4, Some((-1397.0, -935.0))),
    ] {
        let found = table(&folder.join(name), None).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!((found.0.len(), found.1.len()), (points, columns), "{name}");
        if let Some((least, most)) = intensity {
            let ends = found.1[0].1.iter().fold((f64::MAX, f64::MIN), |e, &v| (e.0.min(v), e.1.max(v)));
            assert_eq!((found.1[0].0.as_str(), ends), ("intensity", (least, most)), "{name}");
            assert_eq!(found.1[1].0, "red");
        }
    }
}
