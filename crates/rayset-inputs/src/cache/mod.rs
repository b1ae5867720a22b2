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
use rayset::storage;

use self::entry::{EXTENSION, Listed};
pub(super) use self::entry::{Entry, Found};
use self::stamp::Detail;
pub use self::stamp::fingerprint;
use crate::choices::BuildChoices;
use crate::host::{Host, TemporaryFolder};
use crate::text;

/// What is built of inputs, and where it is kept.
#[derive(Clone, Default)]
pub struct Cache {
    /// The folder that keeps what is built; `None` for the user's folder for caches.
    pub folder: Option<PathBuf>,
    /// Whether everything is built into temporary folders, and nothing kept.
    pub keeps_nothing: bool,
    /// Most bytes that are kept; `None` for 20 GiB.
    pub limit: Option<u64>,
    /// Whether the first damaged file of a folder or pattern is an error, instead of being left out
    /// and named at the end.
    pub strict: bool,
    /// What is built.
    pub choices: BuildChoices,
}

/// Bytes that the cache keeps if nothing else is said.
const DEFAULT_LIMIT: u64 = 20 << 30;

/// Where something is built.
pub(super) enum BuildTarget {
    /// In the cache.
    Kept(Entry),
    /// In a folder that goes when this is dropped.
    Temporary { _folder: Box<dyn TemporaryFolder>, path: PathBuf },
}

impl BuildTarget {
    pub(super) fn path(&self) -> &Path {
        match self {
            Self::Kept(entry) => entry.data(),
            Self::Temporary { path, .. } => path,
        }
    }
}

impl Cache {
    /// A cache in `folder`, or in the user's folder for caches.
    #[must_use]
    pub fn in_folder(folder: Option<PathBuf>) -> Self {
        Self { folder, ..Self::default() }
    }

    /// None: what is built goes with what was opened.
    #[must_use]
    pub fn none() -> Self {
        Self { keeps_nothing: true, ..Self::default() }
    }

    /// The options as one would type them: those that decide what is built, and where it is kept.
    #[must_use]
    pub fn words(&self) -> Vec<String> {
        let folder = self.folder.as_ref().map(|folder| {
            // A command may be run from elsewhere.
            let folder = std::path::absolute(folder).unwrap_or_else(|_| folder.clone());
            format!("--cache={}", folder.display())
        });
        let flags = [("--no-cache", self.keeps_nothing), ("--strict", self.strict)];
        let flags = flags.into_iter().filter(|(_, given)| *given).map(|(name, _)| name.to_owned());
        folder.into_iter().chain(flags).chain(self.choices.words()).collect()
    }

    /// What was built of `inputs` with `options` before, newest first.
    pub(super) fn find(&self, name: &Name) -> Vec<Found> {
        let folder = self.folder().ok().filter(|_| !self.keeps_nothing);
        folder.map_or_else(Vec::new, |folder| Entry::find(&folder, &name.entry, &name.data))
    }

    /// A place for what is built: in the cache, or, if that cannot be written to, which is said, in
    /// a temporary folder.
    pub(super) fn place(&self, name: &Name, host: &dyn Host) -> Result<BuildTarget> {
        if self.keeps_nothing {
            return temporary(name, host);
        }
        let created = self.folder().and_then(|folder| Entry::create(&folder, &name.entry, &name.data));
        created.map(BuildTarget::Kept).or_else(|error| {
            host.remark(&format!(
                "nothing is kept: {error:#}; --cache names another folder, --no-cache says that none is wanted"
            ));
            temporary(name, host)
        })
    }

    fn folder(&self) -> Result<PathBuf> {
        self.folder.clone().map_or_else(user_folder, Ok)
    }

    /// Removes the entries that were not used for longest until the others fit, and what builds
    /// that were killed have left. The newest entry stays, however large, and so does what others
    /// build or read.
    pub(super) fn prune(&self, kept: &Entry, host: &dyn Host) {
        let limit = self.limit.unwrap_or(DEFAULT_LIMIT);
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

fn temporary(name: &Name, host: &dyn Host) -> Result<BuildTarget> {
    let folder = host.temporary_folder()?;
    let path = folder.path().join(&name.data);
    Ok(BuildTarget::Temporary { _folder: folder, path })
}

/// Raised when what is built of the same input changes within a version of the program: entries of
/// before are not used.
const GENERATION: u32 = 14;

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
