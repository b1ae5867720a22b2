//! What is believed of volume files: nothing that was not checked.

use std::io::Write;
use std::path::{Path, PathBuf};

use flate2::Compression;
use flate2::write::GzEncoder;
use proptest::prelude::*;
use rayset::geometry::DVec3;
use rayset::grid::Grid;
use rayset::grid::build::{GridBuildOptions, build};
use rayset::volumes::{self, RawLayout, VolumeSource};

use crate::common::folder;
use crate::vti_text::{base64, blocks, vti, zipped};

pub(crate) const SIZE: [u64; 3] = [5, 4, 3];

/// 60 voxels of 16 bits, little-endian.
pub(crate) fn voxels() -> Vec<u8> {
    (0..60_i16).flat_map(|i| (i * 397 % 1009 - 300).to_le_bytes()).collect()
}

pub(crate) fn gzipped(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::fast());
    encoder.write_all(bytes).expect("a write");
    encoder.finish().expect("it ends")
}

/// Builds a file of the given name and bytes. The bytes of the grid, which opens and verifies, or
/// the error's text; nothing is left then.
pub(crate) fn built(folder: &Path, name: &str, bytes: &[u8]) -> Result<Vec<u8>, String> {
    let path = folder.join(name);
    std::fs::write(&path, bytes).expect("a write");
    built_from(&path)
}

fn built_from(path: &Path) -> Result<Vec<u8>, String> {
    let output = path.with_file_name("out.rset");
    let _ = std::fs::remove_file(&output);
    let before = std::fs::read_dir(path.parent().expect("a folder")).expect("it lists").count();
    let built = volumes::open(path, None).map_err(|e| e.to_string()).and_then(|source| {
        build(source, &output, &GridBuildOptions::default(), &rayset::build::BuildControl::default())
            .map_err(|e| e.to_string())
    });
    if let Err(what) = built {
        let after = std::fs::read_dir(path.parent().expect("a folder")).expect("it lists").count();
        assert_eq!(before, after, "something is left of a build that failed: {what}");
        return Err(what);
    }
    let grid = Grid::open(&output)
        .unwrap_or_else(|e| panic!("{}: a build that cannot be opened: {e}", path.display()));
    grid.verify().unwrap_or_else(|e| panic!("{}: a build that is damaged: {e}", path.display()));
    let bytes = std::fs::read(&output).expect("a read");
    std::fs::remove_file(&output).expect("it goes");
    Ok(bytes)
}

pub(crate) fn refused(folder: &Path, name: &str, bytes: &[u8], expected: &str) {
    let what = built(folder, name, bytes).expect_err(expected);
    assert!(what.contains(expected) && what.contains(name), "{name}: {what}\nexpected: {expected}");
}

fn nrrd(more: &str, encoding: &str) -> Vec<u8> {
    let text = format!(
        "NRRD0004\ntype: short\ndimension: 3\nsizes: 5 4 3\nspacings: 1 2 3\nendian: little\nencoding: {encoding}\n{more}\n"
    );
    text.into_bytes()
}

fn meta(more: &str, file: &str) -> Vec<u8> {
    let text = format!(
        "ObjectType = Image\nNDims = 3\nDimSize = 5 4 3\nElementType = MET_SHORT\nElementSpacing = 1 2 3\n{more}\
         ElementDataFile = {file}\n"
    );
    text.into_bytes()
}

fn nifti() -> Vec<u8> {
    let mut head = vec![0_u8; 352];
    head[0..4].copy_from_slice(&348_i32.to_le_bytes());
    for (i, n) in [3_i16, 5, 4, 3, 1].into_iter().enumerate() {
        head[40 + 2 * i..42 + 2 * i].copy_from_slice(&n.to_le_bytes());
    }
    head[70..72].copy_from_slice(&4_i16.to_le_bytes());
    for (i, v) in [1.0_f32, 1.0, 2.0, 3.0].into_iter().enumerate() {
        head[76 + 4 * i..80 + 4 * i].copy_from_slice(&v.to_le_bytes());
    }
    head[108..112].copy_from_slice(&352_f32.to_le_bytes());
    head[344..348].copy_from_slice(b"n+1\0");
    head
}

