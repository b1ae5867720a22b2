//! A folder of blocks of remote objects that were read before, of a size that is never exceeded.
//!
//! A block is a file of at most [`BLOCK_BYTES`] of an object, behind a checksum. Its name is a hash
//! of the object's address without secrets, entity tag and length, and the block's number, so that
//! an object that has changed has other blocks, and one that is signed anew the same. Folders that
//! are made are open to their owner alone. Several processes may use one folder: they write one
//! after another, under a lock, and read without one. The file `bytes` says how much all blocks
//! take; it is raised before a block gets its name, so that a process that is killed may leave it
//! too high, but never too low. What it left unfinished lies in `unfinished`, with a file that says
//! that it had begun; whoever opens the folder next removes it and counts again.

use std::fs::{self, File};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, SystemTime};

use rayset::storage::shown;
use xxhash_rust::xxh3::{xxh3_64, xxh3_128};

/// Most bytes of a block.
pub(crate) const BLOCK_BYTES: u64 = 64 << 10;
/// Folders among which blocks are distributed.
const FOLDERS: u64 = 256;
/// Bytes of the checksum before a block.
const CHECKSUM_BYTES: usize = 8;
/// What a file takes is a multiple of this.
const UNIT_BYTES: u64 = 4096;
/// The folder within the one that the user named, so that nothing else is ever removed.
const OWN_FOLDER: &str = "rayset-remote-1";
/// Uses of a block are noted no more often than this.
const NOTE_AFTER: Duration = Duration::from_secs(600);
/// Least size of a cache.
const LEAST_BYTES: u64 = 16 << 20;

/// Why a folder cannot be used as a cache.
#[derive(Debug)]
pub struct CacheError {
    folder: PathBuf,
    source: io::Error,
}

impl std::fmt::Display for CacheError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "cannot use {} as the cache of remote objects: {}", self.folder.display(), self.source)
    }
}

impl std::error::Error for CacheError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        Some(&self.source)
    }
}

/// An object in the cache.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Key(u128);

impl Key {
    /// The object with this address, entity tag or date, and length in bytes. Secrets of the
    /// address have no part in it.
    #[must_use]
    pub fn new(address: &str, version: &str, length: u64) -> Self {
        let address = shown(Path::new(address));
        Self(xxh3_128(format!("{address}\n{version}\n{length}").as_bytes()))
    }
}

/// A folder that keeps blocks of remote objects.
#[derive(Debug)]
pub struct Cache {
    folder: PathBuf,
    most_bytes: u64,
    /// The folder from which blocks are removed next.
    next: AtomicU64,
}

impl Cache {
    /// Opens a folder, which is made if it is not there, and removes what killed processes left
    /// unfinished in it. `most_bytes` is at least 16 MiB.
    ///
    /// # Errors
    /// [`CacheError`] if it cannot be made or written to.
    pub fn open(folder: &Path, most_bytes: u64) -> Result<Self, CacheError> {
        let failed = |source| CacheError { folder: folder.to_owned(), source };
        if most_bytes < LEAST_BYTES {
            let what =
                format!("it may hold {most_bytes} bytes, and has to be allowed at least {LEAST_BYTES}");
            return Err(failed(io::Error::new(io::ErrorKind::InvalidInput, what)));
        }
        let next = AtomicU64::new(u64::from(std::process::id()));
        let cache = Self { folder: folder.join(OWN_FOLDER), most_bytes, next };
        cache.prepare().map_err(failed)?;
        Ok(cache)
    }

    fn prepare(&self) -> io::Result<()> {
        create_folders(&self.folder.join("unfinished"))?;
        let mut lock = Lock::take(&self.folder)?;
        let mut killed = false;
        for left in fs::read_dir(self.folder.join("unfinished"))? {
            fs::remove_file(left?.path())?;
            killed = true;
        }
        if killed || lock.bytes()?.is_none() {
            let total = self.total()?;
            lock.set_bytes(total)?;
        }
        let total = lock.bytes()?.unwrap_or(0);
        self.make_room(&mut lock, total, 0).map(drop)
    }

