//! Temporary files: few, large, beside the output, and gone after any exit.
//!
//! On Unix a temporary file loses its name as soon as it is open, so that nothing of it survives the process, not
//! even one that is killed. Elsewhere it is removed when dropped, and a later build of the same output removes what
//! a killed one left.

use std::fs::{File, OpenOptions};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

static NEXT: AtomicU32 = AtomicU32::new(0);

/// An unnamed file for records.
#[derive(Debug)]
pub(crate) struct Spill {
    file: File,
    #[cfg(not(unix))]
    path: PathBuf,
}

fn prefix(output: &Path) -> String {
    let name = output.file_name().unwrap_or_default().to_string_lossy();
    format!(".{name}.rayset-tmp-")
}

/// The name under which the output grows until it is whole.
pub(crate) fn partial_path(output: &Path) -> PathBuf {
    let name = output.file_name().unwrap_or_default().to_string_lossy();
    output.with_file_name(format!(".{name}.rayset-partial"))
}

/// Removes what an earlier, killed build of the same output may have left.
pub(crate) fn remove_leftovers(output: &Path, temp_dir: &Path) -> io::Result<()> {
    let prefix = prefix(output);
    for entry in std::fs::read_dir(temp_dir)? {
        let entry = entry?;
        if entry.file_name().to_string_lossy().starts_with(&prefix) {
            std::fs::remove_file(entry.path())?;
        }
    }
    match std::fs::remove_file(partial_path(output)) {
        Err(e) if e.kind() != io::ErrorKind::NotFound => Err(e),
        _ => Ok(()),
    }
}

/// Gives a file that is whole its name, for good.
pub(crate) fn publish(partial: &Path, output: &Path) -> io::Result<()> {
    std::fs::rename(partial, output)?;
    #[cfg(unix)]
    if let Some(parent) = output.parent() {
        let parent = if parent.as_os_str().is_empty() { Path::new(".") } else { parent };
        File::open(parent)?.sync_all()?;
    }
    Ok(())
}

impl Spill {
    pub(crate) fn create(output: &Path, temp_dir: &Path) -> io::Result<Self> {
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        let path = temp_dir.join(format!("{}{}-{number}", prefix(output), std::process::id()));
        let file = OpenOptions::new().read(true).write(true).create_new(true).open(&path)?;
        #[cfg(unix)]
        std::fs::remove_file(&path)?;
        Ok(Self {
            file,
            #[cfg(not(unix))]
            path,
        })
    }

    pub(crate) fn read_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()> {
        #[cfg(unix)]
        return std::os::unix::fs::FileExt::read_exact_at(&self.file, buffer, offset);
        #[cfg(not(unix))]
        {
            let mut done = 0;
            while done < buffer.len() {
                let n = std::os::windows::fs::FileExt::seek_read(
                    &self.file,
                    &mut buffer[done..],
                    offset + done as u64,
                )?;
                if n == 0 {
                    return Err(io::ErrorKind::UnexpectedEof.into());
                }
                done += n;
            }
            Ok(())
        }
    }

    pub(crate) fn write_at(&self, buffer: &[u8], offset: u64) -> io::Result<()> {
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

#[cfg(not(unix))]
impl Drop for Spill {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.path);
    }
}

/// Appends records to a spill through one buffer.
#[derive(Debug)]
pub(crate) struct SpillWriter {
    spill: Spill,
    buffer: Vec<u8>,
    capacity: usize,
    written: u64,
}

impl SpillWriter {
    pub(crate) fn new(spill: Spill, capacity: usize) -> Self {
        Self { spill, buffer: Vec::with_capacity(capacity), capacity, written: 0 }
    }

    pub(crate) fn push(&mut self, bytes: &[u8]) -> io::Result<()> {
        if self.buffer.len() + bytes.len() > self.capacity {
            self.flush()?;
        }
        self.buffer.extend_from_slice(bytes);
        Ok(())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.spill.write_at(&self.buffer, self.written)?;
        self.written += self.buffer.len() as u64;
        self.buffer.clear();
        Ok(())
    }

    pub(crate) fn finish(mut self) -> io::Result<Spill> {
        self.flush()?;
        Ok(self.spill)
    }
}
