//! Output files, written beside their destinations.

use std::fs::{File, Metadata};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use super::destination::Target;
use super::partial::{Access, Purpose, create_unique, remove_leftovers};
use super::{Destination, OutputError};
use crate::storage::{address, address_of};

/// An output that is being written. [`publish`](Self::publish) gives it its name; if it is dropped
/// before, it is removed.
///
/// A pipe or a device receives bytes as they are written.
#[derive(Debug)]
pub struct OutputFile {
    destination: Destination,
    growing: Arc<Growing>,
    /// `None` for a stream, and once the file has its name.
    partial: Option<PathBuf>,
    /// The file that will be replaced, whose mode and owner are kept.
    replaced: Option<Box<Metadata>>,
}

/// The state that all writers of a file share.
#[derive(Debug)]
struct Growing {
    file: File,
    /// The first failed write. Encoders and buffers write on when they are dropped and do not
    /// report failures, so the failure is kept here: a file to which a write has failed never gets
    /// its name.
    failure: Mutex<Option<io::Error>>,
}

impl OutputFile {
    /// Creates a partial file beside the destination, or opens the pipe or device. Removes files of
    /// the same output that killed processes have left behind.
    ///
    /// # Errors
    /// [`OutputError::Io`].
    pub fn create(destination: &Destination) -> Result<Self, OutputError> {
        let io = |source| OutputError::Io { action: "write", path: destination.path().to_owned(), source };
        let mut replaced = None;
        let access = match &destination.target {
            Target::File(path) => {
                replaced = std::fs::metadata(path).ok().map(Box::new);
                // Until it has the mode of the other, which may be as strict.
                if replaced.is_some() { Access::Private } else { Access::Usual }
            }
            Target::Remote(_) => Access::Private,
            Target::Stream => Access::Usual,
        };
        let (file, partial) = if destination.is_stream() {
            (File::options().write(true).open(destination.path()).map_err(io)?, None)
        } else {
            let folder = destination.folder();
            remove_leftovers(folder, destination);
            let created = create_unique(folder, destination.file_name(), Purpose::Partial, access);
            let (file, partial) = created.map_err(io)?;
            (file, Some(partial))
        };
        let growing = Arc::new(Growing { file, failure: Mutex::default() });
        Ok(Self { destination: destination.clone(), growing, partial, replaced })
    }

    /// The destination.
    #[must_use]
    pub fn destination(&self) -> &Destination {
        &self.destination
    }

    /// A writer that starts at the beginning of the file. Each writer of a file has its own
    /// position.
    #[must_use]
    pub fn writer(&self) -> OutputWriter {
        OutputWriter { growing: self.growing.clone(), is_stream: self.destination.is_stream(), at: 0 }
    }

    /// Makes the file durable and gives it its name.
    ///
    /// # Errors
    /// [`OutputError::Io`]; any existing file of that name is then unchanged, unless the only
    /// failure was to make the folder durable.
    pub fn publish(mut self) -> Result<(), OutputError> {
        self.rename(true).map_err(|source| OutputError::Io {
            action: "write",
            path: self.destination.path().to_owned(),
            source,
        })
    }

    /// Gives the file its name without making it durable: for files whose readers find out if a
    /// crash of the machine has taken some of them.
    #[doc(hidden)]
    pub fn publish_volatile(mut self) -> Result<(), OutputError> {
        self.rename(false).map_err(|source| OutputError::Io {
            action: "write",
            path: self.destination.path().to_owned(),
            source,
        })
    }

    fn rename(&mut self, durable: bool) -> io::Result<()> {
        if let Some(error) = self.growing.failure.lock().unwrap_or_else(PoisonError::into_inner).take() {
            return Err(error);
        }
        let Some(partial) = &self.partial else { return Ok(()) };
        let path = match &self.destination.target {
            Target::File(path) => path,
            // The partial file is removed with this.
            Target::Remote(_) => return put(partial, self.destination.path()),
            Target::Stream => return Ok(()),
        };
        if let Some(replaced) = &self.replaced {
            keep_access(&self.growing.file, replaced)?;
        }
        if durable {
            self.growing.file.sync_all()?;
        }
        std::fs::rename(partial, path)?;
        self.partial = None;
        if durable { sync_folder(self.destination.folder()) } else { Ok(()) }
    }
}

