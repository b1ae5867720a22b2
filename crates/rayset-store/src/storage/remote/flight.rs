//! One request that is in flight: the reads that it fills, and how far its bytes have come.

use std::ops::Range;
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use super::queue::PendingRead;

/// Reads that one range of bytes fills.
pub(super) struct Request {
    /// By ascending offset; there is at least one.
    pub(super) reads: Vec<PendingRead>,
    /// Attempts that have failed.
    pub(super) failures: u32,
    /// Attempts that the server has refused because it was asked for too much at a time.
    pub(super) refusals: u32,
    /// When its first attempt was begun.
    pub(super) since: Instant,
}

impl Request {
    /// The bytes from the first read's to the last one's.
    pub(super) fn range(&self) -> Range<u64> {
        let start = self.reads.iter().map(|read| read.offset).min().unwrap_or(0);
        start..self.reads.iter().map(PendingRead::end).max().unwrap_or(start)
    }

    pub(super) fn bytes(&self) -> u64 {
        let range = self.range();
        range.end - range.start
    }
}

/// A request in flight. Whoever takes it out (the sink when it ends, the clock when the time is
/// over) decides what becomes of it; bytes that come later go nowhere.
pub(super) struct Flight {
    pub(super) number: u64,
    pub(super) begun: Instant,
    /// The bytes of its range.
    pub(super) bytes: u64,
    state: Mutex<Option<Landing>>,
}

struct Landing {
    request: Request,
    range: Range<u64>,
    /// The place of the next byte.
    at: u64,
}

/// What is left of a request that has ended.
pub(super) struct Ended {
    /// Its reads that are not complete; none, if all are.
    pub(super) request: Request,
    /// Bytes that did not come.
    pub(super) missing: u64,
}

impl Flight {
    pub(super) fn new(number: u64, request: Request) -> Self {
        let range = request.range();
        let (at, bytes) = (range.start, range.end - range.start);
        Self { number, begun: Instant::now(), bytes, state: Mutex::new(Some(Landing { request, range, at })) }
    }

    /// The bytes that it is to read; none if it has ended.
    pub(super) fn range(&self) -> Range<u64> {
        let state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        state.as_ref().map_or(0..0, |landing| landing.range.clone())
    }

    /// Copies bytes to the reads that they belong to, and completes those that have all of theirs.
    /// Returns whether more are wanted.
    pub(super) fn put(&self, bytes: &[u8]) -> bool {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(landing) = state.as_mut() else { return false };
        let complete = landing.put(bytes);
        let more = landing.at < landing.range.end;
        drop(state);
        complete.into_iter().for_each(|read| read.complete(Ok(())));
        more
    }

    /// Takes the request out; `None` if somebody else has.
    pub(super) fn take(&self) -> Option<Ended> {
        let landing = self.state.lock().unwrap_or_else(PoisonError::into_inner).take()?;
        let missing = landing.range.end - landing.at;
        Some(Ended { request: landing.request, missing })
    }
}

impl Landing {
    fn put(&mut self, bytes: &[u8]) -> Vec<PendingRead> {
        // A server that sends more than it was asked for is not listened to.
        let wanted = usize::try_from(self.range.end - self.at).unwrap_or(usize::MAX).min(bytes.len());
        let came = self.at..self.at + wanted as u64;
        self.at = came.end;
        let mut complete = Vec::new();
        let mut index = 0;
        while index < self.request.reads.len() {
            let read = &mut self.request.reads[index];
            let (first, end) = (read.offset.max(came.start), read.end().min(came.end));
            if first < end {
                let to = (first - read.offset) as usize..(end - read.offset) as usize;
                let from = (first - came.start) as usize..(end - came.start) as usize;
                read.buffer.bytes_mut()[to].copy_from_slice(&bytes[from]);
            }
            if read.end() <= came.end { complete.push(self.request.reads.remove(index)) } else { index += 1 }
        }
        complete
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc;

    use super::*;
    use crate::storage::buffer::PageBuffer;

    #[test]
    fn each_read_gets_its_own_bytes_however_they_arrive() {
        let source: Vec<u8> = (0..=255).collect();
        for part in [1, 7, 64, 256] {
            let (send, receive) = mpsc::channel();
            let places = [(10_u64, 20_usize), (30, 5), (33, 40), (100, 60)];
            let reads = places.map(|(offset, length)| {
                let send = send.clone();
                let done = Box::new(move |buffer: PageBuffer, outcome: std::io::Result<()>| {
                    assert!(outcome.is_ok());
                    send.send((offset, buffer.bytes()[..length].to_vec())).expect("somebody listens");
                });
                PendingRead { offset, length, buffer: PageBuffer::new(length), done }
            });
            let request = Request { reads: reads.into(), failures: 0, refusals: 0, since: Instant::now() };
            let range = request.range();
            assert_eq!(range, 10..160);
            let flight = Flight::new(1, request);
            let answer = &source[10..200];
            let wanted_more: Vec<bool> = answer.chunks(part).map(|bytes| flight.put(bytes)).collect();
            assert_eq!(wanted_more.last(), Some(&false), "more than was asked for");
            let ended = flight.take().expect("nobody else took it");
            assert!(ended.request.reads.is_empty() && ended.missing == 0);
            assert!(flight.take().is_none());
            drop(send);
            let mut found: Vec<(u64, Vec<u8>)> = receive.iter().collect();
            found.sort_unstable();
            let expected = places.map(|(at, n)| (at, source[at as usize..at as usize + n].to_vec()));
            assert_eq!(found, expected);
        }
    }
}
