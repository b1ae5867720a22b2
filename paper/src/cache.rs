//! A record cache: records of one size in memory, found by the lowest bits of their number,
//! retained and released, and driven out by priority (sections 4.2 and 4.4 of the paper).

use std::collections::{HashMap, VecDeque};
use std::io;

use crate::disk::{Disk, Extent, Ticket};

/// A place in the cache.
pub type Slot = u32;

/// No place.
const NO_SLOT: Slot = Slot::MAX;

/// What a cache takes for each record besides its bytes: its state and its chain.
pub const OVERHEAD_BYTES: usize = size_of::<Entry>() + 2 * size_of::<Slot>();

/// What a cache did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct CacheCounts {
    /// Records asked for that were there.
    pub hits: u64,
    /// That were on their way, and waited for.
    pub late: u64,
    /// That had to be fetched.
    pub misses: u64,
    /// Records asked for ahead of their use.
    pub prefetched: u64,
    /// Of these, used later.
    pub prefetched_used: u64,
    /// Reads.
    pub reads: u64,
    /// Bytes of them.
    pub bytes: u64,
    /// Records driven out.
    pub evictions: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Free,
    /// Part of a read, which [`RecordCache::on_their_way`] knows.
    Loading,
    Resident,
}

#[derive(Clone, Copy, Debug)]
struct Entry {
    record: u64,
    /// The next place of the same chain.
    next: Slot,
    /// Neighbours in the order of eviction, where it stands there.
    before: Slot,
    behind: Slot,
    retained: u32,
    priority: u8,
    state: State,
    /// Brought in ahead, and not used yet.
    ahead: bool,
    /// Whether it stands in the order of eviction.
    is_queued: bool,
}

const FREE: Entry = Entry {
    record: 0,
    next: NO_SLOT,
    before: NO_SLOT,
    behind: NO_SLOT,
    retained: 0,
    priority: 0,
    state: State::Free,
    ahead: false,
    is_queued: false,
};

/// The records of one priority that may go, the least recently used first.
#[derive(Clone, Copy, Debug)]
struct Queue {
    first: Slot,
    last: Slot,
}

/// Reads that more than one record waits for.
struct Arrived {
    bytes: Vec<u8>,
    waiting: usize,
}

/// Why a record cannot be had.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CacheError {
    /// The disk.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// The index leads to where it does not reach.
    #[error(
        "the index is damaged: it leads to {bytes} bytes at {at}, beyond its end at {end}; build it again"
    )]
    Beyond {
        /// Where.
        at: u64,
        /// How many.
        bytes: usize,
        /// Where the index ends.
        end: u64,
    },
    /// A node does not lie in the one that leads to it.
    #[error(
        "the index is damaged: node {child} does not lie in node {parent}, which leads to it; build it again"
    )]
    Tangled {
        /// The node.
        child: u64,
        /// What leads to it.
        parent: u64,
    },
    /// Every place is retained or on its way.
    #[error("a cache of {records} records is too small: all of them are needed at once")]
    Full {
        /// Places.
        records: usize,
    },
}

/// Records of a file in memory.
pub struct RecordCache {
    file: usize,
    record_bytes: usize,
    /// Records that stand together on disk and are read together.
    group: u64,
    /// Places that may be taken. There are more where a larger cache was made smaller while they
    /// were in use.
    limit: usize,
    entries: Vec<Entry>,
    bytes: Vec<u8>,
    /// The first place of each chain.
    buckets: Vec<Slot>,
    free: Vec<Slot>,
    /// Residents that nobody retains, by priority.
    queues: [Queue; 256],
    /// Queues below this are empty.
    least_queue: usize,
    /// The read of each record on its way, and where in its bytes the record is.
    on_their_way: HashMap<Slot, (Ticket, usize)>,
    arrived: HashMap<Ticket, Arrived>,
    /// Places that are on their way, first asked for first.
    loading: VecDeque<Slot>,
    counts: CacheCounts,
}

impl RecordCache {
    /// A cache of `capacity` records over a file of a disk; records are read in groups of `group`.
    #[must_use]
    pub fn new(file: usize, record_bytes: usize, group: u64, capacity: usize) -> Self {
        let mut cache = Self {
            file,
            record_bytes,
            group,
            limit: 0,
            entries: Vec::new(),
            bytes: Vec::new(),
            buckets: Vec::new(),
            free: Vec::new(),
            queues: [Queue { first: NO_SLOT, last: NO_SLOT }; 256],
            least_queue: 256,
            on_their_way: HashMap::new(),
            arrived: HashMap::new(),
            loading: VecDeque::new(),
            counts: CacheCounts::default(),
        };
        cache.set_capacity(capacity);
        cache
    }

