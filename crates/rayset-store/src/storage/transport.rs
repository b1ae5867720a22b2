//! What to read from ([`Storage`]), and how ([`Transport`]).
//!
//! A transport takes batches and completes each read on any thread. None of this can change a
//! picture.

use std::fs::File;
use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::Duration;

use super::buffer::PageBuffer;
use super::cached::read_if_cached;

/// Bytes that can be read at a position, by several threads at once: a file, bytes in memory, an
/// object store.
pub trait Storage: Send + Sync {
    /// The number of bytes.
    ///
    /// # Errors
    /// The system's error.
    fn length(&self) -> io::Result<u64>;

    /// Fills `buffer` with the bytes that start at `offset`.
    ///
    /// # Errors
    /// The system's error, or `UnexpectedEof`.
    fn read_exact_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()>;

    /// The underlying file, if there is one that the kernel may read from directly.
    fn file(&self) -> Option<&File> {
        None
    }

    /// All of its bytes, if they are already in memory: pages are then used in place, without a
    /// copy, and do not count towards any budget.
    fn memory(&self) -> Option<Arc<dyn AsRef<[u8]> + Send + Sync>> {
        None
    }

    /// What tells it from another object that had or will have the same name, such as the entity
    /// tag of an object store. `None` for what cannot be replaced while it is open.
    fn version(&self) -> Option<String> {
        None
    }

    /// Its own way of carrying out many reads at once. `None` if it has none: its reads are then
    /// carried out, one after another or by several threads, as those of local files are.
    #[doc(hidden)]
    fn transport(&self) -> Option<Arc<dyn Transport>> {
        None
    }
}

/// How reads of files are carried out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum BackendKind {
    /// io_uring if the system supports it, otherwise the pool.
    #[default]
    Auto,
    /// io_uring or an error.
    Uring,
    /// A pool of threads that use positioned reads.
    Pool,
}

/// The error for a file that is shorter than it was or should be.
pub(super) fn ends_early(end: u64, wanted: u64) -> io::Error {
    let what = format!("the file ends at byte {end}, before byte {wanted}, up to which it is needed");
    io::Error::new(io::ErrorKind::UnexpectedEof, what)
}

/// Called when a read has ended, with the buffer and the outcome.
pub type Completion = Box<dyn FnOnce(PageBuffer, io::Result<()>) + Send>;

/// A request to fill a buffer.
pub struct Read {
    /// What to read from.
    pub storage: Arc<dyn Storage>,
    /// Offset in the storage, in bytes.
    pub offset: u64,
    /// The buffer to fill completely.
    pub buffer: PageBuffer,
    /// Must be called exactly once, when the read has ended.
    pub done: Completion,
}

impl Read {
    /// Carries out the request on the calling thread.
    pub fn run(mut self) {
        // Storages may be user code: one that panics must not leave threads waiting forever.
        let read = AssertUnwindSafe(|| self.storage.read_exact_at(self.buffer.bytes_mut(), self.offset));
        let outcome = catch_unwind(read).unwrap_or_else(|_| Err(io::Error::other("the storage panicked")));
        (self.done)(self.buffer, outcome);
    }

    /// Carries out the request on the calling thread if that needs no disk; otherwise returns it.
    ///
    /// # Errors
    /// The request, if it was not carried out.
    pub fn run_if_cached(mut self) -> Result<(), Self> {
        let cached = |file: &File| read_if_cached(file, self.buffer.bytes_mut(), self.offset);
        if !self.storage.file().is_some_and(cached) {
            return Err(self);
        }
        (self.done)(self.buffer, Ok(()));
        Ok(())
    }
}

/// A way to carry out reads.
pub trait Transport: Send + Sync {
    /// Starts a batch of reads, most urgent first, and returns without waiting for them.
    fn submit(&self, batch: Vec<Read>);
    /// Starts a read for which the caller will wait. What the page cache has may be read on the
    /// calling thread, which saves waking two threads.
    fn submit_awaited(&self, read: Read) {
        self.submit(vec![read]);
    }
    /// The name of the transport in reports.
    fn name(&self) -> String;
    /// The usual time of a request, if it is measured.
    fn latency(&self) -> Option<Duration> {
        None
    }
    /// Whether requests take so long that many of them should be in flight, long before rays need
    /// what they bring.
    fn is_remote(&self) -> bool {
        false
    }
    /// Memory that requests take at most besides the buffers that they fill, those of all
    /// transports together that share a limit.
    fn memory_bytes(&self) -> u64 {
        0
    }
}
