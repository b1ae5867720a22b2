//! Memory that structures stand in: all of it there, or in pages that an operating system brings in
//! when they are touched.

use std::ops::Deref;

use crate::cache::CacheError;
use crate::records::Work;
use crate::simulated::Clock;
use crate::swap::Swap;

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

/// Memory of which an operating system holds only some pages: demand paging, whose time is counted.
pub struct Paged<B> {
    all: Flat<B>,
    swap: Swap,
    clock: Clock,
}

impl<B: Deref<Target = [u8]>> Paged<B> {
    /// All of the memory, and what of it is there: `swap` counts by the same clock.
    #[must_use]
    pub fn new(all: B, swap: Swap, clock: Clock) -> Self {
        Self { all: Flat(all), swap, clock }
    }

    /// What is there.
    #[must_use]
    pub fn swap(&self) -> &Swap {
        &self.swap
    }
}

impl<B: Deref<Target = [u8]>> Memory for Paged<B> {
    fn read(&mut self, at: u64, bytes: usize) -> Result<&[u8], CacheError> {
        let found = self.all.read(at, bytes)?;
        self.swap.touch(at, bytes, false);
        Ok(found)
    }

    fn work(&mut self, work: Work) {
        self.clock.advance(work.nanoseconds());
    }
}