/// The same voxels, with spacings of 1, 2 and 3, in every compressed form: name, bytes before the
/// data, data, checksum's.
fn compressed() -> Vec<(&'static str, Vec<u8>, Vec<u8>, usize)> {
    let table: Vec<u8> = blocks(&voxels(), 50, 4);
    let appended = vti("format=\"appended\" offset=\"0\"/>", " compressor=\"vtkZLibDataCompressor\"", "raw");
    vec![
        ("a.nrrd", nrrd("", "gzip"), gzipped(&voxels()), 8),
        ("a.nii.gz", Vec::new(), gzipped(&[nifti(), voxels()].concat()), 8),
        ("a.mha", meta("CompressedData = True\n", "LOCAL"), zipped(&voxels()), 4),
        ("a.vti", [appended.into_bytes(), table[..24].to_vec()].concat(), table[24..].to_vec(), 4),
    ]
}

#[test]
fn every_flipped_bit_of_compressed_voxels_is_noticed_or_changes_nothing() {
    let folder = folder();
    let (mut first, mut all, mut harmless) = (None, 0, 0);
    for (name, head, data, checksum) in compressed() {
        let whole = built(folder.path(), name, &[&head[..], &data].concat()).expect("it builds");
        assert_eq!(first.get_or_insert(whole.clone()), &whole, "{name} differs from the others");
        for bit in 0..8 * data.len() {
            let mut flipped = data.clone();
            flipped[bit / 8] ^= 1 << (bit % 8);
            let outcome = built(folder.path(), name, &[&head[..], &flipped].concat());
            all += 1;
            // Flags and times of a gzip header, and bits between the last symbol and the checksum,
            // say nothing.
            harmless += usize::from(outcome.is_ok());
            assert!(outcome.is_err() || bit / 8 < data.len() - checksum, "{name}: bit {bit} of the checksum");
            assert!(outcome.is_err() || outcome == Ok(whole.clone()), "{name}: bit {bit} changed the grid");
        }
    }
    assert!(harmless < all / 10, "{harmless} of {all} bits do nothing");
}

#[test]
fn compressed_voxels_that_are_cut_off_or_go_on_are_errors() {
    let folder = folder();
    for (name, head, data, _) in compressed() {
        for length in 0..data.len() {
            let outcome = built(folder.path(), name, &[&head[..], &data[..length]].concat());
            assert!(outcome.is_err(), "{name} builds of {length} bytes of {}", data.len());
        }
    }
    let more = [voxels(), vec![0]].concat();
    refused(folder.path(), "b.nrrd", &[nrrd("", "gzip"), gzipped(&more)].concat(), "go on behind the voxels");
    refused(
        folder.path(),
        "b.nii.gz",
        &gzipped(&[nifti(), more.clone()].concat()),
        "go on behind the voxels",
    );
    let head = meta("CompressedData = True\n", "LOCAL");
    refused(folder.path(), "b.mha", &[head, zipped(&more)].concat(), "go on behind the voxels");
    // Two members of gzip are one text.
    let two = [gzipped(&voxels()[..33]), gzipped(&voxels()[33..])].concat();
    built(folder.path(), "c.nrrd", &[nrrd("", "gzip"), two].concat()).expect("it builds");
}

#[test]
fn plain_voxels_end_where_their_header_says() {
    let folder = folder();
    let f = folder.path();
    for (name, head) in [("a.nrrd", nrrd("", "raw")), ("a.mha", meta("", "LOCAL")), ("a.nii", nifti())] {
        built(f, name, &[head.clone(), voxels()].concat()).expect("it builds");
        refused(f, name, &[head.clone(), voxels(), vec![0]].concat(), "goes on behind the voxels");
        refused(f, name, &[head, voxels()[1..].to_vec()].concat(), "ends before all voxels are there");
    }
    // A file beside the header may hold other things, too.
    std::fs::write(f.join("more.raw"), [voxels(), vec![7; 9]].concat()).expect("a write");
    built(f, "b.nhdr", &nrrd("data file: more.raw\n", "raw")).expect("it builds");
    built(f, "b.mhd", &meta("", "more.raw")).expect("it builds");
    // The volumes of a series follow the first.
    let mut series = nifti();
    series[40] = 4;
    series[48] = 2;
    built(f, "c.nii", &[series.clone(), voxels(), voxels()].concat()).expect("it builds");
    built(f, "c.nii.gz", &gzipped(&[series.clone(), voxels(), voxels()].concat())).expect("it builds");
    refused(f, "c.nii", &[series.clone(), voxels()].concat(), "ends before");
    refused(f, "c.nii.gz", &gzipped(&[series, voxels()].concat()), "should follow the voxels");
}

