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

use std::fs::File;
use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

pub use self::delayed::Delayed;
pub use self::pool::Pool;
#[cfg(target_os = "linux")]
pub use self::uring::Uring;
use super::PageBuffer;
use crate::storage::read_if_cached;
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
pub trait ReadBackend: Send + Sync {
    /// Starts a batch of reads, most urgent first, and returns without waiting for them.
    fn submit(&self, batch: Vec<Read>);
    /// Starts a read for which the caller will wait. What the page cache has may be read on the calling thread, which saves
    /// waking two threads.
    fn submit_awaited(&self, read: Read) {
        self.submit(vec![read]);
    }
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

#[cfg(test)]
mod tests {
    use std::io::Write;
    use std::sync::mpsc;
    use std::thread::{self, ThreadId};
    use std::time::Duration;

    use super::*;

    type Answer = (ThreadId, Vec<u8>, Result<(), io::ErrorKind>);

    /// Carries out an awaited read of 4096 bytes: by which thread, what, and the outcome.
    fn awaited(backend: &dyn ReadBackend, storage: &Arc<FileStorage>, offset: u64) -> Answer {
        let (send, receive) = mpsc::channel();
        let done = Box::new(move |buffer: PageBuffer, outcome: io::Result<()>| {
            let answer = (thread::current().id(), buffer.bytes().to_vec(), outcome.map_err(|e| e.kind()));
            let _ = send.send(answer);
        });
        let read = Read { storage: storage.clone(), offset, buffer: PageBuffer::new(4096), done };
        backend.submit_awaited(read);
        receive.recv_timeout(Duration::from_secs(20)).expect("an answer")
    }

    #[test]
    fn an_awaited_read_of_what_the_page_cache_has_is_done_on_the_calling_thread() {
        let mut file = tempfile::NamedTempFile::new().expect("a temporary file");
        file.write_all(&[[3; 4096], [7; 4096]].concat()).expect("a write");
        file.write_all(&[9; 100]).expect("a write");
        let storage = Arc::new(FileStorage::open(file.path(), false).expect("it opens"));
        let direct = Arc::new(FileStorage::open(file.path(), true).expect("it opens"));
        let tells = read_if_cached(file.as_file(), &mut [0; 4096], 0);
        if !tells {
            let _ = writeln!(io::stderr(), "reads of the page cache: this system cannot tell what it has");
        }
        for kind in [BackendKind::Pool, BackendKind::Auto] {
            let backend = backend(kind).expect("a backend");
            for (offset, byte) in [(0, 3), (4096, 7)] {
                let (by, bytes, outcome) = awaited(&*backend, &storage, offset);
                assert_eq!(outcome, Ok(()), "{kind:?}");
                assert!(bytes.iter().all(|&b| b == byte), "{kind:?}, at {offset}");
                assert_eq!(by == thread::current().id(), tells, "{kind:?}, at {offset}");
                assert!(awaited(&*backend, &direct, offset).1.iter().all(|&b| b == byte), "{kind:?}");
            }
            let outcome = awaited(&*backend, &storage, 8192).2;
            assert_eq!(outcome, Err(io::ErrorKind::UnexpectedEof), "{kind:?}: 100 bytes are no page");
        }
    }
}
