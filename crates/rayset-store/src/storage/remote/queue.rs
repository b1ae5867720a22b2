//! Reads that wait for a request, and how neighbours are joined into one.

use std::collections::{BTreeMap, VecDeque};
use std::io;
use std::ops::Range;

use crate::storage::buffer::PageBuffer;
use crate::storage::transport::Completion;

/// A read that somebody wants: `length` bytes from `offset` on, into the beginning of a buffer.
pub(super) struct PendingRead {
    pub(super) offset: u64,
    pub(super) length: usize,
    pub(super) buffer: PageBuffer,
    pub(super) done: Completion,
}

impl PendingRead {
    pub(super) fn end(&self) -> u64 {
        self.offset + self.length as u64
    }

    /// Completes the read.
    pub(super) fn complete(self, outcome: io::Result<()>) {
        (self.done)(self.buffer, outcome);
    }
}

/// Limits of joining neighbours.
#[derive(Clone, Copy, Debug)]
pub(super) struct Joining {
    /// Most bytes between two reads that are read for nothing.
    pub(super) gap_bytes: u64,
    /// Most bytes of a request of several reads.
    pub(super) most_bytes: u64,
}

/// A read's place: its offset, and a number that tells reads of one place apart.
type Key = (u64, u64);

/// Reads that wait, most urgent first.
#[derive(Default)]
pub(super) struct Queue {
    by_offset: BTreeMap<Key, PendingRead>,
    /// The order in which they are to be read, including some that have been taken already.
    order: VecDeque<Key>,
    last: u64,
}

impl Queue {
    /// Adds a read, behind all others or, if it is urgent, before them.
    pub(super) fn push(&mut self, wanted: PendingRead, urgent: bool) {
        self.last += 1;
        let key = (wanted.offset, self.last);
        self.by_offset.insert(key, wanted);
        if urgent { self.order.push_front(key) } else { self.order.push_back(key) }
    }

    /// Takes the most urgent read and its neighbours, by ascending offset; empty if nothing waits.
    pub(super) fn take(&mut self, joining: Joining) -> Vec<PendingRead> {
        let mut taken = VecDeque::new();
        while let Some(key) = self.order.pop_front() {
            if let Some(first) = self.by_offset.remove(&key) {
                taken.push_back(first);
                break;
            }
        }
        let Some(first) = taken.front() else { return Vec::new() };
        let mut range = first.offset..first.end();
        while let Some(next) = self.after(&range, joining) {
            range.end = range.end.max(next.end());
            taken.push_back(next);
        }
        while let Some(before) = self.before(&range, joining) {
            range.start = before.offset;
            taken.push_front(before);
        }
        taken.into()
    }

    /// Takes everything.
    pub(super) fn drain(&mut self) -> Vec<PendingRead> {
        self.order.clear();
        std::mem::take(&mut self.by_offset).into_values().collect()
    }

    /// The nearest read behind a range, if it is near enough and fits. Reads may overlap.
    fn after(&mut self, range: &Range<u64>, joining: Joining) -> Option<PendingRead> {
        let (&key, next) = self.by_offset.range((range.start, 0)..).next()?;
        let near = next.offset <= range.end.saturating_add(joining.gap_bytes);
        let fits = next.end().max(range.end) - range.start <= joining.most_bytes;
        if near && fits { self.by_offset.remove(&key) } else { None }
    }

    /// The nearest read before a range, if it is near enough and fits.
    fn before(&mut self, range: &Range<u64>, joining: Joining) -> Option<PendingRead> {
        let (&key, before) = self.by_offset.range(..(range.start, 0)).next_back()?;
        let near = range.start <= before.end().saturating_add(joining.gap_bytes);
        // One that reaches beyond the range's end would have to be read to there.
        let fits = range.end - before.offset <= joining.most_bytes && before.end() <= range.end;
        if near && fits { self.by_offset.remove(&key) } else { None }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn wanted(offset: u64, length: usize) -> PendingRead {
        PendingRead { offset, length, buffer: PageBuffer::new(length), done: Box::new(|_, _| {}) }
    }

    fn offsets(taken: &[PendingRead]) -> Vec<u64> {
        taken.iter().map(|read| read.offset).collect()
    }

    const JOINING: Joining = Joining { gap_bytes: 100, most_bytes: 1000 };

    #[test]
    fn neighbours_on_both_sides_share_a_request_up_to_gap_and_size() {
        let mut queue = Queue::default();
        for offset in [500, 300, 2000, 700, 1101, 400, 100] {
            queue.push(wanted(offset, 100), false);
        }
        // 1101 is too far behind 800; 100 is a gap of 100 before 300.
        assert_eq!(offsets(&queue.take(JOINING)), [100, 300, 400, 500, 700]);
        assert_eq!(offsets(&queue.take(JOINING)), [2000]);
        assert_eq!(offsets(&queue.take(JOINING)), [1101]);
        assert!(queue.take(JOINING).is_empty());
    }

    #[test]
    fn an_urgent_read_overtakes_those_that_wait() {
        let mut queue = Queue::default();
        queue.push(wanted(0, 10), false);
        queue.push(wanted(90_000, 10), true);
        assert_eq!(offsets(&queue.take(JOINING)), [90_000]);
    }

    proptest! {
        #[test]
        fn every_read_is_taken_once_and_no_request_of_several_exceeds_its_limits(
            reads in prop::collection::vec((0_u64..5000, 1_usize..600, any::<bool>()), 0..60),
        ) {
            let mut queue = Queue::default();
            let mut pushed: Vec<(u64, usize)> = Vec::new();
            for (offset, length, urgent) in reads {
                queue.push(wanted(offset, length), urgent);
                pushed.push((offset, length));
            }
            let mut found = Vec::new();
            loop {
                let taken = queue.take(JOINING);
                let Some(first) = taken.first() else { break };
                let mut end = first.end();
                for read in &taken {
                    prop_assert!(read.offset >= first.offset && read.offset <= end + JOINING.gap_bytes);
                    end = end.max(read.end());
                }
                prop_assert!(taken.len() == 1 || end - first.offset <= JOINING.most_bytes);
                found.extend(taken.iter().map(|read| (read.offset, read.length)));
            }
            pushed.sort_unstable();
            found.sort_unstable();
            prop_assert_eq!(pushed, found);
        }
    }
}
