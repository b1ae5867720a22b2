//! Temporary storage for records: a few large temporary files beside the output, removed on any
//! exit; or memory.
//!
//! On Linux a temporary file never has a name if the file system supports unnamed files; on other
//! Unix systems it is unlinked as soon as it is open. So it never outlives the process, even if
//! that is killed. On other systems it is removed when dropped, and a later build of the same
//! output removes what a killed one left.

use std::fs::File;
use std::io;
use std::path::Path;
#[cfg(not(unix))]
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use crate::output::{Access, Destination, Purpose, create_unique};

/// Temporarily stored records: in an unnamed file, or in memory if no file is to be created; or
/// stretches of files that others have written, one after another.
#[derive(Debug)]
pub enum Spill {
    /// In a file without a name.
    File(TemporaryFile),
    /// In memory.
    Memory(Mutex<Vec<u8>>),
    /// Where others have written them; nothing can be written.
    Joined(Joined),
}

/// Stretches of files, one after another, to be read.
#[derive(Debug)]
pub struct Joined {
    files: Vec<File>,
    stretches: Vec<JoinedStretch>,
    bytes: u64,
}

#[derive(Debug)]
struct JoinedStretch {
    /// Where it begins, among all bytes.
    start: u64,
    file: usize,
    /// Where it begins in its file.
    at: u64,
}

impl Joined {
    /// No stretches yet, of these files.
    #[must_use]
    pub fn new(files: Vec<File>) -> Self {
        Self { files, stretches: Vec::new(), bytes: 0 }
    }

    /// Appends `bytes` bytes of a file, from byte `at` on.
    pub fn push(&mut self, file: usize, at: u64, bytes: u64) {
        if bytes > 0 {
            self.stretches.push(JoinedStretch { start: self.bytes, file, at });
            self.bytes += bytes;
        }
    }

    fn read_at(&self, mut buffer: &mut [u8], mut offset: u64) -> io::Result<()> {
        while !buffer.is_empty() {
            let next = self.stretches.partition_point(|stretch| stretch.start <= offset);
            let end = self.stretches.get(next).map_or(self.bytes, |stretch| stretch.start);
            let stretch = self.stretches.get(next.wrapping_sub(1)).filter(|_| offset < end);
            let stretch = stretch.ok_or(io::ErrorKind::UnexpectedEof)?;
            let length = usize::try_from(end - offset).unwrap_or(usize::MAX).min(buffer.len());
            let (now, rest) = buffer.split_at_mut(length);
            read_file_at(&self.files[stretch.file], now, stretch.at + (offset - stretch.start))?;
            offset += length as u64;
            buffer = rest;
        }
        Ok(())
    }
}

/// A file without a name.
#[derive(Debug)]
pub struct TemporaryFile {
    file: File,
    #[cfg(not(unix))]
    path: PathBuf,
}

/// A file in a folder that never has a name; an error if the file system does not support such
/// files.
#[cfg(target_os = "linux")]
fn without_name(folder: &Path) -> io::Result<File> {
    use std::os::unix::fs::OpenOptionsExt;
    let flags = rustix::fs::OFlags::TMPFILE.bits() as i32;
    File::options().read(true).write(true).custom_flags(flags).open(folder)
}

impl Spill {
    /// A file in a folder, which is gone when this is dropped or the process ends, however it ends.
    ///
    /// # Errors
    /// The system's, if it cannot be created.
    pub fn create(output: &Destination, temp_dir: &Path) -> io::Result<Self> {
        #[cfg(target_os = "linux")]
        if let Ok(file) = without_name(temp_dir) {
            return Ok(Self::File(TemporaryFile { file }));
        }
        let (file, path) = create_unique(temp_dir, output.file_name(), Purpose::Temporary, Access::Private)?;
        #[cfg(unix)]
        if let Err(error) = std::fs::remove_file(&path) {
            // Try again: a file that keeps its name would be left behind.
            let _ = std::fs::remove_file(&path);
            return Err(error);
        }
        Ok(Self::File(TemporaryFile {
            file,
            #[cfg(not(unix))]
            path,
        }))
    }

    /// No file.
    #[must_use]
    pub fn in_memory() -> Self {
        Self::Memory(Mutex::default())
    }

