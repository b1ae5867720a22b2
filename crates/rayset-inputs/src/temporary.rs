//! Folders for what is not to be kept: each is removed when it is dropped, and by the next run if
//! its process was killed.
//!
//! Such a folder holds a file that its process keeps locked. A folder with that file, of the same
//! owner, whose file is not locked was left behind. The file is locked before it has its name, so
//! that no other run ever sees it without its lock. Where a file system has no locks, nothing is
//! marked, and nothing is removed later.

use std::fs::{self, DirBuilder, File};
use std::io;
use std::path::{Path, PathBuf};

/// How the names of all such folders begin.
const PREFIX: &str = "rayset-";
/// The file that is locked while the folder is in use.
const MARK: &str = ".rayset-in-use";

/// A folder that is removed when this is dropped.
#[derive(Debug)]
pub struct OwnFolder {
    path: PathBuf,
    /// Locked.
    _mark: Option<File>,
    /// Forked processes do not own it.
    process: u32,
}

impl OwnFolder {
    /// Makes one in another folder, which nobody else may look into, and removes what killed
    /// processes of the same user have left there.
    ///
    /// # Errors
    /// The system's error, if it cannot be made.
    pub fn create(within: &Path, purpose: &str) -> io::Result<Self> {
        let process = std::process::id();
        let mut builder = DirBuilder::new();
        #[cfg(unix)]
        std::os::unix::fs::DirBuilderExt::mode(&mut builder, 0o700);
        let mut number = 0_u32;
        let path = loop {
            let path = within.join(format!("{PREFIX}{purpose}-{process}-{number}"));
            match builder.create(&path) {
                Ok(()) => break path,
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => number += 1,
                Err(error) => return Err(error),
            }
        };
        let mark = mark(&path).ok();
        remove_left(within, &path);
        Ok(Self { path, _mark: mark, process })
    }

    /// Where it is.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }
}

impl crate::TemporaryFolder for OwnFolder {
    fn path(&self) -> &Path {
        &self.path
    }
}

impl Drop for OwnFolder {
    fn drop(&mut self) {
        if self.process == std::process::id() {
            let _ = fs::remove_dir_all(&self.path);
        }
    }
}

/// Marks a folder as one that is in use.
fn mark(folder: &Path) -> io::Result<File> {
    let begun = folder.join(format!("{MARK}-begun"));
    let file = File::options().write(true).create_new(true).open(&begun)?;
    match file.try_lock() {
        Ok(()) => fs::rename(&begun, folder.join(MARK))?,
        Err(error) => {
            fs::remove_file(&begun)?;
            return Err(io::Error::other(error));
        }
    }
    Ok(file)
}

/// Removes the folders that killed processes have left. Those that cannot be removed are in
/// nobody's way.
fn remove_left(within: &Path, own: &Path) {
    let Ok(entries) = fs::read_dir(within) else { return };
    for entry in entries.flatten() {
        let name = entry.file_name();
        let path = entry.path();
        if name.to_str().is_some_and(|name| name.starts_with(PREFIX)) && path != own && is_left(&path, own) {
            let _ = fs::remove_dir_all(&path);
        }
    }
}

/// Whether a folder is one of a process that has ended, and of the owner of `own`.
fn is_left(folder: &Path, own: &Path) -> bool {
    let mark = folder.join(MARK);
    // Links are not followed, and pipes not opened.
    let is = |path: &Path, of: fn(&fs::FileType) -> bool| {
        let found = fs::symlink_metadata(path).ok();
        found.filter(|found| of(&found.file_type()) && is_of_one_owner(found, own)).is_some()
    };
    is(folder, fs::FileType::is_dir)
        && is(&mark, fs::FileType::is_file)
        && File::options().write(true).open(mark).is_ok_and(|file| file.try_lock().is_ok())
}

#[cfg(unix)]
fn is_of_one_owner(found: &fs::Metadata, own: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    fs::symlink_metadata(own).is_ok_and(|own| own.uid() == found.uid())
}

#[cfg(not(unix))]
fn is_of_one_owner(_found: &fs::Metadata, _own: &Path) -> bool {
    true
}
