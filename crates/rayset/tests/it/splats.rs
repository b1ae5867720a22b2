//! Gaussian splats: what is read of every format, beside what other programs read of the same
//! files, and what is refused.
//!
//! The fixtures and what they hold are made by `tests/fixtures/make_splats.py`.

use std::path::{Path, PathBuf};

use rayset::geometry::DVec3;
use rayset::points::{self, ColorDepth, PointBatch, ReadOptions, Schema};

use crate::common::{folder, real_data};
use crate::tables::{Table, table};

const FILES: [&str; 12] = [
    "inria.ply",
    "packed.compressed.ply",
    "v1.spz",
    "v2.spz",
    "v3.spz",
    "v4.spz",
    "khronos.glb",
    "bundle.sog",
    "records.splat",
    "level0.ksplat",
    "level1.ksplat",
    "level2.ksplat",
];
const COLUMNS: [&str; 9] =
    ["red", "green", "blue", "opacity", "radius", "weight", "scale_0", "scale_1", "scale_2"];

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/splats").join(name)
}

fn bytes_of(name: &str) -> Vec<u8> {
    std::fs::read(fixture(name)).expect("a fixture")
}

fn schema(path: &Path) -> Schema {
    points::open(path, &ReadOptions::default()).unwrap_or_else(|e| panic!("{e}")).schema().clone()
}

/// Writes bytes under the name of a fixture.
fn write(folder: &Path, name: &str, bytes: &[u8]) -> PathBuf {
    let path = folder.join(name);
    std::fs::write(&path, bytes).expect("a write");
    path
}

/// What is said of a file that is refused, without its name.
fn refusal(name: &str, bytes: &[u8]) -> String {
    let folder = folder();
    let error = table(&write(folder.path(), name, bytes), None).expect_err("refused").to_string();
    error.split_once(", ").expect("a place").1.to_owned()
}

/// Position, then the nine columns of splats, of a point of a table; then its rotation, of length
/// one and with its largest component above zero, its radius where it is round, and the
/// coefficients of its harmonics.
fn row(table: &Table, index: usize) -> Vec<f64> {
    let column = |name: &str| {
        let column = table.1.iter().find(|(found, _)| found == name).expect("a column");
        column.1[index]
    };
    let rotation = ["rotation_x", "rotation_y", "rotation_z", "rotation_w"].map(column);
    let largest = rotation.into_iter().fold(0.0, |a: f64, b| if b.abs() > a.abs() { b } else { a });
    let length = rotation.iter().map(|v| v * v).sum::<f64>().sqrt().copysign(largest);
    let round = [column(points::ROUND_RADIUS)];
    let harmonics: Vec<f64> = (table.1.iter())
        .filter(|(name, _)| name.starts_with(points::HARMONIC))
        .map(|(_, values)| values[index])
        .collect();
    let all = [&table.0[index][..], &COLUMNS.map(column), &rotation.map(|v| v / length), &round, &harmonics];
    all.concat()
}

/// The semi-axes of a point of a table are its deviations, as far as it goes.
fn check_axes(table: &Table, index: usize, what: &str) {
    let column = |name: String| {
        let column = table.1.iter().find(|(found, _)| *found == name).expect("a column");
        column.1[index]
    };
    let radius = (2.0 * (512.0 * column("weight".into())).ln()).max(0.25).sqrt();
    for axis in 0..3 {
        let (axis, deviation) = (column(format!("semi_axis_{}", axis + 1)), column(format!("scale_{axis}")));
        assert!((axis / (radius * deviation) - 1.0).abs() < 1e-5, "{what}, {index}: {axis}, {deviation}");
    }
}

#[test]
fn every_splat_format_holds_what_other_programs_read_of_it() {
    let text = std::fs::read_to_string(fixture("expected.json")).expect("expected values");
    let expected: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    for name in FILES {
        let table = table(&fixture(name), None).unwrap_or_else(|e| panic!("{e}"));
        let is_byte = schema(&fixture(name)).color_depth == ColorDepth::Byte;
        // Of the larger file every ninth.
        let stride = if name == "packed.compressed.ply" { 9 } else { 1 };
        let rows = expected[name].as_array().expect("rows");
        assert_eq!(table.0.len().div_ceil(stride), rows.len(), "{name}");
        for (index, expected) in rows.iter().enumerate() {
            let mut found = row(&table, index * stride);
            if is_byte {
                found[3..6].iter_mut().for_each(|channel| *channel /= 255.0);
            }
            check_axes(&table, index * stride, name);
            assert_eq!(found.len(), expected.as_array().map_or(0, Vec::len));
            for (column, value) in found.iter().enumerate() {
                let expected = expected[column].as_f64().expect("a number");
                let error = (value - expected).abs();
                // That program takes bytes of rotations from the middle of their range, and not, as
                // the format does, from 128.
                let is_byte_off = name == "records.splat" && (12..16).contains(&column);
                if is_byte_off && error < 1.5 / 128.0 {
                    continue;
                }
                assert!(
                    error <= 2e-5 * expected.abs() + 2e-6,
                    "{name}, {index}, {column}: {value} for {expected}"
                );
            }
        }
    }
}

