//! Gaussian splats as SOG: not bundled, with levels of detail, and what is refused. What a bundle
//! holds is compared in [`splats`](crate::splats).

use std::fs;
use std::path::{Path, PathBuf};

use rayset::points::{self, ReadOptions};
use serde_json::{Value, json};

use crate::common::folder;
use crate::tables::{Table, table};

/// Splats of the bundle.
const COUNT: usize = 40;

fn bundle() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/splats/bundle.sog")
}

/// The members of a ZIP archive in which they are stored as they are.
fn members(bytes: &[u8]) -> Vec<(String, Vec<u8>)> {
    let number = |at: usize, length: usize| {
        bytes[at..at + length].iter().rev().fold(0_usize, |n, &byte| n << 8 | usize::from(byte))
    };
    let entries = (0..bytes.len() - 4).filter(|&at| bytes[at..].starts_with(b"PK\x01\x02"));
    entries
        .map(|at| {
            let (size, name, local) = (number(at + 24, 4), number(at + 28, 2), number(at + 42, 4));
            let start = local + 30 + number(local + 26, 2) + number(local + 28, 2);
            let name = String::from_utf8(bytes[at + 46..at + 46 + name].to_vec()).expect("a name");
            (name, bytes[start..start + size].to_vec())
        })
        .collect()
}

/// Unpacks the bundle to a folder, with its JSON changed.
fn unpack(folder: &Path, change: &dyn Fn(&mut Value)) {
    fs::create_dir_all(folder).expect("a folder");
    for (name, bytes) in members(&fs::read(bundle()).expect("a fixture")) {
        let bytes = if name == "meta.json" {
            let mut json = serde_json::from_slice(&bytes).expect("JSON");
            change(&mut json);
            json.to_string().into_bytes()
        } else {
            bytes
        };
        fs::write(folder.join(name), bytes).expect("a write");
    }
}

fn read(path: &Path) -> Result<Table, String> {
    table(path, None).map_err(|error| error.to_string())
}

#[test]
fn what_is_not_bundled_is_the_same_as_the_bundle() {
    let folder = folder();
    unpack(folder.path(), &|_| ());
    let (bundled, beside) = (read(&bundle()), read(&folder.path().join("meta.json")));
    assert_eq!(bundled.expect("it reads"), beside.expect("it reads"));
    unpack(folder.path(), &|json| json["antialias"] = json!(true));
    let source = points::open(folder.path().join("meta.json"), &ReadOptions::default()).expect("it opens");
    assert_eq!(source.schema().description, "SOG 2; Gaussian splats, y down, antialiased");
}

#[test]
fn of_levels_of_detail_the_finest_is_read_everywhere() {
    let folder = folder();
    let f = folder.path();
    unpack(&f.join("fine"), &|_| ());
    unpack(&f.join("coarse"), &|_| ());
    fs::copy(bundle(), f.join("sky.sog")).expect("a copy");
    let all = read(&bundle()).expect("it reads");
    let leaf = |levels: Value| json!({"bound": {}, "lods": levels});
    let part =
        |file: usize, offset: usize, count: usize| json!({"file": file, "offset": offset, "count": count});
    let mut levels = json!({
        "version": 1, "lodLevels": 2, "filenames": ["coarse/meta.json", "fine/meta.json"],
        "tree": {"bound": {}, "children": [
            leaf(json!({"0": part(1, 10, 5), "1": part(0, 0, 2)})),
            {"children": [leaf(json!({"1": part(0, 7, 3)})), leaf(json!({"1": part(0, 3, 1), "0": part(1, 2, 4)}))]},
        ]},
    });
    let path = f.join("lod-meta.json");
    let read_levels = |levels: &Value| {
        fs::write(&path, levels.to_string()).expect("a write");
        read(&path)
    };
    let numbers = |ranges: &[std::ops::Range<usize>]| -> Vec<[f64; 3]> {
        ranges.iter().cloned().flatten().map(|i| all.0[i]).collect()
    };
    let found = read_levels(&levels).expect("it reads");
    assert_eq!(found.0, numbers(&[7..10, 2..6, 10..15]));
    levels["environment"] = json!("sky.sog");
    assert_eq!(read_levels(&levels).expect("it reads").0, numbers(&[7..10, 2..6, 10..15, 0..COUNT]));
    for (change, said) in [
        (json!(["coarse/meta.json"]), "a node of a file that is not there"),
        (json!(["coarse/meta.json", "../meta.json"]), "expected names in folders beside this file"),
        (json!(["coarse/meta.json", "none/meta.json"]), "none/meta.json"),
    ] {
        let mut changed = levels.clone();
        changed["filenames"] = change;
        let error = read_levels(&changed).expect_err("refused");
        assert!(error.contains(said), "{error}");
    }
    let mut twice = levels.clone();
    twice["tree"]["children"][0]["lods"]["0"]["offset"] = json!(5);
    assert!(read_levels(&twice).expect_err("refused").contains("have the same splats"));
    levels["tree"]["children"][0]["lods"]["0"]["count"] = json!(COUNT);
    assert!(read_levels(&levels).expect_err("refused").contains("fewer than its tree says"));
}

#[test]
fn sog_that_cannot_be_read_is_refused_with_its_reason() {
    let folder = folder();
    let refused = |change: &dyn Fn(&mut Value), said: &str| {
        unpack(folder.path(), change);
        let error = read(&folder.path().join("meta.json")).expect_err(said);
        assert!(error.contains(said), "{error}");
    };
    refused(&|json| drop(json.as_object_mut().map(|all| all.remove("version"))), "SOG of version 1");
    refused(&|json| json["version"] = json!(3), "SOG of version 3");
    refused(&|json| json["count"] = json!(-1), "expected the number of splats");
    refused(&|json| json["count"] = json!(1_u64 << 40), "expected at most");
    refused(&|json| json["count"] = json!(100_000), "pixels; expected 100000 to");
    refused(&|json| json["means"]["mins"] = json!([0, 0]), "`mins`: expected 3 numbers");
    refused(&|json| json["scales"]["codebook"] = json!([1.0]), "`codebook`: expected 256 numbers");
    refused(&|json| json["means"]["files"] = json!(["means_l.webp"]), "the names of 2 images");
    refused(&|json| json["quats"]["files"] = json!(["../quats.webp"]), "the names of 1 images");
    refused(&|json| json["quats"]["files"] = json!(["none.webp"]), "none.webp");
    refused(&|json| json["quats"]["files"] = json!(["meta.json"]), "not WebP");
    refused(&|json| json["shN"]["bands"] = json!(4), "`bands` of 1 to 3");
    refused(&|json| json["shN"]["bands"] = json!(3), "pixels; expected 960 to");
    unpack(folder.path(), &|_| ());
    let image = folder.path().join("sh0.webp");
    let bytes = fs::read(&image).expect("an image");
    for cut in 0..bytes.len() {
        fs::write(&image, &bytes[..cut]).expect("a write");
        let error = read(&folder.path().join("meta.json")).expect_err("cut off");
        assert!(error.contains("sh0.webp") && error.contains("WebP"), "{error}");
    }
}
