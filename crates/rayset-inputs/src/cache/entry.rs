//! Entries of the cache: folders of their own, each with what was built and a note of what it was
//! built from.
//!
//! A folder is created under a name that nobody can predict, so that nothing is in its way, and is
//! open to its owner alone. The note is the cache's mark: a folder without one is somebody else's,
//! whatever its name. Whoever builds or reads an entry holds a shared lock on its note; whoever
//! removes one takes the lock for itself alone, and lets be what is locked.

use std::fs::{File, TryLockError};
use std::hash::{BuildHasher, RandomState};
use std::io::{ErrorKind, Read, Seek, Write};
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use anyhow::{Context, Result, bail};
use rayset::storage;
use serde::{Deserialize, Serialize};

use super::stamp::{self, Detail};

/// Ending of the name of what is built.
pub(super) const EXTENSION: &str = "rset";
/// Name of the note.
const NOTE: &str = "built-from.json";
/// The mark, and the version of the note.
const MARK: u32 = 1;
/// Most bytes of a note that are read.
const MOST_NOTE_BYTES: u64 = 64 << 20;

/// What an entry was built from, besides the files by which it is found.
#[derive(Serialize, Deserialize, Default)]
struct Note {
    #[serde(rename = "rayset-cache")]
    mark: u32,
    /// Files that the inputs pull in, with their stamps.
    files: Vec<(PathBuf, String)>,
    /// What was said while it was built, and is said again whenever it is used.
    remarks: Vec<String>,
    /// Whether it was built to its end.
    is_complete: bool,
}

/// An entry that is being built or read. While this lives, no other process removes it.
pub(crate) struct Entry {
    folder: PathBuf,
    /// Locked.
    note: File,
    data: PathBuf,
    is_complete: bool,
}

/// An entry that can be used.
pub(crate) struct Found {
    pub(crate) entry: Entry,
    pub(crate) files: Vec<PathBuf>,
    pub(crate) remarks: Vec<String>,
}

impl Entry {
    /// Creates an entry in `cache` whose name begins with `name`, for a file called `data`.
    pub(super) fn create(cache: &Path, name: &str, data: &str) -> Result<Self> {
        create_folders(cache).with_context(|| format!("cannot create {}", cache.display()))?;
        for _ in 0..100 {
            // As random as the keys of hash maps.
            let random = RandomState::new().hash_one(std::process::id());
            let folder = cache.join(format!("{name}-{random:016x}"));
            let doing = || format!("cannot create {}", folder.display());
            match create_folder(&folder) {
                Err(error) if error.kind() == ErrorKind::AlreadyExists => continue,
                created => created.with_context(doing)?,
            }
            let path = folder.join(NOTE);
            let mut options = File::options();
            options.read(true).write(true).create_new(true);
            #[cfg(unix)]
            std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
            let entry = options.open(&path).map_err(anyhow::Error::from).and_then(|note| {
                let data = folder.join(data);
                let mut entry = Self { folder: folder.clone(), note, data, is_complete: false };
                entry.write(&Note { mark: MARK, ..Note::default() })?;
                Ok(entry)
            });
            let entry = entry.inspect_err(|_| drop(std::fs::remove_dir(&folder))).with_context(doing)?;
            // Between its creation and the lock, another process may have taken it for one that
            // nobody uses.
            if is_shared(&entry.note) && path.exists() {
                return Ok(entry);
            }
        }
        bail!("cannot create an entry in {}: every one was removed at once", cache.display())
    }

    /// The entries in `cache` whose names begin with `name` and whose inputs are what they were,
    /// newest first.
    pub(super) fn find(cache: &Path, name: &str, data: &str) -> Vec<Found> {
        let begins = format!("{name}-");
        let mut found: Vec<Found> = folders(cache)
            .filter(|folder| folder.file_name().is_some_and(|own| own.to_string_lossy().starts_with(&begins)))
            .filter_map(|folder| Self::open(folder, data))
            .collect();
        found.sort_by_key(|found| std::cmp::Reverse(used(&found.entry.note)));
        found
    }

    fn open(folder: PathBuf, data: &str) -> Option<Found> {
        let path = folder.join(NOTE);
        let mut file = open_note(&path)?;
        // One that is being removed is locked; one that has been removed has no name any more.
        if !is_shared(&file) || !path.exists() {
            return None;
        }
        let note = read(&mut file).filter(|note| note.is_complete)?;
        let is_as_it_was =
            |(path, stamp): &(PathBuf, String)| stamp::of(path, Detail::Local).is_ok_and(|now| now == *stamp);
        if !note.files.iter().all(is_as_it_was) {
            return None;
        }
        let entry = Self { data: folder.join(data), folder, note: file, is_complete: true };
        let files = note.files.into_iter().map(|(path, _)| path).collect();
        Some(Found { entry, files, remarks: note.remarks })
    }

    /// The file that is built, or was.
    pub(crate) fn data(&self) -> &Path {
        &self.data
    }

    /// The folder.
    pub(crate) fn folder(&self) -> &Path {
        &self.folder
    }

    /// Notes that the entry is whole: what it was built from besides the inputs that were named,
    /// and what was said. The built file admits whom all `inputs` admit.
    pub(crate) fn complete(
        &mut self,
        inputs: &[PathBuf],
        stamps: Vec<(PathBuf, String)>,
        remarks: &[String],
    ) -> Result<()> {
        // A note tells no secrets. What cannot be noted is not kept.
        if stamps.iter().any(|(path, _)| Path::new(&storage::shown(path)) != path) {
            return Ok(());
        }
        let remarks = remarks.iter().map(|remark| storage::redacted(remark).into_owned()).collect();
        let doing = || format!("cannot finish {}", self.folder.display());
        restrict(&self.data, inputs).with_context(doing)?;
        let note = Note { mark: MARK, files: stamps, remarks, is_complete: true };
        self.write(&note).with_context(|| format!("cannot finish {}", self.folder.display()))?;
        self.is_complete = true;
        Ok(())
    }

