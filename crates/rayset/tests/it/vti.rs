//! VTI files as programs write them, and as they should not be.

use rayset::grid::Grid;
use rayset::grid::build::{GridBuildOptions, build};
use rayset::volumes;

use crate::common::folder;
use crate::volumes::{SIZE, built, reference, refused, voxels};
use crate::vti_text::{base64, blocks, vti, words, zipped};

const ZLIB: &str = " compressor=\"vtkZLibDataCompressor\"";

fn ascii() -> String {
    let numbers: Vec<String> =
        voxels().chunks(2).map(|two| i16::from_le_bytes([two[0], two[1]]).to_string()).collect();
    numbers.join(" ")
}

fn inline(head: &[u64]) -> String {
    base64(&[words(head, 4), voxels()].concat())
}

fn appended(encoding: &str, offset: u64, file: &str, data: &[u8]) -> Vec<u8> {
    let array = format!("format=\"appended\" offset=\"{offset}\"/>");
    let tail: &[u8] = b"\n</AppendedData>\n</VTKFile>\n";
    [vti(&array, file, encoding).as_bytes(), data, tail].concat()
}

#[test]
fn every_way_to_write_a_vti_gives_the_same_grid() {
    let folder = folder();
    let f = folder.path();
    let (_, expected) = reference(f);
    let plain = [words(&[120], 4), voxels()].concat();
    let wide = " header_type=\"UInt64\"";
    let swapped: Vec<u8> = voxels().chunks(2).flat_map(|two| [two[1], two[0]]).collect();
    let text = vti(&format!("format=\"ascii\">\n{}</DataArray>", ascii()), "", "");
    let file = |bytes: &[u8]| bytes.to_vec();
    let table = |width| {
        let all = blocks(&voxels(), 50, width);
        let (head, data) = all.split_at(6 * width);
        // The table and the blocks, padded each by itself, or in one.
        [base64(head) + &base64(data), base64(&all)]
    };
    let [apart, together] = table(4);
    let element = |text: &str| format!("format=\"binary\">\n {text}\n </DataArray>");
    let mut cases: Vec<(&str, Vec<u8>)> = vec![
        ("ascii", file(text.as_bytes())),
        ("inline", vti(&element(&inline(&[120])), "", "").into()),
        ("inline, lines", vti(&element(&inline(&[120]).replace('A', "A\n")), "", "").into()),
        ("inline, length by itself", {
            let text = base64(&words(&[120], 4)) + &base64(&voxels());
            vti(&element(&text), "", "").into()
        }),
        ("inline, UInt64", vti(&element(&base64(&[words(&[120], 8), voxels()].concat())), wide, "").into()),
        ("inline, zlib", vti(&element(&apart), ZLIB, "").into()),
        ("inline, zlib in one", vti(&element(&together), ZLIB, "").into()),
        ("raw", appended("raw", 0, "", &plain)),
        ("raw, later", appended("raw", 7, "", &[b"1234567", &plain[..], b"<more>"].concat())),
        ("raw, UInt64", appended("raw", 0, wide, &[words(&[120], 8), voxels()].concat())),
        ("raw, zlib", appended("raw", 3, ZLIB, &[b"abc", &blocks(&voxels(), 50, 4)[..]].concat())),
        ("raw, zlib, whole blocks", appended("raw", 0, ZLIB, &blocks(&voxels(), 40, 4))),
        ("raw, zlib, UInt64", appended("raw", 0, &(ZLIB.to_owned() + wide), &blocks(&voxels(), 120, 8))),
        ("base64", appended("base64", 0, "", base64(&plain).as_bytes())),
        (
            "base64, later",
            appended("base64", 8, "", ["AAAAAAAA", &base64(&plain), "AAAA"].concat().as_bytes()),
        ),
        ("base64, zlib", appended("base64", 4, ZLIB, ["AAAA", &apart].concat().as_bytes())),
    ];
    let big = String::from_utf8(appended(
        "base64",
        0,
        "",
        base64(&[&[0, 0, 0, 120], &swapped[..]].concat()).as_bytes(),
    ));
    cases.push(("big-endian", big.expect("text").replace("LittleEndian", "BigEndian").into()));
    for (name, from, to) in [
        ("single quotes", "WholeExtent=\"0 4 0 3 0 2\"", "WholeExtent='0 4 0 3 0 2'"),
        ("tabs", "<ImageData WholeExtent=\"0 4 0 3 0 2\"", "<ImageData\tWholeExtent\t=\n\"0 4\t0 3  0\n2\""),
        ("entities", "Name=\"v\"", "Name=\"&#118;\""),
        (
            "a comment",
            "<ImageData",
            "<!-- <ImageData WholeExtent=\"0 9 0 9 0 9\"> <DataArray type=\"Int8\"> -->\n<ImageData",
        ),
        ("a comment of data", "<PointData", "<!-- <PointData Scalars=\"w\"> --><PointData"),
        ("a declaration", "<VTKFile", "<!DOCTYPE VTKFile>\n<VTKFile"),
        ("a mark", "<?xml", "\u{feff}<?xml"),
        (
            "field data",
            "<Piece",
            "<FieldData><DataArray type=\"Int8\" Name=\"v\" format=\"ascii\">1 2 > 3</DataArray></FieldData><Piece",
        ),
        (
            "cells first",
            "<PointData",
            "<CellData Scalars=\"v\"><DataArray type=\"Int8\" Name=\"v\" format=\"ascii\">1 2</DataArray></CellData><PointData",
        ),
        (
            "another array",
            "<DataArray",
            "<DataArray type=\"Int8\" Name=\"w\" format=\"ascii\">1 2 3</DataArray>\n<DataArray",
        ),
        (
            "keys",
            "format=\"ascii\">",
            "format=\"ascii\">\n<InformationKey name=\"k\" location=\"l\"><Value>1</Value></InformationKey>\n",
        ),
        ("a name with >", "<PointData", "<PointData note=\"a > b\""),
        ("no scalars", " Scalars=\"v\"", ""),
        (
            "vectors first",
            " Scalars=\"v\">",
            "><DataArray type=\"Int8\" NumberOfComponents=\"3\" Name=\"w\" format=\"ascii\">1</DataArray>",
        ),
    ] {
        assert!(text.contains(from), "{name}");
        cases.push((name, text.replacen(from, to, 1).into()));
    }
    for (name, bytes) in cases {
        let found = built(f, "a.vti", &bytes).unwrap_or_else(|e| panic!("{name}: {e}"));
        assert!(found == expected, "{name}: another grid");
    }
}

