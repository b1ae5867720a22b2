//! Sorting more records than fit in memory: count, plan, scatter into buckets, and sort each bucket
//! in memory.
//!
//! A stretch that is too large for memory is partitioned again: a subtree by the same scheme from
//! its own cell down, and a node's own list by the bits of its Hilbert codes and, if these are
//! equal, by the bytes of its records.

use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

use super::context::Context;
use super::control::Stage;
use super::error::BuildError;
use super::pieces::{Assemble, Pack, structure};
use super::plan::{Cell, Event, LEAF_POINTS, Plan, Pyramid};
use super::record::KeyMaker;
use super::region::Region;
use super::sorted::{KeyOfRecord, Records, Sorted};
use crate::octree::pipeline;
use rayset_base::geometry::curve::MAX_LEVEL;
use rayset_store::spill::Spill;

pub(super) struct Partition<'a> {
    context: &'a Context<'a>,
    stride: usize,
    keys: KeyMaker,
    threads: usize,
    /// Largest number of records that one thread loads at once.
    cap: u64,
    stage: Stage,
    /// Number of passes of the stage, of which this is the first.
    passes: u64,
    total: u64,
    done: AtomicU64,
}

/// Largest number of records sorted at once: a sort cannot be cancelled, and takes some
/// milliseconds for this many records. A limit also gives more threads something to do.
const MOST_SORTED: u64 = 1 << 18;
/// Own lists are passed on in multiples of this number of points, so that runs are full.
const RUN: usize = crate::octree::layout::RUN_POINTS;

/// Largest number of records of `stride` bytes that each of some threads loads at once.
pub(super) fn capacity(memory_bytes: u64, threads: usize, stride: usize) -> u64 {
    // A loaded record needs memory for itself, its entry, and the output made from it; up to one
    // bucket more than there are threads is alive. A third of the budget is for these, and a
    // quarter for the buffers of the scatter; the rest is for a second level of the same if a
    // stretch is too large.
    let per_record = (2 * stride + size_of::<KeyOfRecord>() + 16) as u64;
    let cap = memory_bytes / 3 / (threads as u64 + 2) / per_record;
    cap.clamp(2 * LEAF_POINTS, MOST_SORTED)
}

impl<'a> Partition<'a> {
    pub(super) fn new(
        context: &'a Context<'a>,
        stride: usize,
        keys: KeyMaker,
        total: u64,
        stage: Stage,
    ) -> Self {
        let threads = context.options.threads.max(1);
        let cap = capacity(context.options.memory_bytes, threads, stride);
        Self { context, stride, keys, threads, cap, stage, passes: 1, total, done: 0.into() }
    }

    /// The same as the first of several passes of its stage, as far as progress is concerned.
    pub(super) fn in_passes(self, passes: u64) -> Self {
        Self { passes, ..self }
    }

    /// Sorts the records of a region and passes them through `pack` to `out`.
    pub(super) fn run<P: Pack>(
        &self,
        region: Region<'_>,
        pack: &P,
        out: &mut impl Assemble<P::Piece>,
    ) -> Result<(), BuildError> {
        if region.count == 0 { Ok(()) } else { self.tree(region, Cell::ROOT, pack, out) }
    }

    fn tree<P: Pack>(
        &self,
        region: Region<'_>,
        base: Cell,
        pack: &P,
        out: &mut impl Assemble<P::Piece>,
    ) -> Result<(), BuildError> {
        if region.count <= self.cap {
            let records = self.load(region)?;
            let piece = pack.subtree(base, records.sorted());
            self.context.check()?;
            out.subtree(base, piece)?;
            self.advance(region.count as usize);
            return Ok(());
        }
        if base.level == MAX_LEVEL {
            out.open(base);
            self.list(region, 0, &mut OwnList { pack, carry: Vec::new() }, out)?;
            return out.close();
        }
        let pyramid = Pyramid::new(base, region.count, self.context.options.memory_bytes / 8);
        self.count(region, &pyramid)?;
        let plan = Plan::new(pyramid, self.cap);
        let counts: Vec<u64> = plan.buckets.iter().map(|b| b.count).collect();
        let (spill, firsts) = self.scatter(region, &counts, |r| plan.bucket(&self.keys, r) as usize)?;
        self.follow(&plan, 0..plan.buckets.len(), (&spill, &firsts), |_, _| Ok(()), pack, out)
    }