#[test]
fn the_schema_of_splats_tells_the_degree_of_their_colours_and_which_way_is_up() {
    for name in FILES {
        let schema = schema(&fixture(name));
        assert!(schema.names().take(9).eq(COLUMNS), "{name}");
        assert_eq!(
            schema.up,
            Some(DVec3::Y * if [".spz", ".glb"].iter().any(|end| name.ends_with(end)) { 1.0 } else { -1.0 }),
            "{name}"
        );
        // The records of `.splat` have no coefficients of other directions.
        let degree = if name == "records.splat" { 0 } else { 1 };
        assert_eq!((schema.harmonics().0, schema.warnings.len()), (degree, 0), "{name}");
        assert!(schema.description.contains("Gaussian splats, "), "{}", schema.description);
        let is_byte = name.ends_with("splat");
        assert_eq!(schema.color_depth, if is_byte { ColorDepth::Byte } else { ColorDepth::Unit });
    }
    assert_eq!(schema(&fixture("v3.spz")).description, "SPZ 3; Gaussian splats, y up");
}

#[test]
fn a_splat_ply_keeps_columns_of_its_own_and_flat_splats_have_no_third_deviation() {
    let folder = folder();
    let header = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\nproperty float \
                  nx\nproperty float f_dc_0\nproperty float f_dc_1\nproperty float f_dc_2\nproperty float opacity\nproperty \
                  float scale_0\nproperty float scale_1\nproperty uchar label\nproperty float rot_0\nend_header\n";
    let text = format!("{header}1 2 3 0 0 9 -9 0 0 0.6931472 7 0.5\n4 5 6 0 nan inf 1 -inf 0 0 8 0.25\n");
    let path = write(folder.path(), "flat.ply", text.as_bytes());
    let found = table(&path, None).expect("it reads");
    assert!(found.1.iter().map(|(name, _)| name.as_str()).eq(
        COLUMNS.into_iter().chain(points::SHAPE_COLUMNS).chain([points::ROUND_RADIUS, "label", "rot_0"])
    ));
    assert!(schema(&path).columns[17].is_class);
    assert_eq!((&found.1[17].1[..], &found.1[18].1[..]), (&[7.0, 8.0][..], &[0.5, 0.25][..]));
    assert_eq!(row(&found, 0)[..7], [1.0, 2.0, 3.0, 0.5, 1.0, 0.0, 0.5]);
    assert_eq!(found.1[8].1, [0.0, 0.0]);
    // Half of the area of the disc, within Thomsen's 1.1 %.
    let radius = (2.0 * 256_f64.ln()).sqrt();
    assert!((found.1[16].1[0] / radius - 1.0).abs() < 0.011, "{}", found.1[16].1[0]);
    assert!((found.1[4].1[0] / (2.0 * radius) - 1.0).abs() < 1e-6, "the longest");
    assert_eq!(found.1[11].1[0] * 1024.0, found.1[10].1[0], "as thin as points are");
    // Without all four components there is no rotation.
    assert_eq!([12, 13, 14, 15].map(|column| found.1[column].1[0]), [0.0, 0.0, 0.0, 1.0]);
    // What is no number is black, and a logit of minus infinity transparent.
    assert_eq!(row(&found, 1)[3..5], [0.0, 1.0]);
    assert_eq!((found.1[3].1[1], found.1[5].1[1]), (0.0, 0.0));
}

