//! Asynchronous reads: from the disk there is, and from one of the paper's day.

use std::cell::Cell;
use std::collections::HashMap;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::PathBuf;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::Instant;

use rayset::working_set::PageBuffer;
use rayset::working_set::read::{self, FileStorage, ReadBackend, Storage};

/// A read that was asked for.
pub type Ticket = u64;

/// Bytes of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Extent {
    /// Which of the disk's files.
    pub file: usize,
    /// Where it begins.
    pub offset: u64,
    /// Bytes.
    pub bytes: usize,
}

/// A disk that reads while the program goes on.
pub trait Disk {
    /// Starts reads with one call; the disk may put them in order. Returns a ticket for each.
    fn submit(&mut self, batch: &[Extent]) -> Vec<Ticket>;

    /// Waits for a read and hands its bytes over.
    ///
    /// # Errors
    /// What the system says.
    fn wait(&mut self, ticket: Ticket) -> io::Result<Vec<u8>>;

    /// Whether a read has ended, so that nobody would wait for it.
    fn is_done(&mut self, ticket: Ticket) -> bool;

    /// Nanoseconds that [`wait`](Self::wait) has waited so far.
    fn stalled_nanoseconds(&self) -> u64;
}

/// Alignment of direct reads.
const ALIGNMENT: u64 = 512;

type Done = (Ticket, PageBuffer, io::Result<()>);

/// The machine's own disk, by one of rayset's backends.
pub struct RealDisk {
    files: Vec<Arc<dyn Storage>>,
    backend: Arc<dyn ReadBackend>,
    next: Ticket,
    pending: HashMap<Ticket, Extent>,
    arrived: HashMap<Ticket, (PageBuffer, io::Result<()>)>,
    done: (Sender<Done>, Receiver<Done>),
    stalled_nanoseconds: u64,
}

impl RealDisk {
    /// Opens files, past the page cache where `direct`.
    ///
    /// # Errors
    /// What the system says.
    pub fn open(paths: &[PathBuf], direct: bool, backend: read::BackendKind) -> io::Result<Self> {
        let open = |path: &PathBuf| Ok(Arc::new(FileStorage::open(path, direct)?) as Arc<dyn Storage>);
        Ok(Self {
            files: paths.iter().map(open).collect::<io::Result<_>>()?,
            backend: read::backend(backend)?,
            next: 0,
            pending: HashMap::new(),
            arrived: HashMap::new(),
            done: channel(),
            stalled_nanoseconds: 0,
        })
    }
}

impl Disk for RealDisk {
    fn submit(&mut self, batch: &[Extent]) -> Vec<Ticket> {
        let mut tickets = Vec::with_capacity(batch.len());
        let mut reads = Vec::with_capacity(batch.len());
        for &extent in batch {
            let ticket = self.next;
            self.next += 1;
            self.pending.insert(ticket, extent);
            let first = extent.offset / ALIGNMENT * ALIGNMENT;
            let end = (extent.offset + extent.bytes as u64).next_multiple_of(ALIGNMENT);
            let done = self.done.0.clone();
            reads.push(read::Read {
                storage: self.files[extent.file].clone(),
                offset: first,
                buffer: PageBuffer::new((end - first) as usize),
                // A disk that is gone needs no answer.
                done: Box::new(move |buffer, outcome| drop(done.send((ticket, buffer, outcome)))),
            });
            tickets.push(ticket);
        }
        self.backend.submit(reads);
        tickets
    }

    fn wait(&mut self, ticket: Ticket) -> io::Result<Vec<u8>> {
        let gone = || io::Error::other("the read was never asked for");
        let extent = self.pending.remove(&ticket).ok_or_else(gone)?;
        let take = |(buffer, outcome): (PageBuffer, io::Result<()>)| {
            outcome?;
            let from = (extent.offset % ALIGNMENT) as usize;
            Ok(buffer.bytes()[from..from + extent.bytes].to_vec())
        };
        if self.is_done(ticket)
            && let Some(done) = self.arrived.remove(&ticket)
        {
            return take(done);
        }
        let started = Instant::now();
        let outcome = loop {
            let Ok((arrived, buffer, outcome)) = self.done.1.recv() else { break Err(gone()) };
            if arrived == ticket {
                break take((buffer, outcome));
            }
            self.arrived.insert(arrived, (buffer, outcome));
        };
        self.stalled_nanoseconds += started.elapsed().as_nanos() as u64;
        outcome
    }

    fn is_done(&mut self, ticket: Ticket) -> bool {
        for (arrived, buffer, outcome) in self.done.1.try_iter() {
            self.arrived.insert(arrived, (buffer, outcome));
        }
        self.arrived.contains_key(&ticket)
    }

    fn stalled_nanoseconds(&self) -> u64 {
        self.stalled_nanoseconds
    }
}

/// Time that is counted, not measured: nanoseconds since the beginning.
#[derive(Clone, Debug, Default)]
pub struct Clock(Rc<Cell<u64>>);

