//! Inputs that are read from start to end, or here and there: a file on disk, a pipe, or an object
//! that is remote.
//!
//! Remote objects are read ahead: the longer a reader goes on without a jump, the more is asked for
//! at a time, in many requests at once. So what it reads costs the rate of the connection and not a
//! round trip for every buffer.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use super::address;
use super::file::{FileStorage, read_at};
use super::transport::Storage;
use rayset_base::regular_file;

/// Bytes that are read at a time after a jump.
const LEAST_WINDOW: usize = 64 << 10;
/// Most bytes that are read at a time.
const MOST_WINDOW: usize = 8 << 20;

/// What a path names.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Named {
    /// A regular file or a remote object, of this many bytes.
    File(u64),
    /// A folder.
    Folder,
    /// A pipe, a device, a socket.
    Other,
}

/// What a path or an address names.
///
/// # Errors
/// If there is nothing, or it cannot be looked at.
pub fn look(path: &Path) -> io::Result<Named> {
    if address::address_of(path).is_some() {
        return Ok(Named::File(address::open(path, false)?.length()?));
    }
    let found = std::fs::metadata(path)?;
    Ok(match () {
        () if found.is_file() => Named::File(found.len()),
        () if found.is_dir() => Named::Folder,
        () => Named::Other,
    })
}

/// Whether a path or an address names a regular file or a remote object.
#[must_use]
pub fn is_file(path: &Path) -> bool {
    matches!(look(path), Ok(Named::File(_)))
}

/// An input that is read at a cursor of its own.
#[derive(Debug)]
pub struct InputFile(Source);

#[derive(Debug)]
enum Source {
    Local(File),
    Remote(Ahead, u64),
}

impl InputFile {
    /// Opens a regular file or an address.
    ///
    /// # Errors
    /// The system's error; if the path is a folder, a pipe, a socket or a device.
    pub fn open(path: &Path) -> io::Result<Self> {
        match address::address_of(path) {
            Some(_) => Self::remote(path),
            None => Ok(Self(Source::Local(regular_file::open(path)?))),
        }
    }

    /// Opens a file, an address, or a pipe.
    ///
    /// # Errors
    /// The system's error.
    pub fn open_any(path: &Path) -> io::Result<Self> {
        match address::address_of(path) {
            Some(_) => Self::remote(path),
            None => Ok(Self(Source::Local(File::open(path)?))),
        }
    }

    fn remote(path: &Path) -> io::Result<Self> {
        Ok(Self(Source::Remote(Ahead::new(address::open(path, false)?)?, 0)))
    }

    /// Its length in bytes.
    ///
    /// # Errors
    /// The system's error.
    pub fn length(&self) -> io::Result<u64> {
        match &self.0 {
            Source::Local(file) => Ok(file.metadata()?.len()),
            Source::Remote(ahead, _) => Ok(ahead.length),
        }
    }

    /// Whether it is a regular file or a remote object, which have a length and can be read
    /// anywhere.
    #[must_use]
    pub fn is_file(&self) -> bool {
        match &self.0 {
            Source::Local(file) => file.metadata().is_ok_and(|metadata| metadata.is_file()),
            Source::Remote(..) => true,
        }
    }

    /// The same bytes, to be read anywhere by anyone.
    #[must_use]
    pub fn into_storage(self) -> Arc<dyn Storage> {
        match self.0 {
            Source::Local(file) => Arc::new(FileStorage::from(file)),
            Source::Remote(ahead, _) => ahead.storage,
        }
    }
}

impl Read for InputFile {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        match &mut self.0 {
            Source::Local(file) => file.read(buffer),
            Source::Remote(ahead, at) => {
                let read = ahead.read(buffer, *at, u64::MAX)?;
                *at += read as u64;
                Ok(read)
            }
        }
    }
}

impl Seek for InputFile {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        match &mut self.0 {
            Source::Local(file) => file.seek(to),
            Source::Remote(ahead, at) => {
                *at = place_of(to, *at, ahead.length)?;
                Ok(*at)
            }
        }
    }
}