    /// Changes the number of records, also while it is in use: what is retained or on its way
    /// stays.
    pub fn set_capacity(&mut self, capacity: usize) {
        let capacity = capacity.max(1);
        self.limit = capacity;
        self.shrink();
        // Places that are in use keep their numbers.
        let used = |cache: &Self| {
            let last =
                (0..cache.entries.len()).rev().find(|&i| !matches!(cache.entries[i].state, State::Free));
            last.map_or(0, |last| last + 1)
        };
        let places = capacity.max(used(self));
        self.entries.resize(places, FREE);
        self.loading.retain(|&slot| (slot as usize) < places);
        self.bytes.resize(places * self.record_bytes, 0);
        self.free =
            (0..places as Slot).rev().filter(|&s| matches!(self.entry(s).state, State::Free)).collect();
        self.buckets = vec![NO_SLOT; places.next_power_of_two()];
        for slot in 0..places as Slot {
            if !matches!(self.entry(slot).state, State::Free) {
                self.link(slot);
            }
        }
    }

    /// What has happened so far.
    #[must_use]
    pub fn counts(&self) -> CacheCounts {
        self.counts
    }

    /// Records that it holds at most.
    #[must_use]
    pub fn capacity(&self) -> usize {
        self.limit
    }

    /// Records that it holds or waits for.
    #[must_use]
    pub fn resident(&self) -> usize {
        self.entries.len() - self.free.len()
    }

    fn entry(&self, slot: Slot) -> &Entry {
        &self.entries[slot as usize]
    }

    /// The lowest bits of the number are the hash: records that follow each other never collide.
    fn bucket(&self, record: u64) -> usize {
        (record & (self.buckets.len() as u64 - 1)) as usize
    }

    fn find(&self, record: u64) -> Option<Slot> {
        let mut slot = self.buckets[self.bucket(record)];
        while slot != NO_SLOT {
            let entry = self.entry(slot);
            if entry.record == record {
                return Some(slot);
            }
            slot = entry.next;
        }
        None
    }

    fn link(&mut self, slot: Slot) {
        let bucket = self.bucket(self.entry(slot).record);
        self.entries[slot as usize].next = std::mem::replace(&mut self.buckets[bucket], slot);
    }

    fn unlink(&mut self, slot: Slot) {
        let (bucket, next) = (self.bucket(self.entry(slot).record), self.entry(slot).next);
        if self.buckets[bucket] == slot {
            self.buckets[bucket] = next;
            return;
        }
        let mut before = self.buckets[bucket];
        while before != NO_SLOT {
            let entry = &mut self.entries[before as usize];
            if entry.next == slot {
                entry.next = next;
                return;
            }
            before = entry.next;
        }
    }

    /// Whether a record is in memory or on its way.
    #[must_use]
    pub fn is_known(&self, record: u64) -> bool {
        self.find(record).is_some()
    }

    /// The place of a record that is in memory now, or whose read has ended.
    ///
    /// # Errors
    /// [`CacheError::Io`] where that read failed.
    pub fn peek(&mut self, disk: &mut dyn Disk, record: u64) -> Result<Option<Slot>, CacheError> {
        let Some(slot) = self.find(record) else { return Ok(None) };
        if let Some(&(ticket, _)) = self.on_their_way.get(&slot) {
            let known = self.arrived.get(&ticket).is_some_and(|a| !a.bytes.is_empty());
            if !known && !disk.is_done(ticket) {
                return Ok(None);
            }
            self.arrive(disk, slot)?;
        }
        Ok(Some(slot))
    }

    /// The bytes of a record that is retained, or has just been found.
    #[must_use]
    pub fn bytes(&self, slot: Slot) -> &[u8] {
        let from = slot as usize * self.record_bytes;
        &self.bytes[from..from + self.record_bytes]
    }

    /// Retains a record, fetching it if need be.
    ///
    /// # Errors
    /// [`CacheError`] where it cannot be read, or has no room.
    pub fn retain(&mut self, disk: &mut dyn Disk, record: u64, priority: u8) -> Result<Slot, CacheError> {
        let slot = match self.find(record) {
            Some(slot) => {
                // A read that has ended need not have been seen to.
                if self.peek(disk, record)?.is_some() {
                    self.counts.hits += 1;
                } else {
                    self.counts.late += 1;
                    self.arrive(disk, slot)?;
                }
                slot
            }
            None => {
                let end = self.end(disk);
                if record >= end {
                    let (width, bytes) = (self.record_bytes as u64, self.record_bytes);
                    return Err(CacheError::Beyond {
                        at: record.saturating_mul(width),
                        bytes,
                        end: end * width,
                    });
                }
                self.counts.misses += 1;
                self.fetch(disk, record, priority)?
            }
        };
        self.unqueue(slot);
        let entry = &mut self.entries[slot as usize];
        entry.retained += 1;
        entry.priority = entry.priority.max(priority);
        self.counts.prefetched_used += u64::from(std::mem::take(&mut entry.ahead));
        Ok(slot)
    }

