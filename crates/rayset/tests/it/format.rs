//! The files: what they say of themselves, and what tells one from another.

use std::sync::Arc;

use proptest::prelude::*;
use rayset::container::{FileHeader, FileKind, SectionKind, reseal};
use rayset::field::Kernel;
use rayset::octree::Cloud;
use rayset::octree::build::{self, BuildControl, BuildError, BuildOptions, Rule};
use rayset::octree::format::MAX_ATTRIBUTES;
use rayset::octree::verify::Depth;
use rayset::points::{ArraySource, ColumnInfo, ColumnType, PointSource, Values};
use rayset::trace::ExecSettings;

use crate::bad_bytes::section;
use crate::common::{Random, build_at, camera, folder, mixed_points, paged, picture, scene, settings};

fn options() -> BuildOptions {
    BuildOptions { page_bytes: Some(16 << 10), ..BuildOptions::default() }
}

#[test]
fn a_file_overwritten_while_it_is_open_gives_its_own_picture_or_an_error() {
    let folder = folder();
    let (path, other) = (folder.path().join("c.rset"), folder.path().join("other.rset"));
    let cloud = build_at(&path, Box::new(mixed_points(4000, 1.0, 1)), &options());
    build_at(&other, Box::new(mixed_points(4000, 1.0, 2)), &options());
    let (bytes, others) = (std::fs::read(&path).expect("a read"), std::fs::read(&other).expect("a read"));
    let exec = ExecSettings { threads: 2, ..ExecSettings::default() };
    let scene = scene(&cloud, Kernel::Wyvill, false);
    let draw = || picture(&scene, &camera(), &settings(32, 32), &exec, &paged(&scene, 1 << 30));
    let expected = draw().expect("a picture");
    let mut errors = 0;
    // As far as `cp` has come: the length of the one or of the other, the beginning of the other.
    for copied in (0..=others.len()).step_by(others.len() / 12) {
        let mut mixed = others[..copied].to_vec();
        mixed.extend_from_slice(bytes.get(copied..).unwrap_or_default());
        std::fs::write(&path, mixed).expect("a write");
        match draw() {
            Ok(found) => assert!(found == expected, "{copied} bytes of another file: a picture of neither"),
            Err(e) => {
                errors += 1;
                assert!(e.to_string().contains("another file"), "{e}");
            }
        }
    }
    assert!(errors > 6, "{errors} errors");
    assert!(cloud.verify(Depth::Pages).is_err(), "it is another file now");
}

#[test]
fn files_differ_in_identity_as_they_differ_in_content_and_in_nothing_else() {
    let folder = folder();
    let path = folder.path().join("c.rset");
    let source = |seed| Box::new(mixed_points(700, 1.0, seed)) as Box<dyn PointSource>;
    let built = |sources: Vec<Box<dyn PointSource>>, options: &BuildOptions| {
        build::run(sources, &path, options, &BuildControl::default()).expect("it builds");
        (Cloud::open(&path).expect("it opens").header().identity, std::fs::read(&path).expect("a read"))
    };
    let first = built(vec![source(1), source(2)], &options());
    let other = BuildOptions { threads: 5, memory_bytes: 64 << 20, ..options() };
    assert!(first == built(vec![source(2), source(1)], &other), "the order of inputs shows");
    let mut identities = vec![first.0];
    identities.push(built(vec![source(1)], &options()).0);
    identities.push(built(vec![source(1), source(3)], &options()).0);
    identities
        .push(built(vec![source(1), source(2)], &BuildOptions { page_bytes: Some(32 << 10), ..options() }).0);
    identities
        .push(built(vec![source(1), source(2)], &BuildOptions { radius: Some(Rule::Auto), ..options() }).0);
    let scaled = BuildOptions { radius: Some(Rule::Auto), radius_scale: 2.0, ..options() };
    identities.push(built(vec![source(1), source(2)], &scaled).0);
    for (i, identity) in identities.iter().enumerate() {
        assert!(!identities[..i].contains(identity), "{i}: {identity}");
    }
}

