//! The file cache of the system, above the simulated disk: blocks of files, least recently used out
//! first.

use std::collections::{BTreeMap, HashMap};
use std::ops::Range;

/// A read or a write that the arm is to do, or has done.
pub(crate) type Job = u64;

/// A block.
pub const BLOCK_BYTES: u64 = 4096;

/// What the system keeps of the files, and what is read with what is asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FileCaching {
    /// Bytes that it keeps; none where 0.
    pub bytes: u64,
    /// What is absent comes with what is absent around it, in aligned groups of so many bytes:
    /// while an arm seeks, a disk of 8 ms and 50 MB/s could read 400 kB.
    pub around_bytes: u64,
    /// Points are read past it, record by record: where they do not fit, a block of which one
    /// record is used drives out others.
    pub not_points: bool,
}

impl FileCaching {
    /// Reads go past any cache.
    pub const NONE: Self = Self { bytes: 0, around_bytes: BLOCK_BYTES, not_points: false };

    /// A cache of so many bytes that reads block by block.
    #[must_use]
    pub fn by_blocks(bytes: u64) -> Self {
        Self { bytes, ..Self::NONE }
    }
}

/// Blocks that the system keeps. Blocks are numbered over all files.
pub(crate) struct FileCache {
    blocks: usize,
    /// Blocks of an aligned group.
    around: u64,
    known: HashMap<u64, Kept>,
    by_use: BTreeMap<u64, u64>,
    clock: u64,
}

struct Kept {
    used: u64,
    /// The read that brings it.
    job: Job,
}

impl FileCache {
    pub(crate) fn new(caching: FileCaching) -> Self {
        let blocks = (caching.bytes / BLOCK_BYTES) as usize;
        let around = (caching.around_bytes / BLOCK_BYTES).clamp(1, blocks.max(1) as u64);
        Self { blocks, around, known: HashMap::new(), by_use: BTreeMap::new(), clock: 0 }
    }

    /// Has all of some blocks of a file brought in, with what is absent around them; `read` starts
    /// the read of a run of blocks. Returns the reads that bring what is wanted.
    pub(crate) fn bring(
        &mut self,
        wanted: Range<u64>,
        file: Range<u64>,
        mut read: impl FnMut(Range<u64>) -> Job,
    ) -> Vec<Job> {
        let mut jobs = Vec::new();
        let mut block = wanted.start;
        while block < wanted.end {
            if let Some(job) = self.find(block) {
                jobs.push(job);
                block += 1;
                continue;
            }
            let run = self.absent_around(block, wanted.end, &file);
            let job = read(run.clone());
            jobs.push(job);
            // What is wanted is used last, so that what comes with it cannot drive it out.
            let (inside, outside): (Vec<u64>, Vec<u64>) = run.clone().partition(|b| wanted.contains(b));
            outside.into_iter().chain(inside).for_each(|b| self.insert(b, job));
            block = run.end;
        }
        jobs
    }

    /// The absent blocks side by side with an absent one: of its group, and as far as more is
    /// wanted.
    fn absent_around(&self, block: u64, wanted_end: u64, file: &Range<u64>) -> Range<u64> {
        let first = (block / self.around * self.around).max(file.start);
        let end = (block / self.around + 1) * self.around;
        let end = end.max(wanted_end.next_multiple_of(self.around)).min(file.end.max(wanted_end));
        let is_absent = |b: &u64| !self.known.contains_key(b);
        let before = (first..block).rev().take_while(is_absent).count() as u64;
        let behind = (block..end).take_while(is_absent).count() as u64;
        block - before..block + behind
    }

    /// The read that brings a block, which counts as a use of it.
    fn find(&mut self, block: u64) -> Option<Job> {
        let kept = self.known.get_mut(&block)?;
        self.clock += 1;
        self.by_use.remove(&kept.used);
        kept.used = self.clock;
        self.by_use.insert(self.clock, block);
        Some(kept.job)
    }

    fn insert(&mut self, block: u64, job: Job) {
        self.clock += 1;
        self.known.insert(block, Kept { used: self.clock, job });
        self.by_use.insert(self.clock, block);
        while self.known.len() > self.blocks
            && let Some((_, oldest)) = self.by_use.pop_first()
        {
            self.known.remove(&oldest);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Brings blocks in; first and behind last of the runs that were read.
    fn bring(cache: &mut FileCache, wanted: Range<u64>) -> Vec<(u64, u64)> {
        let mut runs = Vec::new();
        cache.bring(wanted, 0..100, |run| {
            runs.push((run.start, run.end));
            runs.len() as Job
        });
        runs
    }

    #[test]
    fn what_is_absent_comes_with_its_group_and_nothing_is_read_twice() {
        let caching =
            FileCaching { around_bytes: 4 * BLOCK_BYTES, ..FileCaching::by_blocks(64 * BLOCK_BYTES) };
        let mut cache = FileCache::new(caching);
        assert_eq!(bring(&mut cache, 5..6), [(4, 8)]);
        assert_eq!(bring(&mut cache, 4..8), []);
        assert_eq!(bring(&mut cache, 2..10), [(0, 4), (8, 12)], "what is there stays");
        assert_eq!(bring(&mut cache, 99..100), [(96, 100)], "a file ends");
        assert_eq!(bring(&mut cache, 14..30), [(12, 32)], "as far as is wanted in one read");
    }

    #[test]
    fn by_blocks_only_what_is_wanted_is_read() {
        let mut cache = FileCache::new(FileCaching::by_blocks(64 * BLOCK_BYTES));
        assert_eq!(bring(&mut cache, 5..6), [(5, 6)]);
        assert_eq!(bring(&mut cache, 3..8), [(3, 5), (6, 8)]);
    }

    #[test]
    fn a_group_larger_than_the_cache_leaves_what_was_wanted() {
        let caching =
            FileCaching { around_bytes: 16 * BLOCK_BYTES, ..FileCaching::by_blocks(4 * BLOCK_BYTES) };
        let mut cache = FileCache::new(caching);
        bring(&mut cache, 1..2);
        assert_eq!(bring(&mut cache, 1..2), []);
    }
}