/// An input that several readers read, each anywhere. Copies share the file, and read ahead of
/// their own reader alone.
#[derive(Clone, Debug)]
pub enum Shared {
    /// A regular file.
    Local(Arc<File>),
    /// A remote object.
    Remote(Ahead),
}

impl Shared {
    /// Opens a regular file or an address.
    pub fn open(path: &Path) -> io::Result<Self> {
        Ok(match InputFile::open(path)?.0 {
            Source::Local(file) => Self::Local(Arc::new(file)),
            Source::Remote(ahead, _) => Self::Remote(ahead),
        })
    }

    /// Its length in bytes.
    pub fn length(&self) -> io::Result<u64> {
        match self {
            Self::Local(file) => Ok(file.metadata()?.len()),
            Self::Remote(ahead) => Ok(ahead.length),
        }
    }

    /// Reads some bytes from byte `at` on; 0 at the end. Nothing at or beyond byte `end` is read.
    pub fn read(&mut self, buffer: &mut [u8], at: u64, end: u64) -> io::Result<usize> {
        match self {
            Self::Local(file) => {
                let left = usize::try_from(end.saturating_sub(at)).unwrap_or(usize::MAX);
                let room = buffer.len().min(left);
                if room == 0 { Ok(0) } else { read_at(file, &mut buffer[..room], at) }
            }
            Self::Remote(ahead) => ahead.read(buffer, at, end),
        }
    }
}

/// The byte that is sought, from byte `at` of something that ends at byte `end`.
pub fn place_of(to: SeekFrom, at: u64, end: u64) -> io::Result<u64> {
    let place = match to {
        SeekFrom::Start(place) => Some(place),
        SeekFrom::Current(distance) => at.checked_add_signed(distance),
        SeekFrom::End(distance) => end.checked_add_signed(distance),
    };
    place.ok_or_else(|| io::ErrorKind::InvalidInput.into())
}

/// The same bytes, read ahead if they are remote, for whoever reads them mostly in order.
pub fn read_ahead(storage: Arc<dyn Storage>) -> io::Result<Arc<dyn Storage>> {
    if storage.transport().is_none() {
        return Ok(storage);
    }
    Ok(Arc::new(InOrder(Mutex::new(Ahead::new(storage)?))))
}

/// A storage that is read ahead.
struct InOrder(Mutex<Ahead>);

impl Storage for InOrder {
    fn length(&self) -> io::Result<u64> {
        Ok(self.0.lock().unwrap_or_else(PoisonError::into_inner).length)
    }

    fn read_exact_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()> {
        let mut ahead = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let mut done = 0;
        while done < buffer.len() {
            match ahead.read(&mut buffer[done..], offset + done as u64, u64::MAX)? {
                0 => return Err(io::ErrorKind::UnexpectedEof.into()),
                some => done += some,
            }
        }
        Ok(())
    }
}

/// Bytes of a storage that are read ahead of whoever reads them. Copies share the storage, and
/// nothing else.
pub struct Ahead {
    storage: Arc<dyn Storage>,
    length: u64,
    /// What has been read, from byte `start` on.
    held: Vec<u8>,
    start: u64,
    /// How much is read next, if it is read where `held` ends.
    next_bytes: usize,
}

impl Ahead {
    fn new(storage: Arc<dyn Storage>) -> io::Result<Self> {
        let length = storage.length()?;
        Ok(Self { storage, length, held: Vec::new(), start: 0, next_bytes: LEAST_WINDOW })
    }

    /// Reads some bytes from byte `at` on; 0 at the end. Nothing at or beyond byte `end` is read.
    fn read(&mut self, buffer: &mut [u8], at: u64, end: u64) -> io::Result<usize> {
        let end = end.min(self.length);
        if buffer.is_empty() || at >= end {
            return Ok(0);
        }
        if !(self.start..self.start + self.held.len() as u64).contains(&at) {
            self.fill(buffer.len(), at, end)?;
        }
        let from = (at - self.start) as usize;
        let some =
            buffer.len().min(self.held.len() - from).min(usize::try_from(end - at).unwrap_or(usize::MAX));
        buffer[..some].copy_from_slice(&self.held[from..from + some]);
        Ok(some)
    }