#[test]
fn splats_are_the_same_in_batches_of_any_size_and_columns_of_any_order() {
    for name in FILES {
        let whole = table(&fixture(name), None).expect("it reads");
        let mut source = points::open(fixture(name), &ReadOptions::default()).expect("it opens");
        assert_eq!(source.count_hint(), Some(whole.0.len() as u64), "{name}");
        source.select(&[8, 0, 8]);
        let (mut batch, mut seen) = (PointBatch::default(), 0);
        for limit in [1, 7, 3, 1000].into_iter().cycle() {
            source.fill(&mut batch, limit).expect("points");
            if batch.is_empty() {
                break;
            }
            assert!(batch.len() <= limit);
            for i in 0..batch.len() {
                assert_eq!(batch.position[i], whole.0[seen + i]);
                let values = [0, 1, 2].map(|column| batch.columns[column].get(i));
                assert_eq!(values, [8, 0, 8].map(|column: usize| whole.1[column].1[seen + i]), "{name}");
            }
            seen += batch.len();
        }
        assert_eq!(seen, whole.0.len(), "{name}");
    }
}

#[test]
fn splats_need_little_memory_however_many_there_are() {
    for name in FILES {
        let source = points::open(fixture(name), &ReadOptions::default()).expect("it opens");
        let needed = source.memory_needed();
        assert!((64 << 10..6 << 20).contains(&needed), "{name}: {needed}");
    }
    // The window of a zstd stream counts, and one that would take too much is refused before
    // anything is unpacked.
    let mut wide = bytes_of("v4.spz");
    let frame = 32 + 6 * 16;
    assert_eq!(wide[frame..frame + 4], [0x28, 0xb5, 0x2f, 0xfd]);
    // Not a single segment: a window of two to the twentieth.
    (wide[frame + 4], wide[frame + 5]) = (0, 10 << 3);
    let folder = folder();
    let path = write(folder.path(), "wide.spz", &wide);
    let source = points::open(&path, &ReadOptions::default()).expect("it opens");
    assert!(source.memory_needed() > 4 << 20);
    wide[frame + 5] = 18 << 3;
    let said = refusal("wide.spz", &wide);
    assert_eq!(
        said,
        format!("byte {frame}: not the beginning of a zstd stream that can be unpacked in 128 MiB")
    );
}

#[test]
fn splat_files_that_end_early_are_errors_wherever_they_end() {
    let folder = folder();
    for name in FILES {
        let whole = bytes_of(name);
        let all = table(&fixture(name), None).expect("it reads");
        let step = if whole.len() > 2000 { 37 } else { 1 };
        for cut in (0..whole.len()).step_by(step).chain([whole.len() - 1]) {
            let path = write(folder.path(), name, &whole[..cut]);
            match table(&path, None) {
                Err(error) => {
                    let said = error.to_string();
                    assert!(said.contains("byte ") || said.contains("line "), "{said}");
                    assert!(!said.contains("failed to fill"), "{said}");
                }
                // Records without a header may end after any of them, and view-dependent colours of
                // PLY are not looked at.
                Ok(found) if name == "records.splat" => assert_eq!(32 * found.0.len(), cut),
                Ok(found) if name == "packed.compressed.ply" => {
                    assert!(cut >= whole.len() - 9 * 270 && found == all, "{cut}");
                }
                Ok(_) => panic!("{name} is read without its end from byte {cut}"),
            }
        }
    }
}

#[test]
fn damaged_splat_files_never_panic_and_checksums_are_checked() {
    let folder = folder();
    for name in FILES {
        let whole = bytes_of(name);
        let step = if whole.len() > 2000 { 53 } else { 2 };
        for at in (0..whole.len().min(64)).chain((64..whole.len()).step_by(step)) {
            for flip in [0xff, 0x01] {
                let mut bytes = whole.clone();
                bytes[at] ^= flip;
                let found = table(&write(folder.path(), name, &bytes), None);
                if let Err(error) = &found {
                    assert!(!error.to_string().contains("failed to fill"), "{error}");
                }
                // Behind its header of ten bytes, gzip protects everything.
                if ["v1.spz", "v2.spz", "v3.spz"].contains(&name) && at >= 10 {
                    assert!(found.is_err(), "{name}, byte {at}");
                }
            }
        }
    }
}

