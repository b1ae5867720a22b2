//! The destination of an output, checked before any work begins.

use std::ffi::OsStr;
use std::fs::{FileType, Metadata};
use std::io;
use std::path::{Path, PathBuf};

use super::OutputError;
use crate::storage::{address, address_of};

/// Symbolic links followed in a row before they are taken for a cycle: as many as Linux follows.
const MOST_LINKS: usize = 40;

/// The destination of an output.
#[derive(Clone, Debug)]
pub struct Destination {
    named: PathBuf,
    pub(super) target: Target,
}

/// What a path refers to.
#[derive(Clone, Debug)]
pub(super) enum Target {
    /// A file that exists and will be replaced, or that does not exist yet; never a link.
    File(PathBuf),
    /// A remote object. It is written to a file in the folder for temporary files first.
    Remote(PathBuf),
    /// A pipe or a device that takes bytes one after another. It is written to, never replaced.
    Stream,
}

impl Destination {
    /// Examines a path. Nothing is created or changed.
    ///
    /// # Errors
    /// [`OutputError`] if the path names a folder, a disk or a socket, its folder is missing, or
    /// the system cannot tell what it is.
    pub fn new(path: impl AsRef<Path>) -> Result<Self, OutputError> {
        Self::at(path.as_ref())
    }

    fn at(path: &Path) -> Result<Self, OutputError> {
        let io = |source| OutputError::Io { action: "write", path: path.to_owned(), source };
        let to = |target| Ok(Self { named: path.to_owned(), target });
        if let Some(address) = address_of(path) {
            address::opener(address).and_then(|opener| opener.prepare(address)).map_err(io)?;
            return to(Target::Remote(std::env::temp_dir()));
        }
        let found = match std::fs::metadata(path) {
            Ok(found) => Some(found),
            // Also a link whose target does not exist.
            Err(e) if e.kind() == io::ErrorKind::NotFound => None,
            Err(e) => return Err(io(e)),
        };
        if let Some(found) = &found
            && !found.is_file()
        {
            check_stream(path, found.file_type())?;
            return to(Target::Stream);
        }
        let target = follow_links(path).map_err(io)?;
        if target.file_name().is_none() {
            return Err(OutputError::NoName { path: path.to_owned() });
        }
        if found.is_none() {
            let folder = folder_of(&target);
            return match std::fs::metadata(folder) {
                Ok(metadata) if metadata.is_dir() => to(Target::File(target)),
                Err(e) if e.kind() != io::ErrorKind::NotFound => Err(io(e)),
                _ => Err(OutputError::NoFolder { path: path.to_owned(), folder: folder.to_owned() }),
            };
        }
        match std::fs::metadata(&target) {
            // The file that is a process's standard output may have been unlinked. Its link in
            // /proc can then still be opened, but the path that the link states does not exist.
            Err(e) if e.kind() == io::ErrorKind::NotFound && target != path => to(Target::Stream),
            Err(e) if e.kind() != io::ErrorKind::NotFound => Err(io(e)),
            _ => to(Target::File(target)),
        }
    }