    /// Gives a record back. It stays; its priority decays.
    pub fn release(&mut self, slot: Slot) {
        let entry = &mut self.entries[slot as usize];
        entry.retained -= 1;
        if entry.retained == 0 {
            entry.priority /= 2;
            self.queue(slot);
            self.shrink();
        }
    }

    /// Drives out what is too much in a cache that was made smaller while its records were in use.
    fn shrink(&mut self) {
        while self.resident() > self.limit
            && let Some(slot) = self.evict(u8::MAX)
        {
            self.free.push(slot);
        }
    }

    /// Puts a resident that nobody retains at the end of those of its priority.
    fn queue(&mut self, slot: Slot) {
        self.unqueue(slot);
        let priority = usize::from(self.entry(slot).priority);
        self.least_queue = self.least_queue.min(priority);
        let queue = &mut self.queues[priority];
        let before = std::mem::replace(&mut queue.last, slot);
        if before == NO_SLOT {
            queue.first = slot;
        } else {
            self.entries[before as usize].behind = slot;
        }
        let entry = &mut self.entries[slot as usize];
        (entry.before, entry.behind, entry.is_queued) = (before, NO_SLOT, true);
    }

    /// Takes it out of there, if it is there.
    fn unqueue(&mut self, slot: Slot) {
        let Entry { before, behind, priority, is_queued, .. } = *self.entry(slot);
        if !is_queued {
            return;
        }
        self.entries[slot as usize].is_queued = false;
        let queue = &mut self.queues[priority as usize];
        match before {
            NO_SLOT => queue.first = behind,
            before => self.entries[before as usize].behind = behind,
        }
        match behind {
            NO_SLOT => queue.last = before,
            behind => self.entries[behind as usize].before = before,
        }
    }

