//! Sorting more records than fit in memory: count, plan, scatter into buckets, and sort each bucket in memory.
//!
//! A stretch that is too large for memory is partitioned again: a subtree by the same scheme from its own cell down, and a
//! node's own list by the bits of its Hilbert codes and, if these are equal, by the bytes of its records.

use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

use super::context::Context;
use super::control::Stage;
use super::error::BuildError;
use super::pipeline;
use super::plan::{Cell, Event, LEAF_POINTS, Plan, Pyramid};
use super::record::{Key, KeyMaker};
use crate::geometry::curve::MAX_LEVEL;
use crate::spill::Spill;

/// The records `first` to `first + count` (exclusive) of a spill.
#[derive(Clone, Copy)]
pub(super) struct Region<'a> {
    spill: &'a Spill,
    first: u64,
    pub(super) count: u64,
}

impl<'a> Region<'a> {
    pub(super) fn all(spill: &'a Spill, count: u64) -> Self {
        Self { spill, first: 0, count }
    }
}

/// Key and index of a record in a bucket.
#[derive(Clone, Copy, Debug)]
pub(super) struct Entry {
    pub(super) key: Key,
    index: u32,
}

/// Records in memory, with their sorted order.
pub(super) struct Records {
    bytes: Vec<u8>,
    entries: Vec<Entry>,
    stride: usize,
}

/// A stretch of sorted records.
#[derive(Clone, Copy)]
pub(super) struct Sorted<'a> {
    bytes: &'a [u8],
    pub(super) entries: &'a [Entry],
    stride: usize,
}

impl<'a> Sorted<'a> {
    pub(super) fn len(&self) -> usize {
        self.entries.len()
    }

    pub(super) fn record(&self, i: usize) -> &'a [u8] {
        let at = self.entries[i].index as usize * self.stride;
        &self.bytes[at..at + self.stride]
    }

    pub(super) fn slice(&self, range: std::ops::Range<usize>) -> Self {
        Self { entries: &self.entries[range], ..*self }
    }

    /// The records that a node at `level` owns itself, which come first, and the stretch of each child.
    pub(super) fn split(&self, level: u32) -> (Self, [Self; 8]) {
        let own = self.entries.iter().take_while(|e| e.key.level() == level).count();
        let rest = self.slice(own..self.len());
        let mut start = 0;
        let children = std::array::from_fn(|octant| {
            let end = rest.entries.partition_point(|e| e.key.cell_at(level + 1) & 7 <= octant as u64);
            let child = rest.slice(start..end);
            start = end;
            child
        });
        (self.slice(0..own), children)
    }
}

impl Records {
    pub(super) fn sorted(&self) -> Sorted<'_> {
        Sorted { bytes: &self.bytes, entries: &self.entries, stride: self.stride }
    }
}