#[test]
fn a_vti_that_contradicts_itself_is_an_error_that_says_where() {
    let folder = folder();
    let f = folder.path();
    let (_, expected) = reference(f);
    let text = vti(&format!("format=\"ascii\">\n{}</DataArray>", ascii()), "", "");
    for (from, to, what) in [
        ("WholeExtent=\"0 4 0 3 0 2\"", "WholeExtent=\"0 4 0 3 0 1\"", "Piece, Extent: differs"),
        (
            "WholeExtent=\"0 4 0 3 0 2\"",
            "WholeExtent=\"0 4 0 3 0 2.5\"",
            "WholeExtent: expected six whole numbers",
        ),
        ("Piece Extent=\"0 4 0 3 0 2\"", "Piece Extent=\"0 4 0 3 1 2\"", "differs from WholeExtent"),
        ("Piece Extent=\"0 4 0 3 0 2\"", "Piece", "Extent: expected six whole numbers"),
        ("0 4 0 3 0 2", "0 4 0 3 0 0", "2 to 16777216"),
        ("0 4 0 3 0 2", "0 4 0 3 2 0", "2 to 16777216"),
        ("0 4 0 3 0 2", "-9223372036854775808 9223372036854775807 0 3 0 2", "2 to 16777216"),
        ("0 4 0 3 0 2", "0 9999999 0 9999999 0 9999999", "WholeExtent"),
        ("0 4 0 3 0 2", "0 9999 0 9999 0 9999", "ends before"),
        ("</Piece>", "</Piece><Piece Extent=\"0 4 0 3 0 2\"></Piece>", "a second Piece"),
        ("Spacing=\"1 2 3\"", "Spacing=\"1 nan 3\"", "Spacing: expected three finite numbers"),
        ("Spacing=\"1 2 3\"", "Spacing=\"1 0 3\"", "Spacing: the axes"),
        ("Spacing=\"1 2 3\"", "Direction=\"1 0 0 1 0 0 0 0 1\"", "the axes"),
        ("Spacing=\"1 2 3\"", "Spacing=\"1 2 3\" Spacing=\"1 2 3\"", "comes twice"),
        ("type=\"Int16\"", "type=\"String\"", "type: expected Int8"),
        ("type=\"Int16\"", "type=\"UInt8\"", "number 1: `-300` is no u8"),
        ("-300", "-300.5", "number 1: `-300.5` is no i16"),
        ("-300", "", "ends after 59 numbers of 60"),
        ("-300", "-300 7", "goes on behind its 60 numbers"),
        ("type=\"ImageData\"", "type=\"PolyData\"", "only ImageData"),
        ("LittleEndian", "MiddleEndian", "byte_order"),
        ("version=\"1.0\" byte", "header_type=\"UInt16\" byte", "header_type"),
        ("format=\"ascii\"", "format=\"octal\"", "format: expected ascii"),
        ("format=\"ascii\"", "format=\"appended\" offset=\"0\"", "no AppendedData"),
        ("Name=\"v\"", "Name=\"v\" NumberOfComponents=\"3\"", "NumberOfComponents"),
        ("Name=\"v\"", "Name=v", "well-formed"),
        ("</PointData>", "", "well-formed"),
        ("</VTKFile>", "", "ends within VTKFile"),
        ("</DataArray>", "", "well-formed"),
        ("-300", "-300 <!-- --> ", "several parts"),
        ("<VTKFile", "<a", "byte"),
    ] {
        assert!(text.contains(from), "{from}");
        refused(f, "a.vti", text.replace(from, to).as_bytes(), what);
    }
    refused(f, "b.vti", "<a>".repeat(100_000).as_bytes(), "deep");
    refused(f, "b.vti", &vec![b' '; 2 << 20], "goes on beyond");
    refused(f, "b.vti", b"not XML", "not a VTK file");
    let many: String = (0..50_000).map(|i| format!(" a{i}=\"\"")).collect();
    refused(f, "b.vti", format!("<VTKFile{many}>").as_bytes(), "attributes");

    let plain = |length: u64| [words(&[length], 4), voxels()].concat();
    for length in [0, 119, 121, 4_294_967_295] {
        refused(f, "c.vti", &appended("raw", 0, "", &plain(length)), "asks for 120");
        let element = format!("format=\"binary\">{}</DataArray>", inline(&[length]));
        refused(f, "c.vti", vti(&element, "", "").as_bytes(), "asks for 120");
    }
    for offset in [1000, u64::MAX, u64::MAX - 300] {
        refused(f, "c.vti", &appended("raw", offset, "", &plain(120)), "beyond the end");
    }
    refused(
        f,
        "c.vti",
        vti("format=\"appended\" offset=\"0\"/>", "", "raw").replace(" _", "x_").as_bytes(),
        "expected `_`",
    );
    refused(f, "c.vti", &appended("hex", 0, "", &plain(120)), "encoding: expected raw or base64");
    refused(
        f,
        "c.vti",
        &appended("raw", 0, " compressor=\"vtkLZ4DataCompressor\"", &plain(120)),
        "compressor",
    );
    let raw = vti("format=\"appended\" offset=\"0\"/>", "", "raw");
    refused(f, "c.vti", &[raw.as_bytes(), &plain(120)[..100]].concat(), "ends before");
    for (from, to, what) in [
        ("AAA", "A!A", "no letter of base64"),
        ("AAA", "A=A", "base64"),
        ("</DataArray>", "AAAA</DataArray>", "go on behind the voxels"),
    ] {
        let text = vti(&format!("format=\"binary\">{}</DataArray>", inline(&[120])), "", "");
        refused(f, "d.vti", text.replacen(from, to, 1).as_bytes(), what);
    }
    assert_eq!(built(f, "e.vti", text.as_bytes()), Ok(expected));
}