    /// Asks for records that will be wanted, those that are absent with one call of at most `batch`
    /// reads each time.
    ///
    /// # Errors
    /// [`CacheError::Io`] where an earlier read failed.
    pub fn prefetch(
        &mut self,
        disk: &mut dyn Disk,
        records: &[u64],
        priority: u8,
        batch: usize,
    ) -> Result<(), CacheError> {
        self.settle(disk, false)?;
        let mut wanted: Vec<Vec<(u64, Slot)>> = Vec::new();
        // More than a part of what it holds would only drive each other out.
        let most = (self.limit / 2).max(self.group as usize);
        let mut placed = 0;
        'records: for &record in records {
            if placed >= most {
                break;
            }
            if self.is_known(record) || record >= self.end(disk) {
                continue;
            }
            let mut together = Vec::new();
            let others = self.members(disk, record).filter(|&member| member != record);
            for member in std::iter::once(record).chain(others) {
                if self.is_known(member) {
                    continue;
                }
                let Some(slot) = self.place(member, priority) else {
                    if !together.is_empty() {
                        wanted.push(together);
                    }
                    break 'records;
                };
                self.entries[slot as usize].ahead = true;
                self.counts.prefetched += 1;
                placed += 1;
                together.push((member, slot));
            }
            wanted.push(together);
        }
        wanted.iter_mut().for_each(|together| together.sort_unstable());
        wanted.retain(|together| !together.is_empty());
        for batch in wanted.chunks(batch.max(1)) {
            self.submit(disk, batch);
        }
        Ok(())
    }

    /// The records that are read together with one.
    fn members(&self, disk: &dyn Disk, record: u64) -> std::ops::Range<u64> {
        let first = record / self.group * self.group;
        first..first.saturating_add(self.group).min(self.end(disk))
    }

    /// Records of the file.
    fn end(&self, disk: &dyn Disk) -> u64 {
        disk.length(self.file) / self.record_bytes as u64
    }

    /// Starts one read for each group of records.
    fn submit(&mut self, disk: &mut dyn Disk, groups: &[Vec<(u64, Slot)>]) {
        let width = self.record_bytes;
        let extents: Vec<Extent> = groups
            .iter()
            .filter_map(|group| {
                let (first, last) = (group.first()?.0, group.last()?.0);
                let bytes = (last - first + 1) as usize * width;
                Some(Extent { file: self.file, offset: first * width as u64, bytes })
            })
            .collect();
        self.counts.reads += extents.len() as u64;
        self.counts.bytes += extents.iter().map(|e| e.bytes as u64).sum::<u64>();
        let tickets = disk.submit(&extents);
        for (group, ticket) in groups.iter().zip(tickets) {
            let first = group[0].0;
            self.arrived.insert(ticket, Arrived { bytes: Vec::new(), waiting: group.len() });
            for &(record, slot) in group {
                let at = (record - first) as usize * width;
                self.entries[slot as usize].state = State::Loading;
                self.on_their_way.insert(slot, (ticket, at));
                self.loading.push_back(slot);
            }
        }
    }

    /// Fetches a record that somebody waits for, with those that stand beside it as far as there is
    /// room.
    fn fetch(&mut self, disk: &mut dyn Disk, record: u64, priority: u8) -> Result<Slot, CacheError> {
        let slot = match self.place(record, u8::MAX) {
            Some(slot) => slot,
            None => {
                self.settle(disk, true)?;
                self.place(record, u8::MAX).ok_or(CacheError::Full { records: self.capacity() })?
            }
        };
        self.entries[slot as usize].priority = priority;
        let mut together = vec![(record, slot)];
        // Its own place must not be taken for its neighbours.
        self.entries[slot as usize].retained = 1;
        for member in self.members(disk, record).filter(|&member| member != record) {
            if !self.is_known(member)
                && let Some(slot) = self.place(member, priority)
            {
                self.entries[slot as usize].ahead = true;
                self.counts.prefetched += 1;
                together.push((member, slot));
            }
        }
        together.sort_unstable();
        self.submit(disk, std::slice::from_ref(&together));
        for &(_, arriving) in &together {
            self.arrive(disk, arriving)?;
        }
        let entry = &mut self.entries[slot as usize];
        entry.retained = 0;
        self.queue(slot);
        self.settle(disk, false)?;
        Ok(slot)
    }

    /// Waits for the record of a place that is on its way.
    fn arrive(&mut self, disk: &mut dyn Disk, slot: Slot) -> Result<(), CacheError> {
        let Some(&(ticket, at)) = self.on_their_way.get(&slot) else { return Ok(()) };
        if let Some(arrived) = self.arrived.get_mut(&ticket)
            && arrived.bytes.is_empty()
        {
            arrived.bytes = disk.wait(ticket)?;
        }
        let Some(arrived) = self.arrived.get_mut(&ticket) else { return Ok(()) };
        let to = slot as usize * self.record_bytes;
        self.bytes[to..to + self.record_bytes].copy_from_slice(&arrived.bytes[at..at + self.record_bytes]);
        arrived.waiting -= 1;
        if arrived.waiting == 0 {
            self.arrived.remove(&ticket);
        }
        self.on_their_way.remove(&slot);
        let entry = &mut self.entries[slot as usize];
        entry.state = State::Resident;
        if entry.retained == 0 {
            self.queue(slot);
        }
        Ok(())
    }

    /// Completes reads, first asked for first: all of them where `waits`, else those that have
    /// ended.
    fn settle(&mut self, disk: &mut dyn Disk, waits: bool) -> Result<(), CacheError> {
        while let Some(&slot) = self.loading.front() {
            if let Some(&(ticket, _)) = self.on_their_way.get(&slot) {
                let known = self.arrived.get(&ticket).is_some_and(|a| !a.bytes.is_empty());
                if !waits && !known && !disk.is_done(ticket) {
                    return Ok(());
                }
                self.arrive(disk, slot)?;
            }
            self.loading.pop_front();
        }
        Ok(())
    }

    /// A place for a record, if need be that of one of a lower priority, or of the same and used
    /// longer ago.
    fn place(&mut self, record: u64, priority: u8) -> Option<Slot> {
        self.shrink();
        let free = if self.resident() < self.limit { self.free.pop() } else { None };
        let slot = match free {
            Some(slot) => slot,
            None => self.evict(priority)?,
        };
        self.entries[slot as usize] = Entry { record, state: State::Loading, priority, ..FREE };
        self.link(slot);
        Some(slot)
    }

    /// Drives out the record of least priority, the least recently used among equals, if that is at
    /// most `priority`.
    fn evict(&mut self, priority: u8) -> Option<Slot> {
        let rest = &self.queues[self.least_queue..];
        self.least_queue += rest.iter().take_while(|queue| queue.first == NO_SLOT).count();
        let least =
            self.queues.get(self.least_queue).filter(|_| self.least_queue <= usize::from(priority))?;
        let slot = least.first;
        self.unqueue(slot);
        self.unlink(slot);
        self.entries[slot as usize].state = State::Free;
        self.counts.evictions += 1;
        Some(slot)
    }
}

#[cfg(test)]
mod tests;
