//! Asynchronous reads from the disk there is.

use std::collections::HashMap;
use std::fs::File;
use std::io;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::Instant;

use rayset::working_set::PageBuffer;
use rayset::working_set::read::{self, FileStorage, Storage, Transport};

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

    /// Bytes of one of its files.
    fn length(&self, file: usize) -> u64;

    /// Nanoseconds that [`wait`](Self::wait) has waited so far.
    fn stalled_nanoseconds(&self) -> u64;
}

/// Alignment of direct reads.
const ALIGNMENT: u64 = 512;

type Done = (Ticket, PageBuffer, io::Result<()>);

/// The machine's own disk, by one of rayset's backends.
pub struct RealDisk {
    files: Vec<Arc<dyn Storage>>,
    around: Option<Around>,
    lengths: Vec<u64>,
    backend: Arc<dyn Transport>,
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
        let length = |path: &PathBuf| Ok(std::fs::metadata(path)?.len());
        Ok(Self {
            lengths: paths.iter().map(length).collect::<io::Result<_>>()?,
            files: paths.iter().map(open).collect::<io::Result<_>>()?,
            around: None,
            backend: read::backend(backend)?,
            next: 0,
            pending: HashMap::new(),
            arrived: HashMap::new(),
            done: channel(),
            stalled_nanoseconds: 0,
        })
    }

    /// Has the system's file cache read what stands around a read with it, in aligned groups of so
    /// many bytes; for files that are read through it.
    ///
    /// # Errors
    /// What the system says.
    pub fn reading_around(mut self, paths: &[PathBuf], bytes: u64) -> io::Result<Self> {
        self.around = Some(Around::new(paths, bytes)?);
        Ok(self)
    }
}

/// Tells the system which parts of files will be wanted.
struct Around {
    files: Vec<File>,
    bytes: u64,
    /// Groups that it was told of lately, each in the place of its number's lowest bits.
    told: Vec<Option<(usize, u64)>>,
}

impl Around {
    /// The system forgets groups in its own way: one that others stood in the place of is told
    /// again.
    const REMEMBERED: usize = 256;

    fn new(paths: &[PathBuf], bytes: u64) -> io::Result<Self> {
        let files = paths.iter().map(File::open).collect::<io::Result<_>>()?;
        Ok(Self { files, bytes: bytes.max(1), told: vec![None; Self::REMEMBERED] })
    }

    fn tell(&mut self, extent: Extent) {
        let group = extent.offset / self.bytes;
        let place = (group as usize + extent.file * Self::REMEMBERED / 3) % Self::REMEMBERED;
        if self.told[place].replace((extent.file, group)) == Some((extent.file, group)) {
            return;
        }
        // Advice that is not taken changes nothing but the time.
        #[cfg(target_os = "linux")]
        let _ = rustix::fs::fadvise(
            &self.files[extent.file],
            group * self.bytes,
            std::num::NonZeroU64::new(self.bytes),
            rustix::fs::Advice::WillNeed,
        );
    }
}

impl Disk for RealDisk {
    fn submit(&mut self, batch: &[Extent]) -> Vec<Ticket> {
        if let Some(around) = &mut self.around {
            batch.iter().for_each(|&extent| around.tell(extent));
        }
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

    fn length(&self, file: usize) -> u64 {
        self.lengths.get(file).copied().unwrap_or(0)
    }

    fn stalled_nanoseconds(&self) -> u64 {
        self.stalled_nanoseconds
    }
}
