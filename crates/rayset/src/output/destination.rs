//! Where an output goes, looked at before any work begins.

use std::ffi::OsStr;
use std::fs::{FileType, Metadata};
use std::io;
use std::path::{Path, PathBuf};

use super::OutputError;

/// Links that are followed, one to another, before they are taken for a circle: as many as Linux follows.
const MOST_LINKS: usize = 40;

/// Where an output goes.
#[derive(Clone, Debug)]
pub struct Destination {
    named: PathBuf,
    pub(super) target: Target,
}

/// What a path stands for.
#[derive(Clone, Debug)]
pub(super) enum Target {
    /// A file that is there and will be replaced, or is not there yet; no link.
    File(PathBuf),
    /// A pipe or a device that takes bytes one after another. It is written to, never replaced.
    Stream,
}

impl Destination {
    /// Looks at a path. Nothing is created or changed.
    ///
    /// # Errors
    /// [`OutputError`] where the path names a folder, a disk or a socket, its folder is missing, or the system refuses to
    /// say what it is.
    pub fn new(path: &Path) -> Result<Self, OutputError> {
        let io = |source| OutputError::Io { action: "write", path: path.to_owned(), source };
        let to = |target| Ok(Self { named: path.to_owned(), target });
        let found = match std::fs::metadata(path) {
            Ok(found) => Some(found),
            // Also a link to what is not there.
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
            // What a process has for its standard output may have no name any more. The link to it, in /proc, then leads to
            // a file by itself and to nothing by its text.
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

    /// The folder in which the file is written, links followed.
    #[must_use]
    pub fn folder(&self) -> &Path {
        folder_of(self.written())
    }

    /// Whether this is a pipe or a device: it takes bytes one after another and cannot be gone back in.
    #[must_use]
    pub fn is_stream(&self) -> bool {
        matches!(self.target, Target::Stream)
    }

    /// Refuses pipes and devices, for outputs that are written in several places.
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

    /// Refuses to replace what a run reads, however it is named: by another path, a link or a hard link.
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
            // Not knowing is no leave to replace it.
            Err(source) => Err(OutputError::Io { action: "look at", path: path.to_owned(), source }),
        };
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

    /// The one path of the file that is written, by which two outputs can be told from each other; `None` for a stream.
    ///
    /// # Errors
    /// The system's, where the folder cannot be found.
    pub fn canonical(&self) -> io::Result<Option<PathBuf>> {
        if self.is_stream() {
            return Ok(None);
        }
        Ok(Some(self.folder().canonicalize()?.join(self.file_name())))
    }

    /// The name of the file that is written, links followed.
    pub(crate) fn file_name(&self) -> &OsStr {
        self.written().file_name().unwrap_or_default()
    }

    /// What is written to.
    fn written(&self) -> &Path {
        match &self.target {
            Target::File(path) => path,
            Target::Stream => &self.named,
        }
    }
}

/// The folder that a path lies in.
pub(super) fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Follows the links that a path is; those on the way to its folder are the system's to follow.
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

/// Pipes and devices that take characters may be written to.
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

/// Whether two paths are of one file, by their names.
fn is_same_path(a: &Path, b: &Path) -> bool {
    matches!((a.canonicalize(), b.canonicalize()), (Ok(a), Ok(b)) if a == b)
}

/// Whether two descriptions are of one file; `None` if the system gives files no numbers.
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
