//! Uniquely named, locked files, and the removal of those that a killed process has left behind.
//!
//! A file is created and locked, and its name is then checked again: a process that removes
//! leftovers may have taken the lock first and removed the name. It holds the lock while it removes
//! the file. So once a writer has found its file under its name, the file keeps that name until the
//! writer releases the lock.
//!
//! Some network file systems have no locks. There, files are written without locks and are never
//! removed as leftovers.

use std::ffi::OsStr;
use std::fs::{File, OpenOptions, TryLockError};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use super::destination::{Destination, is_same};
use crate::storage::{address, address_of};

/// What a file beside an output is for.
#[derive(Clone, Copy)]
pub enum Purpose {
    /// It becomes the output.
    Partial,
    /// It holds what does not fit in memory.
    Temporary,
}

impl Purpose {
    const ALL: [Self; 2] = [Self::Partial, Self::Temporary];

    /// The prefix of the names of such files.
    fn prefix(self, output: &OsStr) -> String {
        let purpose = match self {
            Self::Partial => "partial",
            Self::Temporary => "tmp",
        };
        format!(".{}.rayset-{purpose}-", short(output))
    }
}

/// The name of an output, short enough to be part of another: file systems allow 255 bytes.
fn short(name: &OsStr) -> String {
    const MOST_BYTES: usize = 180;
    let text = name.to_string_lossy();
    if text.len() <= MOST_BYTES {
        return text.into_owned();
    }
    let end = (0..=MOST_BYTES).rev().find(|&at| text.is_char_boundary(at)).unwrap_or(0);
    format!("{}~{:08x}", &text[..end], crc32c::crc32c(name.as_encoded_bytes()))
}

/// The process ID in a name that consists of `prefix` and `PROCESS-NUMBER`; `None` for other names.
fn process_of(name: &OsStr, prefix: &str) -> Option<u32> {
    let (process, number) = name.to_str()?.strip_prefix(prefix)?.split_once('-')?;
    let digits = |text: &str| !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit());
    if digits(number) { process.parse().ok() } else { None }
}

/// Who may read a file while it is written.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Access {
    /// Whoever the process's mask of modes admits.
    Usual,
    /// Its owner alone.
    Private,
}

/// Creates a file in `folder` under a unique name derived from `output`, and locks it.
pub fn create_unique(
    folder: &Path,
    output: &OsStr,
    purpose: Purpose,
    access: Access,
) -> io::Result<(File, PathBuf)> {
    let prefix = purpose.prefix(output);
    let process = std::process::id();
    let mut number = 0_u32;
    let mut options = OpenOptions::new();
    options.read(true).write(true).create_new(true);
    #[cfg(unix)]
    if access == Access::Private {
        std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    }
    #[cfg(not(unix))]
    let _ = access;
    loop {
        // Held until the file is locked: whoever ends this process finds it, or it is not created.
        let ending = wait_if_ending();
        let path = folder.join(format!("{prefix}{process}-{number}"));
        number = number.wrapping_add(1);
        let file = match options.open(&path) {
            Err(e) if e.kind() == io::ErrorKind::AlreadyExists => continue,
            result => result?,
        };
        match hold(&file, &path) {
            Ok(true) => return Ok((file, path)),
            // Another process removed it as a leftover before it was locked.
            Ok(false) => drop(ending),
            Err(error) => {
                let _ = std::fs::remove_file(&path);
                return Err(error);
            }
        }
    }
}

/// Whether this process is being ended: its files are removed, and no further ones are created.
static IS_ENDING: Mutex<bool> = Mutex::new(false);

fn is_ending() -> MutexGuard<'static, bool> {
    IS_ENDING.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Never returns once the process is being ended, which is not begun while the guard is held.
fn wait_if_ending() -> MutexGuard<'static, bool> {
    loop {
        let ending = is_ending();
        if !*ending {
            return ending;
        }
        drop(ending);
        std::thread::park();
    }
}

/// Locks a file that has just been created. Returns false if it has lost its name since, or is
/// about to.
fn hold(file: &File, path: &Path) -> io::Result<bool> {
    match lock(file) {
        Ok(()) => has_name(file, path),
        Err(TryLockError::WouldBlock) => Ok(false),
        Err(TryLockError::Error(e)) if has_no_locks(&e) => Ok(true),
        Err(TryLockError::Error(e)) => Err(e),
    }
}