    fn fill(&mut self, wanted: usize, at: u64, end: u64) -> io::Result<()> {
        let goes_on = at == self.start + self.held.len() as u64;
        let bytes = if goes_on { self.next_bytes } else { LEAST_WINDOW };
        let bytes = bytes.max(wanted.min(MOST_WINDOW));
        self.next_bytes = (2 * bytes).min(MOST_WINDOW);
        // Whoever jumps to the end of a file soon reads what is before it: what lies where is often
        // said last.
        let window = self.length.saturating_sub(LEAST_WINDOW as u64);
        let start = if goes_on || end < self.length { at } else { at.min(window) };
        let bytes = bytes.min(usize::try_from(end - start).unwrap_or(usize::MAX));
        self.held.resize(bytes, 0);
        self.start = start;
        let read = self.storage.read_exact_at(&mut self.held, start);
        if read.is_err() {
            self.held.clear();
        }
        read
    }
}

impl Clone for Ahead {
    fn clone(&self) -> Self {
        let (storage, length) = (self.storage.clone(), self.length);
        Self { storage, length, held: Vec::new(), start: 0, next_bytes: LEAST_WINDOW }
    }
}

impl std::fmt::Debug for Ahead {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Ahead")
            .field("length", &self.length)
            .field("start", &self.start)
            .finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Bytes that count up, and the reads that were made of them.
    struct Counted(Vec<u8>, Mutex<Vec<(u64, usize)>>);

    impl Storage for Counted {
        fn length(&self) -> io::Result<u64> {
            Ok(self.0.len() as u64)
        }

        fn read_exact_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()> {
            self.1.lock().expect("no panic").push((offset, buffer.len()));
            buffer.copy_from_slice(&self.0[offset as usize..offset as usize + buffer.len()]);
            Ok(())
        }
    }

    #[test]
    fn what_goes_on_is_read_in_ever_larger_pieces_and_jumps_begin_small() {
        let bytes: Vec<u8> = (0..20 << 20).map(|at: u32| (at % 251) as u8).collect();
        let storage = Arc::new(Counted(bytes.clone(), Mutex::default()));
        let mut file = InputFile(Source::Remote(Ahead::new(storage.clone()).expect("bytes"), 0));
        let mut read = Vec::new();
        file.read_to_end(&mut read).expect("a read");
        assert!(read == bytes);
        let reads = std::mem::take(&mut *storage.1.lock().expect("no panic"));
        assert!(reads.len() < 12 && reads.iter().all(|&(_, length)| length <= MOST_WINDOW), "{reads:?}");
        assert_eq!(file.seek(SeekFrom::Start(100)).expect("a place"), 100);
        let mut some = [0; 10];
        file.read_exact(&mut some).expect("a read");
        assert_eq!(*storage.1.lock().expect("no panic"), [(100, LEAST_WINDOW)]);
        assert_eq!(some, bytes[100..110]);
        assert!(file.seek(SeekFrom::Current(-(21 << 20))).is_err());
        // The end is read with what is before it.
        assert_eq!(file.seek(SeekFrom::End(-5000)).expect("a place"), (20 << 20) - 5000);
        read.clear();
        file.read_to_end(&mut read).expect("a read");
        assert!(read == bytes[bytes.len() - 5000..]);
        file.seek(SeekFrom::End(-60_000)).expect("a place");
        file.read_exact(&mut some).expect("a read");
        assert_eq!(some, bytes[bytes.len() - 60_000..][..10]);
        assert_eq!(
            storage.1.lock().expect("no panic")[1..],
            [((20 << 20) - LEAST_WINDOW as u64, LEAST_WINDOW)]
        );
    }

    #[test]
    fn nothing_beyond_the_end_of_a_part_is_asked_for() {
        let storage = Arc::new(Counted(vec![7; 1 << 20], Mutex::default()));
        let mut ahead = Ahead::new(storage.clone()).expect("bytes");
        let mut buffer = [0; 4096];
        assert_eq!(ahead.read(&mut buffer, 100, 300).expect("a read"), 200);
        assert_eq!(ahead.read(&mut buffer, 300, 300).expect("the end"), 0);
        assert_eq!(*storage.1.lock().expect("no panic"), [(100, 200)]);
    }
}
