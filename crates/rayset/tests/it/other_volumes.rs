//! Volumes that other projects wrote: arrays of NumPy, VTK's legacy files, OpenDX, SLC; and where
//! voxels are in the spaces of NRRD, NIfTI and MetaImage, beside what these projects' own readers
//! say.

use std::path::Path;

use rayset::volumes;

use crate::common::{folder, real_data};
use crate::volume_fixtures::{compare, cut_off, expected, fixtures, flipped, numbers, read};
use crate::volumes::gzipped;

#[test]
fn volumes_of_other_writers_have_their_voxels_and_places() {
    let expected = expected("volumes");
    let files = expected.as_object().expect("files");
    assert!(files.len() > 40);
    for (name, expected) in files {
        compare(&fixtures("volumes").join(name), expected);
    }
}

#[test]
fn volumes_of_the_test_data_are_as_other_programs_read_them() {
    let expected = expected("real_volumes");
    for (name, expected) in expected.as_object().expect("files") {
        let Some(path) = real_data(&format!("volume/{name}")) else { continue };
        compare(&path, expected);
    }
}

fn fixture(name: &str) -> Vec<u8> {
    std::fs::read(fixtures("volumes").join(name)).expect("a fixture")
}

fn refused(path: &Path, words: &[&str]) {
    let what = volumes::open(path, None).err().map(|e| e.to_string()).expect("it is refused");
    let name = path.file_name().expect("a name").to_string_lossy();
    assert!(volumes::is_volume(path).expect("it reads"), "{name} is taken for points");
    assert!(what.contains(&*name) && words.iter().all(|word| what.contains(word)), "{what}");
}

#[test]
fn volumes_that_are_not_read_are_refused_with_what_converts_them() {
    let folder = folder();
    let f = folder.path();
    let written = |name: &str, bytes: &[u8]| {
        std::fs::write(f.join(name), bytes).expect("a write");
        f.join(name)
    };
    refused(&written("a.vtk", &fixture("rectilinear.vtk")), &["evenly spaced along", "Resample To Image"]);
    refused(&written("b.vtk", &fixture("curved.vtk")), &["STRUCTURED_GRID", "Resample To Image"]);
    let dicom = [&[0; 128][..], b"DICM", &[0; 40]].concat();
    refused(&written("IM0001", &dicom), &["DICOM", "dcm2niix"]);
    refused(&written("stack.ome.tif", b"II*\0\x08\0\0\0"), &["TIFF", "tifffile"]);
    refused(&written("brain.img", &[0; 100]), &["Analyze", "nibabel"]);
    refused(&written("flow.vts", b"<?xml version=\"1.0\"?>"), &["ParaView"]);
    refused(&written("c.nrrd.gz", &gzipped(&fixture("RAS.nrrd"))), &["gunzip"]);
    refused(&written("d.dx.gz", &gzipped(&fixture("plain.dx"))), &["gunzip"]);
    for (name, inside, words) in [
        ("scan", "slice-1", ["DICOM", "dcm2niix"]),
        ("stack.zarr", ".zattrs", ["Zarr", "numpy.save"]),
        ("stack", ".zgroup", ["Zarr", "numpy.save"]),
    ] {
        std::fs::create_dir(f.join(name)).expect("a folder");
        let content = if inside.starts_with('.') { b"{}" } else { &dicom[..] };
        std::fs::write(f.join(name).join(inside), content).expect("a write");
        refused(&f.join(name), &words);
    }
}

#[test]
fn arrays_of_other_dimensions_and_other_datasets_are_no_volumes() {
    let folder = folder();
    let npy = |shape: &str, descr: &str| {
        let text = format!("{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}\n");
        [b"\x93NUMPY\x01\0", &(text.len() as u16).to_le_bytes()[..], text.as_bytes(), &[0; 600]].concat()
    };
    let points =
        b"# vtk DataFile Version 3.0\npoints\nASCII\nDATASET POLYDATA\nPOINTS 1 float\n0 0 0\n".to_vec();
    for (name, bytes, volume) in [
        ("a.npy", npy("(9, 3)", "'<f4'"), false),
        ("b.npy", npy("(9,)", "[('x', '<f4'), ('y', '<f4')]"), false),
        ("c.npy", npy("(9, 3, 2, 2)", "'<f4'"), false),
        ("d.npy", npy("(9, 3, 1)", "'<f4'"), false),
        ("e.npy", npy("(5, 5, 4)", "'<c8'"), false),
        ("f.npy", npy("(5, 5, 4)", "'<f4'"), true),
        ("g.vtk", points, false),
        ("h.xyz", b"11111 2 3\n4 5 6\n".to_vec(), false),
        ("i.csv", b"object class,x,y,z\n1,2,3,4\n".to_vec(), false),
    ] {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).expect("a write");
        assert_eq!(volumes::is_volume(&path).expect("it reads"), volume, "{name}");
    }
}

