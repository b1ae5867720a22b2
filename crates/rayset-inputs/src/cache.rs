//! The cache: clouds and grids built of inputs that were rendered without building them first.
//!
//! An entry is a file named after its input and a hash of everything that it depends on: the paths, sizes and times of
//! change of the inputs, the options, and the version of the program. An input that has changed has another name, so an
//! entry never has to be compared with its input. What has not been used for longest goes first when the cache is full.

use std::fmt::Write as _;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use anyhow::{Context, Result, bail};
use clap::Args;
use rayset::storage::{self, address_of};

use crate::host::{Host, TemporaryFolder};
use crate::{text, values};

/// Options of what is built of inputs, and of where it is kept.
#[derive(Args, Clone, Default)]
#[command(next_help_heading = "Cache of inputs that were not built before")]
pub struct CacheArgs {
    /// Folder that keeps what is built of points or voxels; the user's folder for caches by default
    #[arg(long, conflicts_with = "no_cache")]
    cache: Option<PathBuf>,
    /// Build into a temporary folder, and keep nothing
    #[arg(long)]
    no_cache: bool,
    /// Most bytes that the cache keeps; 20GiB by default
    #[arg(long, value_parser = values::size)]
    cache_limit: Option<u64>,
    /// Names of the columns of text files and of arrays, as in x,y,z,-,intensity; - leaves one out
    #[arg(long, value_delimiter = ',', allow_hyphen_values = true, help_heading = "Columns of tables")]
    columns: Option<Vec<String>>,
}

/// Bytes that the cache keeps if nothing else is said.
const DEFAULT_LIMIT: u64 = 20 << 30;
/// Endings of the names of its entries.
const EXTENSION: &str = "rset";

/// Where something is built, or was built before.
pub(super) enum Place {
    /// In the cache; the file may be there already.
    Kept(PathBuf),
    /// In a folder that goes when this is dropped.
    Temporary { _folder: Box<dyn TemporaryFolder>, path: PathBuf },
}

impl Place {
    pub(super) fn path(&self) -> &Path {
        match self {
            Self::Kept(path) | Self::Temporary { path, .. } => path,
        }
    }
}

impl CacheArgs {
    /// A cache in `folder`, or in the user's folder for caches.
    #[must_use]
    pub fn in_folder(folder: Option<PathBuf>) -> Self {
        Self { cache: folder, ..Self::default() }
    }

    /// None: what is built goes with what was opened.
    #[must_use]
    pub fn none() -> Self {
        Self { no_cache: true, ..Self::default() }
    }

    /// The same, with names of the columns of text files and of arrays; `-` leaves one out.
    #[must_use]
    pub fn with_columns(self, columns: Option<Vec<String>>) -> Self {
        Self { columns, ..self }
    }

    /// The options as one would type them: those that decide what is built, and where it is kept.
    #[must_use]
    pub fn words(&self) -> Vec<String> {
        let folder = self.cache.as_ref().map(|folder| {
            // A command may be run from elsewhere.
            let folder = std::path::absolute(folder).unwrap_or_else(|_| folder.clone());
            format!("--cache={}", folder.display())
        });
        let columns = self.columns.as_ref().map(|columns| format!("--columns={}", columns.join(",")));
        let without = self.no_cache.then(|| "--no-cache".to_owned());
        folder.into_iter().chain(without).chain(columns).collect()
    }

    /// Names of columns, if any were given.
    pub(super) fn columns(&self) -> Option<&[String]> {
        self.columns.as_deref()
    }

    /// The place of what is built of `inputs` with `options`, a text that says what they are.
    pub(super) fn place(&self, inputs: &[PathBuf], options: &str, host: &dyn Host) -> Result<Place> {
        let name = entry_name(inputs, options)?;
        if self.no_cache {
            let folder = host.temporary_folder()?;
            let path = folder.path().join(name);
            return Ok(Place::Temporary { _folder: folder, path });
        }
        let folder = match &self.cache {
            Some(folder) => folder.clone(),
            None => user_folder()?,
        };
        std::fs::create_dir_all(&folder).with_context(|| {
            format!(
                "cannot create the cache {}; --cache names another folder, --no-cache keeps nothing",
                folder.display()
            )
        })?;
        Ok(Place::Kept(folder.join(name)))
    }

