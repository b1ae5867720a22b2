//! Ranges of an object that is the one it was when it was opened.

use std::io;
use std::ops::Range;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use bytes::Bytes;
use futures_util::StreamExt;
use object_store::path::Path;
use object_store::{Error, GetOptions, GetRange, ObjectMeta, ObjectStore, ObjectStoreExt};
use rayset::storage::transport::Transport;
use rayset::storage::{
    RangeError, RangeReader, RangeSink, RemoteOptions, RemoteStorage, RequestLimit, Storage,
};
use tokio::runtime::Runtime;

use super::connect::Client;
use super::place::ObjectAddress;
use super::{failure, tries};
use crate::cache::{self, BLOCK_BYTES, Cache, Key};
use crate::times::Times;

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

    /// A text that differs for another object; `None` if there is nothing to tell it by but the
    /// length.
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

/// What a look at an object has found.
pub(super) struct Look {
    pub(super) version: Version,
    /// Its first bytes; none, if they have not been read.
    pub(super) first: Bytes,
}

/// Looks at an object, and reads the first `bytes` of it at the same time.
pub(super) async fn look(
    client: &Client,
    place: &ObjectAddress,
    bytes: u64,
    times: Times,
) -> io::Result<Look> {
    let look = || look_once(&*client.store, &place.path, bytes);
    tries::attempts(times, &client.renewal, look).await.map_err(|failed| failed.in_words(&place.name))
}

/// Some servers, which then may say that there is nothing, and addresses that were signed for
/// reading, allow no look without a read; and only the answer to a read says in its body why it is
/// refused. An object without bytes, though, cannot be read.
async fn look_once(store: &dyn ObjectStore, path: &Path, bytes: u64) -> Result<Look, Error> {
    let first = GetOptions { range: Some(GetRange::Bounded(0..bytes.max(1))), ..GetOptions::default() };
    let refused = match store.get_opts(path, first).await {
        Ok(answer) => {
            let version = Version::of(&answer.meta);
            return Ok(Look { version, first: answer.bytes().await? });
        }
        Err(error) if failure::is_without_answer(&error) => return Err(error),
        Err(error) => error,
    };
    let meta = store.head(path).await.map_err(|_| refused)?;
    Ok(Look { version: Version::of(&meta), first: Bytes::new() })
}

/// An object that is read by ranges. It keeps the runtime alive that its requests run on.
pub(super) struct PinnedObject {
    remote: RemoteStorage,
    version: Version,
    /// What was read when it was looked at; empty from [`forget_first`](Self::forget_first) on.
    first: Mutex<Bytes>,
}

impl PinnedObject {
    pub(super) fn new(
        runtime: Arc<Runtime>,
        client: Client,
        place: ObjectAddress,
        Look { version, first }: Look,
        cache: Option<Arc<Cache>>,
        times: Times,
        limit: &Arc<RequestLimit>,
    ) -> io::Result<Self> {
        let length = version.length;
        let kept = cache.zip(version.text());
        let kept = kept.map(|(cache, text)| (cache, Key::new(&place.name, &text, length)));
        let ranges = Ranges { client, place, version: version.clone(), kept, patience: times.attempt };
        let reader = Reader { runtime, ranges: Arc::new(ranges) };
        let mut options = RemoteOptions::default();
        (options.timeout, options.attempts) = (times.attempt, times.attempts);
        (options.first_pause, options.longest_pause) = (times.first_pause, Times::LONGEST_PAUSE);
        // The last attempt has its time, too, before all of it is over.
        options.give_up_after = times.all.saturating_sub(times.attempt);
        let remote = RemoteStorage::within(limit, Arc::new(reader), length, options)?;
        Ok(Self { remote, version, first: Mutex::new(first) })
    }

    /// Frees what was read when it was looked at: it has been opened.
    pub(super) fn forget_first(&self) {
        *self.first() = Bytes::new();
    }

    fn first(&self) -> MutexGuard<'_, Bytes> {
        self.first.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Storage for PinnedObject {
    fn length(&self) -> io::Result<u64> {
        self.remote.length()
    }

    fn read_exact_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()> {
        let first = self.first().clone();
        let range = usize::try_from(offset).ok().and_then(|at| Some(at..at.checked_add(buffer.len())?));
        if let Some(read) = range.and_then(|range| first.get(range)) {
            buffer.copy_from_slice(read);
            return Ok(());
        }
        self.remote.read_exact_at(buffer, offset)
    }

    fn version(&self) -> Option<String> {
        self.version.text()
    }

    fn transport(&self) -> Option<Arc<dyn Transport>> {
        self.remote.transport()
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
    client: Client,
    place: ObjectAddress,
    version: Version,
    kept: Option<(Arc<Cache>, Key)>,
    /// How long an answer may take.
    patience: Duration,
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
    async fn request(&self, range: Range<u64>, take: impl FnMut(&Bytes) -> bool) -> Result<(), RangeError> {
        let name = &self.place.name;
        match tokio::time::timeout(self.patience, self.receive(range, take)).await {
            Ok(Ok(true)) => Ok(()),
            Ok(Ok(false)) => Err(failure::has_changed(name)),
            Ok(Err(error)) => Err(failure::of_range(&error, name)),
            Err(_) => Err(failure::of_range(&failure::no_answer(self.patience), name)),
        }
    }

    /// Returns whether the answer is about the object that was opened; its bytes are taken only
    /// then.
    async fn receive(&self, range: Range<u64>, mut take: impl FnMut(&Bytes) -> bool) -> Result<bool, Error> {
        let answer = self.client.renewal.with(|| {
            let range = Some(GetRange::Bounded(range.clone()));
            self.client.store.get_opts(&self.place.path, GetOptions { range, ..self.version.conditions() })
        });
        let answer = answer.await?;
        if !self.version.is_of(&answer.meta) {
            return Ok(false);
        }
        let mut parts = answer.into_stream();
        while let Some(part) = parts.next().await {
            if !take(&part?) {
                break;
            }
        }
        Ok(true)
    }
}
