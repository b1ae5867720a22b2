//! Files that are recognized but not read: what they are, and which tool or option makes one of
//! them that opens.

mod kinds;

use std::io::Read;
use std::path::Path;

use flate2::read::MultiGzDecoder;

use rayset_files::points::roles::excerpt;
use rayset_store::storage::input_file::InputFile;

use self::kinds::{KINDS, Kind, VOLUMES};

/// Bytes that are looked at of what is compressed.
const HEAD_BYTES: u64 = 4096;
/// Files of a folder that are looked at.
const MOST_ENTRIES: usize = 32;

impl Kind {
    /// Whether a file that begins so has a mark of this kind.
    fn begins(&self, head: &[u8]) -> bool {
        self.marks.iter().any(|(at, mark)| head.get(*at..).is_some_and(|head| head.starts_with(mark)))
    }

    /// What it is, that it is not read, and what to do.
    fn advice(&self) -> String {
        format!("this is {}, which is not read; {}", self.what, self.way)
    }
}

/// All kinds, those of volumes first.
fn kinds() -> impl Iterator<Item = &'static Kind> {
    VOLUMES.iter().chain(KINDS)
}

/// What a file is that may be a volume, by its first bytes, and what to do.
pub(crate) fn of_volume_marked(head: &[u8]) -> Option<String> {
    VOLUMES.iter().find(|kind| kind.begins(head)).map(Kind::advice)
}

/// What a folder is that may be a volume, or a file by its name, and what to do.
pub(crate) fn of_volume_named(path: &Path, name: &str) -> Option<String> {
    let kind = if path.is_dir() { folder(path, name) } else { named(name) }?;
    VOLUMES.iter().find(|volume| volume.what == kind.what).map(Kind::advice)
}

/// What a file is that no reader takes, why not, and what to do. `known` are the endings of names
/// that are read.
pub(crate) fn advice(path: &Path, head: &[u8], known: &str) -> String {
    let name = path.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
    if path.is_dir() {
        let otherwise = || "this is a folder; give the files in it that are to be read".to_owned();
        return folder(path, &name).map_or_else(otherwise, Kind::advice);
    }
    if head.is_empty() {
        return "this file is empty, or is no regular file".into();
    }
    if let Some(kind) = recognized(head, &name) {
        return kind.advice();
    }
    if head.starts_with(&[0x1f, 0x8b]) {
        return of_gzip(head, &name);
    }
    let packed = [
        (&b"PK\x03\x04"[..], "ZIP"),
        (b"\x28\xb5\x2f\xfd", "zstd"),
        (b"BZh", "bzip2"),
        (b"\xfd7zXZ", "xz"),
        (b"7z\xbc\xaf", "7-Zip"),
    ];
    if let Some((_, packer)) = packed.iter().find(|(mark, _)| head.starts_with(mark)) {
        return format!("this is compressed with {packer}; unpack it first");
    }
    if !head.contains(&0) && std::str::from_utf8(head).is_ok() {
        return format!(
            "this is text, but no table: expected numbers in columns, or a header that names x, y and z; otherwise points \
             in a file whose name ends in {known}"
        );
    }
    format!("unknown kind of file; expected points in a file whose name ends in {known}")
}

fn recognized(head: &[u8], name: &str) -> Option<&'static Kind> {
    if let Some(kind) = json(head, name) {
        return Some(kind);
    }
    marked(head).or_else(|| named(name))
}

/// The kind of a file of JSON, by what is in it, unless its name says what it is.
fn json(head: &[u8], name: &str) -> Option<&'static Kind> {
    let text = String::from_utf8_lossy(head);
    let text = text.trim_start_matches('\u{feff}').trim_start();
    let starts = |with: &str| {
        text.strip_prefix(with).is_some_and(|rest| rest.trim_start().starts_with(['"', '{', '[']))
    };
    if !starts("{") && !starts("[") {
        return None;
    }
    let has = |words: &[&str]| words.iter().any(|word| text.contains(word));
    let is_numbers =
        text.starts_with('[') && text[1..].trim_start().starts_with('[') && !name.ends_with("json");
    let extension = if has(&["\"FeatureCollection\"", "\"Feature\"", "\"Topology\""]) {
        "geojson"
    } else if has(&["\"CityJSON\""]) {
        "city.json"
    } else if is_numbers || !name.ends_with("json") && !name.is_empty() && named(name).is_some() {
        return None;
    } else if let Some(kind) = named(name).filter(|kind| !kind.extensions.contains(&"json")) {
        return Some(kind);
    } else {
        "json"
    };
    kinds().find(|kind| kind.extensions.contains(&extension))
}

