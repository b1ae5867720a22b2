//! The cache: clouds and grids built of inputs that were rendered without building them first.
//!
//! An entry is found by the name of its first input and a hash of the named files and options. Its
//! note says which other files were read, such as the voxels beside a header; it is used as long as
//! those, too, are what they were. What has not been used for longest goes first when the cache is
//! full.

mod entry;
mod stamp;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use clap::Args;
use rayset::storage;

use self::entry::{EXTENSION, Listed};
pub(super) use self::entry::{Entry, Found};
use self::stamp::Detail;
pub use self::stamp::fingerprint;
use crate::choices::BuildChoices;
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
    /// Stop at the first damaged file of a folder or pattern, instead of leaving it out and naming
    /// it at the end
    #[arg(long, help_heading = "Folders of files")]
    strict: bool,
    #[command(flatten)]
    pub(super) choices: BuildChoices,
}

/// Bytes that the cache keeps if nothing else is said.
const DEFAULT_LIMIT: u64 = 20 << 30;

/// Where something is built.
pub(super) enum Place {
    /// In the cache.
    Kept(Entry),
    /// In a folder that goes when this is dropped.
    Temporary { _folder: Box<dyn TemporaryFolder>, path: PathBuf },
}

impl Place {
    pub(super) fn path(&self) -> &Path {
        match self {
            Self::Kept(entry) => entry.data(),
            Self::Temporary { path, .. } => path,
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
        Self { choices: BuildChoices::of_columns(columns), ..self }
    }

    /// The same, with the volume that is read of a series; `None` for the first.
    #[must_use]
    pub fn with_volume_index(mut self, index: Option<u64>) -> Self {
        self.choices.volume_index = index;
        self
    }

    /// The options as one would type them: those that decide what is built, and where it is kept.
    #[must_use]
    pub fn words(&self) -> Vec<String> {
        let folder = self.cache.as_ref().map(|folder| {
            // A command may be run from elsewhere.
            let folder = std::path::absolute(folder).unwrap_or_else(|_| folder.clone());
            format!("--cache={}", folder.display())
        });
        let flags = [("--no-cache", self.no_cache), ("--strict", self.strict)];
        let flags = flags.into_iter().filter(|(_, given)| *given).map(|(name, _)| name.to_owned());
        folder.into_iter().chain(flags).chain(self.choices.words()).collect()
    }

    /// Whether one damaged file of a folder is an error.
    pub(super) fn strict(&self) -> bool {
        self.strict
    }

    /// What was built of `inputs` with `options` before, newest first.
    pub(super) fn find(&self, name: &Name) -> Vec<Found> {
        let folder = self.folder().ok().filter(|_| !self.no_cache);
        folder.map_or_else(Vec::new, |folder| Entry::find(&folder, &name.entry, &name.data))
    }

    /// A place for what is built: in the cache, or, if that cannot be written to, which is said, in
    /// a temporary folder.
    pub(super) fn place(&self, name: &Name, host: &dyn Host) -> Result<Place> {
        if self.no_cache {
            return temporary(name, host);
        }
        let created = self.folder().and_then(|folder| Entry::create(&folder, &name.entry, &name.data));
        created.map(Place::Kept).or_else(|error| {
            host.remark(&format!(
                "nothing is kept: {error:#}; --cache names another folder, --no-cache says that none is wanted"
            ));
            temporary(name, host)
        })
    }

    fn folder(&self) -> Result<PathBuf> {
        self.cache.clone().map_or_else(user_folder, Ok)
    }

    /// Removes the entries that were not used for longest until the others fit, and what builds
    /// that were killed have left. The newest entry stays, however large, and so does what others
    /// build or read.
    pub(super) fn prune(&self, kept: &Entry, host: &dyn Host) {
        let limit = self.cache_limit.unwrap_or(DEFAULT_LIMIT);
        let Some(cache) = kept.folder().parent() else { return };
        let mut entries = Listed::all(cache);
        entries.sort_by_key(|entry| std::cmp::Reverse(entry.used));
        let (mut removed, mut freed) = (0, 0);
        let mut bytes = kept.data().metadata().map_or(0, |metadata| metadata.len());
        for entry in entries.iter().filter(|entry| entry.folder() != kept.folder()) {
            bytes += entry.bytes;
            if (bytes > limit || !entry.is_of_use) && entry.remove() {
                bytes -= entry.bytes;
                if entry.is_of_use {
                    removed += 1;
                    freed += entry.bytes;
                }
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

/// What an entry is called.
pub(super) struct Name {
    /// Begins the name of its folder.
    entry: String,
    /// The name of the built file.
    data: String,
}

impl Name {
    /// Of what is built of the files that `inputs` stand for, with `options`, a text that says what
    /// they are.
    ///
    /// # Errors
    /// If a file cannot be looked at.
    pub(super) fn of(inputs: &[PathBuf], files: &[PathBuf], options: &str) -> Result<Self> {
        let key = stamp::key(files, &format!("{GENERATION} {options}"))?;
        let Some(first) = inputs.first() else { bail!("no input") };
        // A query, which may grant access, is no part of a name that others may see.
        let stem: String = Path::new(&storage::shown(first))
            .file_stem()
            .unwrap_or_default()
            .to_string_lossy()
            .chars()
            .map(|c| if c.is_alphanumeric() || c == '_' { c } else { '-' })
            .take(40)
            .collect();
        Ok(Self { entry: format!("{stem}-{key}"), data: format!("{stem}.{EXTENSION}") })
    }
}

/// The stamps of files that inputs pull in, taken before they are read.
pub(super) fn stamps(files: &[PathBuf]) -> Result<Vec<(PathBuf, String)>> {
    files.iter().map(|file| Ok((file.clone(), stamp::of(file, Detail::Local)?))).collect()
}

fn temporary(name: &Name, host: &dyn Host) -> Result<Place> {
    let folder = host.temporary_folder()?;
    let path = folder.path().join(&name.data);
    Ok(Place::Temporary { _folder: folder, path })
}

/// Raised when what is built of the same input changes within a version of the program: entries of
/// before are not used.
const GENERATION: u32 = 6;

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
