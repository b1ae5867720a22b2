//! io_uring: one thread, one ring, a whole batch per system call.

use std::collections::VecDeque;
use std::io;
use std::os::fd::{AsRawFd, OwnedFd};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread::JoinHandle;

use io_uring::{IoUring, opcode, types};
use rustix::event::{EventfdFlags, eventfd};

use super::transport::{Read, Transport};

#[derive(Default)]
struct Queue {
    reads: VecDeque<Read>,
    /// The thread has nothing to do and must be woken.
    asleep: bool,
    /// The thread waits for reads to end, but can start others at once if it is notified of them.
    reaping: bool,
    closed: bool,
}

struct Shared {
    queue: Mutex<Queue>,
    filled: Condvar,
    /// Notifies a thread that waits in the kernel of new reads.
    bell: OwnedFd,
}

/// The event to wait for: the bell has become readable.
const POLLIN: u32 = 1;
/// Marks the completion of a wait for the bell.
const BELL: u64 = u64::MAX;

/// Reads through io_uring.
pub struct Uring {
    shared: Arc<Shared>,
    thread: Vec<JoinHandle<()>>,
}

impl Uring {
    /// Opens a ring for `depth` reads in flight.
    ///
    /// # Errors
    /// The system's error; old kernels and some containers have no io_uring.
    pub fn new(depth: u32) -> io::Result<Self> {
        // One more for the bell.
        let ring = IoUring::new((depth + 1).next_power_of_two())?;
        let mut probe = io_uring::Probe::new();
        ring.submitter().register_probe(&mut probe)?;
        if !probe.is_supported(opcode::Read::CODE) || !probe.is_supported(opcode::PollAdd::CODE) {
            return Err(io::Error::new(io::ErrorKind::Unsupported, "this kernel's io_uring cannot read"));
        }
        // Some systems allow a ring to be created but not to be used.
        ring.submit()?;
        let bell = eventfd(0, EventfdFlags::CLOEXEC)?;
        let shared = Arc::new(Shared { queue: Mutex::default(), filled: Condvar::new(), bell });
        let of_thread = shared.clone();
        let flight = (0..depth).map(|_| None).collect();
        let thread = std::thread::Builder::new()
            .name("rayset-uring".into())
            .stack_size(128 << 10)
            .spawn(move || Driver { ring, shared: of_thread, flight, flying: 0, listening: false }.serve())?;
        Ok(Self { shared, thread: vec![thread] })
    }
}

/// The thread's own state. Requests in `flight` own the memory that the kernel writes to.
struct Driver {
    ring: IoUring,
    shared: Arc<Shared>,
    flight: Vec<Option<Read>>,
    flying: usize,
    /// A wait for the bell is in the ring.
    listening: bool,
}

impl Driver {
    fn serve(mut self) {
        let shared = self.shared.clone();
        loop {
            let mut queue = shared.queue.lock().unwrap_or_else(PoisonError::into_inner);
            while queue.reads.is_empty() && self.flying == 0 {
                if queue.closed {
                    return;
                }
                queue.asleep = true;
                queue = shared.filled.wait(queue).unwrap_or_else(PoisonError::into_inner);
            }
            queue.asleep = false;
            let room = self.flight.len() - self.flying;
            let count = room.min(queue.reads.len());
            let batch: Vec<Read> = queue.reads.drain(..count).collect();
            // Without room for more reads there is no need to be notified.
            queue.reaping = self.flying + count < self.flight.len();
            drop(queue);
            batch.into_iter().for_each(|read| self.start(read));
            if self.flying > 0 {
                self.listen();
                self.reap();
            }
        }
    }

    /// Makes the ring complete a request when the bell rings.
    fn listen(&mut self) {
        if self.listening {
            return;
        }
        let bell = types::Fd(self.shared.bell.as_raw_fd());
        let entry = opcode::PollAdd::new(bell, POLLIN).build().user_data(BELL);
        // SAFETY: the entry refers to no memory, and to a file that `shared` keeps open as long as
        // the ring lives. The queue has room for one entry besides those of `flight`, and no second
        // wait is ever in it.
        self.listening = unsafe { self.ring.submission().push(&entry) }.is_ok();
    }

    /// Resets the bell after it has rung.
    fn heard(&mut self) {
        self.listening = false;
        let mut count = [0; 8];
        // It holds a count, so this does not block; the value of the count does not matter.
        let _ = rustix::io::read(&self.shared.bell, &mut count);
    }