impl Clock {
    /// The time.
    #[must_use]
    pub fn now(&self) -> u64 {
        self.0.get()
    }

    /// Lets time pass.
    pub fn advance(&self, nanoseconds: u64) {
        self.0.set(self.0.get() + nanoseconds);
    }
}

/// A disk with an arm, as the paper has it: 8 ms a seek, 50 MB/s, one read after another; a batch is put in the order of
/// its places (the elevator that `lio_listio` gives the kernel room for).
pub struct SimulatedDisk {
    files: Vec<File>,
    /// Where each file lies on the disk.
    starts: Vec<u64>,
    clock: Clock,
    /// When the arm is free, and where it is then.
    free_at: u64,
    head: u64,
    next: Ticket,
    pending: HashMap<Ticket, (Extent, u64)>,
    stalled_nanoseconds: u64,
}

impl SimulatedDisk {
    /// A seek.
    pub const SEEK_NANOSECONDS: u64 = 8_000_000;
    /// Bytes in a second.
    pub const BYTES_PER_SECOND: u64 = 50_000_000;

    /// Over files that lie one behind the other.
    ///
    /// # Errors
    /// What the system says.
    pub fn open(paths: &[PathBuf], clock: Clock) -> io::Result<Self> {
        let files: Vec<File> = paths.iter().map(File::open).collect::<io::Result<_>>()?;
        let mut starts = Vec::new();
        let mut end = 0;
        for file in &files {
            starts.push(end);
            end += file.metadata()?.len();
        }
        Ok(Self {
            files,
            starts,
            clock,
            free_at: 0,
            head: 0,
            next: 0,
            pending: HashMap::new(),
            stalled_nanoseconds: 0,
        })
    }

    /// Nanoseconds that a read takes which begins at a place, with the arm where it is.
    fn duration(&self, place: u64, bytes: usize) -> u64 {
        let seek = if place == self.head { 0 } else { Self::SEEK_NANOSECONDS };
        seek + bytes as u64 * 1_000_000_000 / Self::BYTES_PER_SECOND
    }
}

impl Disk for SimulatedDisk {
    fn submit(&mut self, batch: &[Extent]) -> Vec<Ticket> {
        let first = self.next;
        self.next += batch.len() as u64;
        let mut order: Vec<usize> = (0..batch.len()).collect();
        order.sort_by_key(|&i| (batch[i].file, batch[i].offset));
        for i in order {
            let extent = batch[i];
            let place = self.starts[extent.file] + extent.offset;
            let begins = self.free_at.max(self.clock.now());
            self.free_at = begins + self.duration(place, extent.bytes);
            self.head = place + extent.bytes as u64;
            self.pending.insert(first + i as u64, (extent, self.free_at));
        }
        (first..self.next).collect()
    }

    fn wait(&mut self, ticket: Ticket) -> io::Result<Vec<u8>> {
        let gone = || io::Error::other("the read was never asked for");
        let (extent, ends) = self.pending.remove(&ticket).ok_or_else(gone)?;
        let missing = ends.saturating_sub(self.clock.now());
        self.clock.advance(missing);
        self.stalled_nanoseconds += missing;
        let mut bytes = vec![0; extent.bytes];
        let file = &mut self.files[extent.file];
        file.seek(SeekFrom::Start(extent.offset))?;
        file.read_exact(&mut bytes)?;
        Ok(bytes)
    }

    fn is_done(&mut self, ticket: Ticket) -> bool {
        self.pending.get(&ticket).is_some_and(|(_, ends)| *ends <= self.clock.now())
    }

    fn stalled_nanoseconds(&self) -> u64 {
        self.stalled_nanoseconds
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write as _;

    #[test]
    fn a_simulated_disk_seeks_reads_on_and_overlaps_with_work() {
        let mut file = tempfile::NamedTempFile::new().expect("a file");
        let bytes: Vec<u8> = (0..100_000_u32).map(|i| i as u8).collect();
        file.write_all(&bytes).expect("a write");
        let clock = Clock::default();
        let mut disk = SimulatedDisk::open(&[file.path().to_owned()], clock.clone()).expect("it opens");
        let extent = |offset, bytes| Extent { file: 0, offset, bytes };
        // The second read goes on where the first ends, whatever their order in the batch.
        let tickets = disk.submit(&[extent(1500, 500), extent(1000, 500)]);
        assert_eq!(disk.wait(tickets[1]).expect("bytes"), &bytes[1000..1500]);
        assert_eq!(clock.now(), 8_000_000 + 10_000);
        assert_eq!(disk.wait(tickets[0]).expect("bytes"), &bytes[1500..2000]);
        assert_eq!(clock.now(), 8_000_000 + 20_000);
        // What is asked for early enough costs no time.
        let late = disk.submit(&[extent(50_000, 50)]);
        clock.advance(20_000_000);
        let before = disk.stalled_nanoseconds();
        assert_eq!(disk.wait(late[0]).expect("bytes"), &bytes[50_000..50_050]);
        assert_eq!(disk.stalled_nanoseconds(), before);
    }
}