    /// Removes the entries that were not used for longest until the others fit, before and after something is added. The
    /// newest entry stays, however large.
    pub(super) fn prune(&self, kept: &Path, host: &dyn Host) {
        let limit = self.cache_limit.unwrap_or(DEFAULT_LIMIT);
        let Some(folder) = kept.parent() else { return };
        let mut entries = entries(folder);
        entries.sort_by_key(|entry| std::cmp::Reverse(entry.used));
        let (mut bytes, mut removed, mut freed) = (0, 0, 0);
        for entry in entries {
            bytes += entry.bytes;
            // Who reads it meanwhile keeps it open.
            if bytes > limit && entry.path != kept && std::fs::remove_file(&entry.path).is_ok() {
                bytes -= entry.bytes;
                removed += 1;
                freed += entry.bytes;
            }
        }
        if removed > 0 {
            host.remark(&format!(
                "removed {removed} older entries from the cache, {}; --cache-limit allows {}",
                text::bytes(freed),
                text::bytes(limit)
            ));
        }
    }
}

/// Marks an entry as used now.
pub(super) fn touch(path: &Path) {
    if let Ok(file) = File::options().append(true).open(path) {
        let _ = file.set_modified(SystemTime::now());
    }
}

struct Entry {
    path: PathBuf,
    bytes: u64,
    used: SystemTime,
}

/// Everything in the cache that this program may have written.
fn entries(folder: &Path) -> Vec<Entry> {
    let Ok(found) = std::fs::read_dir(folder) else { return Vec::new() };
    let entry = |path: PathBuf| {
        let hash = path.file_stem()?.to_str()?.rsplit_once('-')?.1.to_owned();
        let ours =
            path.extension()? == EXTENSION && hash.len() == 16 && u64::from_str_radix(&hash, 16).is_ok();
        let metadata = path.symlink_metadata().ok().filter(|m| ours && m.is_file())?;
        Some(Entry { bytes: metadata.len(), used: metadata.modified().unwrap_or(UNIX_EPOCH), path })
    };
    found.filter_map(|found| entry(found.ok()?.path())).collect()
}

/// Raised when what is built of the same input changes within a version of the program: entries of before are not used.
const GENERATION: u32 = 4;

/// `site-0123456789abcdef.rset`: the name of the first input, and a hash of all that the entry depends on.
fn entry_name(inputs: &[PathBuf], options: &str) -> Result<String> {
    let hash = fingerprint(inputs, &format!("{GENERATION} {options}"))?;
    let Some(first) = inputs.first() else { bail!("no input") };
    let stem: String = first
        .file_stem()
        .unwrap_or_default()
        .to_string_lossy()
        .chars()
        .map(|c| if c.is_alphanumeric() || c == '_' { c } else { '-' })
        .take(40)
        .collect();
    Ok(format!("{stem}-{hash}.{EXTENSION}"))
}

/// A hash, in 16 digits, of the version of the program, of the paths, sizes and times of change of some inputs, and of `options`, a
/// text that says what is made of them.
///
/// # Errors
/// If an input cannot be read.
pub fn fingerprint(inputs: &[PathBuf], options: &str) -> Result<String> {
    let mut text = format!("{} {options}\n", env!("CARGO_PKG_VERSION"));
    for input in inputs {
        let doing = || format!("cannot read {}", input.display());
        if address_of(input).is_some() {
            let object = storage::open(input, false).with_context(doing)?;
            let bytes = object.length().with_context(doing)?;
            let _ = writeln!(text, "{input:?} {bytes} {:?}", object.version());
            continue;
        }
        let metadata = std::fs::metadata(input).with_context(doing)?;
        let path = std::fs::canonicalize(input).with_context(doing)?;
        let changed = metadata.modified().ok().and_then(|time| time.duration_since(UNIX_EPOCH).ok());
        let changed = changed.map_or(0, |time| time.as_nanos());
        // Paths that are not text differ in their debugging form.
        let _ = writeln!(text, "{path:?} {} {changed}", metadata.len());
    }
    Ok(format!("{:016x}", xxhash_rust::xxh3::xxh3_64(text.as_bytes())))
}

/// The user's own folder for caches.
fn user_folder() -> Result<PathBuf> {
    let set = |name: &str| std::env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
    let home = || set("HOME").or_else(|| set("USERPROFILE"));
    let found = if cfg!(windows) {
        set("LOCALAPPDATA").map(|folder| folder.join("rayset").join("cache"))
    } else if cfg!(target_os = "macos") {
        home().map(|home| home.join("Library/Caches/rayset"))
    } else {
        set("XDG_CACHE_HOME")
            .or_else(|| home().map(|home| home.join(".cache")))
            .map(|folder| folder.join("rayset"))
    };
    found.context("there is no folder for caches: the environment names no home; --cache DIR names one, --no-cache keeps nothing")
}