    /// Reads a range of bytes of an object. `None` unless all of its blocks are here and whole.
    #[must_use]
    pub fn read(&self, key: Key, length: u64, range: Range<u64>) -> Option<Vec<u8>> {
        let mut bytes = Vec::with_capacity((range.end - range.start) as usize);
        for block in range.start / BLOCK_BYTES..range.end.div_ceil(BLOCK_BYTES) {
            let whole = blocks_of(block..block + 1, length);
            let held = self.block(key, block, (whole.end - whole.start) as usize)?;
            let from = range.start.max(whole.start) - whole.start;
            let to = range.end.min(whole.end) - whole.start;
            bytes.extend_from_slice(&held[CHECKSUM_BYTES + from as usize..CHECKSUM_BYTES + to as usize]);
        }
        Some(bytes)
    }

    /// The file of a block, if it is whole.
    fn block(&self, key: Key, block: u64, bytes: usize) -> Option<Vec<u8>> {
        let mut file = File::open(self.path(key, block)).ok()?;
        let mut held = Vec::with_capacity(CHECKSUM_BYTES + bytes);
        Read::by_ref(&mut file).take((CHECKSUM_BYTES + bytes) as u64 + 1).read_to_end(&mut held).ok()?;
        if held.len() != CHECKSUM_BYTES + bytes {
            return None;
        }
        let (checksum, content) = held.split_at(CHECKSUM_BYTES);
        if checksum != checksum_of(key, block, content) {
            return None;
        }
        let used = file.metadata().and_then(|metadata| metadata.modified());
        if used.is_ok_and(|used| used.elapsed().is_ok_and(|age| age > NOTE_AFTER)) {
            // The system may not allow it; the block then counts as old.
            let _ = File::options()
                .write(true)
                .open(self.path(key, block))
                .and_then(|file| file.set_modified(SystemTime::now()));
        }
        Some(held)
    }

    /// Keeps the whole blocks in `bytes`, which begin at byte `start` of an object of `length`
    /// bytes. A block that cannot be kept is none: the cache then is what it was.
    pub fn keep(&self, key: Key, length: u64, start: u64, bytes: &[u8]) {
        let end = start + bytes.len() as u64;
        let blocks: Vec<u64> = (start.div_ceil(BLOCK_BYTES)..end.div_ceil(BLOCK_BYTES))
            .filter(|&block| {
                blocks_of(block..block + 1, length).end <= end && !self.path(key, block).exists()
            })
            .collect();
        if !blocks.is_empty() {
            let content = |block: u64| {
                let range = blocks_of(block..block + 1, length);
                &bytes[(range.start - start) as usize..(range.end - start) as usize]
            };
            // A full disk or a folder that has gone is no reason not to render.
            let _ = self.write(key, &blocks, content);
        }
    }