#[test]
fn spz_headers_that_cannot_be_are_refused_with_their_reason() {
    let gunzipped = |name: &str| {
        let mut bytes = Vec::new();
        let mut decoder =
            flate2::read::GzDecoder::new(std::fs::File::open(fixture(name)).expect("a fixture"));
        std::io::Read::read_to_end(&mut decoder, &mut bytes).expect("gzip");
        bytes
    };
    let plain = gunzipped("v3.spz");
    let folder = folder();
    // What is in gzip may as well be as it is, and the content tells the format.
    let path = write(folder.path(), "no-name", &plain);
    assert_eq!(table(&path, None).expect("it reads"), table(&fixture("v3.spz"), None).expect("it reads"));
    let set = |at: usize, value: u8| {
        let mut bytes = plain.clone();
        bytes[at] = value;
        refusal("v.spz", &bytes)
    };
    assert_eq!(
        set(4, 5),
        "byte 0: 5 streams; expected 6"
            .replace("5 streams; expected 6", "SPZ of version 5; versions 1 to 4 can be read")
    );
    assert_eq!(set(4, 0), "byte 0: SPZ of version 0; versions 1 to 4 can be read");
    assert_eq!(set(12, 5), "byte 0: spherical harmonics of degree 5; expected 0 to 4");
    assert_eq!(set(13, 25), "byte 0: 25 fractional bits of coordinates that have 24");
    assert!(set(0, b'M').starts_with("byte 0: not an SPZ file"), "{}", set(0, b'M'));
    // More Gaussians than there are bytes.
    let more = set(11, 0xff);
    assert!(more.contains("the file ends early"), "{more}");
    let streams = bytes_of("v4.spz");
    let set = |at: usize, value: u8| {
        let mut bytes = streams.clone();
        bytes[at] = value;
        refusal("v.spz", &bytes)
    };
    assert_eq!(set(15, 5), "byte 15: 5 streams; expected 6");
    assert!(
        set(16, 31).starts_with("byte 16: the table of contents is at byte 31, within"),
        "{}",
        set(16, 31)
    );
    assert!(set(18, 1).contains("the file ends within its header or its table"), "{}", set(18, 1));
    assert_eq!(set(40, 1), "byte 40: a stream of 257 bytes, where 40 Gaussians have 360");
    assert!(set(35, 1).contains("packed bytes, of which the file has"), "{}", set(35, 1));
    let mut packed = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    std::io::Write::write_all(&mut packed, &streams).expect("a write");
    let said = refusal("v.spz", &packed.finish().expect("gzip"));
    assert_eq!(said, "byte 0: an SPZ file of version 4 in gzip; expected it as it is");
}

#[test]
fn files_of_splats_without_a_format_of_their_own_are_looked_at() {
    let records = bytes_of("records.splat");
    assert_eq!(refusal("a.splat", b""), "byte 0: this file is empty: it was not written, or not copied");
    let said = refusal("a.splat", &records[..70]);
    assert_eq!(said, "byte 64: 70 bytes are no whole number of splats, which have 32 bytes each");
    let text = "x y z and no splats, but text of some kind\n".repeat(32);
    assert!(refusal("a.splat", text.as_bytes()).starts_with("byte 0: not a file of splats: "));
    let level1 = bytes_of("level1.ksplat");
    let set = |at: usize, value: u8| {
        let mut bytes = level1.clone();
        bytes[at] = value;
        refusal("a.ksplat", &bytes)
    };
    assert_eq!(set(1, 2), "byte 0: version 0.2 of ksplat; version 0.1 can be read");
    assert_eq!(set(20, 3), "byte 20: compression level 3; expected 0, 1 or 2");
    assert_eq!(set(6, 1), "byte 4: 65538 sections, whose headers the file does not have");
    assert_eq!(set(16, 41), "byte 16: 41 splats, of which the sections have 40");
    assert_eq!(set(4096, 99), "byte 4096: 99 splats in a section for 24");
    assert!(set(4096 + 40, 4).ends_with("spherical harmonics of degree 4; expected 0 to 3"));
    assert!(
        set(4096 + 12, 1).contains("1 buckets of 12 bytes, of which 2 are full and 2 are not"),
        "{}",
        set(4096 + 12, 1)
    );
    assert!(set(4096 + 7, 1).contains("the section ends at byte"), "{}", set(4096 + 7, 1));
    // The sizes of buckets that are not full, behind the headers.
    let short = set(4096 + 2 * 1024, 1);
    assert!(short.ends_with("the buckets of a section have only 20 of its 23 splats"), "{short}");
}