/// The kind whose ending a name has.
fn named(name: &str) -> Option<&'static Kind> {
    // Of names that are whole, as `cloud.js` is, an ending alone is none.
    let is = |e: &&str| name.ends_with(&format!(".{e}")) || e.contains('.') && name == *e;
    kinds().find(|kind| kind.extensions.iter().any(is))
}

/// The kind whose marks a file has.
fn marked(head: &[u8]) -> Option<&'static Kind> {
    let molecule = || kinds().find(|kind| kind.extensions.contains(&"gro") && is_molecule(head));
    kinds().find(|kind| kind.begins(head)).or_else(molecule)
}

/// Whether a file says by its first bytes that it is of a kind that is not read, whatever its name.
pub(crate) fn is_marked(head: &[u8]) -> bool {
    marked(head).is_some()
}

/// Whether a file is known not to be read, by its first bytes or its name.
pub(crate) fn is_recognized(path: &Path, head: &[u8]) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
    recognized(head, &name).is_some()
}

/// Whether a file is a molecule in XYZ: a count, a remark, and lines of a chemical symbol and three
/// numbers.
fn is_molecule(head: &[u8]) -> bool {
    let text = String::from_utf8_lossy(head);
    let mut lines = text.lines();
    let is_count = lines.next().is_some_and(|line| line.trim().parse::<u64>().is_ok());
    let is_remark = lines.next().is_some_and(|line| {
        !line.split_ascii_whitespace().next().is_some_and(|word| word.parse::<f64>().is_ok())
    });
    let mut words = lines.next().unwrap_or_default().split_ascii_whitespace();
    let is_symbol = words.next().is_some_and(|word| {
        word.len() <= 3 && word.starts_with(|c: char| c.is_ascii_uppercase()) && word.is_ascii()
    });
    is_count
        && is_remark
        && is_symbol
        && words.take(3).filter(|word| word.parse::<f64>().is_ok()).count() == 3
}

/// What is in a file that is compressed with gzip, and not recognized by its name.
fn of_gzip(head: &[u8], name: &str) -> String {
    let mut plain = Vec::new();
    // The end is cut off, which is no error here.
    let _ = MultiGzDecoder::new(head).take(HEAD_BYTES).read_to_end(&mut plain);
    let inner = name.strip_suffix(".gz").unwrap_or(name);
    match recognized(&plain, inner) {
        Some(kind) => format!("this is {}, compressed with gzip, which is not read; {}", kind.what, kind.way),
        None => format!("this is compressed with gzip; `gunzip {}` makes what may open", excerpt(name)),
    }
}

/// What a folder is: by the files that it has, or as formats do of which folders have the names.
fn folder(path: &Path, name: &str) -> Option<&'static Kind> {
    let has = |file: &str| path.join(file).exists();
    // Of AMReX, and of RAMSES.
    let is_amr = has("Header") && has("Level_0")
        || name.strip_prefix("output_").is_some_and(|n| has(&format!("info_{n}.txt")));
    let by_files = [
        (has("metadata.json") && has("octree.bin") || has("cloud.js"), "cloud.js"),
        (has(".zarray") || has(".zgroup") || has("zarr.json"), "zarr.json"),
        (has("ept.json"), "ept.json"),
        (is_amr, ".athdf"),
        (has("points3D.bin") && has("images.bin"), "points3d.bin"),
        ([".zarr", ".n5", ".bp", ".bp4", ".bp5"].iter().any(|ending| name.ends_with(ending)), name),
        (has_dicom(path), ".dcm"),
    ];
    by_files.into_iter().find(|(is, _)| *is).and_then(|(_, known)| named(known))
}

/// Whether one of the first files of a folder is a slice of DICOM.
fn has_dicom(path: &Path) -> bool {
    let entries = std::fs::read_dir(path).into_iter().flatten().take(MOST_ENTRIES).filter_map(Result::ok);
    let mut files = entries.filter(|entry| entry.file_type().is_ok_and(|kind| kind.is_file()));
    files.any(|file| {
        let mut head = Vec::new();
        let read = InputFile::open(&file.path()).and_then(|file| file.take(132).read_to_end(&mut head));
        read.is_ok() && VOLUMES[0].begins(&head)
    })
}
