//! Remote objects: many requests in flight, neighbours joined, failures tried again, all
//! in bounded time.
//!
//! A [`RangeReader`] knows how to start reading a range of one object; [`RemoteStorage`] makes a
//! [`Storage`] of it. Its `queue` joins reads to requests, its `engine` starts them, at a `pace`
//! that the server bears and within a `limit` that objects share, and tries again what failed, a
//! `flight` is a request on its way, `unread` tells errors of reading from errors in what was read.

mod counts;
mod engine;
mod flight;
mod limit;
mod options;
mod pace;
mod queue;
mod reader;
mod unread;

use std::io;
use std::sync::{Arc, mpsc};
use std::time::Duration;

pub use self::counts::RemoteCounts;
use self::engine::Engine;
pub use self::limit::RequestLimit;
pub use self::options::RemoteOptions;
use self::queue::PendingRead;
pub use self::reader::{RangeError, RangeReader, RangeSink};
pub use self::unread::{copy_of_reading, is_of_reading};
use super::buffer::PageBuffer;
use super::transport::{Read, Storage, Transport, ends_early};

/// A remote object as a storage. It has one connection's worth of everything: its own queue, its
/// own requests in flight.
pub struct RemoteStorage {
    transport: Arc<RemoteTransport>,
    length: u64,
}

/// The way to a remote object.
struct RemoteTransport(Arc<Engine>);

impl RemoteStorage {
    /// An object of `length` bytes, of which `reader` reads ranges.
    ///
    /// # Errors
    /// The system's error, if the thread that keeps time cannot be started.
    pub fn new(reader: Arc<dyn RangeReader>, length: u64, options: RemoteOptions) -> io::Result<Self> {
        Self::start(reader, length, options, None)
    }

    /// Like [`new`](Self::new), of an object that shares a limit with others.
    ///
    /// # Errors
    /// As of [`new`](Self::new).
    pub fn within(
        limit: &Arc<RequestLimit>,
        reader: Arc<dyn RangeReader>,
        length: u64,
        options: RemoteOptions,
    ) -> io::Result<Self> {
        Self::start(reader, length, options, Some(limit.clone()))
    }

    fn start(
        reader: Arc<dyn RangeReader>,
        length: u64,
        options: RemoteOptions,
        limit: Option<Arc<RequestLimit>>,
    ) -> io::Result<Self> {
        let options = RemoteOptions { in_flight: options.in_flight.max(1), ..options };
        Ok(Self { transport: Arc::new(RemoteTransport(Engine::start(reader, options, limit)?)), length })
    }

    /// What has been read so far, and what it cost.
    #[must_use]
    pub fn counts(&self) -> RemoteCounts {
        self.transport.0.counts.all()
    }

    /// The object in messages.
    #[must_use]
    pub fn name(&self) -> String {
        self.transport.0.name()
    }
}

impl std::fmt::Debug for RemoteStorage {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "RemoteStorage({}, {} bytes)", self.name(), self.length)
    }
}

impl Storage for RemoteStorage {
    fn length(&self) -> io::Result<u64> {
        Ok(self.length)
    }

    fn read_exact_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()> {
        let end = offset.saturating_add(buffer.len() as u64);
        if end > self.length {
            return Err(ends_early(self.length, end));
        }
        let (send, receive) = mpsc::channel();
        // Several requests at a time, if it is much: as a whole it would be one that takes long.
        let part = usize::try_from(self.transport.0.options.most_bytes).unwrap_or(usize::MAX).max(1);
        let starts: Vec<usize> = (0..buffer.len()).step_by(part).collect();
        let reads = starts.iter().map(|&start| {
            let (send, length) = (send.clone(), part.min(buffer.len() - start));
            let done = Box::new(move |bytes: PageBuffer, outcome: io::Result<()>| {
                // Whoever has stopped waiting does not need it.
                let _ = send.send((start, length, bytes, outcome));
            });
            PendingRead { offset: offset + start as u64, length, buffer: PageBuffer::new(length), done }
        });
        self.transport.0.submit(reads.collect(), true);
        drop(send);
        for _ in &starts {
            let answer = receive.recv().map_err(|_| io::Error::other("the storage has forgotten a read"))?;
            let (start, length, bytes, outcome) = answer;
            outcome?;
            buffer[start..start + length].copy_from_slice(&bytes.bytes()[..length]);
        }
        Ok(())
    }

    fn transport(&self) -> Option<Arc<dyn Transport>> {
        Some(self.transport.clone())
    }
}

impl Drop for RemoteStorage {
    fn drop(&mut self) {
        self.transport.0.close();
    }
}

impl Transport for RemoteTransport {
    fn submit(&self, batch: Vec<Read>) {
        self.0.submit(batch.into_iter().map(PendingRead::from).collect(), false);
    }

    fn submit_awaited(&self, read: Read) {
        self.0.submit(vec![read.into()], true);
    }

    fn name(&self) -> String {
        format!("{} requests in flight", self.0.options.in_flight)
    }

    fn latency(&self) -> Option<Duration> {
        self.0.counts.latency()
    }

    fn is_remote(&self) -> bool {
        true
    }

    fn memory_bytes(&self) -> u64 {
        self.0.limit.as_ref().map_or(0, |limit| limit.memory_bytes())
    }
}

impl From<Read> for PendingRead {
    fn from(read: Read) -> Self {
        let Read { offset, buffer, done, .. } = read;
        Self { offset, length: buffer.bytes().len(), buffer, done }
    }
}