/// Converts sorted records to pieces of output, in parallel.
pub(super) trait Pack: Sync {
    type Piece: Send;
    /// Converts a node with everything below it.
    fn subtree(&self, cell: Cell, records: Sorted<'_>) -> Self::Piece;
    /// Converts part of a node's own list: a multiple of 128 points, or the rest of it.
    fn own(&self, records: Sorted<'_>) -> Self::Piece;
}

/// Receives the pieces, in file order.
pub(super) trait Assemble<P> {
    fn open(&mut self, cell: Cell);
    /// Part of the own list of the open node.
    fn own(&mut self, piece: P) -> Result<(), BuildError>;
    fn subtree(&mut self, cell: Cell, piece: P) -> Result<(), BuildError>;
    fn close(&mut self) -> Result<(), BuildError>;
}

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

/// Largest number of records sorted at once: a sort cannot be cancelled, and takes some milliseconds for this many records.
/// A limit also gives more threads something to do.
const MOST_SORTED: u64 = 1 << 18;
/// Own lists are passed on in multiples of this number of points, so that runs are full.
const RUN: usize = crate::octree::layout::RUN_POINTS;

impl<'a> Partition<'a> {
    pub(super) fn new(
        context: &'a Context<'a>,
        stride: usize,
        keys: KeyMaker,
        total: u64,
        stage: Stage,
    ) -> Self {
        let threads = context.options.threads.max(1);
        // A loaded record needs memory for itself, its entry, and the output made from it; up to one bucket more than there
        // are threads is alive. A third of the budget is for these, and a quarter for the buffers of the scatter; the rest
        // is for a second level of the same if a stretch is too large.
        let per_record = (2 * stride + size_of::<Entry>() + 16) as u64;
        let cap = context.options.memory_bytes / 3 / (threads as u64 + 2) / per_record;
        let cap = cap.clamp(2 * LEAF_POINTS, MOST_SORTED);
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
        self.for_each(region, |record| pyramid.count(&self.keys, record))?;
        let plan = Plan::new(pyramid, self.cap);
        let counts: Vec<u64> = plan.buckets.iter().map(|b| b.count).collect();
        let (spill, firsts) = self.scatter(region, &counts, |r| plan.bucket(&self.keys, r) as usize)?;
        self.follow(&plan, &spill, &firsts, pack, out)
    }

    /// Executes the events of a plan: processes buckets in parallel, and passes on the results in order.
    fn follow<P: Pack>(
        &self,
        plan: &Plan,
        spill: &Spill,
        firsts: &[u64],
        pack: &P,
        out: &mut impl Assemble<P::Piece>,
    ) -> Result<(), BuildError> {
        let mut starts = vec![usize::MAX; plan.buckets.len() + 1];
        for (at, event) in plan.events.iter().enumerate().rev() {
            if let Event::Own { bucket, .. } | Event::Subtree { bucket, .. } = event {
                starts[*bucket as usize] = at;
            }
        }
        starts[plan.buckets.len()] = plan.events.len();
        // Events before the first stretch open the upper nodes.
        let leading = starts.first().copied().unwrap_or(0);
        plan.events[..leading].iter().try_for_each(|e| structure(e, out))?;
        let region = |b: usize| Region { spill, first: firsts[b], count: plan.buckets[b].count };
        let work = |b: usize| -> Result<Option<Vec<P::Piece>>, BuildError> {
            if plan.buckets[b].count > self.cap {
                return Ok(None);
            }
            let records = self.load(region(b))?;
            let (sorted, mut at) = (records.sorted(), 0);
            let mut pieces = Vec::new();
            for event in &plan.events[starts[b]..starts[b + 1]] {
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
            // Packing ends early if the build is cancelled; its result is then incomplete and must not be used.
            self.context.check()?;
            Ok(Some(pieces))
        };
        pipeline::ordered(plan.buckets.len(), self.threads, work, |b, pieces| {
            let mut pieces = pieces.map(Vec::into_iter);
            let mut next = || pieces.as_mut().and_then(Iterator::next);
            for event in &plan.events[starts[b]..starts[b + 1]] {
                match event {
                    Event::Open(_) | Event::Close => structure(event, out)?,
                    // A bucket that was not packed is a single stretch that is too large for memory.
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
        })
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

    /// The value of a window of a record's sort key in its list: first the Hilbert code, then the bytes of the record.
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
        let mut entries = Vec::with_capacity(region.count as usize);
        for (index, record) in bytes.chunks_exact(self.stride).enumerate() {
            if index % CHUNK_RECORDS as usize == 0 {
                self.context.check()?;
            }
            entries.push(Entry { key: self.keys.key(record), index: index as u32 });
        }
        let mut records = Records { bytes, entries, stride: self.stride };
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

    /// Copies the records of a region into a new spill, bucket by bucket; the order within a bucket is undefined.
    fn scatter(
        &self,
        region: Region<'_>,
        counts: &[u64],
        bucket_of: impl Fn(&[u8]) -> usize + Sync,
    ) -> Result<(Spill, Vec<u64>), BuildError> {
        let spill = self.context.spill()?;
        let mut first = 0;
        let firsts: Vec<u64> = counts
            .iter()
            .map(|c| {
                first += c;
                first - c
            })
            .collect();
        let cursors: Vec<AtomicU64> = firsts.iter().map(|&f| f.into()).collect();
        let share = self.context.options.memory_bytes / 4 / (self.threads * counts.len()) as u64;
        let buffered = (share / self.stride as u64).clamp(16, 8192) as usize * self.stride;
        let write = |bucket: usize, bytes: &[u8]| {
            let records = (bytes.len() / self.stride) as u64;
            let at = cursors[bucket].fetch_add(records, Ordering::Relaxed);
            spill
                .write_at(bytes, at * self.stride as u64)
                .map_err(self.context.io("write temporary files in"))
        };
        // Buffers outlive the chunks, with one set per thread; `chunks` has no thread-local state, so they are kept in a
        // pool.
        let pool: Mutex<Vec<Vec<Vec<u8>>>> = Mutex::new(Vec::new());
        let take = || pool.lock().unwrap_or_else(std::sync::PoisonError::into_inner).pop();
        pipeline::chunks(region.count, CHUNK_RECORDS, self.threads, |input, range| {
            let mut buffers = take().unwrap_or_else(|| vec![Vec::new(); counts.len()]);
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
        Ok((spill, firsts))
    }

    fn advance(&self, records: usize) {
        let done = self.done.fetch_add(records as u64, Ordering::Relaxed) + records as u64;
        self.context.progress(self.stage, done / self.passes, self.total);
    }
}

/// Number of records that a thread reads at a time.
const CHUNK_RECORDS: u64 = 8192;
/// Number of 10-bit windows of a 60-bit Hilbert code.
const CODE_WINDOWS: u32 = 6;
const WINDOW_CELLS: usize = 1024;

impl Records {
    fn sort(&mut self) {
        let (bytes, stride) = (&self.bytes, self.stride);
        let record = |e: &Entry| &bytes[e.index as usize * stride..(e.index as usize + 1) * stride];
        self.entries.sort_unstable_by(|a, b| a.key.cmp(&b.key).then_with(|| record(a).cmp(record(b))));
    }
}

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
        let entries: Vec<Entry> = (self.carry.chunks_exact(stride).take(count).enumerate())
            .map(|(index, record)| Entry { key: partition.keys.key(record), index: index as u32 })
            .collect();
        let piece = self.pack.own(Sorted { bytes: &self.carry, entries: &entries, stride });
        partition.context.check()?;
        self.carry.drain(..count * stride);
        partition.advance(count);
        out.own(piece)
    }
}

/// Opens and closes nodes; ignores stretches of points.
fn structure<P>(event: &Event, out: &mut impl Assemble<P>) -> Result<(), BuildError> {
    match event {
        Event::Open(cell) => {
            out.open(*cell);
            Ok(())
        }
        Event::Close => out.close(),
        Event::Own { .. } | Event::Subtree { .. } => Ok(()),
    }
}