    /// Marks it as used now.
    pub(crate) fn touch(&self) {
        let _ = self.note.set_modified(SystemTime::now());
    }

    fn write(&mut self, note: &Note) -> Result<()> {
        let text = serde_json::to_vec(note)?;
        self.note.rewind()?;
        self.note.set_len(0)?;
        Ok(self.note.write_all(&text)?)
    }

    /// Removes it, although this holds it, unless others do, too.
    pub(crate) fn discard(mut self) {
        self.is_complete = false;
    }
}

impl Drop for Entry {
    /// What was not finished is not kept.
    fn drop(&mut self) {
        if !self.is_complete && is_mine_alone(&self.note) {
            let _ = remove_files(&self.folder, &self.data);
        }
    }
}

/// An entry as pruning sees it.
pub(super) struct Listed {
    folder: PathBuf,
    pub(super) bytes: u64,
    pub(super) used: SystemTime,
    /// Whether it was built to its end, or is still being built.
    pub(super) is_of_use: bool,
}

impl Listed {
    /// Every entry in the cache.
    pub(super) fn all(cache: &Path) -> Vec<Self> {
        let listed = |folder: PathBuf| {
            let mut file = open_note(&folder.join(NOTE))?;
            let note = read(&mut file)?;
            let bytes = data_of(&folder).and_then(|data| data.metadata().ok()).map_or(0, |m| m.len());
            Some(Self { bytes, used: used(&file), is_of_use: note.is_complete, folder })
        };
        folders(cache).filter_map(listed).collect()
    }

    pub(crate) fn folder(&self) -> &Path {
        &self.folder
    }

    /// Removes it, unless it is being built or read.
    pub(super) fn remove(&self) -> bool {
        let Some(note) = open_note(&self.folder.join(NOTE)) else { return false };
        if !is_mine_alone(&note) {
            return false;
        }
        let data = data_of(&self.folder).unwrap_or_default();
        remove_files(&self.folder, &data).is_ok()
    }
}

/// The built file of an entry: the one file whose name ends so.
fn data_of(folder: &Path) -> Option<PathBuf> {
    let mut files = std::fs::read_dir(folder).ok()?.filter_map(|entry| Some(entry.ok()?.path()));
    files.find(|path| path.extension().is_some_and(|extension| extension == EXTENSION))
}

/// Removes what an entry consists of, and what a build that was killed has left in it. A folder in
/// which something else lies stays, with that.
fn remove_files(folder: &Path, data: &Path) -> std::io::Result<()> {
    for found in std::fs::read_dir(folder)? {
        let path = found?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let is_partial = name.starts_with('.') && name.contains(".rayset-");
        if path == *data || name == NOTE || is_partial {
            let _ = std::fs::remove_file(&path);
        }
    }
    std::fs::remove_dir(folder)
}

/// The folders in the cache; links are none.
fn folders(cache: &Path) -> impl Iterator<Item = PathBuf> {
    std::fs::read_dir(cache).into_iter().flatten().filter_map(|found| {
        let found = found.ok()?;
        found.file_type().is_ok_and(|kind| kind.is_dir()).then(|| found.path())
    })
}

/// Opens a note for reading, and for marking it as used if that is allowed. No link is followed.
fn open_note(path: &Path) -> Option<File> {
    if !path.symlink_metadata().ok()?.is_file() {
        return None;
    }
    File::options().read(true).write(true).open(path).or_else(|_| File::open(path)).ok()
}

/// A note that has the cache's mark; `None` also of one that is just being written.
fn read(file: &mut File) -> Option<Note> {
    let mut text = Vec::new();
    file.rewind().ok()?;
    Read::by_ref(file).take(MOST_NOTE_BYTES).read_to_end(&mut text).ok()?;
    serde_json::from_slice(&text).ok().filter(|note: &Note| note.mark == MARK)
}

fn used(note: &File) -> SystemTime {
    note.metadata().and_then(|metadata| metadata.modified()).unwrap_or(UNIX_EPOCH)
}

/// Takes a shared lock; true also where the file system has none.
fn is_shared(note: &File) -> bool {
    !matches!(note.try_lock_shared(), Err(TryLockError::WouldBlock))
}

/// Takes the lock for this process alone; false where the file system has none.
fn is_mine_alone(note: &File) -> bool {
    note.try_lock().is_ok()
}

/// Creates a folder and those that it lies in, each for its owner alone.
fn create_folders(path: &Path) -> std::io::Result<()> {
    builder().recursive(true).create(path)
}

fn create_folder(path: &Path) -> std::io::Result<()> {
    builder().create(path)
}

fn builder() -> std::fs::DirBuilder {
    #[allow(unused_mut, reason = "other systems have no modes")]
    let mut builder = std::fs::DirBuilder::new();
    #[cfg(unix)]
    std::os::unix::fs::DirBuilderExt::mode(&mut builder, 0o700);
    builder
}

/// Takes from a file the rights that one of `inputs` does not give.
fn restrict(data: &Path, inputs: &[PathBuf]) -> std::io::Result<()> {
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        let modes = inputs.iter().filter_map(|input| std::fs::metadata(input).ok());
        let mode = modes.fold(0o666, |mode, input| mode & input.permissions().mode());
        let own = std::fs::metadata(data)?.permissions().mode();
        std::fs::set_permissions(data, std::fs::Permissions::from_mode(own & mode | 0o600))?;
    }
    let _ = (data, inputs);
    Ok(())
}