    /// Counts the records of a region.
    pub(super) fn count(&self, region: Region<'_>, pyramid: &Pyramid) -> Result<(), BuildError> {
        self.for_each(region, |record| pyramid.count(&self.keys, record))
    }

    /// The sum of a number of each record of a region.
    #[cfg(feature = "parts")]
    pub(super) fn sum(
        &self,
        region: Region<'_>,
        number: impl Fn(&[u8]) -> u64 + Sync,
    ) -> Result<u64, BuildError> {
        let sum = AtomicU64::new(0);
        self.for_each(region, |record| {
            sum.fetch_add(number(record), Ordering::Relaxed);
        })?;
        Ok(sum.into_inner())
    }

    /// Executes the events of some of the buckets of a plan, of which `firsts` has the first
    /// records in `spill`: processes buckets in parallel, and passes on the results in order.
    /// `check` is shown the records of each bucket that fits in memory.
    pub(super) fn follow<P: Pack>(
        &self,
        plan: &Plan,
        buckets: std::ops::Range<usize>,
        (spill, firsts): (&Spill, &[u64]),
        check: impl Fn(usize, &[u8]) -> Result<(), BuildError> + Sync,
        pack: &P,
        out: &mut impl Assemble<P::Piece>,
    ) -> Result<(), BuildError> {
        let starts = plan.starts();
        if buckets.start == 0 && !buckets.is_empty() {
            // Events before the first stretch open the upper nodes.
            plan.events[..starts[0]].iter().try_for_each(|e| structure(e, out))?;
        }
        let region =
            |b: usize| Region { spill, first: firsts[b - buckets.start], count: plan.buckets[b].count };
        let work = |b: usize| {
            if plan.buckets[b].count > self.cap {
                return Ok(None);
            }
            let records = self.load(region(b))?;
            check(b, records.bytes())?;
            self.pack(&plan.events[starts[b]..starts[b + 1]], &records, pack).map(Some)
        };
        let offset = buckets.start;
        pipeline::ordered(
            buckets.len(),
            self.threads,
            |i| work(offset + i),
            |i, pieces| {
                let b = offset + i;
                let mut pieces = pieces.map(Vec::into_iter);
                let mut next = || pieces.as_mut().and_then(Iterator::next);
                for event in &plan.events[starts[b]..starts[b + 1]] {
                    match event {
                        Event::Open(_) | Event::Close => structure(event, out)?,
                        // A bucket that was not packed is a single stretch that is too large for
                        // memory.
                        Event::Own { .. } => match next() {
                            Some(piece) => out.own(piece)?,
                            None => self.list(region(b), 0, &mut OwnList { pack, carry: Vec::new() }, out)?,
                        },
                        Event::Subtree { cell, .. } => match next() {
                            Some(piece) => out.subtree(*cell, piece)?,
                            None => self.tree(region(b), *cell, pack, out)?,
                        },
                    }
                }
                if plan.buckets[b].count <= self.cap {
                    self.advance(plan.buckets[b].count as usize);
                }
                Ok(())
            },
        )
    }

    /// Packs the stretches of a bucket, which the events take one after another.
    fn pack<P: Pack>(
        &self,
        events: &[Event],
        records: &Records,
        pack: &P,
    ) -> Result<Vec<P::Piece>, BuildError> {
        let (sorted, mut at) = (records.sorted(), 0);
        let mut pieces = Vec::new();
        for event in events {
            let mut take = |count: u64| {
                let part = sorted.slice(at..at + count as usize);
                at += count as usize;
                part
            };
            match *event {
                Event::Own { count, .. } => pieces.push(pack.own(take(count))),
                Event::Subtree { cell, count, .. } => pieces.push(pack.subtree(cell, take(count))),
                Event::Open(_) | Event::Close => {}
            }
        }
        // Packing ends early if the build is cancelled; its result is then incomplete and must not
        // be used.
        self.context.check()?;
        Ok(pieces)
    }

    /// Sorts a node's own list, one window of bits after another, down to parts that fit in memory.
    fn list<P: Pack>(
        &self,
        region: Region<'_>,
        window: u32,
        list: &mut OwnList<'_, P>,
        out: &mut impl Assemble<P::Piece>,
    ) -> Result<(), BuildError> {
        self.list_part(region, window, list, out)?;
        list.flush(self, out)
    }