#[test]
fn compressed_ply_without_what_its_splats_are_relative_to_is_refused() {
    let bytes = bytes_of("packed.compressed.ply");
    let end = bytes.windows(11).position(|part| part == b"end_header\n").expect("a header") + 11;
    let header = std::str::from_utf8(&bytes[..end]).expect("text");
    let with = |from: &str, to: &str| {
        assert!(header.contains(from));
        refusal("p.ply", &[header.replace(from, to).as_bytes(), &bytes[end..]].concat())
    };
    assert!(
        with("element chunk 2", "element chunk 1")
            .ends_with("1 chunks are too few for 270 splats; expected one for each 256")
    );
    assert!(with("element chunk 2", "element lumps 2").contains("without a `chunk` element"));
    assert!(with("float max_scale_z", "float scale_z").ends_with("the `chunk` element lacks `max_scale_z`"));
    assert!(with("uint packed_scale", "float packed_scale").ends_with("`packed_scale` is not of type uint"));
}

/// Means of positions, colours, opacities and deviations, as splat-transform 2.7.1 reads them.
#[test]
fn real_splat_files_have_the_means_that_splat_transform_finds() {
    for (name, count, expected) in [
        (
            "3dgs/biker.compressed.ply",
            152_746,
            [
                -0.048_573_42,
                -1.605_046,
                0.002_285_777,
                0.318_888_1,
                0.307_731_2,
                0.300_724_4,
                0.296_625_3,
                0.005_238_666,
                0.010_744_14,
                0.005_766_281,
            ],
        ),
        (
            "3dgs/biker.spz",
            152_746,
            [
                -0.048_573_25,
                1.605_046,
                -0.002_286_062,
                0.318_906_9,
                0.307_714_5,
                0.300_702,
                0.296_625_3,
                0.005_239_768,
                0.010_746_62,
                0.005_767_974,
            ],
        ),
        (
            "3dgs/guitar.compressed.ply",
            90_854,
            [
                0.225_486_6,
                -1.463_924,
                0.190_061_3,
                0.472_337_4,
                0.409_170_2,
                0.305_859_5,
                0.388_866_1,
                0.006_359_924,
                0.013_640_25,
                0.016_496_84,
            ],
        ),
        (
            "3dgs/train-1000.ply",
            1000,
            [
                -0.531_878_3,
                0.025_180_02,
                -0.112_963,
                0.537_068,
                0.560_482_4,
                0.518_441_7,
                0.246_745,
                0.023_893_93,
                0.018_934_98,
                0.020_505_12,
            ],
        ),
    ] {
        let Some(path) = real_data(name) else { continue };
        let found = table(&path, None).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(found.0.len(), count, "{name}");
        let mean = |values: &mut dyn Iterator<Item = f64>| values.sum::<f64>() / count as f64;
        let axes = [0, 1, 2].map(|axis| mean(&mut found.0.iter().map(|p| p[axis])));
        let columns = [0, 1, 2, 3, 6, 7, 8].map(|column: usize| mean(&mut found.1[column].1.iter().copied()));
        for (value, expected) in axes.iter().chain(&columns).zip(expected) {
            assert!(
                (value - expected).abs() <= 1e-5 * expected.abs() + 1e-6,
                "{name}: {value} for {expected}"
            );
        }
    }
    for (name, at) in [("v2", -1.0), ("v3", 0.0), ("v4", 0.0), ("raw", -1.0)] {
        let Some(path) = real_data(&format!("3dgs/minimal-{name}.spz")) else { continue };
        let found = table(&path, None).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!((found.0.len(), found.0[0][2].min(found.0[2][2])), (4, at), "{name}");
    }
    for name in ["3dgs/minimal.splat", "3dgs/minimal.ksplat"] {
        let Some(path) = real_data(name) else { continue };
        let found = table(&path, None).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(found.0, [[-1.0, 0.0, -1.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0; 3]], "{name}");
    }
}

#[test]
fn packed_splats_in_gzip_are_read_to_their_checksum() {
    let folder = folder();
    let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    std::io::Write::write_all(&mut gzip, &bytes_of("packed.compressed.ply")).expect("a write");
    let mut bytes = gzip.finish().expect("gzip");
    let whole = table(&write(folder.path(), "a.ply.gz", &bytes), None).expect("splats");
    assert_eq!(whole.0, table(&fixture("packed.compressed.ply"), None).expect("splats").0);
    let sum = bytes.len() - 8;
    bytes[sum] ^= 1;
    let said =
        table(&write(folder.path(), "a.ply.gz", &bytes), None).expect_err("another checksum").to_string();
    assert!(said.contains("gzip data are damaged"), "{said}");
}
