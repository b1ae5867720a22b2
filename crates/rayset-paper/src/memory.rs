//! Memory that structures stand in: all of it there, or in pages that an operating system brings in when they are touched.

use std::ops::Deref;

use crate::cache::{CacheCounts, CacheError, RecordCache};
use crate::disk::Disk;
use crate::records::Work;
use crate::simulated::Clock;

/// Bytes that a program reads at addresses.
pub trait Memory {
    /// The bytes from an address on.
    ///
    /// # Errors
    /// [`CacheError`] where they cannot be had.
    fn read(&mut self, at: u64, bytes: usize) -> Result<&[u8], CacheError>;

    /// Lets counted time pass, where time is counted.
    fn work(&mut self, _work: Work) {}
}

/// Memory that is there, or that an operating system maps behind the program's back.
pub struct Flat<B>(pub B);

impl<B: Deref<Target = [u8]>> Memory for Flat<B> {
    fn read(&mut self, at: u64, bytes: usize) -> Result<&[u8], CacheError> {
        let beyond = CacheError::Beyond { at, bytes, end: self.0.len() as u64 };
        let range = usize::try_from(at).ok().and_then(|from| Some(from..from.checked_add(bytes)?));
        range.and_then(|range| self.0.get(range)).ok_or(beyond)
    }
}

/// Bytes of a page of the operating system.
pub const OS_PAGE_BYTES: usize = 4096;

/// Memory of which an operating system holds only some pages: demand paging, least recently used.
pub struct Paged {
    disk: Box<dyn Disk>,
    pages: RecordCache,
    clock: Clock,
    scratch: Vec<u8>,
    end: u64,
}

impl Paged {
    /// Over a disk of one file, the image of all memory, of `end` bytes and a whole number of pages.
    #[must_use]
    pub fn new(disk: Box<dyn Disk>, end: u64, memory_bytes: u64, clock: Clock) -> Self {
        let pages = RecordCache::new(0, OS_PAGE_BYTES, 1, (memory_bytes as usize / OS_PAGE_BYTES).max(1));
        Self { disk, pages, clock, scratch: Vec::new(), end }
    }

    /// What paging did.
    #[must_use]
    pub fn counts(&self) -> CacheCounts {
        self.pages.counts()
    }
}

impl Memory for Paged {
    fn read(&mut self, at: u64, bytes: usize) -> Result<&[u8], CacheError> {
        let width = OS_PAGE_BYTES as u64;
        let to = at.checked_add(bytes as u64).filter(|to| *to <= self.end);
        let to = to.ok_or(CacheError::Beyond { at, bytes, end: self.end })?;
        self.scratch.clear();
        let mut from = at;
        while from < to {
            let (page, in_page) = (from / width, (from % width) as usize);
            let taken = (to - from).min(width - in_page as u64) as usize;
            let slot = self.pages.retain(&mut *self.disk, page, 0)?;
            self.scratch.extend_from_slice(&self.pages.bytes(slot)[in_page..in_page + taken]);
            self.pages.release(slot);
            from += taken as u64;
        }
        Ok(&self.scratch)
    }

    fn work(&mut self, work: Work) {
        self.clock.advance(work.nanoseconds());
    }
}
