//! A disk of the paper's day, whose time is counted: an arm that seeks, and a queue in the order of
//! its way.

use std::cell::Cell;
use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::PathBuf;
use std::rc::Rc;

use crate::disk::{Disk, Extent, Ticket};
use crate::file_cache::{BLOCK_BYTES, FileCache, FileCaching, Job};

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

/// The arm. It takes what waits in the order of places, from where it is to the end and then from
/// the beginning: the elevator of the system's queue, for which the paper hands its reads over
/// sixteen at a time.
#[derive(Default)]
pub(crate) struct Arm {
    free_at: u64,
    head: u64,
    next: Job,
    /// By place: bytes, and when it was asked for.
    queue: BTreeMap<(u64, Job), (usize, u64)>,
    /// Where jobs are in the queue.
    places: HashMap<Job, u64>,
    last_asked: u64,
    /// When jobs ended, of those that ended lately.
    ended: HashMap<Job, u64>,
}

impl Arm {
    /// Where the ends of more jobs are known, those in the past are forgotten.
    const REMEMBERED: usize = 1 << 12;

    pub(crate) fn submit(&mut self, place: u64, bytes: usize, now: u64) -> Job {
        let job = self.next;
        self.next += 1;
        self.queue.insert((place, job), (bytes, now));
        self.places.insert(job, place);
        self.last_asked = now;
        job
    }

    /// Nanoseconds of a read from where the arm is. What lies a little ahead turns to the arm
    /// sooner than a seek would take.
    fn duration(&self, place: u64, bytes: usize) -> u64 {
        let pass = |bytes: u64| bytes * 1_000_000_000 / SimulatedDisk::BYTES_PER_SECOND;
        let ahead = place.checked_sub(self.head).map_or(u64::MAX, |gap| pass(gap.min(1 << 30)));
        ahead.min(SimulatedDisk::SEEK_NANOSECONDS) + pass(bytes as u64)
    }

    /// Does the next job, if it begins by `latest`.
    fn step(&mut self, latest: u64) -> bool {
        // Only an arm that had nothing to do can be free before the last was asked for.
        let first_asked = match self.free_at < self.last_asked {
            true => self.queue.values().map(|&(_, asked)| asked).min(),
            false => Some(0),
        };
        let Some(first_asked) = first_asked else { return false };
        let begins = self.free_at.max(first_asked);
        if begins > latest {
            return false;
        }
        let is_there = |(_, (_, asked)): &(&(u64, Job), &(usize, u64))| *asked <= begins;
        let ahead = self.queue.range((self.head, 0)..).find(is_there);
        let Some((&key, &(bytes, _))) = ahead.or_else(|| self.queue.iter().find(is_there)) else {
            return false;
        };
        self.queue.remove(&key);
        let (place, job) = key;
        self.places.remove(&job);
        self.free_at = begins + self.duration(place, bytes);
        self.head = place + bytes as u64;
        self.ended.insert(job, self.free_at);
        true
    }

    /// Does what begins by a time.
    pub(crate) fn run_until(&mut self, now: u64) {
        while self.free_at <= now && self.step(now) {}
        if self.ended.len() > Self::REMEMBERED {
            self.ended.retain(|_, end| *end > now);
        }
    }

    /// When a job ends if nothing else is asked for.
    pub(crate) fn end_of(&mut self, job: Job) -> u64 {
        while self.places.contains_key(&job) && self.step(u64::MAX) {}
        // Those that are forgotten ended long ago.
        self.ended.get(&job).copied().unwrap_or(0)
    }

    fn has_ended(&self, job: Job, now: u64) -> bool {
        !self.places.contains_key(&job) && self.ended.get(&job).is_none_or(|end| *end <= now)
    }
}

struct Pending {
    extent: Extent,
    jobs: Vec<Job>,
}

/// A disk with an arm, as the paper has it: 8 ms a seek, 50 MB/s, one read after another.
///
/// A place at most 400 kB ahead of the arm, less than a turn of such a disk, passes under it sooner
/// than it seeks.
pub struct SimulatedDisk {
    files: Vec<File>,
    lengths: Vec<u64>,
    /// Where each file lies on the disk: at a block.
    starts: Vec<u64>,
    clock: Clock,
    arm: Arm,
    cache: Option<FileCache>,
    /// Whether a file is read through the cache: nodes, secondary records, points.
    is_cached: [bool; 3],
    next: Ticket,
    pending: HashMap<Ticket, Pending>,
    stalled_nanoseconds: u64,
}

impl SimulatedDisk {
    /// A seek.
    pub const SEEK_NANOSECONDS: u64 = 8_000_000;
    /// Bytes in a second.
    pub const BYTES_PER_SECOND: u64 = 50_000_000;

    /// Over files that lie one behind the other, read past any cache.
    ///
    /// # Errors
    /// What the system says.
    pub fn open(paths: &[PathBuf], clock: Clock) -> io::Result<Self> {
        let files: Vec<File> = paths.iter().map(File::open).collect::<io::Result<_>>()?;
        let (mut starts, mut lengths) = (Vec::new(), Vec::new());
        let mut end: u64 = 0;
        for file in &files {
            let length = file.metadata()?.len();
            starts.push(end);
            lengths.push(length);
            end = (end + length).next_multiple_of(BLOCK_BYTES);
        }
        Ok(Self {
            files,
            lengths,
            starts,
            clock,
            arm: Arm::default(),
            cache: None,
            is_cached: [true; 3],
            next: 0,
            pending: HashMap::new(),
            stalled_nanoseconds: 0,
        })
    }

    /// The same, below a file cache of the system.
    #[must_use]
    pub fn with_file_cache(mut self, caching: FileCaching) -> Self {
        self.cache = (caching.bytes >= BLOCK_BYTES).then(|| FileCache::new(caching));
        self.is_cached = [true, true, !caching.not_points];
        self
    }