/// A grid of 4 × 3 × 2 points, and an array as the header says it.
fn dx(array: &str, data: &[u8], after: &str) -> Vec<u8> {
    let head = format!(
        "# made up\nobject 1 class gridpositions counts 4 3 2\n origin 1 2 3\n delta 1 0 0 delta 0 2 0\n delta 0 0 3\n\
         object 2 class gridconnections counts 4 3 2\nobject \"values\" class array {array}\n"
    );
    let field = "attribute \"dep\" string \"positions\"\nobject \"f\" class field\ncomponent \"positions\" value 1\n\
                 component \"data\" value \"values\"\nend\n";
    [head.as_bytes(), data, b"\n", field.as_bytes(), after.as_bytes()].concat()
}

#[test]
fn numbers_of_opendx_are_read_wherever_they_are_and_in_every_order_of_bytes() {
    let folder = folder();
    let path = folder.path().join("a.dx");
    let values: Vec<f32> = (0..24).map(|i| (i * i) as f32 - 7.5).collect();
    let text: String = values.iter().map(|v| format!("{v}\n")).collect();
    let little: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
    let big: Vec<u8> = little.chunks(4).flat_map(|b| b.iter().rev().copied().collect::<Vec<u8>>()).collect();
    std::fs::write(folder.path().join("numbers.bin"), [&[1; 16], &big[..]].concat()).expect("a write");
    let items = "type float rank 0 items 24";
    let behind = |numbers: &[u8]| {
        [dx(&format!("{items} lsb ieee data 3"), b"", ""), b"abc".to_vec(), numbers.to_vec()].concat()
    };
    let files = [
        dx(&format!("{items} data follows"), text.as_bytes(), ""),
        dx(&format!("{items} lsb ieee data follows"), &little, ""),
        dx("items 24 rank 1 shape 1 msb binary data follows", &big, ""),
        dx(&format!("{items} text data 0"), b"", &text),
        dx(&format!("{items} msb ieee data file numbers.bin,16"), b"", ""),
        behind(&little),
    ];
    for (number, bytes) in files.iter().enumerate() {
        std::fs::write(&path, bytes).expect("a write");
        let (source, found) = read(&path).unwrap_or_else(|what| panic!("file {number}: {what}"));
        assert_eq!(source.size, [2, 3, 4], "file {number}");
        assert_eq!(found, values, "file {number}");
        let last = source.space_from_voxel.transform_point3([1.0, 2.0, 3.0].into());
        assert_eq!(last.to_array(), [4.0, 6.0, 6.0]);
    }
    for (array, words) in [
        ("type float rank 0 items 24 ieee data follows", "order of bytes"),
        ("type float rank 0 items 23 msb ieee data 0", "23 items for a grid of 24"),
        ("type float rank 1 shape 3 items 24 msb ieee data 0", "3 numbers"),
        ("type string rank 0 items 24 data 0", "string"),
        ("type float category complex rank 0 items 24 msb ieee data 0", "one real number"),
        ("type float rank 0 items 24 msb ieee data file gone.bin,0", "gone.bin"),
        ("type float rank 0 items 24 msb xdr data 0", "unknown word `xdr`"),
        ("type float rank 0 items 99999999999999999999 data 0", "number of items"),
        ("type float rank 0 items 9999999999999 data follows", "ends before"),
    ] {
        std::fs::write(&path, dx(array, &little, "")).expect("a write");
        let what = read(&path).err().expect(words);
        assert!(what.contains(words), "{what}\nexpected: {words}");
    }
}

