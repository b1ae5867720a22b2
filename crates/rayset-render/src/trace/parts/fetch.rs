//! Fetching the stored bytes of blocks: one block at a time from files, many at a time from objects
//! that are remote, where each costs a round trip.

use std::io;
use std::sync::Arc;
use std::thread::Builder;

use super::error::PartError;
use super::part::{Source, StoredBlock};
use rayset_store::storage::Storage;

/// Blocks that are fetched at a time from what is remote.
pub(super) const AT_A_TIME: usize = 16;
/// Most parts that stay open while they are read.
const OPEN_PARTS: usize = 128;

/// Where a block is.
#[derive(Clone, Copy, Default)]
pub(super) struct BlockPlace {
    pub(super) part: u32,
    pub(super) stored: StoredBlock,
}

/// Parts that are read; the first of them stay open.
pub(super) struct Fetcher {
    open: Vec<Option<Arc<dyn Storage>>>,
}

impl Fetcher {
    /// For so many parts.
    pub(super) fn of(parts: usize) -> Self {
        Self { open: vec![None; parts.min(OPEN_PARTS)] }
    }

    /// The bytes of blocks, each of a part, in their order, read at the same time. Their checksums
    /// have yet to be compared.
    pub(super) fn fetch(&mut self, blocks: &[(&Source, BlockPlace)]) -> Result<Vec<Vec<u8>>, PartError> {
        let mut reads = Vec::with_capacity(blocks.len());
        for &(source, entry) in blocks {
            reads.push((source, self.opened(source, entry.part as usize)?, entry.stored));
        }
        if let [(source, storage, stored)] = reads.as_slice() {
            return Ok(vec![read(source, &**storage, *stored)?]);
        }
        std::thread::scope(|scope| {
            let mut threads = Vec::with_capacity(reads.len());
            for (source, storage, stored) in &reads {
                let work = || read(source, &**storage, *stored);
                let thread = Builder::new().name("rayset-parts".into()).spawn_scoped(scope, work);
                threads.push((source, thread.map_err(|error| PartError::read(&source.name, error))?));
            }
            let panicked =
                |source: &Source| PartError::read(&source.name, io::Error::other("the storage panicked"));
            threads
                .into_iter()
                .map(|(source, thread)| thread.join().unwrap_or_else(|_| Err(panicked(source))))
                .collect()
        })
    }

    /// A part, ready to be read.
    fn opened(&mut self, source: &Source, part: usize) -> Result<Arc<dyn Storage>, PartError> {
        Ok(match self.open.get_mut(part) {
            None => source.open()?,
            Some(Some(storage)) => storage.clone(),
            Some(closed) => closed.insert(source.open()?).clone(),
        })
    }
}

/// The bytes of a block, whose checksum has yet to be compared.
pub(super) fn read(
    source: &Source,
    storage: &dyn Storage,
    stored: StoredBlock,
) -> Result<Vec<u8>, PartError> {
    let mut bytes = vec![0; stored.length as usize];
    source.read(storage, &mut bytes, stored.at)?;
    Ok(bytes)
}
