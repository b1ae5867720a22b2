//! How local files are read: by a ring of io_uring, or a pool of threads.

use std::io;
use std::sync::Arc;

pub use super::delayed::Delayed;
pub use super::file::FileStorage;
pub use super::memory::MemoryStorage;
pub use super::pool::Pool;
pub use super::transport::{BackendKind, Completion, Read, Storage, Transport};
#[cfg(target_os = "linux")]
pub use super::uring::Uring;

/// Most reads in flight at once through io_uring.
pub const DEPTH: usize = 32;
/// Threads of the pool: enough to keep a disk busy, few enough to need little memory.
const POOL_THREADS: usize = 16;

/// Makes a backend.
///
/// # Errors
/// The system's error, if io_uring is requested explicitly and is not available.
pub fn backend(kind: BackendKind) -> io::Result<Arc<dyn Transport>> {
    let pool = || Arc::new(Pool::new(POOL_THREADS)) as Arc<dyn Transport>;
    #[cfg(target_os = "linux")]
    {
        let uring = || Uring::new(DEPTH as u32).map(|u| Arc::new(u) as Arc<dyn Transport>);
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
    use crate::storage::PageBuffer;
    use crate::storage::cached::read_if_cached;

    type Answer = (ThreadId, Vec<u8>, Result<(), io::ErrorKind>);

    /// Carries out an awaited read of 4096 bytes: by which thread, what, and the outcome.
    fn awaited(backend: &dyn Transport, storage: &Arc<FileStorage>, offset: u64) -> Answer {
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