    fn write<'a>(&self, key: Key, blocks: &[u64], content: impl Fn(u64) -> &'a [u8]) -> io::Result<()> {
        let mut lock = Lock::take(&self.folder)?;
        // Somebody else may have kept some of them while this waited.
        let missing = blocks.iter().filter(|&&block| !self.path(key, block).exists());
        let blocks: Vec<u64> = missing.copied().collect();
        let needed: u64 = blocks.iter().map(|&block| file_bytes(content(block).len())).sum();
        let total = match lock.bytes()? {
            Some(total) => total,
            None => self.total()?,
        };
        // As long as this is there, what is counted may be more than there is.
        let begun = self.folder.join("unfinished").join(std::process::id().to_string());
        File::create(&begun)?;
        let total = self.make_room(&mut lock, total, needed)?;
        if total + needed > self.most_bytes {
            return fs::remove_file(begun);
        }
        lock.set_bytes(total + needed)?;
        let mut kept = total;
        for block in blocks {
            let path = self.path(key, block);
            let partial = self.folder.join("unfinished").join(format!("{}-{block}", std::process::id()));
            let checksum = checksum_of(key, block, content(block));
            let written = write_block(&partial, &path, &checksum, content(block));
            if let Err(error) = written {
                let _ = fs::remove_file(&partial);
                // What follows is not written either.
                lock.set_bytes(kept)?;
                let _ = fs::remove_file(begun);
                return Err(error);
            }
            kept += file_bytes(content(block).len());
        }
        fs::remove_file(begun)
    }

    /// Removes blocks that have not been used for long until there is room. Returns what is left.
    fn make_room(&self, lock: &mut Lock, mut total: u64, needed: u64) -> io::Result<u64> {
        if total + needed <= self.most_bytes {
            return Ok(total);
        }
        // Some more, so that not every write has to remove.
        let aim = self.most_bytes.saturating_sub(needed).saturating_sub(self.most_bytes / 32);
        for _ in 0..2 * FOLDERS {
            if total <= aim {
                break;
            }
            let folder = self.folder.join(folder_name(self.next.fetch_add(1, Ordering::Relaxed)));
            for path in oldest_half(&folder) {
                let bytes = fs::metadata(&path).map_or(0, |metadata| file_bytes_of(metadata.len()));
                if fs::remove_file(&path).is_ok() {
                    total = total.saturating_sub(bytes);
                }
            }
        }
        lock.set_bytes(total)?;
        Ok(total)
    }

    /// What all blocks take.
    fn total(&self) -> io::Result<u64> {
        let mut total = 0;
        for number in 0..FOLDERS {
            let Ok(entries) = fs::read_dir(self.folder.join(folder_name(number))) else { continue };
            for entry in entries {
                match entry?.metadata() {
                    Ok(metadata) => total += file_bytes_of(metadata.len()),
                    // Somebody has just removed it.
                    Err(error) if error.kind() == io::ErrorKind::NotFound => {}
                    Err(error) => return Err(error),
                }
            }
        }
        Ok(total)
    }

    fn path(&self, key: Key, block: u64) -> PathBuf {
        let folder =
            folder_name((key.0 as u64).wrapping_add(block.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 40));
        self.folder.join(folder).join(format!("{:032x}-{block:x}", key.0))
    }
}

/// Writes a block's file, which has its name when it is whole.
fn write_block(partial: &Path, path: &Path, checksum: &[u8], content: &[u8]) -> io::Result<()> {
    let mut file = File::create(partial)?;
    file.write_all(checksum)?;
    file.write_all(content)?;
    if let Some(folder) = path.parent() {
        create_folders(folder)?;
    }
    fs::rename(partial, path)
}

/// Creates a folder and those that it lies in, each for its owner alone.
fn create_folders(path: &Path) -> io::Result<()> {
    let mut builder = fs::DirBuilder::new();
    builder.recursive(true);
    #[cfg(unix)]
    std::os::unix::fs::DirBuilderExt::mode(&mut builder, 0o700);
    builder.create(path)
}

/// The bytes of some blocks, in an object of `length` bytes.
pub(crate) fn blocks_of(blocks: Range<u64>, length: u64) -> Range<u64> {
    blocks.start * BLOCK_BYTES..(blocks.end * BLOCK_BYTES).min(length)
}

fn folder_name(number: u64) -> String {
    format!("{:02x}", number % FOLDERS)
}

fn checksum_of(key: Key, block: u64, content: &[u8]) -> [u8; CHECKSUM_BYTES] {
    (xxh3_64(content) ^ key.0 as u64 ^ block.rotate_left(32)).to_le_bytes()
}

/// What the file of a block takes on disk.
fn file_bytes(content: usize) -> u64 {
    file_bytes_of((CHECKSUM_BYTES + content) as u64)
}

fn file_bytes_of(length: u64) -> u64 {
    length.next_multiple_of(UNIT_BYTES)
}

