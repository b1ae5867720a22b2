//! PCD: three encodings of the same points, colours in bits, and damaged files.

use rayset::points::{self, ReadOptions};

use crate::common::{folder, real_data};
use crate::fixtures::{are_same, bytes, check, flips, in_batches, outcome_of, path, truncations};
use crate::tables::table;

const ENCODED: [&str; 5] = [
    "ascii_uint32.pcd",
    "binary_float32.pcd",
    "binary_uint32.pcd",
    "binary_compressed_float32.pcd",
    "binary_compressed_uint32.pcd",
];

fn refusal(bytes: &[u8]) -> String {
    outcome_of("p.pcd", bytes).expect_err("refused").split_once(", ").expect("a place").1.to_owned()
}

fn ascii(fields: &str, rest: &str) -> Vec<u8> {
    format!("# .PCD v.7 - made up\nVERSION .7\nFIELDS {fields}\n{rest}").into_bytes()
}

#[test]
fn pcd_reads_alike_in_its_three_encodings_with_colours_of_either_type() {
    for name in ENCODED {
        check(&path(name), "points.pcd.json");
        let source = points::open(path(name), &ReadOptions::default()).expect("it opens");
        assert_eq!(format!("{:?}", source.schema().color_depth), "Byte");
        // The viewpoint is said, and not applied, as in PCL.
        let description = &source.schema().description;
        assert!(description.ends_with("seen from 1.0 2.0 3.0 0.0 1.0 0.0 0.0"), "{description}");
    }
}

#[test]
fn pcd_is_known_by_its_content_and_read_alike_in_batches_of_any_size() {
    let folder = folder();
    for name in ENCODED {
        let named = folder.path().join("points.xyz");
        std::fs::write(&named, bytes(name)).expect("a write");
        let whole = table(&named, None).expect("it reads");
        for size in [1, 7, 59, 1000] {
            let parts = in_batches(&named, size, 13).expect("it reads");
            assert!(are_same(&parts.0, &whole.0));
            assert_eq!(parts.1[0], whole.1[13]);
        }
    }
}

#[test]
fn pcd_reads_alike_whatever_ends_its_lines() {
    for name in ENCODED {
        let whole = bytes(name);
        let is_text = name.starts_with("ascii");
        let data = whole.windows(5).position(|window| window == b"\nDATA").expect("a line of its data") + 1;
        let header = data + whole[data..].iter().position(|&byte| byte == b'\n').expect("its end") + 1;
        let lines = if is_text { whole.len() } else { header };
        let expected = outcome_of(name, &whole).expect("it reads");
        // A first line that names the format, or none.
        for begin in [&b"# .PCD v.7\n"[..], b""] {
            for end in [&b"\r"[..], b"\r\n"] {
                // The block of compressed points is found by the length of the header.
                let text = [begin, &whole[..lines]].concat();
                let text = text.split(|&byte| byte == b'\n').collect::<Vec<_>>().join(end);
                let found = outcome_of("p", &[&text, &whole[lines..]].concat());
                let found = found.unwrap_or_else(|error| panic!("{name}, {end:?}: {error}"));
                assert!(are_same(&found.0, &expected.0) && found.1 == expected.1, "{name}, {end:?}");
            }
        }
    }
}

#[test]
fn colours_in_the_text_of_a_float_come_apart() {
    let float = f32::from_bits(0x00ff_8001);
    let rest = format!("SIZE 4 4 4 4\nTYPE F F F F\nWIDTH 1\nDATA ascii\n\n1 2 3 {float:e}\n");
    let (position, columns) = outcome_of("p.pcd", &ascii("x y z rgb", &rest)).expect("it reads");
    assert_eq!(position, [[1.0, 2.0, 3.0]]);
    let expected = [("red", 255.0), ("green", 128.0), ("blue", 1.0)];
    assert_eq!(columns, expected.map(|(name, value)| (name.to_owned(), vec![value])));
    let rest = "SIZE 4 4 4 4\nTYPE F F F U\nCOUNT 1 1 1 1\nWIDTH 1\nHEIGHT 1\nPOINTS 1\nDATA ascii\n1 2 3 4278255360\n";
    let (_, columns) = outcome_of("p.pcd", &ascii("x y z rgba", rest)).expect("it reads");
    let expected = [("red", 0.0), ("green", 255.0), ("blue", 0.0), ("alpha", 255.0)];
    assert_eq!(columns, expected.map(|(name, value)| (name.to_owned(), vec![value])));
}

