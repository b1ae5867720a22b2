//! Sources of the bytes of cloud and grid files: a file on disk, bytes in memory, or a user's implementation.

use std::fs::File;
use std::io;
use std::path::Path;
use std::sync::Arc;

/// Bytes that can be read at a position, by several threads at once: a file, bytes in memory, an object store.
pub trait Storage: Send + Sync {
    /// The number of bytes.
    ///
    /// # Errors
    /// The system's error.
    fn length(&self) -> io::Result<u64>;

    /// Fills `buffer` with the bytes that start at `offset`.
    ///
    /// # Errors
    /// The system's error, or `UnexpectedEof`.
    fn read_exact_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()>;

    /// The underlying file, if there is one that the kernel may read from directly.
    fn file(&self) -> Option<&File> {
        None
    }

    /// All of its bytes, if they are already in memory: pages are then used in place, without a copy, and do not count
    /// towards any budget.
    fn memory(&self) -> Option<Arc<dyn AsRef<[u8]> + Send + Sync>> {
        None
    }
}

/// How reads of files are carried out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum BackendKind {
    /// io_uring if the system supports it, otherwise the pool.
    #[default]
    Auto,
    /// io_uring or an error.
    Uring,
    /// A pool of threads that use positioned reads.
    Pool,
}

/// Bytes in memory: a vector, a shared slice, a memory-mapped file.
#[derive(Clone)]
pub struct MemoryStorage(Arc<dyn AsRef<[u8]> + Send + Sync>);

impl MemoryStorage {
    /// Wraps bytes, which must not change during the lifetime of this storage.
    #[must_use]
    pub fn new(bytes: Arc<dyn AsRef<[u8]> + Send + Sync>) -> Self {
        Self(bytes)
    }
}

impl std::fmt::Debug for MemoryStorage {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "MemoryStorage({} bytes)", (*self.0).as_ref().len())
    }
}

impl Storage for MemoryStorage {
    fn length(&self) -> io::Result<u64> {
        Ok((*self.0).as_ref().len() as u64)
    }

    fn read_exact_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()> {
        let bytes = (*self.0).as_ref();
        let end = offset.saturating_add(buffer.len() as u64);
        let start = usize::try_from(offset).ok();
        let found = start.and_then(|start| bytes.get(start..start.checked_add(buffer.len())?));
        let found = found.ok_or_else(|| ends_early(bytes.len() as u64, end))?;
        buffer.copy_from_slice(found);
        Ok(())
    }

    fn memory(&self) -> Option<Arc<dyn AsRef<[u8]> + Send + Sync>> {
        Some(self.0.clone())
    }
}

/// A file, read through the page cache or bypassing it.
#[derive(Debug)]
pub struct FileStorage {
    file: File,
}

impl FileStorage {
    /// Opens a file. With `direct`, reads bypass the page cache if the system and the file system support it.
    ///
    /// # Errors
    /// The system's error.
    pub fn open(path: &Path, direct: bool) -> io::Result<Self> {
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

#[cfg(unix)]
fn read_at(file: &File, buffer: &mut [u8], offset: u64) -> io::Result<usize> {
    std::os::unix::fs::FileExt::read_at(file, buffer, offset)
}

#[cfg(not(unix))]
fn read_at(file: &File, buffer: &mut [u8], offset: u64) -> io::Result<usize> {
    std::os::windows::fs::FileExt::seek_read(file, buffer, offset)
}

/// Fills `buffer` from a file if the page cache has all of it, without waiting for the disk; returns whether it did. `false` also for
/// files that bypass the page cache.
#[cfg(target_os = "linux")]
pub(crate) fn read_if_cached(file: &File, buffer: &mut [u8], offset: u64) -> bool {
    use rustix::io::{ReadWriteFlags, preadv2};
    // Without the page cache, the call would wait for the disk all the same.
    let bypasses = |flags: rustix::fs::OFlags| flags.contains(rustix::fs::OFlags::DIRECT);
    if rustix::fs::fcntl_getfl(file).map_or(true, bypasses) {
        return false;
    }
    let wanted = buffer.len();
    let read = preadv2(file, &mut [io::IoSliceMut::new(buffer)], offset, ReadWriteFlags::NOWAIT);
    read == Ok(wanted)
}

#[cfg(not(target_os = "linux"))]
pub(crate) fn read_if_cached(_file: &File, _buffer: &mut [u8], _offset: u64) -> bool {
    false
}

/// The error for a file that is shorter than it was or should be.
fn ends_early(end: u64, wanted: u64) -> io::Error {
    let what = format!("the file ends at byte {end}, before byte {wanted}, up to which it is needed");
    io::Error::new(io::ErrorKind::UnexpectedEof, what)
}
