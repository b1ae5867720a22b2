//! Volumes that other programs wrote, beside what these programs read in them.

use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use flate2::Crc;
use flate2::read::GzDecoder;
use rayset::geometry::DVec3;
use rayset::volumes::{self, VolumeSource};
use serde_json::Value;

/// A folder below `tests/fixtures`.
pub(crate) fn fixtures(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures").join(name)
}

pub(crate) fn expected(folder: &str) -> Value {
    let text = std::fs::read_to_string(fixtures(folder).join("expected.json")).expect("a fixture");
    serde_json::from_str(&text).expect("JSON")
}

/// A fixture that is kept compressed.
pub(crate) fn unzipped(folder: &str, name: &str) -> Vec<u8> {
    let file = std::fs::File::open(fixtures(folder).join(format!("{name}.gz"))).expect("a fixture");
    let mut bytes = Vec::new();
    GzDecoder::new(file).read_to_end(&mut bytes).expect("gzip");
    bytes
}

/// All voxels of a volume as numbers, read in pieces of uneven lengths. An error as its text.
pub(crate) fn numbers(source: &mut VolumeSource) -> Result<Vec<f32>, String> {
    let width = source.kind.bytes();
    let all = source.size.iter().product::<u64>() as usize;
    let (mut found, mut piece) = (Vec::new(), 1);
    while found.len() < all {
        let mut bytes = vec![0; piece.min(all - found.len()) * width];
        source.read(&mut bytes).map_err(|e| e.to_string())?;
        found.extend(bytes.chunks_exact(width).map(|voxel| source.kind.value(voxel)));
        piece = (piece * 3 + 1) % 100_003;
    }
    Ok(found)
}

/// Opens a volume and reads all of it. An error as its text, which has to be a sentence.
pub(crate) fn read(path: &Path) -> Result<(VolumeSource, Vec<f32>), String> {
    let read = volumes::open(path, None).map_err(|e| e.to_string()).and_then(|mut source| {
        let numbers = numbers(&mut source)?;
        Ok((source, numbers))
    });
    if let Err(what) = &read {
        assert!(what.contains(": ") && !what.contains("failed to fill"), "{what}");
    }
    read
}

/// Compares a volume with what another program says of it.
pub(crate) fn compare(path: &Path, expected: &Value) {
    let (source, numbers) = read(path).unwrap_or_else(|what| panic!("{what}"));
    let name = path.display();
    let three = |value: &Value| -> [f64; 3] {
        let all: Vec<f64> =
            value.as_array().expect("three").iter().map(|v| v.as_f64().expect("a number")).collect();
        all.try_into().expect("three")
    };
    assert_eq!(source.size.map(|n| n as f64), three(&expected["size"]), "{name}: size");
    let range = numbers.iter().fold([f32::INFINITY, f32::NEG_INFINITY], |[a, b], v| [a.min(*v), b.max(*v)]);
    let bound = |at: usize| expected["range"][at].as_f64().expect("a number") as f32;
    assert_eq!(range, [bound(0), bound(1)], "{name}: range");
    for sample in expected["samples"].as_array().expect("samples") {
        let voxel = three(&sample["voxel"]);
        let [x, y, z] = voxel.map(|v| v as usize);
        let [nx, ny, _] = source.size.map(|n| n as usize);
        let value = f64::from(numbers[(z * ny + y) * nx + x]);
        assert_eq!(value as f32, sample["value"].as_f64().expect("a number") as f32, "{name}: {voxel:?}");
        let position = source.space_from_voxel.transform_point3(DVec3::from_array(voxel));
        let there = DVec3::from_array(three(&sample["position"]));
        let far = position.distance(there) / (1.0 + there.length());
        assert!(far < 1e-6, "{name}: {voxel:?} is at {position}, and should be at {there}");
    }
    let mut crc = Crc::new();
    numbers.iter().for_each(|v| crc.update(&v.to_le_bytes()));
    assert_eq!(u64::from(crc.sum()), expected["crc32"].as_u64().expect("a checksum"), "{name}: voxels");
    if let Some(about) = expected["about"].as_array() {
        let about: Vec<&str> = about.iter().map(|v| v.as_str().expect("a sentence")).collect();
        assert_eq!(source.about, about, "{name}");
    }
    for (found, key) in [(source.up, "up"), (source.facing, "facing")] {
        let wanted = expected.get(key).filter(|v| !v.is_null()).map(|v| DVec3::from_array(three(v)));
        assert_eq!(found, wanted, "{name}: {key}");
    }
}

/// Cuts a file off at every one of its first bytes, which is an error unless `harmless` says so of
/// what is cut off.
pub(crate) fn cut_off(path: &Path, bytes: &[u8], harmless: fn(&[u8]) -> bool) {
    std::fs::write(path, bytes).expect("a write");
    let file = std::fs::OpenOptions::new().write(true).open(path).expect("it opens");
    for length in (0..bytes.len()).rev() {
        file.set_len(length as u64).expect("it is cut off");
        let good = harmless(&bytes[length..]) || read(path).is_err();
        assert!(good, "{length} of {} bytes of {} are read", bytes.len(), path.display());
    }
}

/// Flips bits of a file, spread over it and dense at its beginning: an error that is a sentence, or
/// another volume.
pub(crate) fn flipped(path: &Path, bytes: &[u8], flips: usize) {
    std::fs::write(path, bytes).expect("a write");
    let mut file = std::fs::OpenOptions::new().write(true).open(path).expect("it opens");
    let mut put = |at: usize, byte: u8| {
        file.seek(SeekFrom::Start(at as u64)).expect("a seek");
        file.write_all(&[byte]).expect("a write");
    };
    for flip in 0..flips {
        let at = if flip % 2 == 0 { flip / 2 % 600 } else { flip * 7919 } % bytes.len();
        put(at, bytes[at] ^ (1 << (flip / 3 % 8)));
        match volumes::open(path, None) {
            Ok(mut source) if source.size.iter().product::<u64>() < 1 << 20 => drop(numbers(&mut source)),
            Ok(_) => {}
            Err(error) => assert!(error.to_string().contains(": "), "{error}"),
        }
        put(at, bytes[at]);
    }
}