#[test]
fn skips_are_counted_as_the_formats_own_libraries_count_them() {
    let folder = folder();
    let f = folder.path();
    let reference = built(f, "a.nrrd", &[nrrd("", "raw"), voxels()].concat()).expect("it builds");
    let before = b"one\ntwo\n".to_vec();
    for (name, more, encoding, data) in [
        ("lines, raw", "line skip: 2\n", "raw", [before.clone(), voxels()].concat()),
        ("lines, gzip", "line skip: 2\n", "gzip", [before.clone(), gzipped(&voxels())].concat()),
        ("bytes, raw", "byte skip: 3\n", "raw", [b"one".to_vec(), voxels()].concat()),
        ("bytes, gzip", "byteskip: 3\n", "gzip", gzipped(&[b"one".to_vec(), voxels()].concat())),
        (
            "both, gzip",
            "line skip: 1\nbyte skip: 3\n",
            "gzip",
            [b"x\n".to_vec(), gzipped(&[b"one".to_vec(), voxels()].concat())].concat(),
        ),
        ("last, raw", "byte skip: -1\n", "raw", [before.clone(), voxels()].concat()),
        ("last, gzip", "byte skip: -1\n", "gzip", gzipped(&[before.clone(), voxels()].concat())),
        ("before five, raw", "byte skip: -6\n", "raw", [before.clone(), voxels(), vec![9; 5]].concat()),
        ("before five, gzip", "byte skip: -6\n", "gzip", gzipped(&[before, voxels(), vec![9; 5]].concat())),
    ] {
        let attached = built(f, "b.nrrd", &[nrrd(more, encoding), data.clone()].concat());
        assert_eq!(attached, Ok(reference.clone()), "{name}, attached");
        std::fs::write(f.join("beside"), data).expect("a write");
        let detached = built(f, "b.nhdr", &nrrd(&format!("{more}data file: beside\n"), encoding));
        assert_eq!(detached, Ok(reference.clone()), "{name}, detached");
    }
    for (more, encoding, expected) in [
        ("line skip: 2\n", "raw", "fewer lines"),
        ("byte skip: 1\n", "raw", "ends before"),
        ("byte skip: 9223372036854775807\n", "raw", "ends before"),
        ("byte skip: -9223372036854775808\n", "raw", "ends before"),
        ("byte skip: one\n", "raw", "line 8, byte skip"),
        ("line skip: -1\n", "raw", "line 8, line skip"),
    ] {
        refused(f, "c.nrrd", &[nrrd(more, encoding), voxels()].concat(), expected);
    }
    for (more, expected) in [
        ("byte skip: 1\n", "ends before"),
        ("byte skip: -2\n", "ends before"),
        ("byte skip: 9223372036854775807\n", "ends before"),
        ("byte skip: -9223372036854775808\n", "ends before"),
    ] {
        refused(f, "c.nrrd", &[nrrd(more, "gzip"), gzipped(&voxels())].concat(), expected);
    }
    let plain = |more: &str, data: Vec<u8>| built(f, "d.mha", &[meta(more, "LOCAL"), data].concat());
    assert_eq!(plain("HeaderSize = -1\n", [b"one".to_vec(), voxels()].concat()), Ok(reference.clone()));
    let at = meta("HeaderSize = 130\n", "LOCAL").len();
    assert!(at < 200, "{at}");
    let padded = [vec![0; 200 - at], voxels()].concat();
    assert_eq!(plain("HeaderSize = 200\n", padded), Ok(reference.clone()));
    assert!(plain("HeaderSize = 10\n", voxels()).expect_err("within the header").contains("HeaderSize"));
    let zip = zipped(&voxels());
    let more = format!("CompressedData = True\nCompressedDataSize = {}\n", zip.len());
    assert_eq!(plain(&more, [zip.clone(), b"and more".to_vec()].concat()), Ok(reference));
    let more = format!("CompressedData = True\nCompressedDataSize = {}\n", zip.len() - 1);
    assert!(plain(&more, zip).is_err(), "cut off by CompressedDataSize");
}

