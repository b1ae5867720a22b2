//! OpenVDB files, as its own library writes them.

use rayset::build::BuildControl;
use rayset::geometry::DVec3;
use rayset::grid::build::{GridBuildError, GridBuildOptions, build};
use rayset::volumes;

use crate::common::{folder, real_data};
use crate::volume_fixtures::{compare, cut_off, expected, flipped, read, unzipped};

#[test]
fn voxels_and_their_places_are_those_that_openvdb_reads() {
    let folder = folder();
    let expected = expected("vdb");
    let files = expected.as_object().expect("files");
    assert!(files.len() > 18);
    for (name, expected) in files {
        let path = folder.path().join(name);
        std::fs::write(&path, unzipped("vdb", name)).expect("a write");
        compare(&path, expected);
    }
}

#[test]
fn versions_222_to_225_are_read_and_others_refused_with_what_to_do() {
    let folder = folder();
    let path = folder.path().join("v.vdb");
    let mut bytes = unzipped("vdb", "two.vdb");
    for version in [221_u32, 222, 223, 225, 226, 0, u32::MAX] {
        bytes[8..12].copy_from_slice(&version.to_le_bytes());
        std::fs::write(&path, &bytes).expect("a write");
        let read = read(&path);
        if (222..=225).contains(&version) {
            assert!(read.is_ok());
        } else {
            let what = read.err().expect("another version");
            assert!(what.contains(&format!("version {version}")) && what.contains("anew"), "{what}");
        }
    }
}

#[test]
fn grids_that_are_no_volumes_are_refused_with_their_names() {
    let folder = folder();
    for (name, words) in [
        ("velocity.vdb", ["`velocity` (vec3s)", "no grid of floats"]),
        ("empty.vdb", ["no active voxels", "empty.vdb"]),
        ("frustum.vdb", ["NonlinearFrustumMap", "resample"]),
        ("wide.vdb", ["10002 x 10002 x 10002", "crop"]),
    ] {
        let path = folder.path().join(name);
        std::fs::write(&path, unzipped("vdb", name)).expect("a write");
        let what = read(&path).err().expect("no volume");
        assert!(words.iter().all(|word| what.contains(word)), "{what}");
    }
}

#[test]
fn files_of_openvdb_that_are_damaged_are_errors() {
    let folder = folder();
    let path = folder.path().join("v.vdb");
    let bytes = unzipped("vdb", "two.vdb");
    cut_off(&path, &bytes, |_| false);
    flipped(&path, &bytes, 1000);
    for name in ["zip.vdb", "blosc.vdb", "half.vdb", "sphere.vdb"] {
        flipped(&path, &unzipped("vdb", name), 200);
    }
}

#[test]
fn a_build_counts_the_memory_of_the_window_of_voxels() {
    let folder = folder();
    let (path, output) = (folder.path().join("flat.vdb"), folder.path().join("out.rset"));
    std::fs::write(&path, unzipped("vdb", "flat.vdb")).expect("a write");
    let options = |memory_bytes| GridBuildOptions { memory_bytes, temp_dir: None };
    let built = |memory_bytes| {
        let source = volumes::open(&path, None).expect("it opens");
        build(source, &output, &options(memory_bytes), &BuildControl::default())
    };
    let Err(GridBuildError::Memory { needed, .. }) = built(8 << 20) else { panic!("8 MiB suffice") };
    assert!(needed > 11 << 20, "{needed}");
    let least = built(needed).expect("it builds");
    let bytes = std::fs::read(&output).expect("a read");
    let ample = built(256 << 20).expect("it builds");
    assert_eq!((least.range, least.size), (ample.range, ample.size));
    assert!(bytes == std::fs::read(&output).expect("a read"), "memory changes the grid");
}

#[test]
fn in_files_that_houdini_has_signed_y_is_up() {
    /// Where the named values of a file begin; there are none.
    const METADATA: usize = 8 + 4 + 8 + 1 + 36;
    let folder = folder();
    let path = folder.path().join("s.vdb");
    // A file without places of its grids, so that it can be added to.
    let bytes = unzipped("vdb", "stream.vdb");
    let up = |creator: &str| {
        let mut metadata = 1_u32.to_le_bytes().to_vec();
        for text in ["creator", "string", creator] {
            metadata.extend((text.len() as u32).to_le_bytes());
            metadata.extend(text.bytes());
        }
        assert_eq!(bytes[METADATA..METADATA + 4], [0; 4]);
        let signed = [&bytes[..METADATA], &metadata, &bytes[METADATA + 4..]].concat();
        std::fs::write(&path, signed).expect("a write");
        volumes::open(&path, None).expect("a volume").up
    };
    assert_eq!(up("Houdini/SOP_OpenVDB_Write"), Some(DVec3::Y));
    assert_eq!(up("Blender/OpenVDBWriter"), None);
    std::fs::write(&path, &bytes).expect("a write");
    assert_eq!(volumes::open(&path, None).expect("a volume").up, None);
}

#[test]
fn smoke_of_houdini_is_read() {
    let Some(path) = real_data("volume/smoke.vdb") else { return };
    let (source, numbers) = read(&path).expect("smoke");
    // The active voxels are (1, 2, 1) to (111, 223, 112), of single values in half precision.
    assert_eq!(source.size, [114, 224, 113]);
    assert_eq!(source.up, Some(DVec3::Y));
    assert_eq!(numbers.iter().copied().fold(0.0, f32::max), 5.714_843_8);
    assert_eq!(numbers.iter().filter(|v| **v != 0.0).count(), 1_049_275);
}

#[test]
fn what_a_reader_chose_and_knows_of_a_volume_is_kept_in_its_grid() {
    let folder = folder();
    let path = folder.path().join("several.vdb");
    std::fs::write(&path, unzipped("vdb", "several.vdb")).expect("a write");
    let source = volumes::open(&path, None).expect("a volume");
    let about = source.about.clone();
    assert!(about.iter().any(|sentence| sentence.contains("is read, of")), "{about:?}");
    let output = folder.path().join("g.rset");
    build(source, &output, &GridBuildOptions::default(), &BuildControl::default()).expect("a grid");
    let grid = rayset::grid::Grid::open(&output).expect("it opens");
    assert_eq!(grid.header().sources, about);
}