    fn list_part<P: Pack>(
        &self,
        region: Region<'_>,
        window: u32,
        list: &mut OwnList<'_, P>,
        out: &mut impl Assemble<P::Piece>,
    ) -> Result<(), BuildError> {
        if region.count <= self.cap {
            return list.push(self, self.load(region)?, out);
        }
        if window >= CODE_WINDOWS + self.stride as u32 {
            // The records are identical, so any order is correct.
            let mut first = region.first;
            let end = region.first + region.count;
            while first < end {
                let count = self.cap.min(end - first);
                list.push(self, self.load(Region { first, count, ..region })?, out)?;
                first += count;
            }
            return Ok(());
        }
        let counts: Vec<AtomicU64> = (0..WINDOW_CELLS).map(|_| 0.into()).collect();
        self.for_each(region, |record| {
            counts[self.window(record, window)].fetch_add(1, Ordering::Relaxed);
        })?;
        let counts: Vec<u64> = counts.into_iter().map(AtomicU64::into_inner).collect();
        if counts.contains(&region.count) {
            // All records are equal in this window, so scattering them would change nothing.
            return self.list_part(region, window + 1, list, out);
        }
        let (spill, firsts) = self.scatter(region, &counts, |record| self.window(record, window))?;
        for (cell, &count) in counts.iter().enumerate() {
            if count > 0 {
                self.list_part(Region { spill: &spill, first: firsts[cell], count }, window + 1, list, out)?;
            }
        }
        Ok(())
    }

    /// The value of a window of a record's sort key in its list: first the Hilbert code, then the
    /// bytes of the record.
    fn window(&self, record: &[u8], window: u32) -> usize {
        if window < CODE_WINDOWS {
            (self.keys.key(record).code() >> (60 - 10 * (window + 1)) & 1023) as usize
        } else {
            usize::from(record[(window - CODE_WINDOWS) as usize])
        }
    }

    fn load(&self, region: Region<'_>) -> Result<Records, BuildError> {
        let mut bytes = vec![0; region.count as usize * self.stride];
        region
            .spill
            .read_at(&mut bytes, region.first * self.stride as u64)
            .map_err(self.context.io("read temporary files in"))?;
        let mut records = Records::unsorted(bytes, self.stride);
        records.index(&self.keys, || self.context.check())?;
        records.sort();
        self.context.check()?;
        Ok(records)
    }

    fn for_each(&self, region: Region<'_>, visit: impl Fn(&[u8]) + Sync) -> Result<(), BuildError> {
        pipeline::chunks(region.count, CHUNK_RECORDS, self.threads, |buffer, range| {
            self.read_chunk(region, &range, buffer)?;
            buffer.chunks_exact(self.stride).for_each(&visit);
            Ok::<_, BuildError>(())
        })
    }

    fn read_chunk(
        &self,
        region: Region<'_>,
        range: &std::ops::Range<u64>,
        buffer: &mut Vec<u8>,
    ) -> Result<(), BuildError> {
        self.context.check()?;
        buffer.resize((range.end - range.start) as usize * self.stride, 0);
        region
            .spill
            .read_at(buffer, (region.first + range.start) * self.stride as u64)
            .map_err(self.context.io("read temporary files in"))
    }

    /// Copies the records of a region into a new spill, bucket by bucket; the order within a bucket
    /// is undefined.
    fn scatter(
        &self,
        region: Region<'_>,
        counts: &[u64],
        bucket_of: impl Fn(&[u8]) -> usize + Sync,
    ) -> Result<(Spill, Vec<u64>), BuildError> {
        let spill = self.context.spill()?;
        let firsts = firsts(counts);
        self.scatter_into(region, &firsts, bucket_of, |_, bytes, at| {
            spill.write_at(bytes, at).map_err(self.context.io("write temporary files in"))
        })?;
        Ok((spill, firsts))
    }