#[test]
fn numbers_of_headers_that_no_grid_can_have_are_refused_with_their_key() {
    let folder = folder();
    let f = folder.path();
    let with = |bytes: Vec<u8>, from: &str, to: &str| {
        let text = String::from_utf8(bytes).expect("text");
        assert!(text.contains(from), "{text} has no {from}");
        text.replace(from, to).into_bytes()
    };
    for (from, to, expected) in [
        ("spacings: 1 2 3", "spacings: 1 nan 3", "line 5, spacings"),
        ("spacings: 1 2 3", "spacings: 1 inf 3", "line 5, spacings"),
        ("spacings: 1 2 3", "spacings: 1 0 3", "line 5, spacings"),
        ("spacings: 1 2 3", "spacings: 1e-200 1e-200 1", "line 5, spacings"),
        ("spacings: 1 2 3", "spacings: 1e200 1e200 1", "line 5, spacings"),
        ("spacings: 1 2 3", "space origin: (nan,0,0)", "line 5, space origin"),
        ("spacings: 1 2 3", "space directions: (1,0,0) (2,0,0) (0,0,1)", "line 5, space directions"),
        ("spacings: 1 2 3", "space directions: (1,0,0) (0,inf,0) (0,0,1)", "line 5, space directions"),
        ("spacings: 1 2 3", "sizes: 5 4 3", "line 5, sizes"),
        ("sizes: 5 4 3", "sizes: 5 4 1", "line 4, sizes"),
        ("sizes: 5 4 3", "sizes: 5 4 0", "line 4, sizes"),
        ("sizes: 5 4 3", "sizes: 5 4 -3", "line 4, sizes"),
        ("sizes: 5 4 3", "sizes: 16777216 16777216 16777216", "line 4, sizes"),
        ("sizes: 5 4 3", "sizes: 4294967296 4294967296 4294967296", "line 4, sizes"),
        ("endian: little", "endian: middle", "line 6, endian"),
        ("endian: little\n", "", "endian: missing"),
        ("encoding: raw", "encoding: bzip2", "line 7, encoding"),
    ] {
        refused(f, "a.nrrd", &[with(nrrd("", "raw"), from, to), voxels()].concat(), expected);
    }
    for (from, to, expected) in [
        ("ElementSpacing = 1 2 3", "ElementSpacing = 1 nan 3", "line 5, ElementSpacing"),
        ("ElementSpacing = 1 2 3", "ElementSpacing = 1 0 3", "line 5, ElementSpacing"),
        ("ElementSpacing = 1 2 3", "Offset = 1 2 inf", "line 5, Offset"),
        ("ElementSpacing = 1 2 3", "TransformMatrix = 1 0 0 1 0 0 0 0 1", "line 5, TransformMatrix"),
        ("DimSize = 5 4 3", "DimSize = 5 4 1", "line 3, DimSize"),
        ("DimSize = 5 4 3", "DimSize = 99999999 99999999 99999999", "line 3, DimSize"),
        ("NDims = 3", "BinaryData = perhaps", "line 2, BinaryData"),
    ] {
        refused(f, "a.mha", &[with(meta("", "LOCAL"), from, to), voxels()].concat(), expected);
    }
    let float = |at: usize, v: f32| (at, v.to_le_bytes().to_vec());
    let short = |at: usize, v: i16| (at, v.to_le_bytes().to_vec());
    for (fields, expected) in [
        (vec![float(80, f32::NAN)], "byte 80, pixdim"),
        (vec![float(88, f32::INFINITY)], "byte 88, pixdim"),
        (vec![short(254, 1)], "byte 280, srow"),
        (vec![short(254, 1), float(300, f32::NAN)], "byte 300, srow"),
        (vec![short(252, 1), float(260, f32::NAN)], "byte 260, quatern"),
        (vec![short(252, 1), float(268, f32::NEG_INFINITY)], "byte 268, qoffset"),
        (vec![float(112, 2.0), float(116, f32::NAN)], "byte 116, scl_inter"),
        (vec![float(108, f32::NAN)], "byte 108, vox_offset"),
        (vec![float(108, 1e30)], "ends before"),
        (vec![float(108, 40.0)], "byte 108, vox_offset"),
        (vec![short(42, -5)], "byte 42, dim"),
        (vec![short(46, 1)], "byte 42, dim"),
        (vec![short(40, 7), short(48, 32767), short(50, 32767), short(52, 32767), short(54, 32767)], "dim"),
    ] {
        let mut head = nifti();
        for (at, bytes) in fields {
            head[at..at + bytes.len()].copy_from_slice(&bytes);
        }
        refused(f, "a.nii", &[head, voxels()].concat(), expected);
    }
    // A slope that is no number scales nothing, as other readers have it.
    let mut head = nifti();
    head[112..116].copy_from_slice(&f32::NAN.to_le_bytes());
    let plain = built(f, "b.nii", &[nifti(), voxels()].concat());
    assert_eq!(built(f, "b.nii", &[head, voxels()].concat()), plain);
}