/// The files of a folder that were not used for longest: half of them, at least one.
fn oldest_half(folder: &Path) -> Vec<PathBuf> {
    let Ok(entries) = fs::read_dir(folder) else { return Vec::new() };
    let mut files: Vec<(SystemTime, PathBuf)> = entries
        .filter_map(Result::ok)
        .map(|entry| {
            let used = entry.metadata().and_then(|metadata| metadata.modified());
            (used.unwrap_or(SystemTime::UNIX_EPOCH), entry.path())
        })
        .collect();
    files.sort();
    let half = files.len().div_ceil(2);
    files.into_iter().take(half).map(|(_, path)| path).collect()
}

/// The right to write to the folder, until it is dropped.
struct Lock(File);

impl Lock {
    fn take(folder: &Path) -> io::Result<Self> {
        let file =
            File::options().read(true).write(true).create(true).truncate(false).open(folder.join("bytes"))?;
        file.lock()?;
        Ok(Self(file))
    }

    /// What all blocks take; `None` if that is not known.
    fn bytes(&mut self) -> io::Result<Option<u64>> {
        let mut text = String::new();
        self.0.seek(SeekFrom::Start(0))?;
        Read::by_ref(&mut self.0).take(64).read_to_string(&mut text)?;
        Ok(text.strip_suffix('\n').and_then(|number| number.trim().parse().ok()))
    }

    fn set_bytes(&mut self, bytes: u64) -> io::Result<()> {
        self.0.seek(SeekFrom::Start(0))?;
        // Of one length always, so that a write that is cut off is seen.
        self.0.write_all(format!("{bytes:020}\n").as_bytes())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const KEY: Key = Key(0x1234_5678_9abc_def0_1122);

    fn used(folder: &Path) -> u64 {
        let cache = Cache { folder: folder.join(OWN_FOLDER), most_bytes: 0, next: AtomicU64::new(0) };
        // Not while somebody removes and adds.
        let _lock = Lock::take(&cache.folder).expect("a lock");
        cache.total().expect("a folder")
    }

    fn bytes(count: usize, seed: usize) -> Vec<u8> {
        (0..count).map(|at| ((at + seed) % 249) as u8).collect()
    }

    #[test]
    fn an_object_that_is_signed_anew_has_the_same_blocks_and_one_that_has_changed_others() {
        let key = |address: &str, version: &str| Key::new(address, version, 9);
        let signed = key("https://user:hunter2@host/a.rset?sig=1", "\"1\"");
        assert_eq!(signed, key("https://user:other@host/a.rset?sig=2", "\"1\""));
        assert_eq!(signed, key("https://host/a.rset", "\"1\""));
        assert_ne!(signed, key("https://host/a.rset", "\"2\""));
        assert_ne!(signed, key("https://host/b.rset", "\"1\""));
    }

    #[cfg(unix)]
    #[test]
    fn folders_that_are_made_are_open_to_their_owner_alone() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().expect("a folder");
        let named = folder.path().join("a/b");
        let cache = Cache::open(&named, LEAST_BYTES).expect("a cache");
        cache.keep(KEY, BLOCK_BYTES, 0, &bytes(BLOCK_BYTES as usize, 0));
        let block = cache.path(KEY, 0);
        assert!(block.exists());
        let made = [folder.path().join("a"), named.clone(), named.join(OWN_FOLDER)];
        for path in made.iter().map(PathBuf::as_path).chain(block.parent()) {
            let mode = fs::metadata(path).expect("a folder").permissions().mode();
            assert_eq!(mode & 0o777, 0o700, "{}", path.display());
        }
    }

