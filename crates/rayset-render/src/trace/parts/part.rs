//! Reading a part: its head and its end when it is opened, its index and its blocks when they are
//! asked for.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::error::PartError;
use super::header::{
    About, ENTRY_BYTES, FOOT_BYTES, Foot, HEAD_BYTES, Head, MOST_NOTE_BYTES, MOST_TEXT_BYTES, PART_MAGIC,
    VERSION,
};
use super::share::Share;
use rayset_store::storage::shown;
use rayset_store::storage::{InputFile, Storage, address_of};

/// A part of a picture, whose head and end have been checked. Its pixels are checked as they are
/// read.
///
/// A part whose render was interrupted is unfinished: of the squares of its share, in their order,
/// it has the first ones.
#[derive(Clone)]
pub struct Part {
    pub(super) source: Source,
    pub(super) about: About,
    share: Share,
    head: Head,
    foot: Foot,
}

/// Where the bytes of a part are, and the checksum that all others of it continue.
#[derive(Clone)]
pub(super) struct Source {
    pub(super) name: String,
    /// A file or an object is opened for each use, because there may be more parts than can be open
    /// at a time.
    place: PartSource,
    pub(super) seed: u32,
}

/// Where a block is in its part.
#[derive(Clone, Copy, Default)]
pub(super) struct StoredBlock {
    pub(super) at: u64,
    pub(super) length: u32,
    pub(super) crc: u32,
}

impl StoredBlock {
    /// Whether its part does not have it.
    pub(super) fn is_absent(&self) -> bool {
        self.length == 0
    }
}

#[derive(Clone)]
enum PartSource {
    Named(PathBuf),
    Storage(Arc<dyn Storage>),
}

impl std::fmt::Debug for Part {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Part({} of {})", self.share, self.source.name)
    }
}

impl Source {
    /// The bytes, ready to be read.
    pub(super) fn open(&self) -> Result<Arc<dyn Storage>, PartError> {
        match &self.place {
            PartSource::Storage(storage) => Ok(storage.clone()),
            PartSource::Named(path) => InputFile::open(path)
                .map(InputFile::into_storage)
                .map_err(|error| PartError::read(&self.name, error)),
        }
    }

    /// Whether every read costs a round trip.
    pub(super) fn is_remote(&self) -> bool {
        match &self.place {
            PartSource::Named(path) => address_of(path).is_some(),
            PartSource::Storage(storage) => {
                storage.transport().is_some_and(|transport| transport.is_remote())
            }
        }
    }

    /// Fills a buffer from a place.
    pub(super) fn read(&self, storage: &dyn Storage, buffer: &mut [u8], at: u64) -> Result<(), PartError> {
        storage.read_exact_at(buffer, at).map_err(|error| match error.kind() {
            io::ErrorKind::UnexpectedEof => PartError::damaged(&self.name, at, error.to_string()),
            _ => PartError::read(&self.name, error),
        })
    }
}

impl Part {
    /// Opens a part: a file, or an object at an address.
    ///
    /// # Errors
    /// [`PartError`] if it cannot be read, or is no complete part of this version.
    pub fn open(path: impl AsRef<Path>) -> Result<Self, PartError> {
        let path = path.as_ref();
        Self::at(shown(path), PartSource::Named(path.to_owned()))
    }

    /// Opens a part whose bytes are read from any storage; `name` is for messages.
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub fn from_storage(name: &str, storage: Arc<dyn Storage>) -> Result<Self, PartError> {
        Self::at(name.to_owned(), PartSource::Storage(storage))
    }

    /// Which share of its picture it is.
    #[must_use]
    pub fn share(&self) -> Share {
        self.share
    }

    /// How many pixels of its share it has, and how many a finished part has; with those around a
    /// region that ambient occlusion looks at.
    #[must_use]
    pub fn finished_pixels(&self) -> (u64, u64) {
        let blocks = self.about.blocks();
        let pixels = |count: usize| {
            let own = blocks.of_share(self.share).take(count);
            own.map(|block| blocks.region(block).pixels()).sum()
        };
        (pixels(self.foot.blocks as usize), pixels(usize::MAX))
    }

    /// The part, or the error that it is unfinished.
    pub(super) fn finished(self) -> Result<Self, PartError> {
        let (finished, pixels) = self.finished_pixels();
        if finished == pixels {
            return Ok(self);
        }
        Err(PartError::Unfinished { part: self.source.name, finished, pixels })
    }

