//! E57: scans, poses, what is invalid, and damaged files with and without right checksums.

use rayset::points::{self, ReadOptions};

use crate::common::{folder, real_data};
use crate::fixtures::{are_same, bytes, check, flips, in_batches, outcome_of, path, truncations};
use crate::tables::table;

/// Makes the checksum of every page right.
fn seal(bytes: &mut [u8]) {
    for page in bytes.chunks_exact_mut(1024) {
        let sum = crc32c::crc32c(&page[..1020]);
        page[1020..].copy_from_slice(&sum.swap_bytes().to_le_bytes());
    }
}

/// The file with a piece of its XML replaced by one of the same length.
fn with_xml(name: &str, old: &str, new: &str) -> Vec<u8> {
    assert!(new.len() <= old.len(), "{new}");
    let mut bytes = bytes(name);
    // Without the checksums, between which a piece may lie.
    let places: Vec<usize> = (0..bytes.len()).filter(|at| at % 1024 < 1020).collect();
    let content: Vec<u8> = places.iter().map(|&at| bytes[at]).collect();
    let found = content.windows(old.len()).position(|w| w == old.as_bytes()).expect("the piece");
    let padded = format!("{new:<width$}", width = old.len());
    padded.bytes().enumerate().for_each(|(i, byte)| bytes[places[found + i]] = byte);
    seal(&mut bytes);
    bytes
}

fn refusal(bytes: &[u8]) -> String {
    outcome_of("p.e57", bytes).expect_err("refused").split_once(", ").expect("a place").1.to_owned()
}

#[test]
fn scans_of_an_e57_file_are_one_cloud_with_poses_limits_and_invalid_states() {
    check(&path("two_scans.e57"), "two_scans.e57.json");
}

#[test]
fn e57_bytes_stay_bytes_and_other_coordinates_stand_in_for_invalid_ones() {
    check(&path("one_scan.e57"), "one_scan.e57.json");
    let source = points::open(path("one_scan.e57"), &ReadOptions::default()).expect("it opens");
    assert_eq!(format!("{:?}", source.schema().color_depth), "Byte");
    let source = points::open(path("two_scans.e57"), &ReadOptions::default()).expect("it opens");
    assert_eq!(format!("{:?}", source.schema().color_depth), "Unit");
    assert_eq!(source.count_hint(), Some(65));
}

#[test]
fn e57_is_known_by_its_content_and_read_alike_in_batches_of_any_size() {
    let folder = folder();
    let named = folder.path().join("scan.txt");
    std::fs::write(&named, bytes("two_scans.e57")).expect("a write");
    let whole = table(&named, None).expect("it reads");
    for size in [1, 7, 39, 1000] {
        let parts = in_batches(&named, size, 5).expect("it reads");
        assert!(are_same(&parts.0, &whole.0));
        assert_eq!(format!("{:?}", parts.1[0]), format!("{:?}", whole.1[5]));
    }
}

#[test]
fn an_e57_file_that_is_cut_off_or_damaged_is_a_sentence() {
    for name in ["one_scan.e57", "two_scans.e57"] {
        let whole = bytes(name);
        assert_eq!(truncations("p.e57", &whole), [0_usize; 0]);
        // Every page is read, so every flipped byte is noticed but in pages between a scan and the
        // XML.
        let (refused, flipped) = flips("p.e57", &whole, |_| ());
        assert_eq!(refused, flipped, "{name}");
    }
    let mut longer = bytes("one_scan.e57");
    longer.extend([0; 1024]);
    assert!(refusal(&longer).starts_with("byte 16: the header says that the file has 4096 bytes"));
}

#[test]
fn an_e57_file_that_lies_with_right_checksums_is_points_or_a_sentence() {
    let (refused, flipped) = flips("p.e57", &bytes("one_scan.e57"), seal);
    assert!(refused > 200 && refused < flipped, "{refused} of {flipped}");
}

#[test]
fn what_an_e57_file_claims_is_held_against_its_size() {
    let more = with_xml("one_scan.e57", "recordCount=\"30\"", "recordCount=\"99\"");
    assert!(refusal(&more).contains("do not fit into the file"), "{}", refusal(&more));
    let few = with_xml("one_scan.e57", "recordCount=\"30\"", "recordCount=\"3\"");
    assert_eq!(outcome_of("p.e57", &few).expect("fewer").0.len(), 3);
    let whole = bytes("two_scans.e57");
    for (at, number, said) in [
        (16, 1_u64 << 60, "the header says that the file has"),
        (24, 1 << 40, "the XML section is said to begin at byte"),
        (32, 1 << 50, "an XML section of"),
        (40, 512, "pages of 512 bytes"),
        (8, 2, "E57 2.0 is unknown"),
    ] {
        let mut lying = whole.clone();
        lying[at..at + 8].copy_from_slice(&number.to_le_bytes());
        if at == 8 {
            lying[12..16].fill(0);
        }
        seal(&mut lying);
        assert!(refusal(&lying).contains(said), "{}", refusal(&lying));
    }
}