    /// The jobs that bring an extent.
    fn ask(&mut self, extent: Extent) -> Vec<Job> {
        let (start, now) = (self.starts[extent.file], self.clock.now());
        let place = start + extent.offset;
        let arm = &mut self.arm;
        let is_cached = self.is_cached.get(extent.file).copied().unwrap_or(true);
        let Some(cache) = self.cache.as_mut().filter(|_| is_cached) else {
            return vec![arm.submit(place, extent.bytes, now)];
        };
        let blocks = |from: u64, bytes: u64| from / BLOCK_BYTES..(from + bytes).div_ceil(BLOCK_BYTES);
        let (wanted, file) = (blocks(place, extent.bytes as u64), blocks(start, self.lengths[extent.file]));
        cache.bring(wanted, file, |run| {
            arm.submit(run.start * BLOCK_BYTES, ((run.end - run.start) * BLOCK_BYTES) as usize, now)
        })
    }
}

impl Disk for SimulatedDisk {
    fn submit(&mut self, batch: &[Extent]) -> Vec<Ticket> {
        self.arm.run_until(self.clock.now());
        let first = self.next;
        for &extent in batch {
            let jobs = self.ask(extent);
            self.pending.insert(self.next, Pending { extent, jobs });
            self.next += 1;
        }
        (first..self.next).collect()
    }

    fn wait(&mut self, ticket: Ticket) -> io::Result<Vec<u8>> {
        let gone = || io::Error::other("the read was never asked for");
        let Pending { extent, jobs } = self.pending.remove(&ticket).ok_or_else(gone)?;
        let ends = jobs.into_iter().map(|job| self.arm.end_of(job)).max().unwrap_or(0);
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
        let now = self.clock.now();
        self.arm.run_until(now);
        self.pending.get(&ticket).is_some_and(|p| p.jobs.iter().all(|&job| self.arm.has_ended(job, now)))
    }

    fn length(&self, file: usize) -> u64 {
        self.lengths.get(file).copied().unwrap_or(0)
    }

    fn stalled_nanoseconds(&self) -> u64 {
        self.stalled_nanoseconds
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write as _;

    use super::*;

    const FAR: u64 = 10_000_000;

    fn disk() -> (SimulatedDisk, Clock, Vec<u8>, tempfile::NamedTempFile) {
        let mut file = tempfile::NamedTempFile::new().expect("a file");
        let bytes: Vec<u8> = (0..FAR + 100_000).map(|i| (i % 251) as u8).collect();
        file.write_all(&bytes).expect("a write");
        let clock = Clock::default();
        let disk = SimulatedDisk::open(&[file.path().to_owned()], clock.clone()).expect("it opens");
        (disk, clock, bytes, file)
    }

    fn extent(offset: u64, bytes: usize) -> Extent {
        Extent { file: 0, offset, bytes }
    }

    #[test]
    fn the_arm_takes_reads_in_the_order_of_places_and_what_lies_ahead_turns_to_it() {
        let (mut disk, clock, bytes, _file) = disk();
        let tickets = disk.submit(&[extent(FAR + 1500, 500), extent(FAR + 1000, 400)]);
        assert_eq!(disk.wait(tickets[1]).expect("bytes"), &bytes[FAR as usize + 1000..FAR as usize + 1400]);
        assert_eq!(clock.now(), 8_000_000 + 8_000);
        assert_eq!(disk.wait(tickets[0]).expect("bytes"), &bytes[FAR as usize + 1500..FAR as usize + 2000]);
        assert_eq!(clock.now(), 8_000_000 + 20_000, "the gap of 100 bytes passes at 50 MB/s");
        let back = disk.submit(&[extent(FAR, 50)]);
        disk.wait(back[0]).expect("bytes");
        assert_eq!(clock.now(), 16_000_000 + 21_000, "backward is a seek");
    }

    #[test]
    fn what_is_asked_for_early_enough_costs_no_time() {
        let (mut disk, clock, bytes, _file) = disk();
        let early = disk.submit(&[extent(50_000, 50)]);
        assert!(!disk.is_done(early[0]));
        clock.advance(20_000_000);
        assert!(disk.is_done(early[0]));
        assert_eq!(disk.wait(early[0]).expect("bytes"), &bytes[50_000..50_050]);
        assert_eq!((disk.stalled_nanoseconds(), clock.now()), (0, 20_000_000));
        // The disk was idle; it cannot begin before it is asked.
        let late = disk.submit(&[extent(FAR, 50)]);
        disk.wait(late[0]).expect("bytes");
        assert_eq!(clock.now(), 28_001_000);
    }

    #[test]
    fn a_file_cache_brings_blocks_keeps_the_last_used_and_forgets_the_others() {
        let (disk, clock, bytes, _file) = disk();
        let mut disk = disk.with_file_cache(FileCaching::by_blocks(2 * BLOCK_BYTES));
        let mut cost = |offset: u64| {
            let before = clock.now();
            let ticket = disk.submit(&[extent(offset, 16)])[0];
            assert_eq!(disk.wait(ticket).expect("bytes"), &bytes[offset as usize..offset as usize + 16]);
            clock.now() - before
        };
        assert!(cost(FAR) > 8_000_000);
        assert_eq!(cost(FAR + 40), 0, "the same block");
        assert!(cost(1_000_000) > 8_000_000);
        assert_eq!(cost(FAR), 0);
        assert!(cost(5_000_000) > 0, "a third block");
        assert_eq!(cost(FAR), 0, "used later than the other");
        assert!(cost(1_000_000) > 0, "driven out");
    }
}
