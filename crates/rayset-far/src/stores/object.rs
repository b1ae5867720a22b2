//! Ranges of an object that is the one it was when it was opened.

use std::io;
use std::ops::Range;
use std::sync::Arc;

use bytes::Bytes;
use futures_util::StreamExt;
use object_store::path::Path;
use object_store::{Error, GetOptions, GetRange, ObjectMeta, ObjectStore, ObjectStoreExt};
use rayset::storage::transport::Transport;
use rayset::storage::{FarOptions, FarStorage, RangeError, RangeReader, RangeSink, Storage};
use tokio::runtime::Runtime;

use super::failure;
use super::place::Place;
use crate::cache::{self, BLOCK_BYTES, Cache, Key};

/// Attempts at looking at an object.
const ATTEMPTS: u32 = 5;
/// The pause after the first failure, which doubles.
const FIRST_PAUSE: std::time::Duration = std::time::Duration::from_millis(200);

/// What tells an object from another one at the same place.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Version {
    length: u64,
    /// The entity tag, in quotation marks; weak ones begin with `W/`.
    tag: Option<String>,
    /// Seconds since 1970; 0 if the server does not say.
    changed: i64,
}

impl Version {
    fn of(meta: &ObjectMeta) -> Self {
        let tag = meta.e_tag.clone().filter(|tag| !tag.is_empty());
        Self { length: meta.size, tag, changed: meta.last_modified.timestamp() }
    }

    /// A text that differs for another object; `None` if there is nothing to tell it by but the length.
    fn text(&self) -> Option<String> {
        match &self.tag {
            Some(tag) => Some(tag.clone()),
            None if self.changed != 0 => Some(self.changed.to_string()),
            None => None,
        }
    }

    /// Conditions of a request, as far as servers check them: weak tags never match.
    fn conditions(&self) -> GetOptions {
        let strong = self.tag.clone().filter(|tag| !tag.starts_with("W/"));
        GetOptions { if_match: strong, ..GetOptions::default() }
    }

    /// Whether an answer is about the same object. What it does not say is no contradiction.
    fn is_of(&self, meta: &ObjectMeta) -> bool {
        let other = Self::of(meta);
        let same_tag = match (&self.tag, &other.tag) {
            (Some(own), Some(other)) => own == other,
            _ => self.changed == 0 || other.changed == 0 || self.changed == other.changed,
        };
        self.length == other.length && same_tag
    }
}

/// Looks at an object.
pub(super) async fn look(store: &dyn ObjectStore, path: &Path, name: &str) -> io::Result<Version> {
    let mut pause = FIRST_PAUSE;
    for _ in 1..ATTEMPTS {
        match look_once(store, path).await {
            Err(error) if failure::may_pass(&error) => {}
            looked => return looked.map_err(|error| failure::in_words(&error, name)),
        }
        tokio::time::sleep(pause).await;
        pause *= 2;
    }
    look_once(store, path).await.map_err(|error| failure::in_words(&error, name))
}

async fn look_once(store: &dyn ObjectStore, path: &Path) -> Result<Version, Error> {
    match store.head(path).await {
        Ok(meta) => Ok(Version::of(&meta)),
        Err(error @ Error::Unauthenticated { .. }) => Err(error),
        // Some servers, which then may say that there is nothing, and addresses that were signed for reading, allow no look without a read.
        Err(error) => {
            let first = GetOptions { range: Some(GetRange::Bounded(0..1)), ..GetOptions::default() };
            store.get_opts(path, first).await.map(|answer| Version::of(&answer.meta)).map_err(|_| error)
        }
    }
}

/// An object that is read by ranges. It keeps the runtime alive that its requests run on.
pub(super) struct PinnedObject {
    far: FarStorage,
    version: Version,
}

impl PinnedObject {
    pub(super) fn new(
        runtime: Arc<Runtime>,
        store: Arc<dyn ObjectStore>,
        place: Place,
        version: Version,
        cache: Option<Arc<Cache>>,
    ) -> io::Result<Self> {
        let length = version.length;
        let kept = cache.zip(version.text());
        let kept = kept.map(|(cache, text)| (cache, Key::new(&place.name, &text, length)));
        let ranges = Ranges { store, place, version: version.clone(), kept };
        let reader = Reader { runtime, ranges: Arc::new(ranges) };
        let far = FarStorage::new(Arc::new(reader), length, FarOptions::default())?;
        Ok(Self { far, version })
    }
}

