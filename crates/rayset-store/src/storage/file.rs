//! Files on disk as a storage.

use std::fs::File;
use std::io;
use std::path::Path;

use super::transport::{Storage, ends_early};

/// A file, read through the page cache or bypassing it.
#[derive(Debug)]
pub struct FileStorage {
    file: File,
}

impl FileStorage {
    /// Opens a file. With `direct`, reads bypass the page cache if the system and the file system
    /// support it.
    ///
    /// # Errors
    /// The system's error.
    pub fn open(path: impl AsRef<Path>, direct: bool) -> io::Result<Self> {
        let path = path.as_ref();
        let mut options = File::options();
        options.read(true);
        #[cfg(target_os = "linux")]
        if direct {
            use std::os::unix::fs::OpenOptionsExt;
            let flag = rustix::fs::OFlags::DIRECT.bits() as i32;
            match options.clone().custom_flags(flag).open(path) {
                // Some file systems (tmpfs among them) refuse the flag.
                Err(e) if e.raw_os_error() == Some(rustix::io::Errno::INVAL.raw_os_error()) => {}
                result => return result.map(|file| Self { file }),
            }
        }
        let _ = direct;
        options.open(path).map(|file| Self { file })
    }
}

impl From<File> for FileStorage {
    fn from(file: File) -> Self {
        Self { file }
    }
}

impl Storage for FileStorage {
    fn length(&self) -> io::Result<u64> {
        Ok(self.file.metadata()?.len())
    }

    fn read_exact_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()> {
        let mut done = 0;
        while done < buffer.len() {
            match read_at(&self.file, &mut buffer[done..], offset + done as u64) {
                Ok(0) => return Err(ends_early(offset + done as u64, offset + buffer.len() as u64)),
                Ok(n) => done += n,
                Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                Err(e) => return Err(e),
            }
        }
        Ok(())
    }

    fn file(&self) -> Option<&File> {
        Some(&self.file)
    }
}

/// Reads some bytes of a file, wherever its cursor is.
#[cfg(unix)]
pub(super) fn read_at(file: &File, buffer: &mut [u8], offset: u64) -> io::Result<usize> {
    std::os::unix::fs::FileExt::read_at(file, buffer, offset)
}

/// Reads some bytes of a file; its cursor moves.
#[cfg(not(unix))]
pub fn read_at(file: &File, buffer: &mut [u8], offset: u64) -> io::Result<usize> {
    std::os::windows::fs::FileExt::seek_read(file, buffer, offset)
}