#[test]
fn an_unknown_required_feature_is_an_error_with_a_name_and_an_optional_one_is_nothing() {
    let folder = folder();
    let path = folder.path().join("c.rset");
    build_at(&path, Box::new(mixed_points(300, 1.0, 4)), &options());
    let bytes = std::fs::read(&path).expect("a read");
    let mut optional = bytes.clone();
    optional[40] |= 0x10;
    reseal(&mut optional);
    std::fs::write(&path, &optional).expect("a write");
    Cloud::open(&path).expect("it opens").verify(Depth::Deep).expect("it is whole");

    let mut required = bytes.clone();
    required[32] |= 0x20;
    reseal(&mut required);
    std::fs::write(&path, &required).expect("a write");
    let message = Cloud::open(&path).expect_err("it is not understood").to_string();
    assert!(message.contains("number 5") && message.contains("newer"), "{message}");

    // The same with a name for it, in place of the description.
    let words = br#"{"features": {"5": "aggregates"}}"#;
    let at = section(&required, SectionKind::META);
    required[at..at + 4096].fill(0);
    required[at..at + words.len()].copy_from_slice(words);
    let mut header = decode(&required);
    header
        .sections
        .iter_mut()
        .filter(|s| s.kind == SectionKind::META)
        .for_each(|s| s.bytes = words.len() as u64);
    required[..4096].copy_from_slice(&header.encode());
    reseal(&mut required);
    std::fs::write(&path, &required).expect("a write");
    let message = Cloud::open(&path).expect_err("it is not understood").to_string();
    assert!(message.contains("`aggregates`"), "{message}");
}

fn decode(bytes: &[u8]) -> FileHeader {
    FileHeader::decode(bytes[..4096].try_into().expect("a block"), FileKind::Cloud).expect("a header")
}

#[test]
fn an_unknown_section_is_ignored_but_for_its_checksum() {
    let folder = folder();
    let path = folder.path().join("c.rset");
    build_at(&path, Box::new(mixed_points(300, 1.0, 4)), &options());
    let mut bytes = std::fs::read(&path).expect("a read");
    let mut header = decode(&bytes);
    let at = bytes.len() - 4096;
    let footer = bytes.split_off(at);
    bytes.extend_from_slice(b"what a later program adds");
    bytes.resize(at + 4096, 0);
    bytes.extend_from_slice(&footer);
    let (kind, last) = (SectionKind(*b"LATE"), header.sections[0]);
    header.sections.push(rayset::container::Section { kind, pages: 0, offset: at as u64, bytes: 25, ..last });
    header.file_bytes += 4096;
    bytes[..4096].copy_from_slice(&header.encode());
    reseal(&mut bytes);
    std::fs::write(&path, &bytes).expect("a write");
    Cloud::open(&path).expect("it opens").verify(Depth::Deep).expect("it is whole");
    for flipped in [at + 3, at + 900] {
        let mut damaged = bytes.clone();
        damaged[flipped] ^= 1;
        std::fs::write(&path, &damaged).expect("a write");
        let cloud = Cloud::open(&path).expect("it opens");
        assert!(cloud.verify(Depth::Pages).is_err(), "byte {flipped}");
    }
}

#[test]
fn a_file_of_version_1_is_to_be_built_again() {
    let folder = folder();
    let path = folder.path().join("c.rset");
    let mut bytes = vec![0; 40960];
    bytes[..8].copy_from_slice(b"RAYSET\r\n");
    bytes[8] = 1;
    std::fs::write(&path, &bytes).expect("a write");
    let message = Cloud::open(&path).expect_err("it is too old").to_string();
    assert!(message.contains("version 1") && message.contains("build the file again"), "{message}");
}