    /// The path as it was given.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.named
    }

    /// The folder in which the file is written, after links have been followed; the one for
    /// temporary files if the destination is remote.
    #[must_use]
    pub fn folder(&self) -> &Path {
        match &self.target {
            Target::Remote(folder) => folder,
            _ => folder_of(self.written()),
        }
    }

    /// Whether this is a pipe or a device, which takes bytes in order and cannot seek.
    #[must_use]
    pub fn is_stream(&self) -> bool {
        matches!(self.target, Target::Stream)
    }

    /// Refuses pipes and devices, for outputs that are not written sequentially.
    ///
    /// # Errors
    /// [`OutputError::NotAFile`].
    pub fn require_file(&self) -> Result<(), OutputError> {
        if !self.is_stream() {
            return Ok(());
        }
        Err(OutputError::NotAFile {
            path: self.named.clone(),
            what: "a pipe or a device",
            expected: "this output is written in several places and needs a regular file",
        })
    }

    /// Refuses to replace a file that the run reads, even if it is named by another path, a
    /// symbolic link or a hard link.
    ///
    /// # Errors
    /// [`OutputError::IsInput`].
    pub fn refuse_inputs<P: AsRef<Path>>(
        &self,
        inputs: impl IntoIterator<Item = P>,
    ) -> Result<(), OutputError> {
        let described = |path: &Path| match std::fs::metadata(path) {
            Ok(metadata) => Ok(Some(metadata)),
            Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(None),
            // If it cannot be examined, it must not be replaced.
            Err(source) => Err(OutputError::Io { action: "look at", path: path.to_owned(), source }),
        };
        if matches!(self.target, Target::Remote(_)) {
            let inputs: Vec<P> = inputs.into_iter().collect();
            return match inputs.iter().find(|input| input.as_ref() == self.named) {
                Some(input) => {
                    Err(OutputError::IsInput { path: self.named.clone(), input: input.as_ref().to_owned() })
                }
                None => Ok(()),
            };
        }
        let Some(replaced) = described(self.written())? else { return Ok(()) };
        for input in inputs {
            let input = input.as_ref();
            let Some(read) = described(input)? else { continue };
            let same = is_same(&replaced, &read).unwrap_or_else(|| is_same_path(self.written(), input));
            if same && read.is_file() {
                return Err(OutputError::IsInput { path: self.named.clone(), input: input.to_owned() });
            }
        }
        Ok(())
    }

    /// The canonical path of the file that is written, or its address, by which outputs can be
    /// compared; `None` for a stream.
    ///
    /// # Errors
    /// The system's error, if the folder cannot be found.
    pub fn canonical(&self) -> io::Result<Option<PathBuf>> {
        if self.is_stream() {
            return Ok(None);
        }
        if matches!(self.target, Target::Remote(_)) {
            return Ok(Some(self.named.clone()));
        }
        Ok(Some(self.folder().canonicalize()?.join(self.file_name())))
    }

    /// The name of the file that is written, after links have been followed.
    #[doc(hidden)]
    pub fn file_name(&self) -> &OsStr {
        self.written().file_name().unwrap_or_default()
    }

    /// The path that is written to.
    fn written(&self) -> &Path {
        match &self.target {
            Target::File(path) => path,
            Target::Remote(_) | Target::Stream => &self.named,
        }
    }
}

/// The folder that contains a path.
pub(super) fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Follows the path itself while it is a symbolic link; links among its parent folders are left to
/// the system.
fn follow_links(path: &Path) -> io::Result<PathBuf> {
    let mut path = path.to_owned();
    for _ in 0..MOST_LINKS {
        match std::fs::symlink_metadata(&path) {
            Ok(metadata) if metadata.is_symlink() => {
                let target = std::fs::read_link(&path)?;
                path = folder_of(&path).join(target);
            }
            _ => return Ok(path),
        }
    }
    Err(io::Error::other("too many links, one to another"))
}

/// Accepts pipes and character devices; anything else cannot be written to.
fn check_stream(path: &Path, kind: FileType) -> Result<(), OutputError> {
    let refuse =
        |what| Err(OutputError::NotAFile { path: path.to_owned(), what, expected: "name a file to write" });
    if kind.is_dir() {
        return Err(OutputError::NotAFile {
            path: path.to_owned(),
            what: "a folder",
            expected: "name a file in it",
        });
    }
    #[cfg(unix)]
    {
        use std::os::unix::fs::FileTypeExt;
        if kind.is_block_device() {
            return refuse("a disk");
        }
        if kind.is_socket() {
            return refuse("a socket");
        }
        if kind.is_fifo() || kind.is_char_device() {
            return Ok(());
        }
    }
    refuse("no regular file")
}

/// Whether two paths name the same file, by their canonical paths.
fn is_same_path(a: &Path, b: &Path) -> bool {
    matches!((a.canonicalize(), b.canonicalize()), (Ok(a), Ok(b)) if a == b)
}

/// Whether two descriptions are of the same file; `None` if the system has no inode numbers.
pub(super) fn is_same(a: &Metadata, b: &Metadata) -> Option<bool> {
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt;
        Some((a.dev(), a.ino()) == (b.dev(), b.ino()))
    }
    #[cfg(not(unix))]
    {
        let _ = (a, b);
        None
    }
}