#[test]
fn a_library_user_cannot_build_a_grid_that_does_not_open() {
    let folder = folder();
    let raw = folder.path().join("v.raw");
    std::fs::write(&raw, voxels()).expect("a write");
    let layout: RawLayout = "5x4x3,i16".parse().expect("a layout");
    let change: [fn(&mut VolumeSource); 5] = [
        |source| source.scale = f64::NAN,
        |source| source.offset = f64::INFINITY,
        |source| source.space_from_voxel.translation = DVec3::NAN,
        |source| source.space_from_voxel.matrix3 *= 1e200,
        |source| source.space_from_voxel.matrix3.x_axis = DVec3::ZERO,
    ];
    for (number, change) in change.iter().enumerate() {
        let mut source = layout.open(&raw).expect("it opens");
        change(&mut source);
        let output = folder.path().join("out.rset");
        let outcome =
            build(source, &output, &GridBuildOptions::default(), &rayset::build::BuildControl::default());
        assert!(outcome.is_err() && !output.exists(), "change {number}");
    }
}

#[test]
fn volumes_larger_than_their_files_are_refused_before_anything_is_written() {
    let folder = folder();
    let f = folder.path();
    let giant = |text: Vec<u8>| {
        String::from_utf8(text).expect("text").replace("5 4 3", "60000 60000 600").into_bytes()
    };
    refused(f, "a.nrrd", &[giant(nrrd("", "raw")), voxels()].concat(), "ends before");
    refused(f, "a.nrrd", &[giant(nrrd("", "gzip")), gzipped(&voxels())].concat(), "ends before");
    refused(f, "a.mha", &[giant(meta("", "LOCAL")), voxels()].concat(), "ends before");
    let zip = giant(meta("CompressedData = True\n", "LOCAL"));
    refused(f, "a.mha", &[zip, zipped(&voxels())].concat(), "ends before");
    let mut head = nifti();
    [42, 44, 46].iter().for_each(|at| head[*at..at + 2].copy_from_slice(&30000_i16.to_le_bytes()));
    refused(f, "a.nii", &[head.clone(), voxels()].concat(), "ends before");
    refused(f, "a.nii.gz", &gzipped(&[head, voxels()].concat()), "ends before");
    let raw = f.join("v.raw");
    std::fs::write(&raw, voxels()).expect("a write");
    let layout: RawLayout = "60000x60000x600,i16".parse().expect("a layout");
    let what = layout.open(&raw).err().expect("too short").to_string();
    assert!(what.contains("ends before"), "{what}");
    let layout: RawLayout = "5x4x3,i16,spacing=1xnanx1".parse().expect("a layout");
    let what = layout.open(&raw).err().expect("no spacing").to_string();
    assert!(what.contains("spacing"), "{what}");
}

#[test]
fn voxels_that_are_no_numbers_become_0_and_those_too_large_are_errors() {
    let folder = folder();
    let values = [1.5_f64, f64::NAN, f64::INFINITY, f64::NEG_INFINITY, -2.5, 3.0, 3.25, 4.0];
    let double: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
    let single: Vec<u8> = values.iter().flat_map(|v| (*v as f32).to_le_bytes()).collect();
    for (name, bytes) in [("f64", &double), ("f32", &single)] {
        let raw = folder.path().join("v.raw");
        std::fs::write(&raw, bytes).expect("a write");
        let layout: RawLayout = format!("2x2x2,{name}").parse().expect("a layout");
        let source = layout.open(&raw).expect("it opens");
        let output = folder.path().join("out.rset");
        let header =
            build(source, &output, &GridBuildOptions::default(), &rayset::build::BuildControl::default())
                .expect("it builds");
        assert_eq!(header.range, (-2.5, 4.0));
        let loaded = Grid::open(&output).expect("it opens").load().expect("it loads");
        assert_eq!(loaded, [1.5, 0.0, 0.0, 0.0, -2.5, 3.0, 3.25, 4.0]);
    }
    let head = "NRRD0004\ntype: double\ndimension: 3\nsizes: 2 2 2\nendian: little\nencoding: raw\n\n";
    let mut large = double;
    large[40..48].copy_from_slice(&1e39_f64.to_le_bytes());
    refused(folder.path(), "a.nrrd", &[head.as_bytes(), &large].concat(), "byte 40 of the voxels");
}