fn lock(file: &File) -> Result<(), TryLockError> {
    loop {
        match file.try_lock() {
            Err(TryLockError::Error(e)) if e.kind() == io::ErrorKind::Interrupted => {}
            result => return result,
        }
    }
}

/// Whether an error means that the file system does not support locks.
fn has_no_locks(error: &io::Error) -> bool {
    #[cfg(unix)]
    let no_locks = error.raw_os_error() == Some(rustix::io::Errno::NOLCK.raw_os_error());
    #[cfg(not(unix))]
    let no_locks = false;
    no_locks || error.kind() == io::ErrorKind::Unsupported
}

/// Whether a path still names this open file.
fn has_name(file: &File, path: &Path) -> io::Result<bool> {
    match std::fs::symlink_metadata(path) {
        Ok(named) => Ok(is_same(&file.metadata()?, &named).unwrap_or(true)),
        Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(false),
        Err(e) => Err(e),
    }
}

/// Removes from `folder` what killed processes have left of an output. Failures are ignored,
/// because leftovers do not prevent writing.
pub fn remove_leftovers(folder: &Path, output: &Destination) {
    for_each_partial(folder, output.file_name(), |path, _| {
        // Opening a pipe would block.
        if !std::fs::symlink_metadata(path)?.is_file() {
            return Ok(());
        }
        let file = OpenOptions::new().read(true).write(true).open(path)?;
        if lock(&file).is_ok() && has_name(&file, path)? {
            std::fs::remove_file(path)?;
        }
        Ok(())
    });
}

/// Removes from `folder` what killed processes have left of the outputs whose names are `known`.
pub fn remove_partials(folder: &Path, known: impl Fn(&str) -> bool) {
    let Ok(entries) = std::fs::read_dir(folder) else { return };
    for entry in entries.flatten() {
        let name = entry.file_name();
        let output = name.to_str().and_then(|name| name.strip_prefix('.')?.split_once(".rayset-"));
        if let Some((output, _)) = output.filter(|(output, _)| known(output))
            && let Ok(destination) = Destination::new(folder.join(output))
        {
            remove_leftovers(folder, &destination);
        }
    }
}

impl Destination {
    /// Removes the files that this process is currently writing for this destination, although they
    /// are locked: for a process that is about to be ended by a signal. From then on the process
    /// creates no further ones, for any destination: a thread that would waits for the end of the
    /// process. `temp_dir` is the folder of the temporary files, if they are not beside the output.
    pub fn remove_own_partials(&self, temp_dir: Option<&Path>) {
        *is_ending() = true;
        if self.is_stream() {
            return;
        }
        if let Some(address) = address_of(self.path())
            && let Ok(opener) = address::opener(address)
        {
            opener.abandon(address);
        }
        for folder in std::iter::once(self.folder()).chain(temp_dir) {
            for_each_partial(folder, self.file_name(), |path, process| {
                // A process in another container may have the same ID: only files that are open
                // here are removed.
                if process == std::process::id() && is_open_here(path).unwrap_or(true) {
                    std::fs::remove_file(path)?;
                }
                Ok(())
            });
        }
    }
}

/// Whether this process has a file open; `None` if the system cannot tell.
fn is_open_here(path: &Path) -> Option<bool> {
    let named = std::fs::symlink_metadata(path).ok()?;
    let mut files = std::fs::read_dir("/proc/self/fd").ok()?.filter_map(|entry| {
        let open = std::fs::metadata(entry.ok()?.path()).ok()?;
        is_same(&open, &named)
    });
    Some(files.any(|same| same))
}

/// Calls `visit` for every partial or temporary file of an output in `folder`, with the ID of the
/// process that wrote it.
fn for_each_partial(folder: &Path, output: &OsStr, visit: impl Fn(&Path, u32) -> io::Result<()>) {
    let Ok(entries) = std::fs::read_dir(folder) else { return };
    let prefixes = Purpose::ALL.map(|purpose| purpose.prefix(output));
    for entry in entries.flatten() {
        let name = entry.file_name();
        if let Some(process) = prefixes.iter().find_map(|prefix| process_of(&name, prefix)) {
            // Another process may have removed it, or it may not be accessible.
            let _ = visit(&entry.path(), process);
        }
    }
}
