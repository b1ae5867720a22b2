//! Snapshots in GADGET's binary formats: both formats, both byte orders, several files, and marks
//! that are wrong.

use rayset::points::{self, ReadOptions};

use crate::common::folder;
use crate::fixture::{attempt, check_all, damage, fixtures};

#[test]
fn both_formats_in_both_byte_orders_are_read_exactly() {
    check_all("gadget");
}

#[test]
fn a_snapshot_says_its_format_redshift_and_what_was_read() {
    let source =
        points::open(fixtures("gadget").join("parts.0"), &ReadOptions::default()).expect("a snapshot");
    let said = &source.schema().description;
    for part in
        ["format 2, redshift 3", "box size 1000", "2 files; 13 particles of type gas", "compact support"]
    {
        assert!(said.contains(part), "{said}");
    }
}

#[test]
fn a_record_mark_that_differs_behind_a_block_is_an_error_with_its_place() {
    let folder = folder();
    let path = folder.path().join("snap");
    let mut bytes = std::fs::read(fixtures("gadget").join("format1")).expect("a fixture");
    // Behind the 256 bytes of the header and 41 positions.
    let end = 264 + 4 + 41 * 12;
    bytes[end] ^= 4;
    std::fs::write(&path, &bytes).expect("a write");
    let said = attempt(&path).expect_err("a wrong mark");
    assert!(said.contains(&format!("byte {end}")) && said.contains("where 492 stands before it"), "{said}");
}

#[test]
fn damaged_snapshots_of_gadget_are_errors_and_never_panics() {
    // The two are no longer than their parts, so every shortened one up to its positions is an
    // error.
    assert!(damage(&fixtures("gadget").join("format1"), 17) > 40);
    assert!(damage(&fixtures("gadget").join("format2_big"), 31) > 40);
}

#[test]
fn a_header_of_another_length_is_an_error_with_its_place() {
    let folder = folder();
    let path = folder.path().join("snap");
    let record = |bytes: &[u8]| {
        let mark = (bytes.len() as u32).to_le_bytes();
        [&mark[..], bytes, &mark].concat()
    };
    let bytes = [record(b"HEAD\x08\x01\0\0"), record(&[0; 200]), record(b"POS \x08\0\0\0"), record(&[0; 12])];
    std::fs::write(&path, bytes.concat()).expect("a write");
    let said = attempt(&path).expect_err("a short header");
    assert!(said.contains("byte 16: the header has 200 bytes, expected 256"), "{said}");
}