    #[test]
    fn what_was_kept_is_read_and_nothing_else() {
        let folder = tempfile::tempdir().expect("a folder");
        let cache = Cache::open(folder.path(), LEAST_BYTES).expect("a cache");
        let length = 5 * BLOCK_BYTES + 100;
        let object = bytes(length as usize, 0);
        // From the middle of block 1 to the end: blocks 2 to 5 are whole.
        let start = BLOCK_BYTES + 1000;
        cache.keep(KEY, length, start, &object[start as usize..]);
        let range = 2 * BLOCK_BYTES + 7..length - 3;
        assert_eq!(
            cache.read(KEY, length, range.clone()).expect("kept"),
            object[range.start as usize..range.end as usize]
        );
        assert!(
            cache.read(KEY, length, BLOCK_BYTES + 5000..3 * BLOCK_BYTES).is_none(),
            "block 1 is not whole"
        );
        assert!(cache.read(Key::new("a", "b", 3), length, range.clone()).is_none());
        // One that was damaged is none.
        let path = cache.path(KEY, 3);
        let mut damaged = fs::read(&path).expect("the block");
        damaged[5000] ^= 1;
        fs::write(&path, damaged).expect("a write");
        assert!(cache.read(KEY, length, range).is_none());
        assert!(cache.read(KEY, length, 4 * BLOCK_BYTES..length).is_some());
    }

    #[test]
    fn blocks_under_another_name_are_none() {
        let folder = tempfile::tempdir().expect("a folder");
        let cache = Cache::open(folder.path(), LEAST_BYTES).expect("a cache");
        let length = 9 * BLOCK_BYTES;
        cache.keep(KEY, length, 0, &bytes(length as usize, 0));
        fs::create_dir_all(cache.path(KEY, 5).parent().expect("a folder")).expect("a folder");
        fs::copy(cache.path(KEY, 4), cache.path(KEY, 5)).expect("a copy");
        assert!(cache.read(KEY, length, 5 * BLOCK_BYTES..6 * BLOCK_BYTES).is_none());
    }

    #[test]
    fn the_size_is_never_exceeded_whoever_writes() {
        let folder = tempfile::tempdir().expect("a folder");
        let most = LEAST_BYTES;
        std::thread::scope(|scope| {
            for writer in 0..4_u64 {
                let folder = folder.path();
                scope.spawn(move || {
                    let cache = Cache::open(folder, most).expect("a cache");
                    let key = Key::new("object", &writer.to_string(), 1 << 30);
                    for step in 0..60_u64 {
                        let content = bytes(4 * BLOCK_BYTES as usize, step as usize);
                        cache.keep(key, 1 << 30, 4 * step * BLOCK_BYTES, &content);
                        assert!(used(folder) <= most, "{}", used(folder));
                    }
                });
            }
        });
        assert!(used(folder.path()) > most / 2, "hardly anything was kept: {}", used(folder.path()));
        let said = fs::read_to_string(folder.path().join(OWN_FOLDER).join("bytes")).expect("the sum");
        assert_eq!(said.trim().parse::<u64>().expect("a number"), used(folder.path()));
        // A smaller one makes room when it is opened.
        fs::write(folder.path().join("not-ours"), "text").expect("a write");
        assert!(Cache::open(folder.path(), LEAST_BYTES - 1).is_err());
        assert!(folder.path().join("not-ours").exists());
    }

    #[test]
    fn what_a_killed_process_left_is_removed_and_counted_again() {
        let folder = tempfile::tempdir().expect("a folder");
        let cache = Cache::open(folder.path(), LEAST_BYTES).expect("a cache");
        cache.keep(KEY, 1 << 20, 0, &bytes(1 << 20, 0));
        let own = folder.path().join(OWN_FOLDER);
        fs::write(own.join("unfinished/1-7"), "half").expect("a write");
        fs::write(own.join("bytes"), format!("{:020}\n", 15 << 20)).expect("a write");
        let cache = Cache::open(folder.path(), LEAST_BYTES).expect("a cache");
        assert!(fs::read_dir(own.join("unfinished")).expect("a folder").next().is_none());
        let said = fs::read_to_string(own.join("bytes")).expect("the sum");
        assert_eq!(said.trim().parse::<u64>().expect("a number"), used(folder.path()));
        assert!(cache.read(KEY, 1 << 20, 0..1 << 20).is_some(), "and nothing that was whole");
    }
}
