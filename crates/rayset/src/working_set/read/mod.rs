//! Reading pages: what to read from ([`Storage`]), and how ([`ReadBackend`]).
//!
//! A backend takes batches and completes each read on any thread. None of this can change a picture.

mod delayed;
mod pool;
#[cfg(target_os = "linux")]
#[expect(
    unsafe_code,
    reason = "requests handed to the kernel point into memory that this module keeps alive"
)]
mod uring;

use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

pub use self::delayed::Delayed;
pub use self::pool::Pool;
#[cfg(target_os = "linux")]
pub use self::uring::Uring;
use super::PageBuffer;
pub use crate::storage::{BackendKind, FileStorage, MemoryStorage, Storage};

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
}

/// A way to carry out reads.
pub trait ReadBackend: Send + Sync {
    /// Starts a batch of reads, most urgent first, and returns without waiting for them.
    fn submit(&self, batch: Vec<Read>);
    /// The name of the backend in reports.
    fn name(&self) -> String;
}

/// Most reads in flight at once through io_uring.
pub const DEPTH: usize = 32;
/// Threads of the pool: enough to keep a disk busy, few enough to need little memory.
const POOL_THREADS: usize = 16;

/// Makes a backend.
///
/// # Errors
/// The system's error, if io_uring is requested explicitly and is not available.
pub fn backend(kind: BackendKind) -> io::Result<Arc<dyn ReadBackend>> {
    let pool = || Arc::new(Pool::new(POOL_THREADS)) as Arc<dyn ReadBackend>;
    #[cfg(target_os = "linux")]
    {
        let uring = || Uring::new(DEPTH as u32).map(|u| Arc::new(u) as Arc<dyn ReadBackend>);
        match kind {
            BackendKind::Auto => Ok(uring().unwrap_or_else(|_| pool())),
            BackendKind::Uring => uring(),
            BackendKind::Pool => Ok(pool()),
        }
    }
    #[cfg(not(target_os = "linux"))]
    match kind {
        BackendKind::Uring => Err(io::Error::new(io::ErrorKind::Unsupported, "io_uring is a Linux facility")),
        BackendKind::Auto | BackendKind::Pool => Ok(pool()),
    }
}