    fn start(&mut self, mut read: Read) {
        let place = self.flight.iter().position(Option::is_none);
        let (Some(fd), Some(place)) = (read.storage.file().map(AsRawFd::as_raw_fd), place) else {
            // The storage is not a file that the kernel can read.
            return read.run();
        };
        let bytes = read.buffer.bytes_mut();
        let entry = opcode::Read::new(types::Fd(fd), bytes.as_mut_ptr(), bytes.len() as u32)
            .offset(read.offset)
            .build()
            .user_data(place as u64);
        // The buffer's memory is on the heap, so moving `read` does not move it.
        self.flight[place] = Some(read);
        self.flying += 1;
        // SAFETY: the entry points into the buffer and names the file of `self.flight[place]`, both
        // of which stay alive and untouched until the completion of this very request is reaped:
        // `flight[place]` is cleared only in `finish`, and dropping the `Driver`, also when
        // unwinding, first waits until nothing is flying. The queue has room for `flight.len()`
        // entries besides the wait for the bell, and no more are ever unsubmitted.
        let pushed = unsafe { self.ring.submission().push(&entry) };
        if pushed.is_err() {
            self.fall_back(place);
        }
    }

    /// Submits what is queued, waits for at least one completion, and handles all completions there
    /// are.
    fn reap(&mut self) {
        loop {
            match self.ring.submit_and_wait(1) {
                Ok(_) => break,
                Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                // The kernel has accepted nothing or is short of memory for the moment; handling
                // completions frees some.
                Err(_) if !self.ring.completion().is_empty() => break,
                Err(_) => std::thread::yield_now(),
            }
        }
        let done: Vec<(u64, i32)> = self.ring.completion().map(|c| (c.user_data(), c.result())).collect();
        for (place, result) in done {
            if place == BELL { self.heard() } else { self.finish(place as usize, result) }
        }
    }

    fn finish(&mut self, place: usize, result: i32) {
        let Some(read) = self.flight[place].take() else { return };
        self.flying -= 1;
        let wanted = read.buffer.bytes().len();
        if result < 0 {
            (read.done)(read.buffer, Err(io::Error::from_raw_os_error(-result)));
        } else if (result as usize) < wanted {
            // A short read: at the end of the file, or interrupted. Reading again shows which.
            read.run();
        } else {
            (read.done)(read.buffer, Ok(()));
        }
    }

    fn fall_back(&mut self, place: usize) {
        if let Some(read) = self.flight[place].take() {
            self.flying -= 1;
            read.run();
        }
    }
}

impl Drop for Driver {
    fn drop(&mut self) {
        // The kernel may still write to the buffers of what is flying.
        while self.flying > 0 {
            self.reap();
        }
    }
}

impl Transport for Uring {
    fn submit(&self, batch: Vec<Read>) {
        let mut queue = self.shared.queue.lock().unwrap_or_else(PoisonError::into_inner);
        queue.reads.extend(batch);
        let asleep = queue.asleep;
        let reaping = std::mem::take(&mut queue.reaping);
        drop(queue);
        if asleep {
            self.shared.filled.notify_one();
        } else if reaping {
            // Any number rings the bell. If this fails, the reads start when one in flight ends.
            let _ = rustix::io::write(&self.shared.bell, &1_u64.to_le_bytes());
        }
    }

    fn submit_awaited(&self, read: Read) {
        if let Err(read) = read.run_if_cached() {
            self.submit(vec![read]);
        }
    }

    fn name(&self) -> String {
        "io_uring".into()
    }
}

impl Drop for Uring {
    fn drop(&mut self) {
        self.shared.queue.lock().unwrap_or_else(PoisonError::into_inner).closed = true;
        self.shared.filled.notify_one();
        super::pool::join(&mut self.thread);
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;
    use std::sync::mpsc;
    use std::time::Duration;

    use super::*;
    use crate::storage::{FileStorage, PageBuffer};

    #[test]
    fn a_read_that_ends_with_the_file_is_an_error_and_no_whole_page() {
        let Ok(ring) = Uring::new(4) else {
            let _ = writeln!(io::stderr(), "short reads of io_uring: skipped, for there is none here");
            return;
        };
        let mut file = tempfile::NamedTempFile::new().expect("a temporary file");
        file.write_all(&[7; 6000]).expect("a write");
        let storage = Arc::new(FileStorage::open(file.path(), false).expect("it opens"));
        let read = |offset| {
            let (send, receive) = mpsc::channel();
            let done = Box::new(move |buffer: PageBuffer, outcome: io::Result<()>| {
                let _ = send.send((buffer.bytes().to_vec(), outcome.map_err(|e| e.kind())));
            });
            ring.submit(vec![Read { storage: storage.clone(), offset, buffer: PageBuffer::new(4096), done }]);
            receive.recv_timeout(Duration::from_secs(20)).expect("an answer")
        };
        let (bytes, outcome) = read(0);
        assert_eq!(outcome, Ok(()));
        assert!(bytes.iter().all(|&b| b == 7));
        for offset in [4096, 5999, 6000, 1 << 40] {
            assert_eq!(read(offset).1, Err(io::ErrorKind::UnexpectedEof), "at {offset}");
        }
    }
}