    fn at(name: String, place: PartSource) -> Result<Self, PartError> {
        let mut source = Source { name, place, seed: 0 };
        let storage = source.open()?;
        let length = storage.length().map_err(|error| PartError::read(&source.name, error))?;
        let (head, seed) = head(&source, &*storage, length)?;
        source.seed = seed;
        let damaged = |at: u64, what: String| PartError::damaged(&source.name, at, what);
        let mut text = vec![0; head.text_bytes as usize];
        source.read(&*storage, &mut text, HEAD_BYTES as u64)?;
        if crc32c::crc32c(&text) != head.text_crc {
            return Err(damaged(HEAD_BYTES as u64, "the checksum of its description is wrong".into()));
        }
        let about = About::parse(&text).map_err(|what| damaged(HEAD_BYTES as u64, what))?;
        let share = about.share().ok_or_else(|| damaged(HEAD_BYTES as u64, "no share".into()))?;
        let foot_at = length.saturating_sub(FOOT_BYTES as u64);
        let mut bytes = [0; FOOT_BYTES];
        source.read(&*storage, &mut bytes, foot_at)?;
        let foot = Foot::decode(&bytes, seed)
            .ok_or_else(|| damaged(foot_at, format!("its end is not the end of a part of {length} bytes")))?;
        let expected = about.blocks().count_of(share);
        let index_end = foot.index_at.checked_add(u64::from(foot.blocks) * ENTRY_BYTES);
        if u64::from(foot.blocks) > expected || index_end != Some(foot_at) || foot.index_at < head.blocks_at()
        {
            return Err(damaged(
                foot_at,
                format!("{} squares of pixels, expected up to {expected}", foot.blocks),
            ));
        }
        Ok(Self { source, about, share, head, foot })
    }

    /// The note that whoever rendered the part left for whoever joins.
    pub(super) fn note(&self) -> Result<Vec<u8>, PartError> {
        let at = HEAD_BYTES as u64 + u64::from(self.head.text_bytes);
        let mut packed = vec![0; self.head.note_bytes as usize];
        self.source.read(&*self.source.open()?, &mut packed, at)?;
        let damaged = |what: &str| PartError::damaged(&self.source.name, at, what);
        if crc32c::crc32c(&packed) != self.head.note_crc {
            return Err(damaged("the checksum of its note is wrong"));
        }
        let mut note = vec![0; self.about.note_bytes as usize];
        match lz4_flex::block::decompress_into(&packed, &mut note) {
            Ok(found) if found == note.len() => Ok(note),
            _ => Err(damaged("its note does not unpack")),
        }
    }

    /// An upper bound of the bytes that reading the note takes.
    pub(super) fn note_bytes(&self) -> u64 {
        self.head.note_bytes + self.about.note_bytes
    }

    /// The blocks that it has, the first of its share in order. None is empty.
    pub(super) fn index(&self) -> Result<Vec<StoredBlock>, PartError> {
        let Foot { index_at, blocks, index_crc } = self.foot;
        let mut bytes = vec![0; blocks as usize * ENTRY_BYTES as usize];
        self.source.read(&*self.source.open()?, &mut bytes, index_at)?;
        let damaged = |what: &str| PartError::damaged(&self.source.name, index_at, what);
        if crc32c::crc32c_append(self.source.seed, &bytes) != index_crc {
            return Err(damaged("the checksum of its index is wrong"));
        }
        let number = |bytes: &[u8]| bytes.iter().rev().fold(0, |sum, &byte| sum << 8 | u32::from(byte));
        let mut at = self.head.blocks_at();
        let index: Vec<StoredBlock> = bytes
            .chunks_exact(ENTRY_BYTES as usize)
            .map(|entry| {
                let (length, crc) = (number(&entry[..4]), number(&entry[4..]));
                let place = at;
                at = at.saturating_add(u64::from(length));
                StoredBlock { at: place, length, crc }
            })
            .collect();
        if index.iter().any(|block| block.is_absent()) {
            return Err(damaged("a square of pixels is empty"));
        }
        if at == index_at { Ok(index) } else { Err(damaged("its blocks do not end where its index begins")) }
    }
}

/// The first bytes, with their checksum.
fn head(source: &Source, storage: &dyn Storage, length: u64) -> Result<(Head, u32), PartError> {
    let name = &source.name;
    let mut bytes = [0; HEAD_BYTES];
    let known = bytes.len().min(usize::try_from(length).unwrap_or(usize::MAX));
    source.read(storage, &mut bytes[..known], 0)?;
    if !bytes.starts_with(&PART_MAGIC) {
        return Err(PartError::Magic { part: name.clone() });
    }
    let found = u32::from_le_bytes([bytes[8], bytes[9], bytes[10], bytes[11]]);
    if known == HEAD_BYTES && found != VERSION {
        return Err(PartError::Version { part: name.clone(), found, expected: VERSION });
    }
    if length < (HEAD_BYTES + FOOT_BYTES) as u64 {
        let least = HEAD_BYTES + FOOT_BYTES;
        return Err(PartError::damaged(
            name,
            length,
            format!("it ends here; expected at least {least} bytes"),
        ));
    }
    let (head, seed) = Head::decode(&bytes)
        .ok_or_else(|| PartError::damaged(name, 0, "the checksum of its head is wrong"))?;
    let fits = head.text_bytes <= MOST_TEXT_BYTES
        && head.note_bytes <= 2 * MOST_NOTE_BYTES
        && head.blocks_at() <= length - FOOT_BYTES as u64;
    if fits { Ok((head, seed)) } else { Err(PartError::damaged(name, length, "it ends within its head")) }
}