#[cfg(unix)]
#[test]
fn pipes_devices_and_folders_are_no_volumes() {
    let folder = folder();
    let f = folder.path();
    std::fs::create_dir(f.join("a.nrrd")).expect("a folder");
    std::os::unix::fs::symlink("/dev/zero", f.join("b.mha")).expect("a link");
    let made = std::process::Command::new("mkfifo").arg(f.join("c.vti")).status().expect("mkfifo runs");
    assert!(made.success());
    for name in ["a.nrrd", "b.mha", "c.vti"] {
        let what = built_from(&f.join(name)).expect_err("it is no file");
        assert!(what.contains("not a regular file") && what.contains(name), "{what}");
    }
    refused_beside(f, "d.nhdr", &nrrd("data file: /dev/zero\n", "gzip"));
    refused_beside(f, "d.mhd", &meta("", "c.vti"));
}

#[cfg(unix)]
fn refused_beside(folder: &Path, name: &str, bytes: &[u8]) {
    let what = built(folder, name, bytes).expect_err("it is no file");
    assert!(what.contains("not a regular file"), "{what}");
}

/// Whole files, small, of every format.
fn whole() -> Vec<(&'static str, Vec<u8>, usize)> {
    let inline = vti(
        &format!(
            "format=\"binary\">{}</DataArray>",
            base64(&[&120_u32.to_le_bytes()[..], &voxels()].concat())
        ),
        "",
        "",
    );
    let numbers: Vec<String> = (0..60_i16).map(|i| (i * 397 % 1009 - 300).to_string()).collect();
    let ascii = vti(&format!("format=\"ascii\">{}</DataArray>", numbers.join(" ")), "", "");
    let mut all: Vec<(&'static str, Vec<u8>, usize)> = vec![
        ("p.nrrd", [nrrd("byte skip: 0\nspace origin: (1,2,3)\n", "raw"), voxels()].concat(), 150),
        ("p.mha", [meta("Offset = 1 2 3\nHeaderSize = 0\n", "LOCAL"), voxels()].concat(), 130),
        ("p.nii", [nifti(), voxels()].concat(), 352),
        ("i.vti", inline.into_bytes(), 420),
        ("t.vti", ascii.into_bytes(), 420),
    ];
    for (name, head, data, _) in compressed() {
        let header = if head.is_empty() { 40 } else { head.len() };
        all.push((name, [head, data].concat(), header));
    }
    all
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 600, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn whatever_becomes_of_a_header_it_is_an_error_or_a_grid_that_opens(
        which in 0_usize..9,
        changes in prop::collection::vec((any::<u32>(), any::<u8>(), 0_u8..6), 1..4),
    ) {
        const WORDS: [&str; 12] =
            ["nan", "inf", "-1", "0", "1e308", "1e-308", "4294967295", "18446744073709551615", "-9223372036854775808", "\"", "<", "\n"];
        let folder = folder();
        let (name, mut bytes, header) = whole().swap_remove(which);
        for (at, value, kind) in changes {
            let at = at as usize % header.min(bytes.len());
            match kind {
                0 => bytes[at] = value,
                1 => bytes[at] ^= 1 << (value % 8),
                2 => { bytes.remove(at); }
                3 => bytes.insert(at, value),
                // A word of the header becomes another.
                _ => {
                    let apart = |b: &u8| b" \n\"'=:,<>".contains(b);
                    let end = bytes[at..].iter().position(apart).map_or(bytes.len(), |n| at + n);
                    let start = bytes[..at].iter().rposition(apart).map_or(0, |n| n + 1);
                    bytes.splice(start..end, WORDS[value as usize % WORDS.len()].bytes());
                }
            }
        }
        let _ = built(folder.path(), name, &bytes);
    }
}

/// A path in a folder, so that the tests of VTI can share what is here.
pub(crate) fn reference(folder: &Path) -> (PathBuf, Vec<u8>) {
    let path = folder.join("reference.nrrd");
    let grid = built(folder, "reference.nrrd", &[nrrd("", "raw"), voxels()].concat()).expect("it builds");
    (path, grid)
}