/// Fields of a single value take no bytes, so a few letters could ask for any number of points.
#[test]
fn points_that_take_no_bytes_are_bounded() {
    let mut xml = String::from(
        "<?xml version=\"1.0\"?><e57Root type=\"Structure\" xmlns=\"http://www.astm.org/COMMIT/E57/2010-e57-v1.0\">\
         <formatName type=\"String\">ASTM E57 3D Imaging Data File</formatName><guid type=\"String\">a</guid>\
         <versionMajor type=\"Integer\">1</versionMajor><versionMinor type=\"Integer\">0</versionMinor>\
         <data3D type=\"Vector\"><vectorChild type=\"Structure\"><points type=\"CompressedVector\" fileOffset=\"48\" \
         recordCount=\"COUNT\"><prototype type=\"Structure\">",
    );
    for axis in ["X", "Y", "Z"] {
        xml += &format!("<cartesian{axis} type=\"Integer\" minimum=\"4\" maximum=\"4\"/>");
    }
    xml += "</prototype></points></vectorChild></data3D></e57Root>";
    let file = |count: &str| {
        let xml = xml.replace("COUNT", count);
        let mut content = b"ASTM-E57".to_vec();
        let pages = (80 + xml.len()).div_ceil(1020);
        content.extend(1_u32.to_le_bytes());
        content.extend(0_u32.to_le_bytes());
        for number in [1024 * pages, 80, xml.len(), 1024] {
            content.extend((number as u64).to_le_bytes());
        }
        content.extend([1, 0, 0, 0, 0, 0, 0, 0]);
        for number in [32_u64, 80, 0] {
            content.extend(number.to_le_bytes());
        }
        content.extend(xml.bytes());
        content.resize(1020 * pages, 0);
        let mut bytes: Vec<u8> = content.chunks(1020).flat_map(|c| c.iter().copied().chain([0; 4])).collect();
        seal(&mut bytes);
        bytes
    };
    let three = outcome_of("p.e57", &file("3")).expect("it reads");
    assert_eq!(three.0, [[4.0; 3]; 3]);
    let said = refusal(&file("9000000000000000000"));
    assert!(said.contains("9000000000000000000 points of 0 bits, which do not fit"), "{said}");
}

#[test]
fn an_e57_file_without_scans_or_coordinates_says_so() {
    let said = refusal(&with_xml("one_scan.e57", "<data3D type=\"Vector\"", "<data3d type=\"Vector\""));
    assert!(said.contains("XML"), "{said}");
    let none = with_xml("one_scan.e57", "<sphericalRange ", "<sphericalrange ");
    let none = outcome_of("p.e57", &none).expect("Cartesian coordinates are enough");
    assert_eq!(none.0.iter().filter(|p| p[0].is_nan()).count(), 10);
    let said = refusal(&with_xml("two_scans.e57", "<sphericalRange ", "<sphericalrange "));
    assert!(said.contains("scan 1 has neither all of cartesianX"), "{said}");
}

/// As pye57 (libE57Format) reads them.
#[test]
fn real_e57_files_are_read_as_by_lib_e57_format() {
    let Some(folder) = real_data("e57") else { return };
    let read = |name: &str| table(&folder.join(name), None).unwrap_or_else(|e| panic!("{e}"));
    let close = |a: f64, b: f64| (a - b).abs() <= 1e-9 * b.abs().max(1.0);
    let sums =
        |found: &[[f64; 3]], axis: usize| found.iter().map(|p| p[axis]).filter(|v| !v.is_nan()).sum::<f64>();
    for (name, points, expected) in [
        ("bunnyDouble.e57", 30571, [-841.093298, 3151.1987419999996, 264.243972]),
        ("bunnyFloat.e57", 30571, [-841.0932977735692, 3151.198741853237, 264.2439720416619]),
        ("bunnyInt24.e57", 30571, [-841.093298, 3151.1987419999996, 264.243972]),
        ("tinyCartesianFloatRgb.e57", 2090, [-16812.262330532074, 12566.194438457489, 620734.6056213379]),
        ("tiny_pc_and_images.e57", 2, [1.0, 1.0, 1.0]),
    ] {
        let (position, _) = read(name);
        assert_eq!(position.len(), points, "{name}");
        assert!((0..3).all(|axis| close(sums(&position, axis), expected[axis])), "{name}");
    }
    let (_, columns) = read("tinyCartesianFloatRgb.e57");
    let sum = |i: usize| columns[i].1.iter().sum::<f64>();
    assert_eq!([sum(0), sum(1), sum(2)], [273_804.0, 253_408.0, 236_424.0]);
    assert_eq!(read("integer_intensity.e57").1[0].1, [-66.0, 66.0]);
    assert!(close(read("scaled_integer_intensity.e57").1[0].1[1], 66.6));
    let (position, _) = read("tiny_spherical.e57");
    assert_eq!(position.iter().filter(|p| !p[0].is_nan()).count(), 180);
    assert!(close(sums(&position, 0), 89.95435666933113) && close(sums(&position, 2), 114.6459050783777));
}

#[test]
fn scans_that_claim_the_same_bytes_are_refused_before_they_are_read_over_and_over() {
    // Each of the two would fit into the file by itself.
    let (old, new) = (r#"fileOffset="1432" recordCount="25""#, r#"fileOffset="48" recordCount="400""#);
    let said = refusal(&with_xml("two_scans.e57", old, new));
    assert!(said.contains("scan 1 has 400 points") && said.contains("do not fit into the file"), "{said}");
}
