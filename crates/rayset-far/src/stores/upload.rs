//! An object of a finished file: whole, or not at all.
//!
//! What is longer than [`PART_BYTES`] is sent in parts, which become an object only when the last of them is there. Until then a
//! small object beside it, its note, says which upload is under way, so that the next run to the same output can clear away
//! what a run that was killed has left behind.

use std::collections::HashMap;
use std::fs::File;
use std::future::Future;
use std::io;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use bytes::Bytes;
use futures_util::StreamExt;
use futures_util::stream;
use object_store::multipart::PartId;
use object_store::path::Path;
use object_store::{Error, ObjectStoreExt, PutPayload};
use rayset::storage::{FileStorage, Storage};

use super::connect::Writer;
use super::failure;
use super::place::Place;

/// Least bytes of a part.
const PART_BYTES: u64 = 8 << 20;
/// Most parts; services allow 10 000.
const MOST_PARTS: u64 = 9_000;
/// Parts that are sent at a time.
const AT_A_TIME: usize = 8;
/// Attempts at each request.
const ATTEMPTS: u32 = 6;
/// The pause after the first failure, which doubles.
const FIRST_PAUSE: Duration = Duration::from_millis(250);
/// Longest note that is read.
const LONGEST_NOTE: u64 = 64 << 10;

/// The uploads that are under way, by the names of their objects.
#[derive(Clone, Default)]
pub(super) struct Uploads(Arc<Mutex<HashMap<String, String>>>);

impl Uploads {
    fn begin(&self, place: &Place, id: &str) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).insert(place.name.clone(), id.to_owned());
    }

    fn end(&self, place: &Place) -> Option<String> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).remove(&place.name)
    }
}

/// Clears away what a run that was killed has left behind, and makes sure that the bucket can be written to.
pub(super) async fn prepare(writer: Writer, place: Place) -> io::Result<()> {
    let said = |error: Error| failure::in_words(&error, &place.name);
    let note = note_of(&place);
    match attempts(|| writer.store.get(&note)).await {
        Ok(found) if found.meta.size <= LONGEST_NOTE => {
            let text = found.bytes().await.map_err(said)?;
            let id = String::from_utf8_lossy(&text).trim().to_owned();
            if !id.is_empty() {
                clear(&writer, &place.path, &id).await.map_err(said)?;
            }
        }
        Ok(_) | Err(Error::NotFound { .. }) => {}
        Err(error) => return Err(said(error)),
    }
    // Hours of work must not end with a refusal.
    attempts(|| writer.store.put(&note, PutPayload::new())).await.map_err(said)?;
    attempts(|| writer.store.delete(&note)).await.map_err(said)?;
    Ok(())
}

/// Sends a file.
pub(super) async fn put(writer: Writer, place: Place, file: File, uploads: Uploads) -> io::Result<()> {
    let file = Arc::new(FileStorage::from(file));
    let length = file.length()?;
    let said = |error: Error| failure::in_words(&error, &place.name);
    if length <= PART_BYTES {
        let bytes = read(file, 0, length).await?;
        return attempts(|| writer.store.put(&place.path, bytes.clone().into()))
            .await
            .map(drop)
            .map_err(said);
    }
    let id = attempts(|| writer.parts.create_multipart(&place.path)).await.map_err(said)?;
    uploads.begin(&place, &id);
    let note = note_of(&place);
    let work = async {
        attempts(|| writer.store.put(&note, id.clone().into())).await.map_err(said)?;
        let parts = send_parts(&writer, &place, &id, &file, length).await?;
        let completed = attempts(|| writer.parts.complete_multipart(&place.path, &id, parts.clone())).await;
        match completed {
            // The answer to an attempt that succeeded may have been lost.
            Err(error) if is_gone(&error) && is_there(&writer, &place.path, length).await => Ok(()),
            completed => completed.map(drop).map_err(said),
        }
    };
    let outcome = work.await;
    if outcome.is_err() {
        // The first error is the one to be told.
        let _ = clear(&writer, &place.path, &id).await;
    }
    let removed = attempts(|| writer.store.delete(&note)).await;
    uploads.end(&place);
    outcome?;
    removed.map(drop).or_else(none_there).map_err(said)
}

/// Gives up an upload of this process.
pub(super) async fn abandon(writer: Writer, place: Place, uploads: Uploads) {
    if let Some(id) = uploads.end(&place) {
        let _ = clear(&writer, &place.path, &id).await;
        let _ = writer.store.delete(&note_of(&place)).await;
    }
}

async fn send_parts(
    writer: &Writer,
    place: &Place,
    id: &String,
    file: &Arc<FileStorage>,
    length: u64,
) -> io::Result<Vec<PartId>> {
    let bytes = PART_BYTES.max(length.div_ceil(MOST_PARTS).next_multiple_of(1 << 20));
    let count = length.div_ceil(bytes);
    let mut sent = stream::iter(0..count)
        .map(|index| async move {
            let start = index * bytes;
            let content = read(file.clone(), start, bytes.min(length - start)).await?;
            let put = || writer.parts.put_part(&place.path, id, index as usize, content.clone().into());
            attempts(put).await.map_err(|error| failure::in_words(&error, &place.name))
        })
        .buffered(AT_A_TIME);
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
async fn clear(writer: &Writer, path: &Path, id: &String) -> Result<(), Error> {
    attempts(|| writer.parts.abort_multipart(path, id)).await.or_else(none_there)
}

fn none_there(error: Error) -> Result<(), Error> {
    if is_gone(&error) { Ok(()) } else { Err(error) }
}

/// Whether there is no such object or upload.
fn is_gone(error: &Error) -> bool {
    matches!(error, Error::NotFound { .. }) || error.to_string().contains("NoSuchUpload")
}

/// Whether there is an object of a length.
async fn is_there(writer: &Writer, path: &Path, length: u64) -> bool {
    attempts(|| writer.store.head(path)).await.is_ok_and(|found| found.size == length)
}

/// The object that notes the upload.
fn note_of(place: &Place) -> Path {
    Path::from(format!("{}.rayset-upload", place.path))
}

/// Tries until it succeeds, or fails for good.
async fn attempts<T, F: Future<Output = Result<T, Error>>>(mut work: impl FnMut() -> F) -> Result<T, Error> {
    let mut pause = FIRST_PAUSE;
    for _ in 1..ATTEMPTS {
        match work().await {
            Err(error) if failure::may_pass(&error) => {}
            outcome => return outcome,
        }
        tokio::time::sleep(pause).await;
        pause *= 2;
    }
    work().await
}