#[test]
fn data_of_cells_lie_at_their_centres_in_opendx() {
    let folder = folder();
    let path = folder.path().join("a.dx");
    let text = String::from_utf8(dx("items 6 data follows", b"1 2 3 4 5 6", "")).expect("text");
    let text = text
        .replace("string \"positions\"", "string \"connections\"")
        .replace("counts 4 3 2", "counts 3 3 3");
    let text = text.replace("items 6", "items 8").replace("5 6", "5 6 7 8");
    std::fs::write(&path, text).expect("a write");
    let (source, found) = read(&path).expect("cells");
    assert_eq!((source.size, found.len(), found[7]), ([2, 2, 2], 8, 8.0));
    assert_eq!(source.space_from_voxel.translation.to_array(), [1.5, 3.0, 4.5]);
}

#[test]
fn volumes_of_other_writers_that_are_damaged_are_errors() {
    let folder = folder();
    // Lines that are empty at the end hold no numbers, nor does the rest of OpenDX behind its
    // array.
    let blank: fn(&[u8]) -> bool = |rest| rest.iter().all(u8::is_ascii_whitespace);
    let behind_array: fn(&[u8]) -> bool = |rest| {
        let array_ends = rest.windows(9).position(|part| part == b"attribute");
        array_ends.is_none_or(|end| rest[..end].iter().all(u8::is_ascii_whitespace))
    };
    // The last number of a text ends with the file, if no white space follows: one that is
    // shortened is a number, too.
    let of_last_number: fn(&[u8]) -> bool = |rest| rest.trim_ascii().iter().all(u8::is_ascii_digit);
    for (name, harmless) in [
        ("c_little_i2.npy", (|_| false) as fn(&[u8]) -> bool),
        ("c_u1.npy", |_| false),
        ("stored.npz", |_| false),
        ("deflated.npz", |_| false),
        ("runs.slc", |_| false),
        ("plain.slc", |_| false),
        ("plain.dx", behind_array),
        ("ascii_cells.vtk", of_last_number),
        ("binary_cells.vtk", blank),
    ] {
        let path = folder.path().join(name);
        cut_off(&path, &fixture(name), harmless);
        flipped(&path, &fixture(name), 400);
    }
}

#[test]
fn a_checksum_of_an_archive_that_is_wrong_is_an_error() {
    let folder = folder();
    let path = folder.path().join("a.npz");
    let bytes = fixture("stored.npz");
    let header = volumes::open(fixtures("volumes").join("stored.npz"), None).expect("it opens");
    assert_eq!(header.size, [6, 5, 4]);
    // The voxels are 480 bytes before the list of files.
    let list = bytes.windows(4).position(|part| part == b"PK\x01\x02").expect("a list");
    for at in [list - 480, list - 1] {
        let mut changed = bytes.clone();
        changed[at] ^= 1;
        std::fs::write(&path, changed).expect("a write");
        let mut source = volumes::open(&path, None).expect("the header is whole");
        let what = numbers(&mut source).expect_err("a bad byte");
        assert!(what.contains("checksum"), "{what}");
    }
}

#[test]
fn arrays_whose_last_axis_has_colours_or_coordinates_are_no_volumes_and_axes_of_one_do_not_count() {
    let folder = folder();
    let path = folder.path().join("a.npy");
    for (shape, is_volume) in [
        ("(20, 30, 3)", false),
        ("(2, 2048, 3)", false),
        ("(4, 5, 3)", true),
        ("(1, 4, 5, 6, 1)", true),
        // A series of volumes, and a film.
        ("(2, 4, 5, 6)", true),
        ("(2, 4, 5, 3)", false),
        ("(1, 4, 5)", false),
    ] {
        let header = format!("{{'descr': '|u1', 'fortran_order': False, 'shape': {shape}, }}\n");
        let count: usize =
            shape.trim_matches(['(', ')']).split(", ").map(|n| n.parse::<usize>().unwrap_or(0)).product();
        let length = (header.len() as u16).to_le_bytes();
        let bytes = [b"\x93NUMPY\x01\x00", &length[..], header.as_bytes(), &vec![7; count]].concat();
        std::fs::write(&path, bytes).expect("a write");
        assert_eq!(volumes::is_volume(&path).expect("it reads"), is_volume, "{shape}");
        assert_eq!(volumes::open(&path, None).is_ok(), is_volume, "{shape}");
    }
}
