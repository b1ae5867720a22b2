//! An object of a finished file: whole, or not at all.
//!
//! What is longer than [`PART_BYTES`] is sent in parts, which become an object only when the last
//! of them is there. Until then a small object beside it, its note, says which upload is under way,
//! so that the next run to the same output can clear away what a run that was killed has left
//! behind. The note is there, empty, before an upload begins: where it says no more, the bucket is
//! asked for the uploads of this object.

use std::collections::HashMap;
use std::fs::File;
use std::future::Future;
use std::io;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use bytes::Bytes;
use futures_util::StreamExt;
use futures_util::stream;
use object_store::multipart::PartId;
use object_store::path::Path;
use object_store::{Error, ObjectStoreExt, PutPayload};
use rayset::storage::{FileStorage, Storage};

use super::connect::Writer;
use super::place::ObjectAddress;
use super::tries::{self, Failure};

/// Least bytes of a part.
const PART_BYTES: u64 = 8 << 20;
/// Most parts; services allow 10 000.
const MOST_PARTS: u64 = 9_000;
/// Bytes of the parts that are sent at a time, which lie in memory, if nobody says otherwise.
pub(super) const USUAL_SENDING_BYTES: u64 = 64 << 20;
/// Bytes with which a request counts as one that sends none.
const FEW_BYTES: u64 = 64 << 10;
/// Longest note that is read.
const LONGEST_NOTE: u64 = 64 << 10;

/// The uploads that are under way, by the names of their objects; their identities are empty until
/// they are known.
#[derive(Clone, Default)]
pub(super) struct Uploads(Arc<Mutex<HashMap<String, String>>>);

impl Uploads {
    fn begin(&self, place: &ObjectAddress, id: &str) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).insert(place.name.clone(), id.to_owned());
    }

    fn end(&self, place: &ObjectAddress) -> Option<String> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).remove(&place.name)
    }
}

impl Writer {
    /// Tries a request that sends a number of bytes.
    async fn send<T, F: Future<Output = Result<T, Error>>>(
        &self,
        bytes: u64,
        work: impl FnMut() -> F,
    ) -> Result<T, Failure> {
        let times = if bytes > FEW_BYTES { self.times.sending(bytes) } else { self.times };
        tries::attempts(times, &self.renewal, work).await
    }

    /// Tries a request that sends hardly anything.
    async fn ask<T, F: Future<Output = Result<T, Error>>>(
        &self,
        work: impl FnMut() -> F,
    ) -> Result<T, Failure> {
        tries::attempts(self.times, &self.renewal, work).await
    }
}

/// Clears away what a run that was killed has left behind, and makes sure that the bucket can be
/// written to.
pub(super) async fn prepare(writer: Writer, place: ObjectAddress) -> io::Result<()> {
    let said = |failed: Failure| failed.in_words(&place.name);
    let note = note_of(&place);
    let read = || async {
        let found = writer.store.get(&note).await?;
        if found.meta.size > LONGEST_NOTE { Ok(Bytes::new()) } else { found.bytes().await }
    };
    match writer.ask(read).await {
        Ok(text) => {
            let id = String::from_utf8_lossy(&text).trim().to_owned();
            if id.is_empty() {
                clear_unknown(&writer, &place.path, None).await;
            } else {
                clear(&writer, &place.path, &id).await.map_err(said)?;
            }
        }
        Err(failed) if matches!(failed.error, Error::NotFound { .. }) => {}
        Err(failed) => return Err(said(failed)),
    }
    // Hours of work must not end with a refusal.
    writer.ask(|| writer.store.put(&note, PutPayload::new())).await.map_err(said)?;
    writer.ask(|| writer.store.delete(&note)).await.or_else(none_there).map_err(said)
}

/// Sends a file, in parts of which as many are sent at a time as have `sending_bytes` together, at
/// least one.
pub(super) async fn put(
    writer: Writer,
    place: ObjectAddress,
    file: File,
    uploads: Uploads,
    sending_bytes: u64,
) -> io::Result<()> {
    let file = Arc::new(FileStorage::from(file));
    let length = file.length()?;
    let said = |failed: Failure| failed.in_words(&place.name);
    if length <= PART_BYTES {
        let bytes = read(file, 0, length).await?;
        let sent = writer.send(length, || writer.store.put(&place.path, bytes.clone().into())).await;
        return sent.map(drop).map_err(said);
    }
    let note = note_of(&place);
    uploads.begin(&place, "");
    let begun = match writer.ask(|| writer.store.put(&note, PutPayload::new())).await {
        Ok(_) => begin(&writer, &place.path).await,
        Err(failed) => Err(failed),
    };
    let id = match begun {
        Ok(id) => id,
        Err(error) => {
            // The first error is the one to be told.
            let _ = writer.ask(|| writer.store.delete(&note)).await;
            uploads.end(&place);
            return Err(said(error));
        }
    };
    uploads.begin(&place, &id);
    let work = async {
        writer.ask(|| writer.store.put(&note, id.clone().into())).await.map_err(said)?;
        let parts = send_parts(&writer, &place, &id, &file, sending_bytes).await?;
        // Services put many parts together in minutes, and are silent meanwhile.
        let complete = || writer.parts.complete_multipart(&place.path, &id, parts.clone());
        match tries::attempts(writer.times.patient(), &writer.renewal, complete).await {
            // The answer to an attempt that succeeded may have been lost.
            Err(failed) if is_gone(&failed.error) && is_there(&writer, &place.path, length).await => Ok(()),
            completed => completed.map(drop).map_err(said),
        }
    };
    if let Err(error) = work.await {
        // The first error is the one to be told, and soon.
        let clear_away = async {
            let _ = clear(&writer, &place.path, &id).await;
            let _ = writer.ask(|| writer.store.delete(&note)).await;
        };
        let _ = tokio::time::timeout(writer.times.attempt, clear_away).await;
        uploads.end(&place);
        return Err(error);
    }
    let removed = writer.ask(|| writer.store.delete(&note)).await;
    uploads.end(&place);
    removed.or_else(none_there).map_err(said)
}