#[test]
fn what_a_pcd_header_leaves_out_is_as_pcl_has_it_and_padding_is_no_column() {
    let (position, columns) =
        outcome_of("p.pcd", &ascii("x y _ z label", "POINTS 2\nDATA ascii\n1 2 9 3 4\n5 6 9 7 8"))
            .expect("it reads");
    assert_eq!(position, [[1.0, 2.0, 3.0], [5.0, 6.0, 7.0]]);
    assert_eq!(columns, [("label".to_owned(), vec![4.0, 8.0])]);
}

#[test]
fn a_pcd_file_that_is_cut_off_is_a_sentence_at_every_byte() {
    for name in ENCODED {
        let whole = bytes(name);
        let unnoticed = truncations("p.pcd", &whole);
        // A shortened last number of a text is a number, and its line end is not needed.
        let least = if name.starts_with("ascii") { whole.len() - 4 } else { whole.len() };
        assert!(unnoticed.iter().all(|&length| length >= least), "{name}: {unnoticed:?} of {}", whole.len());
    }
}

#[test]
fn a_damaged_pcd_file_is_points_or_a_sentence() {
    for name in ENCODED {
        let (refused, flipped) = flips("p.pcd", &bytes(name), |_| ());
        assert!(refused > 40 && refused < flipped, "{name}: {refused} of {flipped}");
    }
}

#[test]
fn what_a_pcd_header_claims_is_checked() {
    let said = |rest: &str| refusal(&ascii("x y z", rest));
    for (rest, expected) in [
        ("WIDTH 2\nHEIGHT 2\nPOINTS 3\nDATA ascii\n", "line 7: POINTS is 3, where WIDTH and HEIGHT make 4"),
        ("DATA ascii\n", "line 4: neither `POINTS` nor `WIDTH` before `DATA`"),
        (
            "WIDTH 9999999999\nHEIGHT 9999999999\nDATA ascii\n",
            "line 6: a grid of 9999999999 × 9999999999 points",
        ),
        ("SIZE 4 4\nWIDTH 1\nDATA ascii\n", "line 6: SIZE has 2 words for 3 fields"),
        ("SIZE 4 4 3\nWIDTH 1\nDATA ascii\n", "line 6: field `z` of type F and size 3"),
        ("COUNT 1 1 2\nWIDTH 1\nDATA ascii\n", "line 6: no fields called x, y and z, of one number each"),
        ("COUNT 1 1 999999999999\nWIDTH 1\nDATA ascii\n", "line 6: a point of more than 8192 numbers"),
        ("WIDTH 1\nDATA zipped\n", "line 5: `zipped` where ascii, binary or binary_compressed"),
        ("SHAPE 1\n", "line 4: `SHAPE` where VERSION"),
        ("WIDTH 2\nDATA ascii\n1 2 3\n", "line 6: the file ends early: 1 of 2 points read"),
        ("WIDTH 1\nDATA ascii\n1 2\n", "line 6: fewer numbers than the 3 of a point"),
        ("WIDTH 1\nDATA ascii\n1 2 3 4\n", "line 6: 1 numbers more than the 3 of a point"),
        ("WIDTH 1\nDATA ascii\n1 two 3\n", "line 6: `two` is no number of type f32"),
        ("WIDTH 2\nDATA binary\nabc", "byte 68: the file ends early: 0 of 2 points read"),
    ] {
        assert!(said(rest).starts_with(expected), "{}, not {expected}", said(rest));
    }
}