/// A column of random bits of a type.
fn random_column(kind: ColumnType, points: usize, random: &mut Random) -> Values {
    let mut values = Values::empty(kind);
    for _ in 0..points {
        let bits: Vec<u8> = (0..kind.bytes()).map(|_| (random.unit() * 256.0) as u8).collect();
        values.push_le_bytes(&bits);
    }
    values
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]
    #[test]
    fn columns_of_every_type_survive_bit_for_bit(kinds in prop::collection::vec(0_usize..10, 1..12), points in 1_usize..700) {
        let mut random = Random(points as u64);
        let columns: Vec<(ColumnInfo, Values)> = kinds
            .iter()
            .enumerate()
            .map(|(i, &kind)| {
                let kind = ColumnType::ALL[kind];
                let info = ColumnInfo::new(format!("column {i}"), kind).with_unit("s");
                (if i % 2 == 0 { info.of_classes() } else { info }, random_column(kind, points, &mut random))
            })
            .collect();
        let position: Vec<[f64; 3]> = (0..points).map(|_| [random.unit(), random.unit(), random.unit()]).collect();
        // The last column tells which point it was.
        let mut all = columns.clone();
        let numbers = (0..points as u64).map(|i| i << 40 | i).collect::<Vec<u64>>();
        all.push((ColumnInfo::new("number", ColumnType::U64), Values::from(numbers)));
        let names = all.iter().map(|(info, _)| info.name.clone()).collect();
        let folder = folder();
        let options = BuildOptions { attributes: names, ..BuildOptions::default() };
        let cloud = build_at(&folder.path().join("c.rset"), Box::new(ArraySource::typed(position, all)), &options);
        cloud.verify(Depth::Deep).expect("it is whole");
        let header = cloud.header();
        for (stored, (info, _)) in header.attributes.iter().zip(&columns) {
            prop_assert_eq!(
                (&stored.name, stored.kind, &stored.unit, stored.is_class),
                (&info.name, info.kind, &info.unit, info.is_class)
            );
        }
        let mut seen = 0;
        cloud.for_each_run(|_, run| {
            let numbers = run.attribute_bytes(header, columns.len()).chunks_exact(8);
            for (place, number) in numbers.enumerate() {
                let mut b = [0; 8];
                b.copy_from_slice(number);
                let point = u64::from_le_bytes(b) as u32 as usize;
                for (index, (info, values)) in columns.iter().enumerate() {
                    let width = info.kind.bytes();
                    let mut expected = Vec::new();
                    values.write_as(point, info.kind, &mut expected);
                    let found = &run.attribute_bytes(header, index)[place * width..(place + 1) * width];
                    assert_eq!(found, expected, "column {index} of point {point}");
                }
                seen += 1;
            }
        }).expect("it reads");
        prop_assert_eq!(seen, points);
    }
}

#[test]
fn inputs_of_different_types_make_a_column_that_holds_both() {
    let folder = folder();
    let source = |values: Values| {
        let info = ColumnInfo::new("id", values.kind());
        Box::new(ArraySource::typed(vec![[0.0; 3]; values.len()], vec![(info, values)]))
            as Box<dyn PointSource>
    };
    let path = folder.path().join("c.rset");
    let options = BuildOptions { attributes: vec!["id".into()], ..BuildOptions::default() };
    let sources = vec![source(vec![200_u8].into()), source(vec![-70_000_i32].into())];
    build::run(sources, &path, &options, &BuildControl::default()).expect("it builds");
    let header = Cloud::open(&path).expect("it opens").header().clone();
    let id = &header.attributes[0];
    assert_eq!((id.kind, id.min, id.max), (ColumnType::I32, -70_000.0, 200.0));
}

#[test]
fn as_many_columns_as_there_may_be_fit_the_smallest_clouds() {
    let folder = folder();
    let columns: Vec<(ColumnInfo, Values)> = (0..MAX_ATTRIBUTES)
        .map(|i| (ColumnInfo::new(format!("c{i}"), ColumnType::F64), Values::from(vec![i as f64 + 0.1; 300])))
        .collect();
    let names: Vec<String> = columns.iter().map(|(info, _)| info.name.clone()).collect();
    let mut random = Random(7);
    let position: Vec<[f64; 3]> = (0..300).map(|_| [random.unit(), random.unit(), random.unit()]).collect();
    let source = || Box::new(ArraySource::typed(position.clone(), columns.clone()));
    let path = folder.path().join("c.rset");
    let options = BuildOptions { attributes: names, ..BuildOptions::default() };
    let cloud = build_at(&path, source(), &options);
    cloud.verify(Depth::Deep).expect("it is whole");
    let tight = BuildOptions { page_bytes: Some(16 << 10), ..options };
    let error =
        build::run(vec![source()], &path, &tight, &BuildControl::default()).expect_err("a run does not fit");
    assert!(matches!(error, BuildError::Option { option: "page size", .. }), "{error}");
    let needed: u32 =
        error.to_string().split_ascii_whitespace().rev().nth(1).and_then(|w| w.parse().ok()).expect("bytes");
    build_at(&path, source(), &BuildOptions { page_bytes: Some(needed), ..tight });
}

#[test]
fn a_grid_file_is_called_a_grid_and_a_cloud_a_cloud() {
    let folder = folder();
    let path = folder.path().join("c.rset");
    build_at(&path, Box::new(mixed_points(30, 1.0, 4)), &options());
    let message = rayset::grid::Grid::open(&path).expect_err("it is a cloud").to_string();
    assert!(message.contains("a cloud where a grid was expected"), "{message}");
    let cloud = Arc::new(Cloud::open(&path).expect("it opens"));
    assert_eq!(cloud.header().sources, Vec::<String>::new());
}