/// Begins an upload.
async fn begin(writer: &Writer, path: &Path) -> Result<String, Failure> {
    let tried = AtomicU32::new(0);
    let begun = writer
        .ask(|| {
            tried.fetch_add(1, Ordering::Relaxed);
            writer.parts.create_multipart(path)
        })
        .await;
    // An attempt whose answer was lost may have begun another one.
    if tried.into_inner() > 1 {
        clear_unknown(writer, path, begun.as_ref().ok()).await;
    }
    begun
}

/// Clears away the uploads of an object other than one, where they can be found. That they cannot
/// is no error: they are not in the way.
async fn clear_unknown(writer: &Writer, path: &Path, except: Option<&String>) {
    let Some(pending) = &writer.pending else { return };
    for id in writer.ask(|| pending.of(path)).await.unwrap_or_default() {
        if Some(&id) != except {
            let _ = clear(writer, path, &id).await;
        }
    }
}

/// Gives up an upload of this process.
pub(super) async fn abandon(writer: Writer, place: ObjectAddress, uploads: Uploads) {
    if let Some(id) = uploads.end(&place) {
        if id.is_empty() {
            clear_unknown(&writer, &place.path, None).await;
        } else {
            let _ = clear(&writer, &place.path, &id).await;
        }
        let _ = writer.store.delete(&note_of(&place)).await;
    }
}

async fn send_parts(
    writer: &Writer,
    place: &ObjectAddress,
    id: &String,
    file: &Arc<FileStorage>,
    sending_bytes: u64,
) -> io::Result<Vec<PartId>> {
    let length = file.length()?;
    let bytes = PART_BYTES.max(length.div_ceil(MOST_PARTS).next_multiple_of(1 << 20));
    let count = length.div_ceil(bytes);
    let mut sent = stream::iter(0..count)
        .map(|index| async move {
            let start = index * bytes;
            let content = read(file.clone(), start, bytes.min(length - start)).await?;
            let put = || writer.parts.put_part(&place.path, id, index as usize, content.clone().into());
            writer.send(content.len() as u64, put).await.map_err(|failed| failed.in_words(&place.name))
        })
        .buffered(usize::try_from(sending_bytes / bytes).unwrap_or(1).max(1));
    let mut parts = Vec::new();
    while let Some(part) = sent.next().await {
        parts.push(part?);
    }
    Ok(parts)
}

async fn read(file: Arc<FileStorage>, start: u64, length: u64) -> io::Result<Bytes> {
    let read = move || {
        let mut bytes = vec![0; usize::try_from(length).map_err(io::Error::other)?];
        file.read_exact_at(&mut bytes, start)?;
        Ok(Bytes::from(bytes))
    };
    tokio::task::spawn_blocking(read).await.map_err(io::Error::other)?
}

/// Removes the parts of an upload; it is no error if there are none.
async fn clear(writer: &Writer, path: &Path, id: &String) -> Result<(), Failure> {
    writer.ask(|| writer.parts.abort_multipart(path, id)).await.or_else(none_there)
}

fn none_there(failed: Failure) -> Result<(), Failure> {
    if is_gone(&failed.error) { Ok(()) } else { Err(failed) }
}

/// Whether there is no such object or upload.
fn is_gone(error: &Error) -> bool {
    matches!(error, Error::NotFound { .. }) || error.to_string().contains("NoSuchUpload")
}

/// Whether there is an object of a length.
async fn is_there(writer: &Writer, path: &Path, length: u64) -> bool {
    writer.ask(|| writer.store.head(path)).await.is_ok_and(|found| found.size == length)
}

/// The object that notes the upload.
fn note_of(place: &ObjectAddress) -> Path {
    Path::from(format!("{}.rayset-upload", place.path))
}