/// Gives a file the mode of the one that it replaces, and its owner and group where the system
/// allows that.
fn keep_access(file: &File, replaced: &Metadata) -> io::Result<()> {
    #[cfg(unix)]
    {
        use std::os::unix::fs::{MetadataExt, PermissionsExt, fchown};
        let own = file.metadata()?;
        if (own.uid(), own.gid()) != (replaced.uid(), replaced.gid())
            && fchown(file, Some(replaced.uid()), Some(replaced.gid())).is_err()
        {
            // A member of the group may give the file to it, if not to another owner.
            let _ = fchown(file, None, Some(replaced.gid()));
        }
        // The group's rights are those of that group alone.
        let same_group = file.metadata()?.gid() == replaced.gid();
        let mode = replaced.mode() & if same_group { 0o777 } else { 0o707 };
        file.set_permissions(std::fs::Permissions::from_mode(mode))
    }
    #[cfg(not(unix))]
    {
        let _ = (file, replaced);
        Ok(())
    }
}

/// Makes a remote object of a finished file.
fn put(file: &Path, to: &Path) -> io::Result<()> {
    let address = address_of(to).ok_or(io::ErrorKind::InvalidInput)?;
    address::opener(address)?.put(file, address)
}

impl Drop for OutputFile {
    fn drop(&mut self) {
        if let Some(partial) = self.partial.take()
            && std::fs::remove_file(&partial).is_err()
        {
            // Try again: the first attempt may have been interrupted.
            let _ = std::fs::remove_file(&partial);
        }
    }
}

/// Makes the names in a folder durable, if the file system supports it.
fn sync_folder(folder: &Path) -> io::Result<()> {
    #[cfg(unix)]
    match File::open(folder)?.sync_all() {
        Err(e) if matches!(e.kind(), io::ErrorKind::InvalidInput | io::ErrorKind::Unsupported) => {}
        result => return result,
    }
    let _ = folder;
    Ok(())
}

/// A position in an [`OutputFile`] at which bytes are written, and read back unless it is a stream,
/// without buffering.
#[derive(Debug)]
pub struct OutputWriter {
    growing: Arc<Growing>,
    is_stream: bool,
    at: u64,
}

impl OutputWriter {
    /// Waits until all that was written is on disk.
    ///
    /// # Errors
    /// The system's reason.
    pub fn sync(&self) -> io::Result<()> {
        self.growing.file.sync_all()
    }
}

impl Write for OutputWriter {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let file = &self.growing.file;
        let written = if self.is_stream { (&*file).write(bytes) } else { write_at(file, bytes, self.at) };
        match &written {
            Ok(count) => self.at += *count as u64,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => {
                let mut failure = self.growing.failure.lock().unwrap_or_else(PoisonError::into_inner);
                failure.get_or_insert_with(|| match error.raw_os_error() {
                    Some(code) => io::Error::from_raw_os_error(code),
                    None => error.kind().into(),
                });
            }
        }
        written
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Read for OutputWriter {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let read = read_at(&self.growing.file, bytes, self.at)?;
        self.at += read as u64;
        Ok(read)
    }
}

impl Seek for OutputWriter {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let target = match to {
            SeekFrom::Start(at) => Some(at),
            SeekFrom::Current(by) => self.at.checked_add_signed(by),
            SeekFrom::End(by) => self.growing.file.metadata()?.len().checked_add_signed(by),
        };
        let target = target.ok_or(io::ErrorKind::InvalidInput)?;
        if self.is_stream && target != self.at {
            let what = "a pipe or a device cannot be written in several places";
            return Err(io::Error::new(io::ErrorKind::NotSeekable, what));
        }
        self.at = target;
        Ok(target)
    }
}

#[cfg(unix)]
fn write_at(file: &File, bytes: &[u8], at: u64) -> io::Result<usize> {
    std::os::unix::fs::FileExt::write_at(file, bytes, at)
}

#[cfg(unix)]
fn read_at(file: &File, bytes: &mut [u8], at: u64) -> io::Result<usize> {
    std::os::unix::fs::FileExt::read_at(file, bytes, at)
}

#[cfg(not(unix))]
fn read_at(file: &File, bytes: &mut [u8], at: u64) -> io::Result<usize> {
    std::os::windows::fs::FileExt::seek_read(file, bytes, at)
}

#[cfg(not(unix))]
fn write_at(file: &File, bytes: &[u8], at: u64) -> io::Result<usize> {
    std::os::windows::fs::FileExt::seek_write(file, bytes, at)
}
