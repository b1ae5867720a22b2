//! How a file is told from the one that had its name before.

use std::fmt::Write as _;
use std::hash::{BuildHasher, RandomState};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use rayset::storage::{self, address_of};

/// What stamps say of a file.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Detail {
    /// Path, length, and time of change: the same on every machine that sees the file.
    Shared,
    /// Also the number of the file and the time when the system last changed anything of it, which
    /// a program that sets a file's time of change, such as `cp -p`, cannot set.
    Local,
}

/// A line that differs for files that may differ. Of an address it has no secrets, so that an
/// object that is signed anew is the same. Where these could tell objects apart and the server says
/// nothing that does, an entry of the cache is never found again.
///
/// # Errors
/// If the file cannot be looked at.
pub(super) fn of(path: &Path, detail: Detail) -> Result<String> {
    let doing = || format!("cannot read {}", path.display());
    if address_of(path).is_some() {
        let object = storage::open(path, false).with_context(doing)?;
        let bytes = object.length().with_context(doing)?;
        let shown = storage::shown(path);
        let version = object.version();
        let is_told = version.is_some() || Path::new(&shown) == path;
        return Ok(match detail {
            _ if is_told => format!("{shown:?} {bytes} {version:?}"),
            Detail::Shared => format!("{path:?} {bytes}"),
            // As random as the keys of hash maps.
            Detail::Local => format!("{shown:?} {bytes} {:016x}", RandomState::new().hash_one(bytes)),
        });
    }
    let metadata = std::fs::metadata(path).with_context(doing)?;
    // A pipe has no path of its own.
    let own_path = match storage::look(path) {
        Ok(storage::Named::Other) => path.to_owned(),
        _ => std::fs::canonicalize(path).with_context(doing)?,
    };
    // Paths that are not text differ in their debugging form.
    let mut line = format!("{own_path:?} {}", metadata.len());
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt;
        // Seconds before 1970 are negative.
        let _ = write!(line, " {}.{:09}", metadata.mtime(), metadata.mtime_nsec());
        if detail == Detail::Local {
            let _ = write!(line, " {}.{:09} {}", metadata.ctime(), metadata.ctime_nsec(), metadata.ino());
        }
    }
    #[cfg(not(unix))]
    {
        let _ = (detail, write!(line, " {:?}", metadata.modified().ok()));
    }
    Ok(line)
}

/// A hash, in 16 digits, of the version of the program, of `options`, a text that says what is made
/// of some files, and of the files' stamps.
fn hash(files: &[PathBuf], options: &str, detail: Detail) -> Result<String> {
    let mut text = format!("{} {options}\n", env!("CARGO_PKG_VERSION"));
    for file in files {
        text.push_str(&of(file, detail)?);
        text.push('\n');
    }
    Ok(format!("{:016x}", xxhash_rust::xxh3::xxh3_64(text.as_bytes())))
}

/// What a cache entry is found by.
pub(super) fn key(files: &[PathBuf], options: &str) -> Result<String> {
    hash(files, options, Detail::Local)
}

/// A hash, in 16 digits, of the version of the program, of the paths, sizes and times of change of
/// some inputs, and of `options`, a text that says what is made of them. It is the same on all
/// machines that see the inputs under these paths.
///
/// # Errors
/// If an input cannot be read.
pub fn fingerprint(inputs: &[PathBuf], options: &str) -> Result<String> {
    hash(inputs, options, Detail::Shared)
}
