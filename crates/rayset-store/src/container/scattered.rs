//! Pages that are read here and there: of a remote file many at a time, for each would take a round
//! trip.

use std::io;
use std::sync::{Arc, mpsc};

use super::file::{OpenError, OpenFile};
use super::header::SectionKind;
use crate::storage::transport::{Read, Transport};
use crate::storage::{PageBuffer, Storage};

/// Most bytes of pages that are read at a time.
const MOST_BYTES: usize = 1 << 20;

impl OpenFile {
    /// Passes some pages of a section of pages to `take`, in the order of `pages`: the number of
    /// each within the section, its offset in the file and its bytes, which have yet to be checked.
    ///
    /// # Errors
    /// The first error of `take`, or [`OpenError`] if there is no such page, or it cannot be read.
    pub fn each_of<E: From<OpenError>>(
        &self,
        kind: SectionKind,
        pages: &[u32],
        mut take: impl FnMut(u32, u64, &[u8]) -> Result<(), E>,
    ) -> Result<(), E> {
        let Some((storage, transport)) = self.remote() else {
            for &page in pages {
                let (offset, bytes) = self.page(kind, page)?;
                take(page, offset, &bytes)?;
            }
            return Ok(());
        };
        let at_a_time = (MOST_BYTES / self.header().page_bytes as usize).max(1);
        for pages in pages.chunks(at_a_time) {
            let offsets = pages.iter().map(|&page| self.page_offset(kind, page));
            let offsets: Vec<u64> = offsets.collect::<Result<_, OpenError>>()?;
            let read = read_all(&storage, &*transport, &offsets, self.header().page_bytes as usize);
            for ((&page, &offset), read) in pages.iter().zip(&offsets).zip(read) {
                let bytes = read.map_err(|error| self.ends_early(offset, error))?;
                take(page, offset, &bytes.bytes()[..self.header().page_bytes as usize])?;
            }
        }
        Ok(())
    }
}

/// Reads `bytes` bytes from each of some places at the same time; in their order.
fn read_all(
    storage: &Arc<dyn Storage>,
    transport: &dyn Transport,
    offsets: &[u64],
    bytes: usize,
) -> Vec<io::Result<PageBuffer>> {
    let (send, receive) = mpsc::channel();
    let reads = offsets.iter().enumerate().map(|(at, &offset)| {
        let send = send.clone();
        let done = Box::new(move |buffer: PageBuffer, outcome: io::Result<()>| {
            // Whoever has stopped waiting does not need it.
            let _ = send.send((at, outcome.map(|()| buffer)));
        });
        Read { storage: storage.clone(), offset, buffer: PageBuffer::new(bytes), done }
    });
    transport.submit(reads.collect());
    drop(send);
    let forgotten = || Err(io::Error::other("the storage has forgotten a read"));
    let mut read: Vec<io::Result<PageBuffer>> = offsets.iter().map(|_| forgotten()).collect();
    receive.iter().for_each(|(at, outcome)| read[at] = outcome);
    read
}