    /// Hands the records of a region to `write`, some of a bucket at a time, with the bucket and
    /// the byte at which they go. Buckets follow each other, and begin at the records `firsts`; the
    /// order within a bucket is undefined.
    pub(super) fn scatter_into(
        &self,
        region: Region<'_>,
        firsts: &[u64],
        bucket_of: impl Fn(&[u8]) -> usize + Sync,
        write: impl Fn(usize, &[u8], u64) -> Result<(), BuildError> + Sync,
    ) -> Result<(), BuildError> {
        let cursors: Vec<AtomicU64> = firsts.iter().map(|&f| f.into()).collect();
        let share = self.context.options.memory_bytes / 4 / (self.threads * firsts.len().max(1)) as u64;
        let buffered = (share / self.stride as u64).clamp(16, 8192) as usize * self.stride;
        let write = |bucket: usize, bytes: &[u8]| {
            let records = (bytes.len() / self.stride) as u64;
            let at = cursors[bucket].fetch_add(records, Ordering::Relaxed);
            write(bucket, bytes, at * self.stride as u64)
        };
        // Buffers outlive the chunks, with one set per thread; `chunks` has no thread-local state,
        // so they are kept in a pool.
        let pool: Mutex<Vec<Vec<Vec<u8>>>> = Mutex::new(Vec::new());
        let take = || pool.lock().unwrap_or_else(std::sync::PoisonError::into_inner).pop();
        pipeline::chunks(region.count, CHUNK_RECORDS, self.threads, |input, range| {
            let mut buffers = take().unwrap_or_else(|| vec![Vec::new(); firsts.len()]);
            self.read_chunk(region, &range, input)?;
            for record in input.chunks_exact(self.stride) {
                let bucket = bucket_of(record);
                let buffer = &mut buffers[bucket];
                if buffer.len() == buffered {
                    write(bucket, buffer)?;
                    buffer.clear();
                }
                buffer.extend_from_slice(record);
            }
            pool.lock().unwrap_or_else(std::sync::PoisonError::into_inner).push(buffers);
            Ok::<_, BuildError>(())
        })?;
        while let Some(buffers) = take() {
            for (bucket, bytes) in buffers.iter().enumerate().filter(|(_, b)| !b.is_empty()) {
                self.context.check()?;
                write(bucket, bytes)?;
            }
        }
        Ok(())
    }

    /// Largest number of records that one thread loads at once.
    #[cfg(feature = "parts")]
    pub(super) fn cap(&self) -> u64 {
        self.cap
    }

    fn advance(&self, records: usize) {
        let done = self.done.fetch_add(records as u64, Ordering::Relaxed) + records as u64;
        self.context.progress(self.stage, done / self.passes, self.total);
    }
}

/// The first record of each bucket.
pub(super) fn firsts(counts: &[u64]) -> Vec<u64> {
    let mut next = 0;
    let first = |count: &u64| {
        next += count;
        next - count
    };
    counts.iter().map(first).collect()
}

/// Number of records that a thread reads at a time.
const CHUNK_RECORDS: u64 = 8192;
/// Number of 10-bit windows of a 60-bit Hilbert code.
const CODE_WINDOWS: u32 = 6;
const WINDOW_CELLS: usize = 1024;

/// An own list that arrives in parts; runs must not be cut at the ends of parts.
struct OwnList<'a, P: Pack> {
    pack: &'a P,
    carry: Vec<u8>,
}

impl<P: Pack> OwnList<'_, P> {
    fn push(
        &mut self,
        partition: &Partition<'_>,
        records: Records,
        out: &mut impl Assemble<P::Piece>,
    ) -> Result<(), BuildError> {
        let sorted = records.sorted();
        (0..sorted.len()).for_each(|i| self.carry.extend_from_slice(sorted.record(i)));
        drop(records);
        let count = self.carry.len() / partition.stride;
        self.emit(partition, count / RUN * RUN, out)
    }

    fn flush(
        &mut self,
        partition: &Partition<'_>,
        out: &mut impl Assemble<P::Piece>,
    ) -> Result<(), BuildError> {
        self.emit(partition, self.carry.len() / partition.stride, out)
    }

    fn emit(
        &mut self,
        partition: &Partition<'_>,
        count: usize,
        out: &mut impl Assemble<P::Piece>,
    ) -> Result<(), BuildError> {
        if count == 0 {
            return Ok(());
        }
        let stride = partition.stride;
        let entries: Vec<KeyOfRecord> = (self.carry.chunks_exact(stride).take(count).enumerate())
            .map(|(index, record)| KeyOfRecord { key: partition.keys.key(record), index: index as u32 })
            .collect();
        let piece = self.pack.own(Sorted::in_order(&self.carry, &entries, stride));
        partition.context.check()?;
        self.carry.drain(..count * stride);
        partition.advance(count);
        out.own(piece)
    }
}