    /// Fills a buffer with the bytes from `offset` on.
    ///
    /// # Errors
    /// The system's, or that there are not so many.
    pub fn read_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()> {
        match self {
            Self::File(file) => file.read_at(buffer, offset),
            Self::Joined(joined) => joined.read_at(buffer, offset),
            Self::Memory(bytes) => {
                let bytes = bytes.lock().unwrap_or_else(PoisonError::into_inner);
                let start = usize::try_from(offset).unwrap_or(usize::MAX);
                let found = bytes.get(start..start.saturating_add(buffer.len()));
                buffer.copy_from_slice(found.ok_or(io::ErrorKind::UnexpectedEof)?);
                Ok(())
            }
        }
    }

    /// Writes bytes from `offset` on.
    ///
    /// # Errors
    /// The system's.
    pub fn write_at(&self, buffer: &[u8], offset: u64) -> io::Result<()> {
        match self {
            Self::File(file) => file.write_at(buffer, offset),
            Self::Joined(_) => Err(io::ErrorKind::Unsupported.into()),
            Self::Memory(bytes) => {
                let mut bytes = bytes.lock().unwrap_or_else(PoisonError::into_inner);
                let start = usize::try_from(offset).map_err(|_| io::ErrorKind::OutOfMemory)?;
                let end = start.checked_add(buffer.len()).ok_or(io::ErrorKind::OutOfMemory)?;
                if bytes.len() < end {
                    bytes.resize(end, 0);
                }
                bytes[start..end].copy_from_slice(buffer);
                Ok(())
            }
        }
    }
}

impl TemporaryFile {
    fn read_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()> {
        read_file_at(&self.file, buffer, offset)
    }

    fn write_at(&self, buffer: &[u8], offset: u64) -> io::Result<()> {
        #[cfg(unix)]
        return std::os::unix::fs::FileExt::write_all_at(&self.file, buffer, offset);
        #[cfg(not(unix))]
        {
            let mut done = 0;
            while done < buffer.len() {
                done += std::os::windows::fs::FileExt::seek_write(
                    &self.file,
                    &buffer[done..],
                    offset + done as u64,
                )?;
            }
            Ok(())
        }
    }
}

fn read_file_at(file: &File, buffer: &mut [u8], offset: u64) -> io::Result<()> {
    #[cfg(unix)]
    return std::os::unix::fs::FileExt::read_exact_at(file, buffer, offset);
    #[cfg(not(unix))]
    {
        let mut done = 0;
        while done < buffer.len() {
            let n =
                std::os::windows::fs::FileExt::seek_read(file, &mut buffer[done..], offset + done as u64)?;
            if n == 0 {
                return Err(io::ErrorKind::UnexpectedEof.into());
            }
            done += n;
        }
        Ok(())
    }
}

#[cfg(not(unix))]
impl Drop for TemporaryFile {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.path);
    }
}

/// Appends records to a spill through one buffer.
#[derive(Debug)]
pub struct SpillWriter {
    spill: Spill,
    buffer: Vec<u8>,
    capacity: usize,
    written: u64,
}

impl SpillWriter {
    /// Writes from the first byte on, `capacity` bytes at a time.
    #[must_use]
    pub fn new(spill: Spill, capacity: usize) -> Self {
        Self { spill, buffer: Vec::with_capacity(capacity), capacity, written: 0 }
    }

    /// Appends bytes.
    ///
    /// # Errors
    /// The system's.
    pub fn push(&mut self, bytes: &[u8]) -> io::Result<()> {
        if self.buffer.len() + bytes.len() > self.capacity {
            self.flush()?;
        }
        self.buffer.extend_from_slice(bytes);
        Ok(())
    }

    /// The number of bytes pushed so far, to which [`rewind`](Self::rewind) goes back.
    pub fn mark(&self) -> u64 {
        self.written + self.buffer.len() as u64
    }

    /// Forgets what was pushed since the mark was taken.
    pub fn rewind(&mut self, mark: u64) {
        let held = usize::try_from(mark.saturating_sub(self.written)).unwrap_or(usize::MAX);
        self.buffer.truncate(held);
        // What has gone to the file behind the mark is overwritten, or lies beyond the last record.
        self.written = self.written.min(mark);
    }

    fn flush(&mut self) -> io::Result<()> {
        self.spill.write_at(&self.buffer, self.written)?;
        self.written += self.buffer.len() as u64;
        self.buffer.clear();
        Ok(())
    }

    /// Everything that was pushed.
    ///
    /// # Errors
    /// The system's.
    pub fn finish(mut self) -> io::Result<Spill> {
        self.flush()?;
        Ok(self.spill)
    }
}