/// A block of LZF: sizes, and tokens that make far more of little.
#[test]
fn compressed_points_cannot_claim_more_than_they_hold() {
    let file = |points: u32, packed: u32, unpacked: u32, body: &[u8]| {
        let mut bytes = ascii("x y z", &format!("WIDTH {points}\nDATA binary_compressed\n"));
        bytes.extend(packed.to_le_bytes());
        bytes.extend(unpacked.to_le_bytes());
        bytes.extend(body);
        bytes
    };
    // One byte, then 264 and 264 and so on of the same.
    let long = [&[0, 7][..], &[0xe0, 255, 0].repeat(5), &[0xe0, 255 - 124, 0]].concat();
    let points = (1 + 5 * 264 + 140) / 12 - 1;
    let whole = file(points, long.len() as u32, 12 * points, &long);
    assert!(
        refusal(&whole).contains("the compressed points are more than their size says"),
        "{}",
        refusal(&whole)
    );
    let short = [&[0, 7][..], &[0xe0, 255, 0].repeat(4), &[0xe0, 134, 0]].concat();
    let points = (1 + 4 * 264 + 143) / 12;
    let (position, _) =
        outcome_of("p.pcd", &file(points, short.len() as u32, 12 * points, &short)).expect("it reads");
    assert_eq!(position.len(), points as usize);
    assert!(position.iter().flatten().all(|v| *v == f64::from(f32::from_bits(0x0707_0707))));
    for (bytes, said) in [
        (
            file(300_000_000, 6, 3_600_000_000, &[0; 6]),
            "3600000000 bytes of points are said to be compressed to 6",
        ),
        (
            file(1, 900, 12, &[0; 6]),
            "12 bytes of points are said to be compressed to 900, of which the file has 6",
        ),
        (file(2, 6, 12, &[0; 6]), "12 bytes of compressed points, where 2 points of 12 bytes were expected"),
        (file(1, 3, 12, &[0x20, 0, 9]), "refer to what comes before their beginning"),
        (file(1, 3, 12, &[1, 0, 9]), "end here, and are fewer than their size says"),
    ] {
        assert!(refusal(&bytes).contains(said), "{}", refusal(&bytes));
    }
}

/// What is needed does not grow with the number of points, in any encoding.
#[test]
fn memory_of_pcd_is_that_of_its_fields() {
    let folder = folder();
    let path = folder.path().join("p.pcd");
    let needed = |bytes: &[u8]| {
        std::fs::write(&path, bytes).expect("a write");
        points::open(&path, &ReadOptions::default()).expect("it opens").memory_needed()
    };
    let file = |points: u32| {
        // Bytes as they are: a token of 32 each.
        let body = [&[31; 1][..], &[65; 32]].concat().repeat(3 * points as usize / 8);
        let header = format!("SIZE 4 4 4\nWIDTH {points}\nDATA binary_compressed\n");
        [
            ascii("x y z", &header),
            (body.len() as u32).to_le_bytes().to_vec(),
            (12 * points).to_le_bytes().to_vec(),
            body,
        ]
        .concat()
    };
    let (small, large) = (needed(&file(800)), needed(&file(80_000)));
    assert_eq!(small, large);
    assert!(large < 300_000 && file(80_000).len() > 900_000, "{large}");
}

/// As pypcd4 reads them.
#[test]
fn real_pcd_files_are_read_as_by_another_reader() {
    let Some(folder) = real_data("pcd") else { return };
    for (name, points, missing, sums) in [
        ("autzen-utm.pcd", 1065, 0, [526_636_816.64, 5_195_213_595.26, 140_913.34]),
        ("bun0.pcd", 397, 0, [-11.545135005610064, 40.75310292094946, 10.838877076108474]),
        ("car6.pcd", 10031, 0, [-375_096.4949645996, -647_618.8002090454, -63_155.11009502411]),
        ("colored_cloud.pcd", 1000, 0, [-218.51275972346775, -513.7772444486618, 1210.1030099391937]),
        ("office1.pcd", 307_200, 52_744, [-46_326.294224539306, -30_577.450752738398, 1_020_420.6150166988]),
        ("office1_keypoints.pcd", 1318, 0, [408.1211923509836, -1397.7022200096399, 282.80942551861517]),
    ] {
        let (position, columns) = table(&folder.join(name), None).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(position.len(), points);
        assert_eq!(position.iter().filter(|p| p[0].is_nan()).count(), missing);
        for axis in 0..3 {
            let sum: f64 = position.iter().map(|p| p[axis]).filter(|v| !v.is_nan()).sum();
            assert!((sum - sums[axis]).abs() < 1e-9 * sums[axis].abs(), "{name}: {sum}");
        }
        let sum = |name: &str| -> f64 {
            columns.iter().find(|c| c.0 == name).map_or(f64::NAN, |c| c.1.iter().sum())
        };
        let colors = ["red", "green", "blue"].map(sum);
        match name {
            "colored_cloud.pcd" => assert_eq!(colors, [140_634.0, 139_284.0, 136_778.0]),
            "office1.pcd" => assert_eq!(colors, [49_843_515.0, 46_461_178.0, 46_260_514.0]),
            "autzen-utm.pcd" => {
                assert_eq!(["Red", "Green", "Blue"].map(sum), [129_567.0, 118_582.0, 134_764.0]);
                assert!((sum("GpsTime") - 263_704_809.3907848).abs() < 1e-6);
            }
            "office1_keypoints.pcd" => assert!((sum("intensity") - 652.1921992003918).abs() < 1e-6),
            _ => {}
        }
    }
}