#[test]
fn lengths_of_compressed_blocks_must_be_true() {
    let folder = folder();
    let f = folder.path();
    let blocks_of = |head: &[u64], data: &[Vec<u8>]| {
        let sizes: Vec<u64> = data.iter().map(|block| block.len() as u64).collect();
        [words(head, 4), words(&sizes, 4), data.concat()].concat()
    };
    let zip = |ranges: &[std::ops::Range<usize>]| -> Vec<Vec<u8>> {
        ranges.iter().map(|range| zipped(&voxels()[range.clone()])).collect()
    };
    built(f, "a.vti", &appended("raw", 0, ZLIB, &blocks_of(&[2, 60, 0], &zip(&[0..60, 60..120]))))
        .expect("it builds");
    for (head, data, what) in [
        (vec![2, 60, 0], zip(&[0..59, 60..120]), "block 1 of 2: it holds less"),
        (vec![2, 60, 0], zip(&[0..61, 60..120]), "block 1 of 2: it holds more"),
        (vec![2, 60, 0], zip(&[0..60, 60..119]), "block 2 of 2: it holds less"),
        (vec![2, 100, 20], zip(&[0..100, 100..119]), "block 2 of 2: it holds less"),
        (vec![2, 60, 59], zip(&[0..60, 60..119]), "asks for 120"),
        (vec![2, 20, 100], zip(&[0..20, 20..120]), "longer than the others"),
        (vec![0, 0, 0], vec![], "asks for 120"),
        (vec![0, 120, 0], vec![], "asks for 120"),
        (vec![4_294_967_295, 4_294_967_295, 0], vec![], "asks for 120"),
        (vec![120, 1, 1], vec![], "room for"),
    ] {
        refused(f, "b.vti", &appended("raw", 0, ZLIB, &blocks_of(&head, &data)), what);
    }
    // Compressed sizes that are wrong by a byte, or by far.
    let good = blocks_of(&[2, 60, 0], &zip(&[0..60, 60..120]));
    for (at, change) in [(12, 1_u8), (12, 0xff), (16, 1), (16, 0xff)] {
        let mut bad = good.clone();
        bad[at] = bad[at].wrapping_add(change);
        let what = built(f, "c.vti", &appended("raw", 0, ZLIB, &bad)).expect_err("a wrong size");
        assert!(what.contains("c.vti"), "{what}");
        bad[at + 3] = 0xff;
        refused(f, "c.vti", &appended("raw", 0, ZLIB, &bad), "room for");
    }
    // Words of 64 bits whose products and sums do not fit.
    for head in [[u64::MAX, u64::MAX, u64::MAX], [2, u64::MAX, 1], [1 << 33, 1 << 31, 0], [u64::MAX, 1, 1]] {
        let file = format!("{ZLIB} header_type=\"UInt64\"");
        let what = built(f, "d.vti", &appended("raw", 0, &file, &words(&head, 8))).expect_err("impossible");
        assert!(what.contains("d.vti"), "{what}");
    }
    let file = format!("{ZLIB} header_type=\"UInt64\"");
    let sizes = [words(&[2, 60, 0, u64::MAX, u64::MAX], 8), voxels()].concat();
    refused(f, "d.vti", &appended("raw", 0, &file, &sizes), "room for");
}

#[test]
fn values_of_cells_stand_at_their_centres() {
    let folder = folder();
    let path = folder.path().join("a.vti");
    // As many cells as there are points elsewhere.
    let text = vti(&format!("format=\"ascii\">\n{}</DataArray>", ascii()), "", "")
        .replace("PointData", "CellData")
        .replace("0 4 0 3 0 2", "2 7 0 4 0 3");
    std::fs::write(&path, text).expect("a write");
    let source = volumes::open(&path, None).expect("it opens");
    let header = build(
        source,
        folder.path().join("a.rset"),
        &GridBuildOptions::default(),
        &rayset::build::BuildControl::default(),
    );
    let header = header.expect("it builds");
    assert_eq!(header.size, SIZE);
    assert_eq!(header.space_from_voxel.translation.to_array(), [2.5, 1.0, 1.5]);
    let values = Grid::open(folder.path().join("a.rset")).expect("it opens").load().expect("it loads");
    let expected: Vec<f32> =
        voxels().chunks(2).map(|two| f32::from(i16::from_le_bytes([two[0], two[1]]))).collect();
    assert_eq!(values, expected);
}