impl Storage for PinnedObject {
    fn length(&self) -> io::Result<u64> {
        self.far.length()
    }

    fn read_exact_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()> {
        self.far.read_exact_at(buffer, offset)
    }

    fn version(&self) -> Option<String> {
        self.version.text()
    }

    fn transport(&self) -> Option<Arc<dyn Transport>> {
        self.far.transport()
    }
}

/// Starts reading ranges.
struct Reader {
    runtime: Arc<Runtime>,
    ranges: Arc<Ranges>,
}

impl RangeReader for Reader {
    fn start(&self, range: Range<u64>, sink: RangeSink) {
        let ranges = self.ranges.clone();
        self.runtime.spawn(async move { ranges.read(range, sink).await });
    }

    fn name(&self) -> String {
        self.ranges.place.name.clone()
    }
}

/// An object, and where its blocks are kept.
struct Ranges {
    store: Arc<dyn ObjectStore>,
    place: Place,
    version: Version,
    kept: Option<(Arc<Cache>, Key)>,
}

impl Ranges {
    async fn read(self: Arc<Self>, range: Range<u64>, mut sink: RangeSink) {
        let outcome = match &self.kept {
            None => self.request(range.clone(), |bytes| sink.put(bytes)).await,
            Some((cache, key)) => match self.find(cache, *key, range.clone()).await {
                Some(bytes) => {
                    sink.put(&bytes);
                    Ok(())
                }
                None => self.request_and_keep(cache, *key, range, &mut sink).await,
            },
        };
        sink.end(outcome);
    }

    async fn find(&self, cache: &Arc<Cache>, key: Key, range: Range<u64>) -> Option<Vec<u8>> {
        let (cache, length) = (cache.clone(), self.version.length);
        tokio::task::spawn_blocking(move || cache.read(key, length, range)).await.ok()?
    }

    /// Reads the blocks that a range lies in, hands the range to the sink, and keeps the blocks.
    async fn request_and_keep(
        &self,
        cache: &Arc<Cache>,
        key: Key,
        range: Range<u64>,
        sink: &mut RangeSink,
    ) -> Result<(), RangeError> {
        let length = self.version.length;
        let whole = cache::blocks_of(range.start / BLOCK_BYTES..range.end.div_ceil(BLOCK_BYTES), length);
        let mut read = Vec::with_capacity((whole.end - whole.start) as usize);
        let (skip, wanted) = ((range.start - whole.start) as usize, (range.end - range.start) as usize);
        self.request(whole.clone(), |bytes| {
            let before = read.len();
            read.extend_from_slice(bytes);
            let (from, to) = (before.max(skip), read.len().min(skip + wanted));
            // What lies behind the range is wanted too, for the cache.
            from >= to || sink.put(&read[from..to]) || to == skip + wanted
        })
        .await?;
        if read.len() as u64 == whole.end - whole.start {
            let cache = cache.clone();
            tokio::task::spawn_blocking(move || cache.keep(key, length, whole.start, &read));
        }
        Ok(())
    }

    /// Asks for a range; the bytes are passed on as they come, until `take` wants no more.
    async fn request(
        &self,
        range: Range<u64>,
        mut take: impl FnMut(&Bytes) -> bool,
    ) -> Result<(), RangeError> {
        let name = &self.place.name;
        let options = GetOptions { range: Some(GetRange::Bounded(range)), ..self.version.conditions() };
        let answer = self.store.get_opts(&self.place.path, options).await;
        let answer = answer.map_err(|error| failure::of_range(&error, name))?;
        if !self.version.is_of(&answer.meta) {
            return Err(failure::has_changed(name));
        }
        let mut parts = answer.into_stream();
        while let Some(part) = parts.next().await {
            if !take(&part.map_err(|error| failure::of_range(&error, name))?) {
                break;
            }
        }
        Ok(())
    }
}
