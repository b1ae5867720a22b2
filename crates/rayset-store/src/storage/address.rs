//! Addresses of remote objects, such as `s3://bucket/key` and `https://host/path`,
//! wherever a path may stand.
//!
//! The library knows no protocol. A program that can reach such objects says so once, by
//! [`open_addresses_with`]; the crate `rayset-remote` does so for object stores and web servers.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

use super::file::FileStorage;
use super::shown::shown;
use super::transport::Storage;

/// What opens addresses and writes to them.
pub trait Addresses: Send + Sync {
    /// Opens the object at an address. It is that object from then on: if another takes its place,
    /// reads are errors.
    ///
    /// # Errors
    /// What is wrong with the address, or why the object cannot be read, and what to do.
    fn open(&self, address: &str) -> io::Result<Arc<dyn Storage>>;

    /// Refuses an address that cannot be written to, before any work is done, and removes what a
    /// run that was killed has left behind there.
    ///
    /// # Errors
    /// What is wrong with the address.
    fn prepare(&self, address: &str) -> io::Result<()>;

    /// Makes an object of a finished file: whole, or not at all.
    ///
    /// # Errors
    /// Why it could not be written. Nothing is left behind then.
    fn put(&self, file: &Path, address: &str) -> io::Result<()>;

    /// Gives up what this process is putting at an address: the process is about to be ended.
    fn abandon(&self, address: &str);

    /// From now on, [`open`](Self::open) looks at each object again, however lately it was looked
    /// at. For whoever trusts a look for a while; others need do nothing.
    fn look_again(&self) {}
}

static ADDRESSES: OnceLock<Arc<dyn Addresses>> = OnceLock::new();

/// Says who opens addresses in this process. Only the first call counts; returns whether this was
/// the first.
pub fn open_addresses_with(addresses: Arc<dyn Addresses>) -> bool {
    ADDRESSES.set(addresses).is_ok()
}

/// The address that a path is; `None` if it is the path of a file.
#[must_use]
pub fn address_of(path: &Path) -> Option<&str> {
    let text = path.to_str()?;
    let (scheme, rest) = text.split_once("://")?;
    let mut letters = scheme.bytes();
    let is_scheme = letters.next().is_some_and(|first| first.is_ascii_alphabetic())
        && letters.all(|letter| letter.is_ascii_alphanumeric() || b"+-.".contains(&letter));
    (is_scheme && !rest.is_empty()).then_some(text)
}

/// A path that stands in a file of a folder: addresses and absolute paths are what they are, others
/// are sought in the folder, which may itself be an address.
#[must_use]
pub fn beside(folder: &Path, path: &Path) -> PathBuf {
    if address_of(path).is_some() {
        return path.to_owned();
    }
    match address_of(folder) {
        Some(address) => PathBuf::from(joined(address, &path.to_string_lossy())),
        None => folder.join(path),
    }
}

/// The address of `relative`, with dots resolved, below a folder's address.
fn joined(folder: &str, relative: &str) -> String {
    let (scheme, rest) = folder.split_once("://").unwrap_or(("", folder));
    let mut parts: Vec<&str> = rest.split('/').filter(|part| !part.is_empty()).collect();
    if relative.starts_with('/') {
        parts.truncate(1);
    }
    for part in relative.split('/') {
        match part {
            "" | "." => {}
            // The first part is the host or the bucket.
            ".." => parts.truncate(parts.len().saturating_sub(1).max(1)),
            name => parts.push(name),
        }
    }
    format!("{scheme}://{}", parts.join("/"))
}

/// A path, or an address without its secrets: for messages, and for whatever else people see.
pub fn without_secrets(path: &Path) -> PathBuf {
    address_of(path).map_or_else(|| path.to_owned(), |_| PathBuf::from(shown(path)))
}

/// Opens a file or an address. With `direct`, reads of a file bypass the page cache if the system
/// supports it.
///
/// # Errors
/// The system's error, or that of whoever opens addresses.
pub fn open(path: &Path, direct: bool) -> io::Result<Arc<dyn Storage>> {
    match address_of(path) {
        Some(address) => opener(address)?.open(address),
        None => Ok(Arc::new(FileStorage::open(path, direct)?)),
    }
}

/// Begins something new, which sees the objects that are at their addresses now: each is looked at
/// when it is opened next, and not taken to be what it was a moment ago. What is open stays what it
/// is.
pub fn look_again() {
    if let Some(addresses) = ADDRESSES.get() {
        addresses.look_again();
    }
}

/// Whoever opens addresses.
///
/// # Errors
/// If nobody does in this process.
pub fn opener(address: &str) -> io::Result<&'static Arc<dyn Addresses>> {
    ADDRESSES.get().ok_or_else(|| {
        let what = format!(
            "{} is an address, and this program was built without what opens addresses: build it with `--features \
             remote`, or copy the object to a disk",
            shown(Path::new(address))
        );
        io::Error::new(io::ErrorKind::Unsupported, what)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_told_from_paths() {
        for address in ["s3://bucket/a.rset", "https://host/a?b=c", "x-y+z.1://a"] {
            assert_eq!(address_of(Path::new(address)), Some(address));
        }
        for path in ["a.rset", "/a/b://c", "://a", "1s://a", "s3:/a", "s3://", "C:\\a", "a b://c"] {
            assert_eq!(address_of(Path::new(path)), None, "{path}");
        }
    }

    #[test]
    fn paths_in_a_file_are_sought_beside_it_wherever_it_is() {
        let at = |folder: &str, path: &str| beside(Path::new(folder), Path::new(path)).display().to_string();
        assert_eq!(at("s3://bucket/a/b", "c.rset"), "s3://bucket/a/b/c.rset");
        assert_eq!(at("s3://bucket/a/b/", "./d/../../c.rset"), "s3://bucket/a/c.rset");
        assert_eq!(at("s3://bucket", "../../c.rset"), "s3://bucket/c.rset");
        assert_eq!(at("https://host/a", "/c.rset"), "https://host/c.rset");
        assert_eq!(at("https://host/a", "s3://bucket/c"), "s3://bucket/c");
        assert_eq!(at("folder", "s3://bucket/c"), "s3://bucket/c");
        assert_eq!(at("folder", "c.rset"), Path::new("folder").join("c.rset").display().to_string());
    }
}
